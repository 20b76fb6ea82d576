import json

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import write_json
from roadsight.io.records.placement_tables import write_detections
from roadsight.io.records.tables import write_table
from roadsight.setcover.common.problem import TIME_LIMIT, Cover
from roadsight.setcover.common.program import version
from roadsight.setcover.plans.whole import ContradictionError
from roadsight.stages.placement import check_coverage, solve_cover

FOOT_M = 0.3048
FRAME = Frame((636_000.0, 850_000.0, 400.0), FOOT_M, FOOT_M, CRS.from_epsg(2994).to_wkt())
OUTPUTS = ("solution.json", "layers.gpkg", "timing.json")

# a and d are needed for t0 and t5; b and c see nothing that is still missing then.
SIGHT = {"a": "012", "b": "12", "c": "23", "d": "345"}


def write_candidates(path, names):
    number = np.arange(len(names), dtype=float)
    table = pd.DataFrame({"candidate": names, "key": names, "edge": "left", "mount": "edge"})
    table = table.assign(station_m=4 * number, x=4 * number, y=-0.5, z=15.0, height_m=5.0)
    write_table(path, table.assign(ground_z_m=10.0, yaw_deg=90.0))


def write_sight(path, sensor, sight):
    rows = [(name, f"t{target}", 9) for name, targets in sight.items() for target in targets]
    table = pd.DataFrame(rows, columns=["candidate", "target", "hits"])
    write_detections(path, table.astype({"hits": "uint16"}), {"sensor": sensor})


class Site:
    """Tables of one site.

    Parameters
    ----------
    folder : where they are.
    sight : targets (one digit each) that each candidate sees, by sensor.
    targets : how many there are.
    """

    def __init__(self, folder, sight, targets=6):
        self.folder = folder
        write_json(folder / "frame.json", FRAME.to_dict())
        places = np.column_stack([np.arange(targets), np.full(targets, 3.0), np.full(targets, 10)])
        table = pd.DataFrame(places, columns=["x", "y", "z"])
        table.insert(0, "target", [f"t{number}" for number in range(targets)])
        write_table(folder / "targets.parquet", table)
        names = sorted({name for seen in sight.values() for name in seen})
        self.candidates = [folder / "round-0.parquet", folder / "round-1.parquet"]
        write_candidates(self.candidates[0], names[:2])
        write_candidates(self.candidates[1], names[2:])
        self.detections = []
        for sensor, seen in sight.items():
            self.detections.append(folder / f"{sensor}.parquet")
            write_sight(self.detections[-1], sensor, seen)

    def check(self, *plans):
        return check_coverage.main(
            [
                *("--targets", str(self.folder / "targets.parquet"), "--plans", *plans),
                *("--candidates", *map(str, self.candidates)),
                *("--detections", *map(str, self.detections)),
                *("--out", str(self.folder / "coverage.json")),
            ]
        )

    def solve(self, *sensors, options=(), out="", extra=()):
        files = {"coverage": "coverage.json", "frame": "frame.json", "targets": "targets.parquet"}
        names = ("solution", "layers", "timing")
        files |= {name: out + file for name, file in zip(names, OUTPUTS, strict=True)}
        paths = [part for n, file in files.items() for part in (f"--{n}", str(self.folder / file))]
        return solve_cover.main(
            [
                *("--site", "here", "--plan", "p", "--sensors", *sensors, *paths),
                *("--second-objective", "False", *options),
                *("--candidates", *map(str, self.candidates)),
                *("--detections", *map(str, self.detections), *map(str, extra)),
            ]
        )

    def read(self, name):
        return json.loads((self.folder / name).read_text())

    def solved(self, *sensors, plan="p=S", **how):
        """The solution of a plan whose coverage was checked."""
        assert self.check(plan) == 0
        assert self.solve(*sensors, **how) == 0
        return self.read("solution.json")


@pytest.fixture
def site(tmp_path):
    return Site(tmp_path, {"S": SIGHT})


def test_coverage_names_the_uncovered_targets_of_each_plan(tmp_path):
    site = Site(tmp_path, {"S": {"a": "01", "b": "1", "c": ""}, "T": {"c": "23"}}, targets=5)
    assert site.check("s=S", "t=T", "both=S,T", "none=U") == 0
    coverage = site.read("coverage.json")
    assert (coverage["targets"], coverage["candidates"]) == (5, 3)
    assert {name: plan["uncovered"] for name, plan in coverage["plans"].items()} == {
        "s": ["t2", "t3", "t4"],
        "t": ["t0", "t1", "t4"],
        "both": ["t4"],
        "none": ["t0", "t1", "t2", "t3", "t4"],
    }
    assert coverage["plans"]["both"]["covered_share"] == pytest.approx(0.8)


def test_of_two_cheapest_plans_the_one_that_sees_more_again_is_taken(tmp_path):
    site = Site(tmp_path, {"S": {"a": "012", "b": "0", "c": "345", "d": "12345"}})
    assert "second" not in site.solved("S=1")
    limit = ("--second-objective", "True", "--second-time-limit-s", "5")
    solution = site.solved("S=1", options=limit)
    assert [sensor["candidate"] for sensor in solution["sensors"]] == ["a", "d"]
    found = solution["second"]
    assert found["status"] == "optimal"
    assert found["once_more"] == found["once_more_bound"] == pytest.approx(2 / 6)
    assert found["twice_more"] == 0
    assert site.solve("S=1", options=(*limit, "--options", '{"alternatives": true}')) == 0
    assert site.read("solution.json")["second"] == found


@pytest.mark.parametrize(
    "options", [{}, {"at_least": 1, "alternatives": True}, {"budget": {"sensors": 1}, "curve": 2},
                {"price": 0.5}, {"keep_share": 0.4}, {"spacing_m": 2}])  # fmt: skip
def test_highs_solves_and_checks_every_plan_as_we_do(site, options):
    assert site.check("p=S") == 0
    asked = ("--options", json.dumps(options)) if options else ()
    assert site.solve("S=1", options=(*asked, "--verify", "highs")) == 0
    own = site.read("solution.json")
    assert own["verified"]["result"] == "confirmed"
    assert site.solve("S=1", options=(*asked, "--solver", "highs")) == 0
    theirs = site.read("solution.json")
    assert (own["solver"], theirs["solver"]) == ("own", "highs")
    assert theirs["proved_by"] == "highs"
    assert theirs["solver_version"].startswith("HiGHS 1.")
    for name in ("status", "objective", "bound"):
        assert theirs[name] == own[name]
    if options:
        assert theirs["options"]["goal"] == own["options"]["goal"]


def test_a_wrong_proof_is_contradicted(site, monkeypatch):
    wrong = Cover("optimal", np.array([0, 1, 3]), 3.0, 3.0, 0.0, 0.0)
    monkeypatch.setattr(solve_cover, "solve_cover_problem", lambda *a, **b: wrong)
    assert site.check("p=S") == 0
    with pytest.raises(ContradictionError, match="costs 3 and is proven to cost at least 3"):
        site.solve("S=1", options=("--verify", "highs"))


def test_no_time_to_verify_is_refused(site, capsys):
    assert site.check("p=S") == 0
    assert site.solve("S=1", options=("--verify", "highs", "--verify-time-limit-s", "0")) == 2
    assert "raise verify_time_limit_s" in capsys.readouterr().err


def test_no_target_at_all_is_refused(tmp_path, capsys):
    site = Site(tmp_path, {"S": SIGHT}, targets=0)
    assert site.check("s=S") == 2
    assert "no target" in capsys.readouterr().err
    assert not (tmp_path / "coverage.json").exists()


def test_solution_is_the_known_optimum(site):
    solution = site.solved("S=1")
    assert solution.pop("reductions") is not None
    sensors = {sensor["candidate"]: sensor for sensor in solution.pop("sensors")}
    assert solution == {
        "site": "here", "plan": "p", "sensor_types": ["S"], "status": "optimal", "objective": 2.0,
        "bound": 2.0, "gap": 0.0, "solver": "own", "solver_version": version("own"),
        "proved_by": "own", "at_least": 1, "targets": 6, "covered_targets": 6,
        "uncoverable_targets": 0, "excluded": [],
    }  # fmt: skip
    assert list(sensors) == ["a", "d"]
    assert [sensors[name]["targets"] for name in "ad"] == [3, 3]
    assert [sensors[name]["only"] for name in "ad"] == [3, 3]
    assert sensors["d"]["x"] == 4.0  # second of the second table of candidates
    native = FRAME.to_native([4.0, -0.5, 15.0])
    assert sensors["d"]["native"] == pytest.approx(native, abs=1e-4)
    assert site.read("timing.json")["seconds_cpu"] >= 0


def test_what_only_one_sensor_sees_is_counted(tmp_path):
    site = Site(tmp_path, {"S": {"a": "012", "b": "23", "c": "345"}})
    sensors = site.solved("S=1")["sensors"]
    assert [(s["candidate"], s["targets"], s["only"]) for s in sensors] == [
        ("a", 3, 3),
        ("c", 3, 3),
    ]
    site = Site(tmp_path, {"S": {"a": "0123", "b": "2345"}})
    sensors = site.solved("S=1")["sensors"]
    assert [(s["targets"], s["only"]) for s in sensors] == [(4, 2), (4, 2)]


def test_layers_hold_sensors_and_targets_in_the_sites_crs(site):
    site.solved("S=1")
    path = site.folder / "layers.gpkg"
    sensors = gpd.read_file(path, layer="sensors")
    targets = gpd.read_file(path, layer="targets")
    assert sensors.crs.to_epsg() == targets.crs.to_epsg() == 2994
    assert sensors["candidate"].tolist() == ["a", "d"]
    assert targets["target"].tolist() == [f"t{number}" for number in range(6)]
    assert targets["sensors"].tolist() == [1] * 6
    place = sensors.geometry[1]
    native = FRAME.to_native([4.0, -0.5, 15.0])
    assert (place.x, place.y, place.z) == pytest.approx(native, abs=1e-6)
    assert targets.geometry[5].x == pytest.approx(636_000 + 5 / FOOT_M, abs=1e-6)


def test_same_tables_same_bytes(site):
    assert site.check("p=S") == 0
    for out in ("first-", "second-"):
        assert site.solve("S=1", out=out) == 0
    for name in ("solution.json", "layers.gpkg"):
        first, second = (
            (site.folder / f"{out}-{name}").read_bytes() for out in ("first", "second")
        )
        assert first == second


def test_order_of_detections_does_not_matter(site):
    assert site.check("p=S") == 0
    assert site.solve("S=1", out="first-") == 0
    write_sight(site.detections[0], "S", {name: SIGHT[name][::-1] for name in reversed(SIGHT)})
    assert site.solve("S=1", out="second-") == 0
    assert site.read("first-solution.json") == site.read("second-solution.json")


def test_cheaper_sensors_are_preferred_and_one_stands_at_a_place(tmp_path):
    sight = {"near": {"a": "01", "b": "2"}, "far": {"a": "012", "b": "012"}}
    site = Site(tmp_path, sight, targets=3)
    solution = site.solved("near=1", "far=3", plan="p=near,far")
    assert solution["objective"] == 2.0
    chosen = [(s["sensor"], s["candidate"]) for s in solution["sensors"]]
    assert chosen == [("near", "a"), ("near", "b")]
    solution = site.solved("near=2", "far=3", plan="p=near,far")
    assert solution["objective"] == 3.0
    assert [s["sensor"] for s in solution["sensors"]] == ["far"]


def test_two_sensors_never_share_a_place(tmp_path):
    # Together at a they would cost 2; apart it takes the dear candidate b.
    sight = {"left": {"a": "0"}, "right": {"a": "1"}, "dear": {"b": "01"}}
    site = Site(tmp_path, sight, targets=2)
    solution = site.solved("left=1", "right=1", "dear=5", plan="p=left,right,dear")
    chosen = [(s["sensor"], s["candidate"]) for s in solution["sensors"]]
    assert chosen == [("dear", "b")]


def test_detections_of_other_plans_are_left_out(site):
    write_sight(site.folder / "other.parquet", "T", {"b": "012345"})
    assert site.solved("S=1", extra=[site.folder / "other.parquet"])["objective"] == 2.0


def gap_site(folder):
    site = Site(folder, {"S": SIGHT}, targets=8)
    assert site.check("p=S") == 0
    return site


def test_uncovered_targets_stop_by_default(tmp_path, capsys):
    site = gap_site(tmp_path)
    assert site.solve("S=1") == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("roadsight: site here, plan p: 2 of 8 targets are seen by no candidate")
    assert "coverage.json" in error
    assert "coverage.uncoverable: exclude" in error
    assert not any((tmp_path / name).exists() for name in OUTPUTS)


def test_uncovered_targets_are_left_out_on_request_and_reported(tmp_path):
    site = gap_site(tmp_path)
    solution = site.solved("S=1", options=["--uncoverable", "exclude"])
    assert solution["excluded"] == ["t6", "t7"]
    assert solution["targets"] == 8
    assert solution["covered_targets"] == 6
    assert solution["uncoverable_targets"] == 2
    targets = gpd.read_file(tmp_path / "layers.gpkg", layer="targets")
    assert targets["target"].tolist() == [f"t{number}" for number in range(6)]


def test_nothing_covered_is_an_error_even_where_gaps_are_left_out(tmp_path, capsys):
    site = Site(tmp_path, {"S": {"a": "", "b": "", "c": ""}})
    assert site.check("p=S") == 0
    assert site.solve("S=1", options=["--uncoverable", "exclude"]) == 2
    assert "no target is seen by any candidate" in capsys.readouterr().err
    assert not any((tmp_path / name).exists() for name in OUTPUTS)


def test_covering_twice_is_counted_and_refused_where_impossible(tmp_path, capsys):
    site = Site(tmp_path, {"S": {"a": "01", "b": "01", "c": "0"}}, targets=2)
    solution = site.solved("S=1", options=["--at-least", "2"])
    assert (solution["at_least"], solution["objective"]) == (2, 2.0)
    targets = gpd.read_file(tmp_path / "layers.gpkg", layer="targets")
    assert targets["sensors"].tolist() == [2, 2]
    before = (tmp_path / "solution.json").read_bytes()
    assert site.solve("S=1", options=["--at-least", "3"]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert "no set of sensors covers every target 3 times" in error
    assert "found 1 targets" in error
    assert (tmp_path / "solution.json").read_bytes() == before


def test_a_time_limit_leaves_a_gap_and_says_that_nothing_is_proven(tmp_path, caplog):
    rng = np.random.default_rng(5)
    names = [f"c{number:03d}" for number in range(300)]
    site = Site(tmp_path, {"S": dict.fromkeys(names, "")}, targets=600)
    sees = rng.random((len(names), 600)) < 0.05
    row, column = np.nonzero(sees)
    table = pd.DataFrame({"candidate": np.array(names)[row], "target": [f"t{c}" for c in column]})
    write_detections(site.detections[0], table.assign(hits=np.uint16(9)), {"sensor": "S"})
    assert sees.any(axis=0).all()
    assert site.check("p=S") == 0
    with caplog.at_level("WARNING"):
        solution = site.solved("S=1", options=["--time-limit-s", "0.5"])
    assert solution["status"] == "time_limit"
    assert 0 < solution["gap"] < 1
    assert 1 <= solution["bound"] < solution["objective"] == len(solution["sensors"])
    assert "not proven, gap" in caplog.text
    chosen = [names.index(sensor["candidate"]) for sensor in solution["sensors"]]
    assert sees[chosen].any(axis=0).all()


def test_a_time_limit_before_anything_was_found_is_an_error(site, capsys, monkeypatch):
    nothing = Cover(TIME_LIMIT, np.empty(0, np.int64), np.inf, 1.0, 1.0, 0.0)
    monkeypatch.setattr(solve_cover, "solve_cover_problem", lambda *_, **__: nothing)
    assert site.check("p=S") == 0
    assert site.solve("S=1", options=["--time-limit-s", "0.5"]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert "found within the time limit; found 0.5 s; raise cover.time_limit_s" in error
    assert not any((site.folder / name).exists() for name in OUTPUTS)
