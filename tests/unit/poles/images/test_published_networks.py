import numpy as np
import pytest

from roadsight.base.texts import read_yaml
from roadsight.io.images.models import open_model
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.networks import class_mask, tensor_of
from tests.conftest import PROJECT
from tests.helpers.onnx_bytes import network, node, pointwise, value

MANIFESTS = PROJECT / "resources/manifests"
CITYSCAPES = (
    "road", "sidewalk", "building", "wall", "fence", "pole", "light", "sign", "vegetation",
    "terrain", "sky", "person", "rider", "car", "truck", "bus", "train", "motorcycle", "bicycle",
    "background",
)  # fmt: skip
"""Labels in their order ("train ids"), as the data set's own scripts list them."""
MOVING = ("person", "rider", "car", "truck", "bus", "train", "motorcycle", "bicycle")
MEANT = (
    {name: name for name in ("road", "building", "pole", "sign", "vegetation", "sky")}
    | {"wall": "building", "light": "sign"}
    | dict.fromkeys(MOVING, "vehicle")
)


@pytest.mark.parametrize(
    ("file", "labels"),
    [
        ("espnetv2_cityscapes", 20),
        ("bisenet_cityscapes", 19),
        ("segformer_cityscapes", 19),
        ("labels_cityscapes", 20),
    ],
)
def test_cityscapes_labels_are_what_their_names_mean(file, labels):
    content = read_yaml(MANIFESTS / f"{file}.yaml")
    assert content["labels"] == labels
    assert {CITYSCAPES[number]: kind for number, kind in content["classes"].items()} == MEANT


def copied(folder, name: str, content: bytes):
    """Manifest of the project beside another network."""
    (folder / f"{name}.onnx").write_bytes(content)
    path = folder / f"{name}.yaml"
    path.write_text((MANIFESTS / f"{name}.yaml").read_text())
    return path


def mask_by(path, image: np.ndarray) -> np.ndarray:
    model = open_model(path)
    inputs = {model.input_name: tensor_of(image, model.manifest.input)}
    outputs = model.session.run(list(model.output_names), inputs)
    return class_mask(outputs, model.manifest, image.shape[:2], str(path))


def largest_channel(size: tuple[int, int]) -> bytes:
    """Network that gives 0, 1 or 2 by the largest colour, as BiSeNet's export gives labels."""
    nodes = [node("ArgMax", ["image"], "preds", axis=1, keepdims=0)]
    return network(nodes, [], [value("image", [1, 3, *size])], [value("preds", [1, *size], 7)])


def test_small_cityscapes_networks_fit_their_manifests(tmp_path):
    """Networks of one layer with their signatures see the colours that each manifest says."""
    image = np.full((512, 1024, 3), 128, np.uint8)
    image[:, :512, 2] = 132  # grey, and a reddish half
    weights = np.zeros((20, 3))
    weights[[0, 5]] = [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    (tmp_path / "one").mkdir()
    path = copied(tmp_path / "one", "espnetv2_cityscapes", pointwise(weights, (512, 1024)))
    # 0.485 x 255 = 123.7: both halves are red to this network, which a plain 0.5 would part
    assert (mask_by(path, image) == PixelClass.POLE).all()
    image[:, 512:] = [85, 92, 78]
    path = copied(tmp_path, "bisenet_cityscapes", largest_channel((1024, 2048)))
    mask = mask_by(path, image)
    assert (mask[:, :512] == PixelClass.ROAD).all()
    # 78, 92, 85 less the means 83.1, 94.1, 82.2: blue is the largest
    assert (mask[:, 512:] == PixelClass.BUILDING).all()
