import dataclasses
import json

import geopandas as gpd
import numpy as np
import pytest
import shapely

from roadsight.io.vector.vectors import write_layers
from roadsight.stages.placement import solve_cover
from roadsight.stages.placement.shared.cover_inputs import FILES
from tests.unit.placement.stages.test_solve_cover_stage import FRAME, Site, write_sight

# Candidates stand 4 m apart (local x 0, 4, 0, 4, 8, ...), two in the first table, the rest after.
SIGHT = {"a": "012", "b": "12", "c": "23", "d": "345"}


@pytest.fixture
def site(tmp_path):
    found = Site(tmp_path, {"S": SIGHT})
    assert found.check("p=S") == 0
    return found


def solve(site, options, sensors=("S=1",), files=(), uncoverable="error", extra=()):
    arguments = [f"--options={json.dumps(options)}", "--uncoverable", uncoverable, *extra]
    for name, path in dict(files).items():
        arguments += [f"--{name}", str(path)]
    return site.solve(*sensors, options=arguments)


def polygons(folder, file, boxes, **columns):
    """Boxes (west, south, east, north) in local metres as a GeoPackage in the site's CRS."""
    features = gpd.GeoDataFrame(columns, geometry=[shapely.box(*box) for box in boxes])
    write_layers(folder / file, {"areas": features}, FRAME)
    return folder / file


def points(folder, name, rows, header):
    """CSV of points, whose first two columns are local metres."""
    lines = [",".join(["x", "y", *header])]
    for x, y, *rest in rows:
        native = FRAME.to_native(np.array([x, y, 0.0]))
        lines.append(",".join(map(str, [native[0], native[1], *rest])))
    (folder / name).write_text("\n".join(lines))
    return folder / name


def chosen(site):
    return [sensor["candidate"] for sensor in site.read("solution.json")["sensors"]]


def last_error(capsys):
    return capsys.readouterr().err.splitlines()[-1]


def test_budget_sees_the_most_for_so_many_sensors(site):
    assert solve(site, {"budget": {"sensors": 1, "cost": None}}) == 0
    solution = site.read("solution.json")
    assert chosen(site) in (["a"], ["d"])
    assert solution["covered_targets"] == 3
    assert (solution["objective"], solution["bound"], solution["status"]) == (1.0, None, "optimal")
    assert solution["options"]["goal"] == {"kind": "coverage", "value": 3.0, "bound": 3.0}


def test_budget_in_money_and_weights_by_area(site, tmp_path):
    areas = polygons(tmp_path, "areas.gpkg", [(1.5, 2, 3.5, 4)], weight=[5.0])
    options = {"budget": {"sensors": None, "cost": 2.5}, "areas": {"crs": None}}
    assert solve(site, options, sensors=("S=2",), files={"areas": areas}) == 0
    # c sees both heavy targets: t2 and t3.
    assert chosen(site) == ["c"]
    solution = site.read("solution.json")
    assert solution["options"]["weight"] == {"seen": 10.0, "of": 14.0}
    assert solution["objective"] == 2.0
    targets = gpd.read_file(tmp_path / "layers.gpkg", layer="targets")
    assert targets["weight"].tolist() == [1, 1, 5, 5, 1, 1]


def test_a_price_leaves_targets_that_are_not_worth_a_sensor(site):
    assert solve(site, {"price": 0.3}) == 0
    goal = site.read("solution.json")["options"]["goal"]
    assert chosen(site) == []
    assert goal == {
        "kind": "cost and price",
        "value": pytest.approx(1.8),
        "bound": pytest.approx(1.8),
    }
    assert solve(site, {"price": 0.4}) == 0
    assert chosen(site) == ["a", "d"]
    assert site.read("solution.json")["covered_targets"] == 6


def test_folds_that_cannot_be_reached_are_one_message_or_are_lowered(site, capsys):
    assert solve(site, {"at_least": 2}) == 2
    error = last_error(capsys)
    assert (
        "3 of 6 targets cannot be seen by as many sensors as asked for, 0 of them by none" in error
    )
    assert "found t0 (1 of 2), t4 (1 of 2), t5 (1 of 2)" in error
    assert solve(site, {"at_least": 2}, uncoverable="exclude") == 0
    solution = site.read("solution.json")
    assert solution["options"]["short"] == {"t0": 1, "t4": 1, "t5": 1}
    assert solution["at_least"] == 2
    assert chosen(site) == ["a", "b", "c", "d"]


def test_areas_may_ask_for_more_or_nothing(site, tmp_path):
    boxes = [(1.5, 2, 2.5, 4), (3.5, 2, 5.5, 4)]
    areas = polygons(tmp_path, "areas.gpkg", boxes, at_least=[3, 0])
    assert solve(site, {"areas": {"crs": None}}, files={"areas": areas}) == 0
    assert chosen(site) == ["a", "b", "c"]
    areas = polygons(tmp_path, "bad.gpkg", boxes, owner=["x", "y"])
    assert solve(site, {"areas": {"crs": None}}, files={"areas": areas}) == 2


def test_targets_that_areas_waive_need_no_candidate(tmp_path):
    site = Site(tmp_path, {"S": {"a": "012", "b": "34"}})
    assert site.check("p=S") == 0
    assert solve(site, {"at_least": 1}) == 2  # nothing sees target 5
    areas = polygons(tmp_path, "areas.gpkg", [(4.5, 2, 5.5, 4)], at_least=[0])
    assert solve(site, {"areas": {"crs": None}}, files={"areas": areas}) == 0
    assert chosen(site) == ["a", "b"]


def test_zones_forbid_candidates_and_targets_that_only_they_see(site, tmp_path, capsys):
    zone = polygons(tmp_path, "zone.gpkg", [(3.9, -1, 4.1, 0)])  # b and d
    options = {"forbidden": {"crs": None}}
    assert solve(site, options, files={"forbidden": zone}) == 2
    assert "2 of 6 targets cannot be seen" in last_error(capsys)
    assert solve(site, options, files={"forbidden": zone}, uncoverable="exclude") == 0
    solution = site.read("solution.json")
    assert chosen(site) == ["a", "c"]
    assert solution["excluded"] == ["t4", "t5"]
    assert solution["covered_targets"] == 4
    assert solution["options"]["forbidden_candidates"] == 2


def test_mandatory_points_snap_to_a_candidate_or_say_why_not(site, tmp_path, capsys):
    near = points(tmp_path, "near.csv", [(0.5, 0.0, "S")], ["kind"])
    options = {"mandatory": {"crs": None, "within_m": 1.0}}
    assert solve(site, options, files={"mandatory": near}) == 0
    solution = site.read("solution.json")
    assert [s["candidate"] for s in solution["sensors"] if s["mandatory"]] == ["a"]
    far = points(tmp_path, "far.csv", [(20.0, 0.0, "")], ["kind"])
    assert solve(site, options, files={"mandatory": far}) == 2
    assert "has no candidate near it; found the nearest is 16.0 m away" in last_error(capsys)
    other = points(tmp_path, "other.csv", [(0.0, -0.5, "T")], ["kind"])
    assert solve(site, options, files={"mandatory": other}) == 2
    assert "kind names no sensor of the plan; found T; allowed: S" in last_error(capsys)
    both = points(tmp_path, "both.csv", [(0.0, -0.5), (0.1, -0.5)], [])
    assert solve(site, options, files={"mandatory": both}) == 2
    assert "stands at the same candidates" in last_error(capsys)


def test_a_point_between_two_places_takes_one_of_them(site, tmp_path):
    two = points(tmp_path, "two.csv", [(2.0, -0.5), (4.0, -0.5)], [])
    options = {"mandatory": {"crs": None, "within_m": 3.0}}
    assert solve(site, options, files={"mandatory": two}) == 0
    sensors = [s for s in site.read("solution.json")["sensors"] if s["mandatory"]]
    assert len(sensors) == 2


def test_mandatory_beyond_the_budget_is_one_message(site, tmp_path, capsys):
    two = points(tmp_path, "two.csv", [(0.0, -0.5), (4.0, -0.5)], [])
    options = {"mandatory": {"crs": None, "within_m": 1.0}, "budget": {"sensors": 1, "cost": None}}
    assert solve(site, options, files={"mandatory": two}) == 2
    assert "the mandatory sensors alone exceed the budget; found 2 of 1" in last_error(capsys)


def test_poles_make_candidates_cheaper_within_their_heights(site, tmp_path):
    header = ["cost", "height_min_m", "height_max_m"]
    options = {"poles": {"crs": None, "within_m": 1.0, "cost": 0.0, "new_cost": 4.0}}
    usable = points(tmp_path, "poles.csv", [(4.2, -0.5, 0.5, 3, 6)], header)
    assert solve(site, options, files={"poles": usable}) == 0
    costs = {s["candidate"]: (s["cost"], s["pole"]) for s in site.read("solution.json")["sensors"]}
    assert costs == {"a": (5.0, ""), "d": (1.5, "t1")}
    low = points(tmp_path, "low.csv", [(4.2, -0.5, 0.5, 1, 3)], header)
    assert solve(site, options, files={"poles": low}) == 0
    assert site.read("solution.json")["objective"] == 10.0


def test_spacing_keeps_sensors_apart_or_says_that_nothing_does(site, capsys):
    # a and c stand at one place, b and d at another, 4 m away.
    assert solve(site, {"spacing_m": 4.0}) == 0
    assert chosen(site) == ["a", "d"]
    assert solve(site, {"spacing_m": 4.5}) == 2
    error = last_error(capsys)
    assert "no set of sensors meets what the plan asks for; found spacing_m" in error
    assert solve(site, {"spacing_m": 4.5, "budget": {"sensors": 3, "cost": None}}) == 0
    assert len(chosen(site)) == 1


def test_what_a_failure_leaves_is_kept(tmp_path):
    sight = {"a": "0123", "b": "0123", "c": "4567", "d": "01", "e": "45", "f": "67"}
    site = Site(tmp_path, {"S": sight}, targets=8)
    assert site.check("p=S") == 0
    assert solve(site, {"keep_share": 0.5}) == 0
    assert len(chosen(site)) == 2
    assert solve(site, {"keep_share": 0.75}) == 0
    solution = site.read("solution.json")
    assert len(chosen(site)) == 4
    assert solution["options"]["failure"]["left_share"] >= 0.75
    assert max(s["loses"] for s in solution["sensors"]) <= 2
    assert solve(site, {"keep_share": 1.0}) == 0
    assert len(chosen(site)) == 5
    solution = site.read("solution.json")
    assert solution["options"]["failure"]["left_share"] == 1.0
    assert [sensor["loses"] for sensor in solution["sensors"]] == [0.0] * 5
    assert solve(site, {"keep_share": 1.0, "curve": 5}) == 0
    curve = site.read("solution.json")["options"]["curve"]["points"]
    # Two sensors see the same half and three the other: what one alone sees does not count.
    assert [p["weight"] for p in curve] == [0.0, 4.0, 4.0, 6.0, 8.0]
    assert [p["bound"] for p in curve] == [0.0, 4.0, 4.0, 6.0, 8.0]


def test_curve_and_alternatives_are_recorded_and_mapped(tmp_path):
    site = Site(tmp_path, {"S": {"a": "012", "b": "345", "c": "345", "d": "0"}})
    assert site.check("p=S") == 0
    assert solve(site, {"curve": 10, "alternatives": True}) == 0
    options = site.read("solution.json")["options"]
    points_ = [(p["budget"], p["weight"], p["bound"]) for p in options["curve"]["points"]]
    assert points_ == [(1.0, 3.0, 3.0), (2.0, 6.0, 6.0)]
    assert options["alternatives"]["by"] == [[], ["c"]]
    # c stands below a, which every answer needs: no answer has a place of its own.
    assert options["alternatives"]["least_shared_places"] == 2
    assert options["alternatives"]["shared_places"] == 2
    layer = gpd.read_file(tmp_path / "layers.gpkg", layer="alternatives")
    assert layer[["candidate", "replaces"]].to_numpy().tolist() == [["c", "b"]]
    assert layer.crs.to_epsg() == 2994


def test_options_hold_for_sensors_in_poses(tmp_path):
    site = Site(tmp_path, {"S": {"a": "01", "b": "", "c": ""}, "eye": {"a": ""}}, targets=4)
    looks = {"b@y+0p-10r+0": "2", "b@y+35p-10r+0": "3", "a@y+0p-10r+0": "23"}
    write_sight(site.detections[1], "eye", looks)
    assert site.check("p=S,eye") == 0
    at_a = points(tmp_path, "a.csv", [(0.2, -0.5, "S")], ["kind"])
    options = {
        "mandatory": {"crs": None, "within_m": 1.0},
        "budget": {"sensors": 2, "cost": None},
        "alternatives": True,
    }
    assert solve(site, options, ("S=1", "eye=1"), files={"mandatory": at_a}) == 0
    # One choice stands at a place: with S at a, the camera at b sees one of two targets.
    solution = site.read("solution.json")
    found = [(s["sensor"], s["candidate"], s["mandatory"]) for s in solution["sensors"]]
    assert found == [("S", "a", True), ("eye", "b@y+0p-10r+0", False)]
    assert solution["covered_targets"] == 3
    assert solution["options"]["alternatives"]["by"] == [[], ["b@y+35p-10r+0"]]
    layer = gpd.read_file(tmp_path / "layers.gpkg", layer="alternatives")
    assert layer[["candidate", "replaces"]].to_numpy().tolist() == [
        ["b@y+35p-10r+0", "b@y+0p-10r+0"]
    ]


def test_same_options_same_bytes(site, tmp_path):
    options = {"budget": {"sensors": 2, "cost": None}, "curve": 3, "alternatives": True}
    found = []
    for _ in range(2):
        assert solve(site, options) == 0
        found.append([(tmp_path / n).read_bytes() for n in ("solution.json", "layers.gpkg")])
    assert found[0] == found[1]


def test_stage_takes_files_of_options():
    taken = {field.name for field in dataclasses.fields(solve_cover.CoverFiles)}
    assert set(FILES) == {"areas", "forbidden", "mandatory", "poles"} <= taken
