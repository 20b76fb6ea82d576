from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from roadsight.geometry.cameras import attitude_deg
from roadsight.io.images.image_shards import JpegShardWriter
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import write_table
from roadsight.poles.alignment.landmarks import Turns
from roadsight.poles.alignment.pose import FOCAL
from roadsight.stages.poles import turn_side_views
from roadsight_worlds.rendering.images import RuralRenderer
from roadsight_worlds.rendering.rendering_look import drive_look, random_finish
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.videolog import random_drives, shots

SEED = 3
LENS_SIGMA = 0.0065


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Twelve places of a rendered drive, with its true cameras."""
    folder = tmp_path_factory.mktemp("turned")
    site = build_rural(SEED, 200.0)
    narrow, _ = random_drives(SEED)
    renderer, look = RuralRenderer(site), drive_look(SEED, 0)
    frames, cameras = [], []
    with JpegShardWriter(folder / "images.zip") as images:
        for shot in shots(site, narrow, SEED)[4:16]:
            for view in ("front", "right"):
                finish = random_finish(np.random.default_rng(shot.sequence))
                picture = renderer.render_view(shot.cameras[view], look, finish, shot.sequence)
                images.write(shot.name(view), picture.colour)
            front = shot.cameras["front"]
            lens = front.intrinsics
            frames.append(
                {
                    "image": shot.name(), "path": shot.name(), "left_path": "",
                    "right_path": shot.name("right"), "route": shot.route,
                    "sequence": shot.sequence, "width_px": lens.width_px,
                    "height_px": lens.height_px, "x": 0.0, "y": 0.0,
                }
            )  # fmt: skip
            heading, pitch, roll = (float(angle) for angle in attitude_deg(front.rotation))
            x, y, z = front.position_m
            pose = {"x": x, "y": y, "z": z, "heading_deg": heading, "pitch_deg": pitch}
            pose |= {"roll_deg": roll, "focal_px": lens.focal_px, "cx_px": lens.cx_px}
            pose |= {"cy_px": lens.cy_px, "width_px": lens.width_px, "height_px": lens.height_px}
            cameras.append({"image": shot.name(), "accepted": True} | pose)
    write_table(folder / "frames.parquet", pd.DataFrame(frames))
    write_table(folder / "cameras.parquet", pd.DataFrame(cameras))
    key = narrow.route, narrow.intrinsics.width_px, narrow.intrinsics.height_px
    return SimpleNamespace(folder=folder, key=key, turn_deg=narrow.views["right"])


def run(drive, monkeypatch, turns):
    covariance = np.zeros((13, 13))
    covariance[FOCAL, FOCAL] = LENS_SIGMA**2
    mount = SimpleNamespace(covariance=covariance)
    found = SimpleNamespace(key=drive.key, turns=turns, mount=mount)
    monkeypatch.setattr(turn_side_views, "from_content", lambda _: found)
    write_json(drive.folder / "calibration.json", {"drives": [{}]})
    files = {"frames": "frames.parquet", "calibration": "calibration.json"}
    files |= {"images": "images.zip", "cameras": "cameras.parquet", "out": "turns.json"}
    given = [part for name, file in files.items() for part in (f"--{name}", drive.folder / file)]
    assert turn_side_views.main([str(part) for part in given]) == 0
    return read_json(drive.folder / "turns.json")["turns"]


def test_a_side_view_is_turned_by_what_it_shares_with_the_front_view(drive, monkeypatch):
    (turn,) = run(drive, monkeypatch, Turns())
    assert (turn["route"], turn["width_px"], turn["height_px"]) == drive.key
    assert turn["view"] == "right"
    assert turn["turn_deg"] == pytest.approx(drive.turn_deg, abs=0.2)
    assert turn["sigma_deg"] == pytest.approx(LENS_SIGMA * drive.turn_deg, rel=0.2)


def test_a_yaw_that_is_known_is_left_alone(drive, monkeypatch):
    assert run(drive, monkeypatch, Turns((0.0, 0.0, 25.0), (0.0, np.inf, 0.1))) == []
