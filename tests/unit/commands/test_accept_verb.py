import json

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from shapely import Point

from roadsight.__main__ import build_parser, main
from roadsight.api.sight import CATALOGUE
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.clouds import write_laz
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import write_table
from roadsight.io.vector.vectors import write_layers
from roadsight.placement.sensors.poses import AS_MOUNTED, local_from_sensor, tilt_rotation
from tests.unit.placement.plans.test_acceptance import PLACE_M, scan, street
from tests.unit.placement.stages.test_solve_cover_stage import FRAME

SENSORS = {
    "sensors": {
        "mine": {
            "kind": "spinning",
            "azimuth_step_deg": 1.0,
            "elevations_deg": list(range(-45, 11)),
            "range_m": 60.0,
        }
    }
}
OWN = Frame((0.0, 0.0, 0.0), 1.0, 1.0, FRAME.crs_wkt)
"""A scan in the sensor's own frame: metres from its centre."""


def write_plan(folder):
    """A plan of one sensor amid its results in a folder, and its sensors file; gives the plan."""
    plan = folder / "placement" / "p"
    plan.mkdir(parents=True)
    (folder / "scene").mkdir()
    write_json(folder / "scene" / "frame.json", FRAME.to_dict())
    place = dict(zip("xyz", PLACE_M.tolist(), strict=True)) | {"yaw_deg": 30.0}
    write_json(
        plan / "solution.json", {"sensors": [place | {"sensor": "mine", "candidate": "left-1"}]}
    )
    feet = [Point(-9.0, 8.2, 0.0), Point(4.0, 8.0, 0.0)]
    table = gpd.GeoDataFrame({"target": ["t0", "t1"], "sensors": [1, 2]}, geometry=feet)
    write_layers(plan / "solution.gpkg", {"targets": table}, FRAME, {"targets": "Point Z"})
    points = scan(PLACE_M, street(0))
    source = {"point_source_id": np.ones(len(points), np.uint16)}
    write_laz(plan / "scans.laz", points, FRAME, source)
    write_json(folder / "sensors.yaml", SENSORS)  # JSON is YAML
    return plan


@pytest.fixture
def accept(tmp_path, capsys):
    """Runs the verb on a plan of one sensor, `tmp_path` being its results."""
    plan = write_plan(tmp_path)

    def run(points, frame, *options):
        write_laz(tmp_path / "scan.laz", points, frame)
        argv = ["accept", str(tmp_path / "scan.laz"), "--plan", str(plan / "solution.json")]
        argv += ["--sensor", "1", "--sensors", str(tmp_path / "sensors.yaml")]
        code = main([*argv, "-o", str(tmp_path / "out.json"), *options])
        told = capsys.readouterr()
        return json.loads((tmp_path / "out.json").read_text()) if code == 0 else told.err

    return run


def test_a_sensor_that_stands_as_planned_is_accepted_in_either_frame(accept):
    position_m = PLACE_M + np.array([0.1, 0.0, 0.05])
    measured = scan(position_m, street(0))
    yaw = np.radians(30.0)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    found = accept((measured - position_m) @ turn, OWN)
    assert found["verdict"] == "accepted"
    assert found["moved_m"]["x"] == pytest.approx(0.1, abs=0.02)
    assert found["moved_m"]["z"] == pytest.approx(0.05, abs=0.01)
    placed = accept(measured - position_m + PLACE_M, FRAME)  # placed as if it stood as planned
    assert placed["moved_m"]["x"] == pytest.approx(0.1, abs=0.02)


def test_a_sensor_beside_its_place_behind_a_truck_is_not(accept):
    position_m = PLACE_M + np.array([0.4, 0.0, 0.0])
    measured = scan(position_m, [*street(0), ((-12, 4, 0), (-4, 7, 3.5))])
    found = accept(measured - position_m + PLACE_M, FRAME)
    assert found["verdict"] == "not accepted"
    assert any("m from its place" in reason for reason in found["reasons"])
    assert accept(measured - position_m + PLACE_M, FRAME, "--move-m", "0.5")["moved_by_m"] > 0.3


def test_a_scan_of_another_place_is_one_message(accept):
    other = np.array([0.0, 0.0, 7.5])
    told = accept(scan(other, street(3)) - other + PLACE_M, FRAME)
    assert "another place" in told
    assert told.count("\n") == 1


def test_a_sensor_that_the_plan_lacks_is_refused(accept):
    told = accept(scan(PLACE_M, street(0)), FRAME, "--sensor", "2")
    assert "--sensor" in told
    assert "1 to 1" in told


def test_a_mount_that_was_planned_to_lean_may_lean(accept, tmp_path):
    normal = np.array([0.06, -0.03, 1.0]) / np.linalg.norm([0.06, -0.03, 1.0])
    turn = local_from_sensor(30.0, AS_MOUNTED, tilt_rotation(normal))
    own = (scan(PLACE_M, street(0)) - PLACE_M) @ turn
    upright = accept(own, OWN)
    assert any("leans" in reason for reason in upright["reasons"])
    names = ("normal_x", "normal_y", "normal_z")
    lean = pd.DataFrame([{"candidate": "left-1", **dict(zip(names, normal, strict=True))}])
    (tmp_path / "placement" / "round-0").mkdir()
    write_table(tmp_path / "placement" / "round-0" / "tilts.parquet", lean)
    leaning = accept(own, OWN)
    assert leaning["tilted_deg"] < 0.1
    assert leaning["verdict"] == "accepted"
    # Tilts of an earlier run, whose effect is skipped now, are none of the plan's.
    write_json(tmp_path / "effects.json", [{"effect": "mount_tilt", "decision": "skip"}])
    assert accept(own, OWN)["tilted_deg"] == pytest.approx(upright["tilted_deg"])


def test_targets_are_those_that_the_plan_detected(accept, tmp_path):
    points = scan(PLACE_M, street(0))
    usual = accept(points, FRAME)
    assert usual["target"] == {"radius_m": 0.25, "height_m": 0.6, "min_beams": 8}
    folder = tmp_path / "placement" / "round-0" / "detection" / "mine"
    folder.mkdir(parents=True)
    about = {"sensor": "mine", "length_m": 4.5, "width_m": 1.8, "height_m": 1.5, "min_beams": 2}
    none = pd.DataFrame({"candidate": [], "target": [], "hits": []})
    write_table(folder / "0.parquet", none, about)
    found = accept(points, FRAME)
    assert found["target"] == {"radius_m": 0.9, "height_m": 1.5, "min_beams": 2}
    assert found["targets"]["seen"] > usual["targets"]["seen"]


def test_a_model_that_the_sensors_file_lacks_is_refused(accept, tmp_path):
    other = tmp_path / "other.yaml"
    write_json(other, {"sensors": {"theirs": SENSORS["sensors"]["mine"]}})
    told = accept(scan(PLACE_M, street(0)), FRAME, "--sensors", str(other))
    assert told.count("\n") == 1
    for part in ("other.yaml", "mine", "theirs", "--sensors"):
        assert part in told


def test_the_catalogue_of_sensors_is_the_package_s_own():
    asked = build_parser().parse_args(
        ["accept", "s.laz", "--plan", "p", "--sensor", "1", "-o", "o"]
    )
    assert asked.sensors == CATALOGUE
