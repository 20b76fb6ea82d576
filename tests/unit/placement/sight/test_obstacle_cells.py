import json
from itertools import pairwise

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest

from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import write_json
from roadsight.io.records.depth_maps import DepthMapInfo, DepthMapWriter
from roadsight.io.records.placement_tables import write_detections
from roadsight.io.records.scene_tables import write_surfels
from roadsight.io.records.tables import write_table
from roadsight.placement.depth.hybrid import hybrid_depth
from roadsight.placement.sensors.rays import NOT_CAST_M
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.obstacles import cell_lines, obstacles_of_target, points_by_cell
from roadsight.stages.placement import find_obstacles
from tests.unit.placement.sensors.test_detection import cylinder_range
from tests.unit.placement.sight.test_obstacles import wall_of_surfels

SIZE = (1.5, 3.0)
"""Larger than the paper's targets, so that few wide cells hold many of their points."""
AROUND = Sensor(azimuth_step_deg=10, elevations_deg=tuple(range(-30, 6, 5)), range_m=45)
PARTIAL = Sensor(
    azimuth_min_deg=120, azimuth_max_deg=255, azimuth_step_deg=7.5,
    elevations_deg=tuple(range(-24, 0, 4)), range_m=30,
)  # fmt: skip


def direction(azimuth_deg, elevation_deg):
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def cell_holds(sensor, row, column, offset, yaw_deg):
    """Whether a point, from the sensor, lies in a cell."""
    azimuth = np.degrees(np.arctan2(offset[1], offset[0])) - yaw_deg
    elevation = np.degrees(np.arctan2(offset[2], np.hypot(offset[0], offset[1])))
    low, high = list(pairwise(sensor.elevation_edges_deg))[row]
    across = (azimuth - sensor.azimuth_min_deg) % 360 / sensor.azimuth_cell_deg
    return low <= elevation < high and int(across) == column


def appendix_b(points, scene_m, sensor, position, yaw_deg, foot):
    """For each cell of the target's map: r_s < r_t, and then the cell's points between them."""
    found, hidden, cells = set(), 0, 0
    for row, column in np.ndindex(*sensor.shape):
        beam = direction(sensor.azimuth_deg[column] + yaw_deg, sensor.elevation_deg[row])
        target_m = float(cylinder_range(position, beam, foot, *SIZE))
        if not target_m < sensor.range_m:
            continue
        cells += 1
        depth_m = float(scene_m[row, column])
        if not 0 < depth_m < target_m or depth_m == NOT_CAST_M:
            continue
        hidden += 1
        for number, point in enumerate(points):
            offset = point - position
            inside = cell_holds(sensor, row, column, offset, yaw_deg)
            if inside and depth_m <= np.linalg.norm(offset) <= target_m:
                found.add(number)
    return sorted(found), hidden / cells if cells else 0.0


@pytest.mark.parametrize("sensor", [AROUND, PARTIAL], ids=["full circle", "partial"])
def test_points_are_those_of_appendix_b(sensor, rng):
    position, yaw_deg = np.array([2.0, -1.0, 5.0]), 33.0
    points = rng.uniform((-25, -25, 0), (25, 25, 4), (1500, 3))
    scene_m = hybrid_depth(points, sensor, position, yaw_deg, min_cell_points=1).astype(np.float64)
    scene_m[rng.random(scene_m.shape) < 0.02] = NOT_CAST_M
    cells = points_by_cell(points, sensor, position, yaw_deg)
    some = 0
    for angle in np.radians(rng.uniform(0, 360, 20)):
        reach = rng.uniform(4, 24)
        foot = position + np.array([reach * np.cos(angle), reach * np.sin(angle), -5.0])
        view = cells, scene_m, sensor, position, yaw_deg
        found, share = obstacles_of_target(*view, foot, SIZE)
        expected, expected_share = appendix_b(points, scene_m, sensor, position, yaw_deg, foot)
        assert found.tolist() == expected
        assert share == pytest.approx(expected_share)
        some += len(found)
    assert some > 20


def test_lines_are_means_by_pair_and_cubic_metre():
    pairs = pd.DataFrame({"candidate": ["a", "a", "b"], "target": ["s", "t", "s"], "x": 0.0})
    xyz = np.array([[0.2, 0.2, 0.5], [0.4, 0.6, 0.7], [5.5, 0.1, 0.1]])
    none = np.zeros(0, np.int64)
    lines = cell_lines(pairs, xyz, [(np.array([0, 1, 2]), 0.5), (none, 0.0), (np.array([2]), 1.0)])
    assert lines[["candidate", "target"]].to_numpy().tolist() == [
        ["a", "s"],
        ["a", "s"],
        ["b", "s"],
    ]
    place = lines[["obstacle_x", "obstacle_y", "obstacle_z"]].to_numpy()
    np.testing.assert_allclose(place, [[0.3, 0.4, 0.6], [5.5, 0.1, 0.1], [5.5, 0.1, 0.1]])
    assert lines["blocked_share"].tolist() == [0.5, 0.5, 1.0]
    assert set(cell_lines(pairs.iloc[:0], xyz, [])) == set(lines)


FRAME = Frame((458_000.0, 5_428_000.0, 100.0))
STREET_SENSORS = """
sensors:
  far: {azimuth_step_deg: 0.5, elevation_min_deg: -30, elevation_max_deg: 0, channels: 61,
        range_m: 60}
  eye: {kind: camera, columns_px: 800, rows_px: 600, hfov_deg: 60, range_m: 60, min_pixels: 20}
"""


@pytest.fixture
def street(tmp_path, rng):
    """A sensor at the origin, 6 m up, a wall at 20 m, one target before it and two behind."""
    ground = np.column_stack(
        [rng.uniform(-20, 50, 60_000), rng.uniform(-12, 12, 60_000), 0 * np.ones(60_000)]
    )
    wall = np.column_stack([np.full(30_000, 20.0), *rng.uniform((-10, 0), (10, 5), (30_000, 2)).T])
    xyz = np.concatenate([ground, wall])
    ones = np.ones(len(xyz), np.uint8)
    with TileWriter(tmp_path / "cloud.parquet", 20.0, coloured=False) as writer:
        counts = dict.fromkeys(("classification", "return_number", "number_of_returns"), ones)
        writer.append(dict(zip("xyz", xyz.T, strict=True)) | {"intensity": ones} | counts)
        writer.finish()
    write_json(tmp_path / "frame.json", FRAME.to_dict())
    write_surfels(tmp_path / "surfels.parquet", wall_of_surfels(20.0, 5.0))
    write_raster(tmp_path / "dem.tif", np.zeros((40, 120)), FRAME, -20.0, 20.0, 1.0)
    feet = [[10, 0, 0], [30, 0, 0], [33, 2, 0]]
    targets = pd.DataFrame(feet, columns=list("xyz"), dtype=float)
    targets.insert(0, "target", ["t0", "t1", "t2"])
    write_table(tmp_path / "targets.parquet", targets)
    candidate = {"candidate": ["c0"], "x": [0.0], "y": [0.0], "z": [6.0], "yaw_deg": [10.0]}
    write_table(tmp_path / "candidates.parquet", pd.DataFrame(candidate))
    seen = pd.DataFrame({"candidate": ["c0"], "target": ["t0"], "hits": np.array([9], np.uint16)})
    write_detections(tmp_path / "seen.parquet", seen, {"sensor": "far"})
    (tmp_path / "sensors.yaml").write_text(STREET_SENSORS)
    write_json(tmp_path / "coverage.json", {"plans": {"p": {"uncovered": ["t2"]}}})
    far = Sensor(
        azimuth_step_deg=0.5, elevation_min_deg=-30, elevation_max_deg=0, channels=61, range_m=60
    )
    depth_m = hybrid_depth(xyz.astype(np.float32), far, (0, 0, 6), 10.0)
    with DepthMapWriter(
        tmp_path / "depth.parquet", DepthMapInfo("far", "hybrid", *far.shape, 0.001)
    ) as writer:
        writer.append("c0", depth_m)
    return tmp_path


def run(folder, *options, sensor="far"):
    chosen = {"candidate": "c0", "sensor": sensor, "x": 0.0, "y": 0.0, "z": 6.0}
    chosen |= {"yaw_deg": 10.0, "pitch_deg": 0.0, "roll_deg": 0.0}
    write_json(folder / "solution.json", {"sensors": [chosen], "sensor_types": [sensor]})
    files = {name: f"{name}.parquet" for name in ("targets", "surfels", "candidates")}
    files |= {name: f"{name}.json" for name in ("frame", "coverage", "solution")}
    files |= {"dem": "dem.tif", "sensors": "sensors.yaml", "detections": "seen.parquet"}
    paths = [part for n, file in files.items() for part in (f"--{n}", str(folder / file))]
    out = ["--plan", "p", "--method", "cells", "--out", str(folder / "obstacles.gpkg")]
    return find_obstacles.main([*paths, *out, *options])


def test_stage_finds_the_wall_by_cells(street):
    cells = ("--depth", str(street / "depth.parquet"), "--cloud", str(street / "cloud.parquet"))
    assert run(street, *cells) == 0
    obstacles = gpd.read_file(street / "obstacles.gpkg", layer="obstacles")
    x = obstacles.geometry.x - FRAME.origin[0]
    wall = obstacles[np.abs(x - 20) < 0.01]
    # Lines to targets of 0.6 m cross the wall 2.0 to 2.6 m up; cells are a little wider.
    assert len(wall) and wall["height_m"].between(1.7, 2.9).all()
    assert wall["targets"].sum() >= 2 and set(wall["sensors"]) == {1}
    # Whatever else lies between the wall and the targets in their cells: the road behind the wall.
    assert x.between(19.9, 33.5).all()
    gaps = gpd.read_file(street / "obstacles.gpkg", layer="uncovered")
    assert gaps[["target", "reason"]].to_numpy().tolist() == [["t2", "hidden"]]


def test_what_cells_cannot_use_is_told(street, capsys):
    cloud = ("--cloud", str(street / "cloud.parquet"))
    assert run(street, *cloud) == 2
    assert "depth maps of chosen sensors are missing" in capsys.readouterr().err
    assert run(street, "--depth", str(street / "depth.parquet")) == 2
    assert "obstacles.method: cells, --cloud" in capsys.readouterr().err
    assert run(street, *cloud, sensor="eye") == 2
    told = capsys.readouterr().err
    assert "cells of spinning LiDARs" in told and "eye" in told
    assert json.loads((street / "solution.json").read_text())["sensor_types"] == ["eye"]
