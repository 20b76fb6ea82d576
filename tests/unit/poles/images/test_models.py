import hashlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from roadsight.base.errors import InputError
from roadsight.io.images.models import open_model, read_label_map
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.networks import (
    SILENT,
    LabelMap,
    Labels,
    Manifest,
    Size,
    class_mask,
    downward_trend,
    folder_mask,
    inverse_depth,
    merge_masks,
    packed_depth,
    tensor_of,
)
from tests.helpers.onnx_bytes import external, network, node, pointwise, queries, value

ANY = ("height", "width")
COLOURS = np.eye(3, dtype=np.float32)


def write(folder: Path, network: bytes, **changes) -> Path:
    (folder / "tiny.onnx").write_bytes(network)
    content = {
        "task": "classes", "file": "tiny.onnx",
        "input": {"colour": "BGR", "size": {"multiple_of": 4}}, "output": {"kind": "logits"},
        "labels": 3, "classes": {0: "road", 2: "pole"},
    } | changes  # fmt: skip
    path = folder / "tiny.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in content.items() if v is not None}))
    return path


def run(path: Path, image: np.ndarray) -> np.ndarray:
    model = open_model(path)
    tensor = tensor_of(image, model.manifest.input)
    outputs = model.session.run(list(model.output_names), {model.input_name: tensor})
    return class_mask(outputs, model.manifest, image.shape[:2], str(path))


def three_colours() -> np.ndarray:
    image = np.zeros((8, 12, 3), np.uint8)
    for channel in range(3):
        image[:, 4 * channel : 4 * channel + 4, channel] = 200
    return image


@pytest.mark.parametrize("labels", [False, True])
def test_pixels_get_the_class_of_the_largest_logit(tmp_path, labels):
    kind = "labels" if labels else "logits"
    path = write(tmp_path, pointwise(COLOURS, ANY, labels), output={"kind": kind})
    expected = np.repeat([PixelClass.ROAD, SILENT, PixelClass.POLE], 4)
    assert (run(path, three_colours()) == expected).all()


def test_colour_order_is_that_of_the_manifest(tmp_path):
    bgr = write(tmp_path, pointwise(COLOURS, ANY))
    assert run(bgr, three_colours())[0, 0] == PixelClass.ROAD
    rgb = write(
        tmp_path, pointwise(COLOURS, ANY), input={"colour": "RGB", "size": {"multiple_of": 4}}
    )
    assert run(rgb, three_colours())[0, 0] == PixelClass.POLE


def test_values_are_divided_shifted_and_scaled_by_channel(tmp_path):
    spec = {
        "colour": "RGB", "size": {"multiple_of": 4}, "divide_by": 255, "mean": [0.1, 0.2, 0.3],
        "std": [0.5, 0.25, 2.0],
    }  # fmt: skip
    model = open_model(write(tmp_path, pointwise(COLOURS, ANY), input=spec))
    image = np.random.default_rng(0).integers(0, 256, (8, 12, 3), np.uint8)
    found = tensor_of(image, model.manifest.input)
    rgb = image[..., ::-1] / 255.0
    expected = ((rgb - [0.1, 0.2, 0.3]) / [0.5, 0.25, 2.0]).transpose(2, 0, 1)[None]
    assert found.shape == (1, 3, 8, 12)
    assert np.allclose(found, expected, atol=1e-5)


def test_query_masks_are_combined_as_published(tmp_path, rng):
    masks = rng.normal(0, 0.05, (5, 3))
    classes = rng.normal(0, 0.5, (5, 4)) + 4 * np.eye(5, 4)[[0, 1, 2, 3, 0]]
    path = write(
        tmp_path,
        queries(masks, classes, ANY),
        output={"kind": "query_masks", "names": ["class_logits", "mask_logits"]},
        classes={0: "road", 1: "sign", 2: "pole"},
    )
    image = rng.integers(0, 256, (8, 12, 3), np.uint8)
    share = np.exp(classes) / np.exp(classes).sum(axis=1, keepdims=True)
    best = np.empty((8, 12), int)
    for row in range(8):
        for column in range(12):
            inside = 1 / (1 + np.exp(-(masks @ image[row, column].astype(float))))
            best[row, column] = np.argmax([(share[:, k] * inside).sum() for k in range(3)])
    expected = np.array([PixelClass.ROAD, PixelClass.SIGN, PixelClass.POLE])[best]
    assert (run(path, image) == expected).all()
    assert len(np.unique(expected)) > 1


def refused(path: Path, *words: str) -> None:
    with pytest.raises(InputError) as error:
        open_model(path)
    for word in words:
        assert word in str(error.value)


def test_a_manifest_that_does_not_match_its_network_is_refused(tmp_path):
    fixed = pointwise(COLOURS, (8, 12))
    size = {"colour": "BGR", "size": {"height_px": 8, "width_px": 16}}
    refused(write(tmp_path, fixed, input=size), "1 x 3 x 8 x 12", "1 x 3 x 8 x 16")
    refused(write(tmp_path, fixed), "1 x 3 x 8 x 12", "any x any")
    refused(write(tmp_path, pointwise(COLOURS, ANY), labels=4), "found 4", "allowed: 3")
    two = queries(COLOURS, np.zeros((3, 4)), ANY)
    refused(write(tmp_path, two), "1 output", "class_logits, mask_logits")
    named = {"kind": "logits", "names": ["nothing"]}
    refused(write(tmp_path, pointwise(COLOURS, ANY), output=named), "nothing", "logits")
    refused(
        write(tmp_path, pointwise(COLOURS, ANY, labels=True)), "cannot be logits", "tensor(int64)"
    )
    query = {"kind": "query_masks", "names": ["class_logits", "mask_logits"]}
    refused(write(tmp_path, two, output=query, labels=4), "found 4", "allowed: 3")
    depth = {"task": "relative_depth", "labels": None, "classes": None}
    refused(
        write(tmp_path, pointwise(COLOURS, ANY, True), output={"kind": "depth"}, **depth),
        "cannot be depth",
    )


def test_the_file_itself_is_checked(tmp_path):
    good = pointwise(COLOURS, ANY)
    path = write(tmp_path, good, sha256=hashlib.sha256(good).hexdigest())
    open_model(path)
    refused(write(tmp_path, good + b" ", sha256=hashlib.sha256(good).hexdigest()), "another file")
    refused(write(tmp_path, b"no network"), "cannot be opened")
    refused(write(tmp_path, good, file="gone.onnx"), "missing", "gone.onnx")
    refused(write(tmp_path, good, file="${NO_SUCH_VARIABLE}/a.onnx"), "NO_SUCH_VARIABLE")


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"lables": 3}, "labels"),
        ({"classes": {0: "raod"}}, "raod"),
        ({"classes": {3: "road"}}, "not below labels"),
        ({"task": "relative_depth"}, "does not fit task"),
        ({"input": {"colour": "BGR", "size": {"height_px": 8}}}, "width_px"),
        ({"labels": None}, "needs labels"),
        ({"sha256": "12"}, "sha256"),
    ],
)
def test_malformed_manifests_are_refused(tmp_path, changes, word):
    refused(write(tmp_path, pointwise(COLOURS, ANY), **changes), word)


def test_weights_in_a_file_beside_the_network(tmp_path):
    kernel = external("w", (3, 3, 1, 1), "tiny.onnx.data")
    ends = value("image", [1, 3, *ANY]), value("logits", [1, 3, *ANY])
    content = network([node("Conv", ["image", "w"], "logits")], [kernel], [ends[0]], [ends[1]])
    (tmp_path / "tiny.onnx.data").write_bytes(COLOURS.tobytes())
    found = run(write(tmp_path, content), three_colours())
    np.testing.assert_array_equal(
        found, run(write(tmp_path, pointwise(COLOURS, ANY)), three_colours())
    )
    both = hashlib.sha256(content + COLOURS.tobytes()).hexdigest()
    open_model(write(tmp_path, content, sha256=both))
    (tmp_path / "tiny.onnx.data").write_bytes(COLOURS[::-1].tobytes())
    with pytest.raises(InputError, match="another file"):
        open_model(write(tmp_path, content, sha256=both))
    (tmp_path / "tiny.onnx.data").unlink()
    with pytest.raises(InputError, match=r"weights are missing.*tiny\.onnx\.data"):
        open_model(write(tmp_path, content))


def test_size_of_the_input_keeps_the_shape_of_the_image():
    assert Size(multiple_of=32).of(375, 1242) == (384, 1248)
    assert Size(multiple_of=32, height_px=512).of(1200, 2356) == (512, 992)
    assert Size(multiple_of=32, height_px=512).of(1200, 2356, 256) == (256, 512)
    assert Size(multiple_of=32).of(3, 5) == (32, 32)
    assert Size(height_px=512, width_px=896).of(375, 1242, 256) == (512, 896)


def test_logits_of_another_size_are_enlarged_before_the_largest_is_taken(rng):
    manifest = Manifest.model_validate(
        {
            "task": "classes", "file": "x", "labels": 3, "output": {"kind": "logits"},
            "input": {"colour": "BGR", "size": {"multiple_of": 4}},
            "classes": {0: "road", 1: "sign", 2: "pole"},
        }
    )  # fmt: skip
    logits = rng.normal(0, 1, (1, 3, 5, 7)).astype(np.float32)
    full = np.stack([cv2.resize(one, (28, 20)) for one in logits[0]])
    expected = manifest.lookup()[np.argmax(full, axis=0)]
    assert (class_mask([logits], manifest, (20, 28), "x") == expected).all()
    with pytest.raises(InputError, match="labels"):
        class_mask([logits[:, :2]], manifest, (20, 28), "x")


def test_later_sources_replace_with_their_own_classes_only():
    first = Labels(labels=3, classes={0: "road", 1: "pole", 2: "vegetation"})
    second = Labels(labels=2, classes={1: "marking"}, over=("road",))
    a = np.array([[0, 1, 2, 0]], np.uint8)
    b = np.array([[1, 1, 1, 0]], np.uint8)
    masks = [folder_mask(a, first, (1, 4), "a"), folder_mask(b, second, (1, 4), "b")]
    merged = merge_masks(masks, [first, second])
    expected = [PixelClass.MARKING, PixelClass.POLE, PixelClass.VEGETATION, PixelClass.ROAD]
    assert merged.tolist() == [expected]
    nothing = folder_mask(np.zeros((1, 4), np.uint8), second, (1, 4), "b")
    assert (merge_masks([nothing], [second]) == PixelClass.OTHER).all()


def test_a_label_that_is_not_in_the_map_is_refused(tmp_path):
    (tmp_path / "map.yaml").write_text("labels: 2\nclasses: {1: road}\n")
    labels = read_label_map(tmp_path / "map.yaml")
    with pytest.raises(InputError, match=r"found 7.*allowed: 0 to 1"):
        folder_mask(np.array([[0, 7]], np.uint8), labels, (1, 2), "a.png")
    (tmp_path / "map.yaml").write_text("classes: {1: road}\n")
    with pytest.raises(InputError, match="labels"):
        read_label_map(tmp_path / "map.yaml")
    assert LabelMap(labels=300, classes={299: "road"}).lookup().shape == (300,)


def depth_manifest(kind: str) -> Manifest:
    return Manifest.model_validate(
        {
            "task": "relative_depth", "file": "x", "output": {"kind": kind},
            "input": {"colour": "RGB", "size": {"multiple_of": 4}},
        }
    )  # fmt: skip


def test_depth_and_inverse_depth_end_up_the_same_way_round():
    z = np.linspace(50, 2, 40)[:, None].repeat(9, axis=1).astype(np.float32)
    for kind, values in (("depth", z), ("inverse_depth", 3.0 / z)):
        packed = packed_depth(inverse_depth([values[None, None]], depth_manifest(kind)), False)
        assert packed.dtype == np.uint16
        assert packed[-1, 0] == 65535
        assert packed[0, 0] == 1
        assert downward_trend(packed) > 0.5
        line = np.polyfit(1 / z[:, 0], packed[:, 0], 1)
        assert np.allclose(np.polyval(line, 1 / z[:, 0]), packed[:, 0], atol=2)
    wrong = packed_depth(inverse_depth([z[None]], depth_manifest("inverse_depth")), False)
    assert downward_trend(wrong) < -0.5


def test_depth_without_content_is_noticed():
    assert not packed_depth(np.full((4, 5), 3.0, np.float32), False).any()
    assert not packed_depth(np.full((4, 5), np.nan, np.float32), False).any()
    assert np.isnan(downward_trend(np.zeros((8, 5), np.uint16)))
    hole = np.arange(20, dtype=np.float32).reshape(4, 5)
    hole[1, 2] = np.nan
    packed = packed_depth(hole, False)
    assert packed[1, 2] == 0
    assert (packed > 0).sum() == 19


def test_metric_depth_keeps_its_scale():
    inverse = 1 / np.array([[0.1, 1.0, 10.0, 100.0]], np.float32)
    packed = packed_depth(inverse, True)
    back = 0.5 * 65534 / (packed[0].astype(float) - 1)
    assert np.allclose(back[1:], [1, 10, 100], rtol=0.004)
    assert packed[0, 0] == 65535


def test_manifests_of_the_project_are_valid(project):
    files = sorted((project / "resources/manifests").glob("*.yaml"))
    assert len(files) >= 8
    for file in files:
        content = yaml.safe_load(file.read_text())
        (LabelMap if file.stem.startswith("labels_") else Manifest).model_validate(content)


@pytest.mark.real
def test_a_real_network_finds_the_road_as_before(project, data):
    path = project / "resources/manifests/road_segmentation_adas_0001.yaml"
    model = open_model(path)
    folder = data / "videolog/kitti_0009"
    image = cv2.imread(str(folder / "images/0000000025.jpg"))
    tensor = tensor_of(image, model.manifest.input)
    outputs = model.session.run(list(model.output_names), {model.input_name: tensor})
    mask = class_mask(outputs, model.manifest, image.shape[:2], str(path))
    labels = read_label_map(project / "resources/manifests/labels_road.yaml")
    stored = cv2.imread(str(folder / "road_masks/0000000025.png"), cv2.IMREAD_UNCHANGED)
    expected = folder_mask(stored, labels, image.shape[:2], "stored")
    assert np.mean(mask == expected) > 0.98
