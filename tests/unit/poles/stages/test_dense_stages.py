import json

import cv2
import numpy as np
import pandas as pd
import pytest

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.images.image_shards import ImageShardWriter
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.poles.alignment.dense import moved
from roadsight.poles.alignment.pose import Start
from roadsight.poles.images.views import view_name
from roadsight.stages.poles import align_cameras, calibrate_drive
from roadsight.stages.poles.shared.dense_inputs import method_of, on_level, turned_axes
from tests.helpers.dense_street import LENS, SIZE, DenseStreet

FRAME = Frame((0.0, 0.0, 0.0))
COUNT = 5
MOUNT = np.array([0.0, 0.0, 1.8, 1.2, -2.0, 0.5])
SHIFT = np.array([20.0, 10.0, 0.0])
"""A local frame begins in the south-west of its cloud."""
ROW = {"fx_px": LENS.focal_px, "cx_px": LENS.cx_px, "cy_px": LENS.cy_px}


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Files of a drive through a generated street, and its true poses."""
    folder, street = tmp_path_factory.mktemp("dense"), DenseStreet(seed=1)
    xyz, level = street.points(0.15)
    xyz = xyz + SHIFT
    ones = np.ones(len(xyz), np.uint8)
    names = ("classification", "return_number", "number_of_returns")
    with TileWriter(folder / "cloud.parquet", 50.0, coloured=False) as writer:
        columns = dict(zip("xyz", xyz.T, strict=True))
        writer.append(columns | {"intensity": level.astype(np.uint16)} | dict.fromkeys(names, ones))
        writer.finish()
    write_json(folder / "frame.json", FRAME.to_dict())
    write_raster(folder / "dem.tif", np.zeros((140, 60)), FRAME, 0.0, 140.0, 1.0)
    (folder / "images").mkdir()
    random, poses, rows = np.random.default_rng(7), [], []
    with ImageShardWriter(folder / "masks.zip", {"scale": 1.0}) as masks:
        for n in range(COUNT):
            track = np.array([0.7, 4.0 * n, 0.0, 0.0, 0.0, 0.0])
            sway = random.normal(0.0, [0.3, 0.3, 0.03, 0.3, 0.2, 0.2])
            pose = moved(track, MOUNT + sway)
            grey, classes = street.photograph(pose)
            cv2.imwrite(str(folder / "images" / f"{n}.png"), grey)
            masks.write(view_name(f"{n}.png"), classes)
            poses.append(pose + np.append(SHIFT, np.zeros(3)))
            x, y, z = track[:3] + SHIFT
            rows.append((f"{n}.png", f"{n}.png", "r", n, x, y, z, 0.0, SIZE[1], SIZE[0], "ok"))
    names = ["image", "path", "route", "sequence", "x", "y", "z_road", "heading_deg"]
    frames = pd.DataFrame(rows, columns=[*names, "width_px", "height_px", "status"])
    write_table(folder / "frames.parquet", frames)
    edges = pd.DataFrame({name: np.empty(0) for name in "xyz"})
    write_table(folder / "road_edges.parquet", edges)
    seen = pd.DataFrame({"image": pd.Series([], dtype=str), "u": [], "v": [], "side": []})
    write_table(folder / "edges.parquet", seen.assign(kind=pd.Series([], dtype=str)))
    return folder, np.array(poses)


def options(folder, **more):
    files = {
        "frames": "frames.parquet", "road-edges": "road_edges.parquet", "frame": "frame.json",
        "image-edges": "edges.parquet", "dem": "dem.tif", "cloud": "cloud.parquet",
        "photographs": "images", "masks": "masks.zip",
    }  # fmt: skip
    named = [part for name, file in files.items() for part in (f"--{name}", str(folder / file))]
    return [*named, *(part for name, value in more.items() for part in (f"--{name}", value))]


def test_a_drive_with_a_known_lens_is_aligned(drive, caplog):
    folder, true = drive
    lens = {"intrinsics": json.dumps(ROW)}
    calibration, cameras = str(folder / "calibration.json"), folder / "cameras.parquet"
    assert calibrate_drive.main(options(folder, out=calibration, **lens)) == 0
    (content,) = read_json(calibration)["drives"]
    assert content["focal_px"] == pytest.approx(LENS.focal_px, rel=1e-9)
    assert content["problem"] == ""
    assert content["yaw_deg"] == pytest.approx(MOUNT[3], abs=0.6)
    more = {"calibration": calibration, "max-sigma-heading-deg": "0.3", **lens}
    with caplog.at_level("INFO"):
        assert align_cameras.main(options(folder, out=str(cameras), **more)) == 0
    found, about = read_table(cameras), read_about(cameras)
    assert about["method"] == "dense"
    assert about["lost_views"] == {"r": int((~found["accepted"]).sum())}
    good = found["accepted"].to_numpy()
    assert good.any()
    off = np.abs((found["heading_deg"].to_numpy() - true[:, 3] + 180) % 360 - 180)
    assert np.median(off[good]) < 0.2 and off[good].max() < 0.5
    assert (found["focal_px"] == LENS.focal_px).all() and (found["cx_px"] == LENS.cx_px).all()
    columns = ["sigma_heading_deg", "sigma_pitch_deg", "sigma_lateral_m", "sigma_along_m"]
    assert np.isfinite(found[columns].to_numpy(float)).all()
    lost = [line for line in caplog.text.splitlines() if "views are not used" in line]
    assert len(lost) == 1 and f"of {COUNT} views" in lost[0]


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"cx_px": 20.0}, "principal point contradicts the image's size"),
        ({"width_px": 640, "height_px": 480}, "images of another size"),
    ],
)
def test_a_lens_of_other_images_is_one_message(drive, capsys, changed, told):
    folder, _ = drive
    lens = {"intrinsics": json.dumps(ROW | changed)}
    out = folder / "never.json"
    assert calibrate_drive.main(options(folder, out=str(out), **lens)) == 2
    error = capsys.readouterr().err
    assert told in error and "allowed" in error and len(error.strip().splitlines()) == 1
    assert not out.exists()


def test_the_dense_method_needs_a_lens(drive, capsys):
    folder, _ = drive
    given = {"method": "dense", "out": str(folder / "never.json")}
    assert calibrate_drive.main(options(folder, **given)) == 2
    assert "needs a known lens" in capsys.readouterr().err


def test_the_lens_decides_where_nobody_does():
    assert method_of("auto", True) == "dense" and method_of("auto", False) == "road"
    assert method_of("road", True) == "road" and method_of("dense", True) == "dense"
    with pytest.raises(InputError, match=r"poles\.intrinsics"):
        method_of("dense", False)


def test_axes_turn_with_the_view():
    turn = turned_axes(30.0)
    np.testing.assert_allclose(turn @ turn.T, np.eye(6), atol=1e-12)
    # One metre along the road is, from a camera that looks 30 degrees to the right of it, ahead
    # by the cosine and to the left by the sine.
    np.testing.assert_allclose(turn @ np.eye(6)[0], [np.cos(np.pi / 6), -0.5, 0, 0, 0, 0])


def test_road_edges_do_not_bank_the_camera():
    start = Start(1.0, 2.0, 3.0, 4.0, 0.05, 0.06, 100, 80, 50.0, 40.0, 0.01, 0.02)
    level = on_level(start)
    assert (level.bank, level.bend, level.hump) == (0.0, 0.0, 0.0)
    assert (level.grade, level.heading_deg, level.x_m) == (0.05, 4.0, 1.0)
