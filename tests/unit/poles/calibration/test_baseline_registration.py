import json

import numpy as np
import pytest
from pyproj import CRS

from roadsight.base.errors import InputError
from roadsight.commands.register import read_pairs
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.poles.alignment.pose import FOCAL, UNKNOWNS, Start, pose_of
from roadsight.poles.calibration.calibration import weak_mount
from roadsight.poles.calibration.calibration_table import baseline_mount
from roadsight.poles.calibration.registration import baseline, mounted, register_camera

WIDTH = 1200
HEIGHT = 800
TRUTH = np.array([1.2, -0.4, 2.1, 1.5, -3.0, 0.7, np.log(900.0), 0, 0, 0, 0])


def start(number=0):
    middle = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    tilt = 0.03, -0.02
    return Start(5.0 * number, 3.0, 11.0, 70.0 + number, *tilt, WIDTH, HEIGHT, *middle, 0.001, 2e-4)


def clicked(rng, begin, noise_px=0.0, count=12):
    """Places in front of the true camera of a start, and their pixels."""
    pose = pose_of(begin, TRUTH)
    rotation = cam_from_world(pose.heading_deg, pose.pitch_deg, pose.roll_deg)
    depth = rng.uniform(8, 60, count)
    side = np.column_stack([rng.uniform(-0.5, 0.5, count), rng.uniform(-0.2, 0.3, count)])
    camera = np.column_stack([side * depth[:, None], depth])
    xyz = camera @ rotation + pose.position_m
    lens = Intrinsics.centred(WIDTH, HEIGHT, pose.focal_px)
    uv, _ = project(lens, rotation, pose.position_m, xyz)
    return uv + rng.normal(0, noise_px, uv.shape), xyz


def registered(rng, begin, **more):
    return register_camera(*clicked(rng, begin, **more), WIDTH, HEIGHT)


def test_exact_pairs_give_the_mount_back(rng):
    value, sigma = mounted(registered(rng, start()), start())
    assert value == pytest.approx(TRUTH[: FOCAL + 1], abs=1e-4)
    assert (sigma > 0).all()


def test_several_images_share_one_baseline(rng):
    images = [(registered(rng, start(n), noise_px=2.0), start(n)) for n in range(6)]
    content = json.loads(json.dumps(baseline(images)))
    assert content["images"] == 6 and content["pairs"] == 72
    assert content["rms_px"] == pytest.approx(2.0 * np.sqrt(2), rel=0.3)
    assert content["focal_px"] == pytest.approx(900.0, rel=0.01)
    prior = baseline_mount(content, weak_mount(None, WIDTH), WIDTH)
    pose = slice(FOCAL + 1)
    off = np.abs(prior.mean[pose] - TRUTH[pose]) / np.sqrt(np.diag(prior.covariance))[pose]
    assert off.max() < 4.0
    assert set(content["sigma"]) == set(UNKNOWNS[: FOCAL + 1])


def test_a_badly_registered_image_counts_little(rng):
    good = registered(rng, start()), start()
    bad = registered(rng, start(1), noise_px=40.0, count=5), start(1)
    both = baseline([good, bad])
    assert both["focal_px"] == pytest.approx(900.0, rel=0.02)


@pytest.fixture
def frame():
    return Frame((458_000.0, 5_428_000.0, 100.0), 1.0, 1.0, CRS.from_epsg(25832).to_wkt())


def written(tmp_path, *rows):
    path = tmp_path / "pairs.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def test_pairs_in_the_clouds_crs(tmp_path, frame):
    path = written(
        tmp_path,
        "Image,pixel_x,pixel_y,x,y,z",
        "a.jpg,10.5,20,458010,5428020,103.5",
        "a.jpg,11,21,458011,5428021,",
    )
    pairs = read_pairs(path, frame)
    assert pairs.iloc[0].tolist() == ["a.jpg", 10.5, 20.0, 10.0, 20.0, 3.5]
    assert np.isnan(pairs["z"].iloc[1])


def test_pairs_in_longitude_and_latitude(tmp_path, frame):
    (lat,), (lon,) = SiteNorth(frame).to_geographic(np.array([[10.0, 20.0]]))
    path = written(
        tmp_path, "image,pixel_x,pixel_y,lon,lat,z", f"a.jpg,1,2,{lon:.9f},{lat:.9f},105"
    )
    assert read_pairs(path, frame)[["x", "y", "z"]].to_numpy()[0] == pytest.approx(
        [10.0, 20.0, 5.0], abs=1e-3
    )


@pytest.mark.parametrize(
    ("rows", "word"),
    [
        (["image,pixel_x,x,y,z", "a,1,2,3,4"], "pixel_y"),
        (["image,pixel_x,pixel_y,z", "a,1,2,3"], "lon, lat"),
        (["image,pixel_x,pixel_y,x,y", "a,1,2,458000,5428000", "a,nan,2,3,4"], "line 3"),
        (["image,pixel_x,pixel_y,x,y,z", "a,1,2,458000,5428000,low"], "z is no number"),
    ],
)
def test_bad_pairs_are_told(tmp_path, frame, rows, word):
    with pytest.raises(InputError, match=word):
        read_pairs(written(tmp_path, *rows), frame)
