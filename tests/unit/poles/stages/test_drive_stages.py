import json
import shutil

import cv2
import numpy as np
import pandas as pd
import pytest

from roadsight.geometry.frames import Frame
from roadsight.geometry.lens import RadialLens
from roadsight.io.images.image_shards import ImageShard, ImageShardWriter
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.poles.drive.drive_profile import upright_curves
from roadsight.poles.images.plumb_line import bow
from roadsight.stages.poles import profile_drive, undistort_views, use_given_cameras
from roadsight.stages.poles.align_cameras import CAMERA_COLUMNS
from tests.helpers.road_bed import Mount as BedMount
from tests.helpers.road_bed import RoadBed, edge_table, frames_of
from tests.unit.poles.images.test_plumb_line import SIZE, picture

FRAME = Frame((0.0, 0.0, 0.0))
LENS = RadialLens.centred(-0.06, 0.0, *SIZE)
COUNT = 12


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A level drive whose lens bends every post, with its profile."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "images").mkdir()
    names = [f"i{n:02d}.jpg" for n in range(COUNT)]
    for n, name in enumerate(names):
        posts = tuple(60 + (97 * n + 83 * k) % 520 for k in range(5))
        cv2.imwrite(str(folder / "images" / name), picture(LENS, posts))
    x = 8.0 * np.arange(COUNT)
    frames = pd.DataFrame(
        {
            "image": names, "path": names, "left_path": "", "right_path": "", "route": "r",
            "sequence": range(COUNT), "x": x, "y": 0.0, "z_road": 0.0, "heading_deg": 90.0,
            "width_px": SIZE[0], "height_px": SIZE[1], "status": "ok",
        }
    )  # fmt: skip
    write_table(folder / "frames.parquet", frames)
    write_json(folder / "frame.json", FRAME.to_dict())
    write_raster(folder / "dem.tif", np.zeros((80, 200)), FRAME, -50.0, 40.0, 1.0)
    options = ["--frames", "frames.parquet", "--dem", "dem.tif", "--frame", "frame.json"]
    options += ["--images", "images", "--doubts", "doubts.json", "--out", "drive.json"]
    named = [str(folder / o) if not o.startswith("--") else o for o in options]
    assert profile_drive.main(named) == 0
    return folder


def test_a_level_drive_without_side_views_and_with_a_bent_lens(drive):
    found = read_json(drive / "drive.json")
    assert (found["images"], found["hidden_road_share"], found["side_share"]) == (COUNT, 0.0, 0.0)
    assert all(gap is None for _, gap in found["front_view_gaps"])
    (lens,) = found["lenses"]
    assert lens["source"] == "plumb lines"
    assert lens["corner_px"] == pytest.approx(LENS.corner_px(*SIZE), abs=3 * lens["sigma_px"])
    assert abs(lens["corner_px"]) > 3 * lens["sigma_px"]


def test_images_that_repeat_the_one_before_are_reported(drive, tmp_path):
    assert read_json(drive / "doubts.json") == []
    shutil.copytree(drive, tmp_path / "hung")
    images = tmp_path / "hung/images"
    shutil.copy(images / "i06.jpg", images / "i07.jpg")
    options = ["--frames", "frames.parquet", "--dem", "dem.tif", "--frame", "frame.json"]
    options += ["--images", "images", "--doubts", "doubts.json", "--out", "drive.json"]
    named = [str(tmp_path / "hung" / o) if not o.startswith("--") else o for o in options]
    assert profile_drive.main(named) == 0
    (doubt,) = read_json(tmp_path / "hung/doubts.json")
    assert (doubt["code"], doubt["measured"]) == ("images_repeated", 1)
    assert "i07.jpg" in doubt["message"]


def straight(folder, out, *more):
    with ImageShardWriter(folder / "maps.zip", {"scale": 1.0}) as shard:
        for number in range(COUNT):
            shard.write(f"i{number:02d}", picture(LENS))
    options = ["--frames", "frames.parquet", "--images", "images", "--drive", "drive.json"]
    options += ["--maps", "maps.zip", "--out", out]
    named = [str(folder / o) if not o.startswith("--") else o for o in options]
    assert undistort_views.main([*named, *more]) == 0
    return ImageShard(folder / out)


def most_bowed(image):
    return max(abs(bow(curve)) for curve in upright_curves(image))


def test_maps_are_straightened_by_the_measured_lens(drive):
    shard = straight(drive, "measured.zip")
    assert shard.about == {"scale": 1.0}
    assert len(shard.names) == COUNT
    smoothed = cv2.GaussianBlur(shard.read("i00"), (0, 0), 1.0)
    assert most_bowed(smoothed) < 0.5 * most_bowed(picture(LENS))


def test_a_given_lens_comes_first(drive):
    focal = 500.0
    ratio = (focal / LENS.scale_px) ** 2
    given = {"route": None, "k1": LENS.k1 * ratio, "k2": 0.0, "focal_px": focal}
    shard = straight(drive, "given.zip", "--lenses", json.dumps([given]))
    smoothed = cv2.GaussianBlur(shard.read("i03"), (0, 0), 1.0)
    assert most_bowed(smoothed) < 0.5 * most_bowed(picture(LENS))
    none = straight(drive, "none.zip", "--lenses", json.dumps([given | {"k1": 0.0}]))
    np.testing.assert_array_equal(none.read("i03"), picture(LENS))


def test_an_impossible_given_lens_is_one_message(drive, capsys):
    lens = json.dumps([{"route": None, "k1": -3.0, "k2": 0.0, "focal_px": 300.0}])
    options = ["--frames", "frames.parquet", "--images", "images", "--drive", "drive.json"]
    options += ["--maps", "maps.zip", "--out", "never.zip"]
    named = [str(drive / o) if not o.startswith("--") else o for o in options]
    assert undistort_views.main([*named, "--lenses", lens]) == 2
    assert "folds them" in capsys.readouterr().err
    assert not (drive / "never.zip").exists()


@pytest.fixture(scope="module")
def bed():
    return RoadBed(seed=2, images=12, spacing_m=12.0, mount=BedMount(hfov_deg=48.0))


@pytest.fixture(scope="module")
def road(tmp_path_factory, bed):
    folder = tmp_path_factory.mktemp("posed")
    write_table(folder / "frames.parquet", frames_of(bed))
    write_table(folder / "edges.parquet", edge_table(bed))
    xyz = dict(zip("xyz", bed.road_edges.T, strict=True))
    write_table(folder / "road_edges.parquet", pd.DataFrame(xyz))
    write_json(folder / "frame.json", FRAME.to_dict())
    return folder


def posed(folder, bed, turn_deg=0.0, left_out=()):
    """Cameras by the stage, from true ones that are turned by so much."""
    images = frames_of(bed)["image"]
    rows = [
        {
            "image": image, "easting_m": pose.x_m, "northing_m": pose.y_m, "height_m": pose.z_m,
            "heading_grid_deg": pose.heading_deg + turn_deg, "pitch_deg": pose.pitch_deg,
            "roll_deg": pose.roll_deg, "focal_px": pose.focal_px, "cx_px": bed.intrinsics.cx_px,
            "cy_px": bed.intrinsics.cy_px,
        }
        for image, pose in zip(images, bed.truth, strict=True)
        if image not in left_out
    ]  # fmt: skip
    pd.DataFrame(rows).to_csv(folder / "cameras.csv", index=False)
    assert run_given(folder) == 0
    return read_table(folder / "out.parquet"), read_about(folder / "out.parquet")


def run_given(folder):
    options = ["--frames", "frames.parquet", "--image-edges", "edges.parquet", "--frame"]
    options += ["frame.json", "--road-edges", "road_edges.parquet", "--cameras", "cameras.csv"]
    options += ["--out", "out.parquet"]
    named = [str(folder / o) if not o.startswith("--") else o for o in options]
    return use_given_cameras.main(named)


def test_given_cameras_are_taken_as_they_are(road, bed):
    table, about = posed(road, bed)
    assert list(table.columns) == list(CAMERA_COLUMNS)
    assert table["accepted"].all()
    truth = np.array([[p.x_m, p.y_m, p.z_m, p.heading_deg, p.focal_px] for p in bed.truth])
    found = table[["x", "y", "z", "heading_deg", "focal_px"]].to_numpy(float)
    np.testing.assert_allclose(found, truth, atol=1e-6)
    assert about["method"] == "given"
    assert about["agreeing_share"] > 0.7
    assert table["residual_px"].median() < 2.5


def test_given_uncertainties_replace_the_usual_ones(road, bed):
    posed(road, bed)
    cameras = pd.read_csv(road / "cameras.csv").assign(sigma_heading_deg=0.7)
    cameras.to_csv(road / "cameras.csv", index=False)
    assert run_given(road) == 0
    table = read_table(road / "out.parquet")
    assert set(table["sigma_heading_deg"]) == {0.7}
    assert set(table["sigma_lateral_m"]) == {0.1}


def test_cameras_that_do_not_agree_with_the_road_are_told(road, bed, caplog):
    good, about = posed(road, bed)
    turned, told = posed(road, bed, turn_deg=3.0)
    assert told["agreeing_share"] < 0.5 * about["agreeing_share"]
    assert turned["residual_px"].median() > 4 * good["residual_px"].median()
    assert turned["accepted"].all()


def test_images_without_a_given_camera_are_refused_with_the_reason(road, bed):
    missing = frames_of(bed)["image"].iloc[4]
    table, _ = posed(road, bed, left_out=(missing,))
    row = table.set_index("image").loc[missing]
    assert not row["accepted"]
    assert row["reason"] == "no camera is given"
    assert np.isnan(row["x"])
    assert table["accepted"].sum() == len(table) - 1
