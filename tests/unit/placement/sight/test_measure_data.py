import json

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely

from roadsight.io.cloud.clouds import write_laz
from roadsight.io.records.atomic import write_json
from roadsight.io.records.depth_maps import DepthMapInfo, DepthMapWriter
from roadsight.io.records.placement_tables import write_detections
from roadsight.io.records.tables import write_table
from roadsight.io.vector.vectors import read_layer, write_layers
from roadsight.placement.sensors.sensors import load_sensors
from roadsight.placement.sight.kinds import Cylinder
from roadsight.placement.sight.sight import Sight, beams_by_height, count_beams
from roadsight.stages.placement import measure_data
from tests.unit.placement.stages.test_solve_cover_stage import FRAME

SENSOR = load_sensors("config/sensors.yaml")["OS-64"]
INFO = DepthMapInfo("OS-64", "surfel", *SENSOR.shape, 0.002)
# Near a wall hides the targets on one side.
SCENE = {name: np.zeros(SENSOR.shape, np.float32) for name in ("a", "b", "unused")}
SCENE["b"][:, : SENSOR.columns // 2] = 3.0
SEEN = {"a": range(0, 12), "b": range(8, 20), "unused": range(20)}


@pytest.fixture
def folder(tmp_path):
    x = np.arange(20) + 0.5
    targets = pd.DataFrame({"target": [f"t{n}" for n in range(20)], "x": x, "y": 2.0, "z": 0.0})
    write_table(tmp_path / "targets", targets, {"cell_size_m": 1.0})
    points = {"a": 6, "b": 9, "unused": 200}
    rows = [(name, f"t{n}", points[name]) for name, seen in SEEN.items() for n in seen]
    table = pd.DataFrame(rows, columns=["candidate", "target", "hits"])
    write_detections(tmp_path / "seen", table.astype({"hits": "uint16"}), {"sensor": "OS-64"})
    place = {"sensor": "OS-64", "y": -1.0, "z": 5.0}
    chosen = [place | {"candidate": "b", "x": 14.0}, place | {"candidate": "a", "x": 4.0}]
    write_json(tmp_path / "solution", {"sensors": chosen})
    places = pd.DataFrame({"candidate": ["a", "b"], "x": [4.0, 14.0], "y": -1.0, "z": 5.0})
    write_table(tmp_path / "candidates", places.assign(yaw_deg=90.0))
    with DepthMapWriter(tmp_path / "depth", INFO) as writer:
        for name in ("unused", "b", "a"):
            writer.append(name, SCENE[name])
    write_json(tmp_path / "frame.json", FRAME.to_dict())
    line = gpd.GeoDataFrame({"edge": ["e"]}, geometry=[shapely.LineString([(0, 0), (20, 0)])])
    road = gpd.GeoDataFrame({"part": [0]}, geometry=[shapely.box(0, 0, 20, 4)])
    write_layers(tmp_path / "edges.gpkg", {"edges": line}, FRAME)
    write_layers(tmp_path / "pavement.gpkg", {"pavement": road}, FRAME)
    returns = np.array([[1, 1, 0], [2, 3, 0], [3, 9, 0], [5, 2, 0]], float)
    source = {"point_source_id": np.array([1, 1, 1, 2], np.uint16)}
    write_laz(tmp_path / "scans.laz", returns, FRAME, source)
    return tmp_path


def test_figures_of_plan_and_sensors(folder):
    names = {
        "solution": "solution", "targets": "targets", "frame": "frame.json", "edges": "edges.gpkg",
        "pavement": "pavement.gpkg", "scans": "scans.laz", "detections": "seen", "depth": "depth",
        "candidates": "candidates", "out": "out.json", "layers": "out.gpkg",
    }  # fmt: skip
    files = [part for key, name in names.items() for part in (f"--{key}", str(folder / name))]
    options = ["--sensors", "config/sensors.yaml", "--frames-hz", "20"]
    assert measure_data.main([*files, *options]) == 0
    found = json.loads((folder / "out.json").read_text())
    assert found["targets_by_sensors"] == [0, 16, 4]
    assert found["share_seen_by_two"] == 0.2
    assert found["overlaps"] == [{"sensor": "a", "next": "b", "targets": 4, "length_m": 4.0}]
    assert found["points_per_s"] == 2 * 64 * 3600 * 20
    assert found["road_points_per_s"] == 3 * 20
    first, second = found["sensors"]
    assert (first["candidate"], first["road_points_per_s"]) == ("b", 40)
    assert (second["overlap_with_next_m"], first["overlap_with_next_m"]) == (4.0, None)
    six, nine = 0.152 * np.log(6) + 0.659, 0.152 * np.log(9) + 0.659
    likely = found["probability"]
    assert (likely["targets"], likely["least"]) == (20, pytest.approx(six))
    assert likely["mean"] == pytest.approx((8 * six + 12 * nine) / 20)
    assert likely["independent"]["least"] == pytest.approx(six)
    both = 1 - (1 - six) * (1 - nine)
    assert likely["independent"]["mean"] == pytest.approx((8 * six + 8 * nine + 4 * both) / 20)
    layer = read_layer(folder / "out.gpkg", "sensors", FRAME)
    assert layer["points_per_s"].sum() == found["points_per_s"]
    assert layer.geometry.x.tolist() == pytest.approx([14.0, 4.0], abs=1e-3)
    check_heights(found["heights"], read_layer(folder / "out.gpkg", "targets", FRAME))


def check_heights(found, layer):
    """Both sensors' beams on every target, from their own depth maps."""
    feet = np.column_stack([np.arange(20) + 0.5, np.full(20, 2.0), np.zeros(20)])
    sight = Sight(SENSOR.range_m)
    pose = {"a": (4.0, -1.0, 5.0), "b": (14.0, -1.0, 5.0)}
    parts = [
        beams_by_height(SCENE[n], SENSOR, pose[n], 90.0, feet, Cylinder(0.25, 0.6), sight, 4)
        for n in "ab"
    ]
    counted = [count_beams(SCENE[n], SENSOR, pose[n], 90.0, feet, (0.25, 0.6), sight) for n in "ab"]
    assert np.abs(sum(parts).sum(axis=1) - sum(counted)).max() <= 2
    columns = layer[["points_1", "points_2", "points_3", "points_4"]]
    np.testing.assert_allclose(columns.to_numpy(), sum(parts), atol=0.05)
    assert layer["sensors"].tolist() == [1] * 8 + [2] * 4 + [1] * 8
    (points,) = found
    assert points["unit"] == "points"
    np.testing.assert_allclose([b["mean"] for b in points["bands"]], sum(parts).mean(axis=0))
    np.testing.assert_allclose(
        [b["median"] for b in points["bands"]], np.median(sum(parts), axis=0)
    )
    assert [b["to_m"] for b in points["bands"]] == pytest.approx([0.15, 0.3, 0.45, 0.6])
