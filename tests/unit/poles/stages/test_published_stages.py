import numpy as np
import pandas as pd
import pytest

from roadsight.geometry.cameras import wrap_deg
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.poles.alignment.pose import UNKNOWNS
from roadsight.stages.poles import align_cameras, calibrate_drive
from roadsight.stages.poles.align_cameras import CAMERA_COLUMNS, ways_ahead
from tests.helpers.road_bed import Mount, RoadBed, edge_table, frames_of

IMAGES = 16
SIZE = "2000x1200"


@pytest.fixture(scope="module")
def bed():
    """A road in rolling country, the study's size of images, positions that drift slowly."""
    mount = Mount(hfov_deg=34.0, lane_inset_m=0.05)
    return RoadBed(seed=5, images=IMAGES, mount=mount, gps_m=0.3, gps_length_m=200.0, outliers=0.05)


@pytest.fixture(scope="module")
def road(tmp_path_factory, bed):
    folder = tmp_path_factory.mktemp("published")
    write_table(folder / "frames.parquet", frames_of(bed))
    write_table(folder / "edges.parquet", edge_table(bed))
    xyz = dict(zip("xyz", bed.road_edges.T, strict=True))
    write_table(folder / "road_edges.parquet", pd.DataFrame(xyz))
    write_json(folder / "frame.json", Frame((0.0, 0.0, 0.0)).to_dict())
    mount = bed.mount
    write_json(folder / "baseline.json", {SIZE: {
        "hfov_deg": mount.hfov_deg, "along_m": 0.0, "lateral_m": mount.lateral_m,
        "height_m": mount.height_m, "yaw_deg": mount.yaw_deg, "pitch_deg": mount.pitch_deg,
        "roll_deg": mount.roll_deg - 1.1,
    }})  # fmt: skip
    return folder


def options(folder, *names):
    pairs = [(f"--{name.replace('_', '-')}", str(folder / FILES[name])) for name in names]
    return ["--method", "published", *(part for pair in pairs for part in pair)]


FILES = {
    "frames": "frames.parquet",
    "image_edges": "edges.parquet",
    "road_edges": "road_edges.parquet",
    "frame": "frame.json",
}


def calibrated(folder, tmp_path, baseline="baseline.json", *more):
    given = [*options(folder, *FILES), "--out", str(tmp_path / "c.json")]
    if baseline:
        given += ["--baseline", str(folder / baseline)]
    return calibrate_drive.main([*given, *more])


@pytest.fixture(scope="module")
def cameras(road, tmp_path_factory):
    """Cameras by both stages."""
    folder = tmp_path_factory.mktemp("aligned")
    assert calibrated(road, folder) == 0
    given = options(road, *FILES)
    given += ["--calibration", str(folder / "c.json"), "--out", str(folder / "cameras.parquet")]
    assert align_cameras.main(given) == 0
    return folder / "cameras.parquet"


def test_both_stages_run_to_their_end(cameras, bed):
    table = read_table(cameras)
    assert tuple(table.columns) == CAMERA_COLUMNS
    assert len(table) == IMAGES
    assert table["accepted"].all()
    assert (table["reason"] == "").all()
    assert (table["edge_points"] > 100).all()
    assert read_about(cameras)["method"] == "published"
    assert table[["x", "y", "z", "heading_deg", "pitch_deg", "roll_deg"]].notna().all(axis=None)
    assert table["sigma_heading_deg"].isna().all()  # nothing is said of errors
    turned = wrap_deg(table["heading_deg"] - np.array([p.heading_deg for p in bed.truth]))
    assert np.median(np.abs(turned)) < 1.5


def test_the_lens_is_that_of_the_baseline(cameras, bed):
    table = read_table(cameras)
    np.testing.assert_allclose(table["focal_px"], bed.intrinsics.focal_px, rtol=1e-9)
    assert set(zip(table["cx_px"], table["cy_px"], strict=True)) == {(999.5, 599.5)}


def test_calibration_is_the_registered_camera_and_nothing_else(cameras, road):
    (drive,) = read_json(cameras.parent / "c.json")["drives"]
    (stated,) = read_json(road / "baseline.json").values()
    assert {n: drive[n] for n in UNKNOWNS[:6]} == pytest.approx(
        {n: stated[n] for n in UNKNOWNS[:6]}
    )
    assert (drive["drift"], drive["told"], drive["images"]) == ([], [], 0)


def test_cameras_look_to_the_next_image_and_move_no_farther_than_their_bounds(cameras, bed):
    """The first dozen of a route keeps the narrow bounds."""
    table, mount = read_table(cameras), bed.mount
    chord = np.diff(np.column_stack([bed.track, bed.z_road]), axis=0)
    chord = np.concatenate([chord, chord[-1:]])
    heading = np.degrees(np.arctan2(chord[:, 0], chord[:, 1]))
    rise = np.degrees(np.arctan2(chord[:, 2], np.hypot(*chord[:, :2].T)))
    yaw = wrap_deg(table["heading_deg"] - heading - mount.yaw_deg)
    pitch = table["pitch_deg"] - rise - mount.pitch_deg
    roll = table["roll_deg"] - (mount.roll_deg - 1.1)
    assert np.abs(yaw[:12]).max() < 0.13
    assert np.abs(pitch[:12]).max() < 0.13
    assert np.abs(roll[:12]).max() < 0.11 + 0.03  # turned by pitch and yaw: up to 0.03 more
    up = np.array([0, 0, mount.height_m])
    moved = table[["x", "y", "z"]].to_numpy() - np.column_stack([bed.track, bed.z_road]) - up
    assert np.linalg.norm(moved[:12], axis=1).max() < 1.1 * 0.3048 * np.sqrt(3) + 0.5


def test_a_settings_bound_holds(road, tmp_path, bed):
    """Cameras that may not move at all stay with the baseline."""
    assert calibrated(road, tmp_path) == 0
    given = [*options(road, *FILES), "--bound-m", "1e-9", "--bound-deg", "1e-9"]
    given += ["--calibration", str(tmp_path / "c.json"), "--out", str(tmp_path / "k.parquet")]
    assert align_cameras.main(given) == 0
    table = read_table(tmp_path / "k.parquet")[:12]
    chord = np.diff(bed.track, axis=0)
    heading = np.degrees(np.arctan2(chord[:12, 0], chord[:12, 1]))
    np.testing.assert_allclose(
        wrap_deg(table["heading_deg"] - heading), bed.mount.yaw_deg, atol=3e-3
    )


def test_an_image_without_edges_keeps_the_baseline_and_is_not_accepted(road, tmp_path):
    edges = read_table(road / "edges.parquet")
    first = read_table(road / "frames.parquet")["image"].iloc[0]
    write_table(tmp_path / "edges.parquet", edges[edges["image"] != first])
    assert calibrated(road, tmp_path) == 0
    given = options(road, "frames", "road_edges", "frame")
    given += ["--image-edges", str(tmp_path / "edges.parquet")]
    given += ["--calibration", str(tmp_path / "c.json"), "--out", str(tmp_path / "k.parquet")]
    assert align_cameras.main(given) == 0
    row = read_table(tmp_path / "k.parquet").iloc[0]
    assert not row["accepted"]
    assert row["reason"] == "no edges in the image"
    assert np.isfinite(row["heading_deg"])


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (None, "sizes none"),
        ({"640x416": {"hfov_deg": 20.0}}, "sizes 640x416"),
        (
            {SIZE: {"hfov_deg": 20.0, "height_m": 2.2, "yaw_deg": 0.0}},
            "no along_m, lateral_m, pitch_deg, roll_deg",
        ),
        ({SIZE: {"height_m": 2.0}}, "log_focal"),
    ],
)
def test_without_a_registered_camera_there_is_one_message(road, tmp_path, capsys, content, found):
    baseline = None
    if content is not None:
        baseline = "other.json"
        write_json(road / baseline, content)
    assert calibrated(road, tmp_path, baseline) == 2
    told = capsys.readouterr().err
    assert "registered camera of each image size" in told
    assert SIZE in told
    assert found in told
    assert "roadsight register" in told


def test_a_known_lens_and_that_of_the_baseline_contradict_each_other(road, tmp_path, capsys):
    lens = '{"fx_px": 3000, "cx_px": 999.5, "cy_px": 599.5}'
    assert calibrated(road, tmp_path, "baseline.json", "--intrinsics", lens) == 2
    assert "keeps the lens of its registered camera" in capsys.readouterr().err


def test_ways_ahead():
    """A place at which the vehicle stands looks to where it goes on, the last one as before."""
    xyz = np.array([[0, 0, 0], [8, 0, 1], [8.1, 0, 1], [8, 8, 1], [8, 16, 0]], float)
    found = ways_ahead(xyz)
    expected = [[8, 0, 1], [0, 8, 0], [0, 8, 0], [0, 8, -1], [0, 8, -1]]
    np.testing.assert_allclose(found, expected)
    assert ways_ahead(xyz[1:3]) == [None, None]
