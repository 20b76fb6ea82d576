import json

import numpy as np
import pandas as pd
import pytest

from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.scene_tables import read_surfels, write_surfels
from roadsight.io.records.tables import read_table, write_table
from roadsight.io.vector.vectors import read_layer
from roadsight.scene.surfels import Surfels
from roadsight.stages.placement import (
    build_detection_shard,
    find_obstacles,
    gather_objects,
    render_depth_maps,
    solve_cover,
    try_removals,
)

SENSORS = """
sensors:
  S:
    {azimuth_step_deg: 0.5, elevation_min_deg: -80, elevation_max_deg: 0, channels: 161,
     range_m: 60}
"""
BARRIER = "barrier+10+4"
FRAME = Frame((0.0, 0.0, 0.0))


def grid(x, y, z, normal):
    """Surfels of 0.1 m at all places of three axes."""
    centre = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    return centre, np.tile(np.array(normal, np.float32), (len(centre), 1))


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A road of 20 m x 8 m with a barrier of 1.4 m across its middle, a sensor at either end."""
    folder = tmp_path_factory.mktemp("site")
    road = grid(np.arange(-1, 21, 0.2), np.arange(-1, 9, 0.2), [0.0], (0, 0, 1))
    barrier = grid([10.0], np.arange(0, 8, 0.2), np.arange(0.1, 1.4, 0.2), (1, 0, 0))
    centre, normal = (np.concatenate(parts) for parts in zip(road, barrier, strict=True))
    half_m = np.full((len(centre), 2), 0.11, np.float32)
    write_surfels(folder / "surfels.parquet", Surfels(centre, normal, half_m))
    write_raster(folder / "dem.tif", np.zeros((12, 24)), FRAME, -2.0, 10.0, 1.0)
    write_json(folder / "frame.json", FRAME.to_dict())
    (folder / "sensors.yaml").write_text(SENSORS)
    at = np.stack(np.meshgrid(np.arange(1.5, 19), np.arange(0.5, 8)), -1).reshape(-1, 2)
    feet = pd.DataFrame({"x": at[:, 0], "y": at[:, 1], "z": 0.0})
    feet.insert(0, "target", [f"t{i}" for i in range(len(at))])
    write_table(folder / "targets.parquet", feet)
    place = {"y": -0.5, "z": 3.0, "yaw_deg": 90.0, "height_m": 3.0, "edge": "e", "mount": "m"}
    candidates = pd.DataFrame({"candidate": ["a", "b"], "key": ["a", "b"], "x": [2.0, 18.0]})
    write_table(folder / "candidates.parquet", candidates.assign(**place))
    write_json(folder / "coverage.json", {"plans": {"p": {"uncovered": []}}})
    return folder


def files(folder, **named):
    return [
        part for n, f in named.items() for part in (f"--{n.replace('_', '-')}", str(folder / f))
    ]


def gather(folder, *remove):
    ground = files(folder, surfels="surfels.parquet", dem="dem.tif", frame="frame.json")
    out = files(folder, objects="objects.gpkg", members="objects.parquet", left="left.parquet")
    return gather_objects.main(["--site", "here", *ground, *out, "--remove", *remove])


def plan(folder, surfels):
    """Sensors, obstacles and removals of a plan in a scene."""
    about = files(folder, sensors="sensors.yaml", candidates="candidates.parquet")
    scene = files(folder, surfels=surfels, cloud="none")
    about += ["--sensor", "S"]
    assert render_depth_maps.main([*about, *scene, *files(folder, out="maps")]) == 0
    seen = files(folder, depth="maps", targets="targets.parquet", out="seen.parquet")
    assert build_detection_shard.main([*about, *seen]) == 0
    tables = files(folder, targets="targets.parquet", candidates="candidates.parquet")
    tables += files(folder, detections="seen.parquet", frame="frame.json")
    made = files(folder, solution="solution.json", layers="solution.gpkg", timing="timing.json")
    made += files(folder, coverage="coverage.json", doubts="doubts.json")
    site = ["--site", "here", "--plan", "p", "--sensors", "S=1.0"]
    assert solve_cover.main([*site, *tables, *made]) == 0
    scene = files(folder, surfels=surfels, objects="objects.parquet", solution="solution.json")
    rest = files(folder, coverage="coverage.json", dem="dem.tif", sensors="sensors.yaml")
    rest += files(folder, out="obstacles.gpkg")
    assert find_obstacles.main([*tables, *scene, *rest, "--plan", "p"]) == 0
    rest = files(
        folder, obstacles="obstacles.gpkg", sensors_file="sensors.yaml", out="removals.json"
    )
    assert try_removals.main([*tables, *scene, *rest, "--costs", "S=1.0", "--felled", "3"]) == 0
    return read_json(folder / "solution.json"), read_json(folder / "removals.json")


def test_a_barrier_is_named_and_taken_away(site):
    assert gather(site) == 0
    objects = read_layer(site / "objects.gpkg", "objects", FRAME)
    assert objects[["name", "removed"]].to_numpy().tolist() == [[BARRIER, 0]]
    everything = read_surfels(site / "surfels.parquet").centre_m
    np.testing.assert_array_equal(read_surfels(site / "left.parquet").centre_m, everything)
    own = read_table(site / "objects.parquet")
    assert set(own["object"]) == {BARRIER}
    assert gather(site, BARRIER) == 0
    assert read_layer(site / "objects.gpkg", "objects", FRAME)["removed"].tolist() == [1]
    left = read_surfels(site / "left.parquet").centre_m
    assert len(left) == len(everything) - len(own)
    assert left[:, 2].max() < 0.4
    assert read_table(site / "objects.parquet").empty


def test_a_name_that_nothing_has_is_refused_in_one_message(site, capsys):
    assert gather(site, "barrier+11+4") == 2
    message = capsys.readouterr().err
    assert "site here: placement.remove" in message
    assert "found barrier+11+4" in message
    assert f"did you mean '{BARRIER}'" in message
    assert gather(site, "xyz") == 2
    assert f"valid names: {BARRIER}" in capsys.readouterr().err


def test_a_removal_says_what_it_saves_and_keeps_its_word(site):
    assert gather(site) == 0
    solution, found = plan(site, "surfels.parquet")
    assert len(solution["sensors"]) == 2
    (row,) = found["rows"]
    (told,) = found["objects"]
    assert (told["name"], told["kind"], told["sensors"]) == (BARRIER, "barrier", 2)
    assert told["targets"] == row["hidden_targets"]
    assert (row["object"], row["kind"], row["status"]) == (BARRIER, "barrier", "optimal")
    assert (row["sensors_before"], row["sensors"]) == (2, 1)
    assert row["hidden_targets"] > 10
    assert gather(site, BARRIER) == 0
    solution, found = plan(site, "left.parquet")
    assert len(solution["sensors"]) == 1
    assert found == {"plan": "p", "objects": [], "rows": []}
    told = json.loads((site / "doubts.json").read_text())
    assert [doubt["code"] for doubt in told] == ["few_positions"]
