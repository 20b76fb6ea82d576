from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml
from pyproj import CRS

from roadsight.geometry.cameras import wrap_deg
from roadsight.geometry.frames import Frame
from roadsight.io.images.image_shards import ImageShard, ImageShardWriter
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.poles.alignment.landmarks import Turns
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.views import View, ViewOffsets
from roadsight.poles.sightings.sighting_bearing import OWN_COLUMN
from roadsight.stages.poles import measure_poles, trace_image_edges
from tests.helpers.onnx_bytes import network, node, pointwise, tensor, value
from tests.unit.poles.images.test_image_edges import straight_road
from tests.unit.poles.sightings.test_sightings import CAMERA, place, rendered

TRUTH = ((350.0, 20.0), (15.0, 25.0))
FRAME = Frame(
    (760_000.0, 600_000.0, 2_150.0), 1200 / 3937, 1200 / 3937, CRS.from_epsg(6543).to_wkt()
)


@pytest.fixture
def frames(tmp_path):
    count = 3
    table = pd.DataFrame(
        {
            "image": [f"a{i}.jpg" for i in range(count)], "route": "r", "sequence": range(count),
            "x": 0.0, "y": 0.0,
            "path": [f"a{i}.jpg" for i in range(count)], "left_path": "", "right_path": "",
            "status": ["ok"] * (count - 1) + ["no position"],
        }
    )  # fmt: skip
    write_table(tmp_path / "frames.parquet", table)
    return tmp_path


def write_site(folder):
    mask, depth = rendered([place(*one) for one in TRUTH])
    for name, image in (("masks", mask), ("depth", depth)):
        with ImageShardWriter(folder / f"{name}.zip") as shard:
            for i in range(2):
                shard.write(f"a{i}", image)
    write_json(folder / "frame.json", FRAME.to_dict())
    write_raster(folder / "dem.tif", np.zeros((260, 260)), FRAME, -130.0, 130.0, 1.0)
    angles = {"heading_deg": 355.0, "pitch_deg": -2.0, "roll_deg": 1.0}
    own = CAMERA.intrinsics
    pose = {
        "x": 5.0, "y": -3.0, "z": 2.5, **angles, "focal_px": own.focal_px, "cx_px": own.cx_px,
        "cy_px": own.cy_px, "width_px": 1000, "height_px": 600, "sigma_heading_deg": 0.1,
        "sigma_pitch_deg": 0.1, "sigma_lateral_m": 0.1, "sigma_along_m": 0.1,
        "sigma_cx_px": 0.0, "heading_by_cx_deg": 0.0, "sigma_focal_ratio": 0.0,
        "heading_by_focal_deg": 0.0, "pitch_by_cy_deg": 0.0,
    }  # fmt: skip
    rows = [{"image": f"a{i}.jpg", **pose, "accepted": i == 0} for i in range(2)]
    write_table(folder / "cameras.parquet", pd.DataFrame(rows))
    stem = np.floor(np.array([[*place(*TRUTH[0]), z] for z in np.arange(0, 9, 0.3)]) / 0.3)
    voxels = pd.DataFrame(stem.astype(np.int32), columns=["ix", "iy", "iz"]).assign(cls=np.uint8(1))
    about = {"cell_size_m": 0.3, "anchor": [0.0, 0.0, 0.0]}
    write_table(folder / "voxels.parquet", voxels, about)
    x, y = place(*TRUTH[0])
    column = {
        "x": x, "y": y, "z_ground": 0.0, "top_m": 9.0, "sigma_m": 0.05, "points": 9.0,
        "open_top": 0.0,
    }  # fmt: skip
    write_table(folder / "columns.parquet", pd.DataFrame([column]))


def write_side_view(folder, in_front=False):
    """A site of one image with a view to the right; the camera that took it."""
    write_site(folder)
    table = read_table(folder / "frames.parquet")
    write_table(folder / "frames.parquet", table.assign(right_path="right/" + table["path"]))
    poles = [place(*one) for one in TRUTH]
    for name, part in (("masks", 0), ("depth", 1)):
        with ImageShardWriter(folder / f"{name}.zip") as shard:
            shard.write("a0", rendered(poles)[part] * np.array(in_front, np.uint8))
            shard.write("a0.right", rendered(poles, replace(CAMERA, yaw_deg=20.0))[part])
    camera = read_table(folder / "cameras.parquet").iloc[0]
    return str(table["route"].iloc[0]), int(camera["width_px"]), int(camera["height_px"])


def options(folder, file, out):
    """The images' table, what is read beside it, and what is written."""
    named = {"frames": "frames.parquet", file.split(".")[0]: file, "out": out}
    return [f"--{name}={folder / path}" for name, path in named.items()]


def measure(folder, *more: str) -> int:
    names = ("frames", "cameras", "masks", "depth", "dem", "voxels", "columns", "frame", "out")
    files = ("frames.parquet", "cameras.parquet", "masks.zip", "depth.zip", "dem.tif",
             "voxels.parquet", "columns.parquet", "frame.json", "sightings.parquet")  # fmt: skip
    pairs = [w for n, f in zip(names, files, strict=True) for w in (f"--{n}", str(folder / f))]
    return measure_poles.main([*pairs, "--min-marking-px", "60", *more])


def test_sightings_of_accepted_cameras_are_written(frames):
    write_site(frames)
    assert measure(frames) == 0
    table = read_table(frames / "sightings.parquet")
    assert table["image"].tolist() == ["a0.jpg", "a0.jpg"]
    assert table["kept"].all()
    assert np.abs(wrap_deg(table["bearing_grid_deg"] - [350.0, 15.0])).max() < 0.3
    assert np.allclose(table["depth_m"], [20.0, 25.0], rtol=0.05)
    assert table["method"].tolist() == ["fused", "image"]
    turn = wrap_deg(table["bearing_deg"] - table["bearing_grid_deg"])
    assert np.ptp(turn) < 1e-6
    assert 0.1 < abs(turn[0]) < 3.0
    assert table["latitude"].between(34, 37).all()
    assert read_about(frames / "sightings.parquet")["settings"]["bearing"] == "fused"
    first = (frames / "sightings.parquet").read_bytes()
    assert measure(frames) == 0
    assert (frames / "sightings.parquet").read_bytes() == first


def test_a_row_of_the_principal_point_widens_pitches_but_moves_no_foot(frames):
    write_site(frames)
    cameras = read_table(frames / "cameras.parquet")
    found = []
    for by_cy_deg in (0.0, 0.8, 0.0):
        sigma_deg = np.hypot(0.1, 0.8 if found else 0.0)
        wide = cameras.assign(sigma_pitch_deg=sigma_deg, pitch_by_cy_deg=by_cy_deg)
        write_table(frames / "cameras.parquet", wide)
        assert measure(frames) == 0
        found.append(read_table(frames / "sightings.parquet")["sigma_depth_ground_m"].to_numpy())
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)
    assert (found[2] > 2.0 * found[0]).all()


def test_a_shard_without_images_has_an_empty_table_of_the_same_columns(frames):
    write_site(frames)
    assert measure(frames) == 0
    full = read_table(frames / "sightings.parquet")
    cameras = read_table(frames / "cameras.parquet").assign(accepted=False)
    write_table(frames / "cameras.parquet", cameras)
    assert measure(frames) == 0
    empty = read_table(frames / "sightings.parquet")
    assert len(empty) == 0
    assert list(empty.columns) == list(full.columns)
    pd.concat([empty, full]).to_numpy()


def test_images_without_poles_give_an_empty_table(frames):
    write_site(frames)
    with ImageShardWriter(frames / "masks.zip") as shard:
        shard.write("a0", np.full((600, 1000), PixelClass.ROAD, np.uint8))
    assert measure(frames) == 0
    assert len(read_table(frames / "sightings.parquet")) == 0


def test_a_pole_in_two_views_is_kept_once(frames):
    write_side_view(frames, in_front=True)
    assert measure(frames, "--right-yaw-deg", "20") == 0
    found = read_table(frames / "sightings.parquet")
    assert len(found) == 4
    assert found["kept"].sum() == 2
    assert set(found.loc[~found["kept"], "reason"]) == {"same as in the front view"}
    beside = found[found["view"] == "right"]["bearing_grid_deg"]
    assert np.abs(wrap_deg(beside - [350.0, 15.0])).max() < 0.3


@pytest.mark.parametrize(("said", "kept"), [("found", False), ("given", True)])
def test_a_side_view_whose_yaw_the_drive_does_not_tell(frames, monkeypatch, said, kept):
    """Its bearings would be off by as much as the guess is."""
    key = write_side_view(frames)
    monkeypatch.setattr(measure_poles, "_side_views", lambda *_: {key: Turns()})
    assert measure(frames, "--right-yaw-deg", "20", "--side-views", said) == 0
    found = read_table(frames / "sightings.parquet")
    found = found[found["view"] == "right"]
    assert len(found) and (found["kept"].any()) == kept
    if not kept:
        assert set(found["reason"]) == {"yaw of the side view not found"}


def test_edges_are_written_by_image_and_empty_ones_say_why(frames):
    with ImageShardWriter(frames / "masks.zip") as shard:
        shard.write("a0", straight_road())
        shard.write("a1", np.zeros((60, 80), np.uint8))
    assert trace_image_edges.main(options(frames, "masks.zip", "edges.parquet")) == 0
    table = read_table(frames / "edges.parquet")
    assert set(table["image"]) == {"a0.jpg"}
    assert set(table["kind"]) == {"lane", "border"}
    assert (table["u"].dtype, table["side"].dtype) == (np.float32, np.int8)
    reasons = read_about(frames / "edges.parquet")["without_edges"]
    assert reasons == {"a1.jpg": "no road in the mask"}


def write_images(folder) -> None:
    (folder / "images").mkdir()
    image = np.zeros((40, 60, 3), np.uint8)
    image[20:] = (0, 0, 255)
    image[5:30, 30:34] = (255, 0, 0)
    for i in range(2):
        cv2.imwrite(str(folder / f"images/a{i}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 100])


def manifest(folder, weights, **changes) -> str:
    (folder / "tiny.onnx").write_bytes(pointwise(np.array(weights), ("h", "w")))
    size = {"multiple_of": 4}
    content = {"file": "tiny.onnx", "input": {"colour": "BGR", "size": size}} | changes
    (folder / "tiny.yaml").write_text(yaml.safe_dump(content))
    return str(folder / "tiny.yaml")


def test_masks_come_from_networks_and_from_folders(frames):
    pytest.importorskip("roadsight.io.images.videologs")
    from roadsight.stages.poles import segment_images

    write_images(frames)
    path = manifest(
        frames, [[0, 0.5, 0], [0, 0, 1], [1, 0, 0]], task="classes", labels=3,
        output={"kind": "logits"}, classes={0: "sky", 1: "road", 2: "vegetation"},
    )  # fmt: skip
    (frames / "labels").mkdir()
    label = np.zeros((40, 60), np.uint8)
    label[5:30, 30:34] = 1
    for i in range(2):
        cv2.imwrite(str(frames / f"labels/a{i}.png"), label)
    (frames / "map.yaml").write_text("labels: 2\nclasses: {1: pole}\n")
    arguments = [*options(frames, "images", "masks.zip"), "--source", path]
    arguments += ["--source", str(frames / "labels"), str(frames / "map.yaml")]
    assert segment_images.main(arguments) == 0
    shard = ImageShard(frames / "masks.zip")
    assert sorted(shard.names) == ["a0", "a1"]
    mask = shard.read("a0")
    assert mask[35, 10] == PixelClass.ROAD
    assert (mask[5:30, 30:34] == PixelClass.POLE).all()


@pytest.mark.parametrize("stage", ["segment_images", "estimate_depth"])
def test_images_without_their_label_or_depth_are_left_out_and_named(frames, stage, caplog, capsys):
    from roadsight.stages.poles import estimate_depth, segment_images

    write_images(frames)
    (frames / "given").mkdir()
    (frames / "map.yaml").write_text("labels: 2\nclasses: {1: pole}\n")
    cv2.imwrite(str(frames / "given/a0.png"), np.eye(40, 60, dtype=np.uint8))
    source = [str(frames / "given")]
    source += [str(frames / "map.yaml")] if stage == "segment_images" else []
    main = {"segment_images": segment_images, "estimate_depth": estimate_depth}[stage].main
    arguments = [*options(frames, "images", "out.zip"), "--source", *source]
    assert main(arguments) == 0
    shard = ImageShard(frames / "out.zip")
    assert (shard.names, shard.about["left_out"]) == (["a0"], ["a1"])
    assert "only 1 of 2 images have" in caplog.text and "left out: a1.jpg" in caplog.text
    (frames / "given/a0.png").rename(frames / "given/b0.png")
    (frames / "out.zip").unlink()
    assert main(arguments) == 2
    assert "none of 2 images have" in capsys.readouterr().err
    assert not (frames / "out.zip").exists()


def test_steps_behind_go_on_without_images_that_were_left_out(frames):
    with ImageShardWriter(frames / "masks.zip") as shard:
        shard.write("a0", straight_road())
    assert trace_image_edges.main(options(frames, "masks.zip", "edges.parquet")) == 0
    reasons = read_about(frames / "edges.parquet")["without_edges"]
    assert reasons == {"a1.jpg": "no label image"}
    write_site(frames)
    with ImageShardWriter(frames / "masks.zip") as shard:
        shard.write("b0", np.full((600, 1000), PixelClass.ROAD, np.uint8))
    assert measure(frames) == 0
    assert len(read_table(frames / "sightings.parquet")) == 0


def test_depth_the_wrong_way_round_names_the_key_to_change(frames, capsys):
    pytest.importorskip("roadsight.io.images.videologs")
    from roadsight.stages.poles import estimate_depth

    (frames / "images").mkdir()
    (frames / "depth").mkdir()
    rows = np.arange(40, dtype=np.uint16)[:, None] * np.ones((1, 60), np.uint16)
    for i in range(2):
        grey = (rows * 5).astype(np.uint8)
        cv2.imwrite(str(frames / f"images/a{i}.jpg"), cv2.merge([grey] * 3))
        cv2.imwrite(str(frames / f"depth/a{i}.png"), 1000 + rows * 100)
    base = [*options(frames, "images", "depth.zip"), "--source"]
    spec = {"task": "relative_depth", "output": {"kind": "inverse_depth"}}
    assert estimate_depth.main([*base, manifest(frames, [[1, 0, 0]], **spec)]) == 0
    (frames / "depth.zip").unlink()
    assert estimate_depth.main([*base, manifest(frames, [[-1, 0, 0]], **spec)]) == 2
    assert "output.kind" in capsys.readouterr().err
    assert not (frames / "depth.zip").exists()
    assert estimate_depth.main([*base, str(frames / "depth")]) == 0
    near = ImageShard(frames / "depth.zip").read("a0")
    assert near[39, 0] > near[0, 0] > 0
    assert estimate_depth.main([*base, manifest(frames, [[0, 0, 0]], **spec)]) == 0
    assert not ImageShard(frames / "depth.zip").read("a0").any()


def test_depth_of_other_proportions_than_its_image_is_refused(frames, capsys):
    """As of an export that fixed the shape of its example: here twice as wide as the image."""
    from roadsight.stages.poles import estimate_depth

    write_images(frames)
    path = manifest(
        frames, [[1, 0, 0]], task="relative_depth", output={"kind": "inverse_depth"}
    )  # fmt: skip
    nodes = [node("Conv", ["image", "w"], "once"), node("Concat", ["once"] * 2, "logits", axis=3)]
    kernel = tensor("w", np.ones((1, 3, 1, 1), np.float32))
    ends = [value("image", [1, 3, "h", "w"])], [value("logits", [1, 1, "h", "v"])]
    (frames / "tiny.onnx").write_bytes(network(nodes, [kernel], *ends))
    arguments = [*options(frames, "images", "depth.zip"), "--source", path]
    assert estimate_depth.main(arguments) == 2
    assert "other proportions than its input" in capsys.readouterr().err
    assert not (frames / "depth.zip").exists()


def test_bearings_in_a_side_view_carry_the_error_of_its_yaw(frames, monkeypatch):
    key = write_side_view(frames)
    stated, own, heading = [], [], []
    for sigma in (0.0, 0.5):
        turns = Turns((0.0, -20.0, 20.0), (0.0, np.inf, sigma))
        monkeypatch.setattr(measure_poles, "_side_views", lambda *_, found=turns: {key: found})
        assert measure(frames, "--bearing", "image") == 0
        seen = read_table(frames / "sightings.parquet").query("view == 'right' and kept")
        stated.append(seen["sigma_bearing_deg"].to_numpy())
        own.append(seen[OWN_COLUMN].to_numpy())
        heading.append(seen["bearing_by_heading_deg"].to_numpy())
    assert len(stated[0]) and stated[1] == pytest.approx(np.hypot(stated[0], 0.5), rel=0.02)
    # The front view has no part of it.
    assert own[1] == pytest.approx(np.hypot(own[0], 0.5))
    assert heading[1] == pytest.approx(heading[0])


def test_a_side_view_has_of_the_lens_the_heading_that_goes_with_the_focal_length():
    angles = {"x": 0.0, "y": 0.0, "z": 2.0, "heading_deg": 0.0, "pitch_deg": 0.0, "roll_deg": 0.0}
    lens = {"focal_px": 800.0, "cx_px": 499.5, "cy_px": 299.5, "width_px": 1000, "height_px": 600}
    sigmas = dict.fromkeys(measure_poles._SIGMAS, 0.0)
    sigmas |= {"sigma_heading_deg": np.sqrt(0.3**2 + 0.1**2 + 0.2**2), "sigma_cx_px": 4.0}
    sigmas |= {"heading_by_cx_deg": 0.3, "sigma_focal_ratio": 0.01, "heading_by_focal_deg": 0.1}
    pose = pd.Series(angles | lens | sigmas)
    seen = [
        measure_poles._camera(View("a.jpg", view, "", ""), pose, ViewOffsets(), (600, 1000))
        for view in ("front", "right")
    ]
    assert [one.own_heading_deg for one in seen] == pytest.approx([0.2, 0.2])
    assert [one.heading_by_focal_deg for one in seen] == [0.1, 0.1]
    assert [one.heading_by_cx_deg for one in seen] == [0.3, 0.0]
    assert [one.sigma_cx_px for one in seen] == [4.0, 0.0]
    assert [one.sigma_focal_ratio for one in seen] == [0.01, 0.0]
