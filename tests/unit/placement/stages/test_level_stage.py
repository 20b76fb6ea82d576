import numpy as np
import pytest

from roadsight.config.plans import Plan
from roadsight.io.records.placement_tables import read_detections, write_detections
from roadsight.io.records.tables import read_table, write_table
from roadsight.io.vector.vectors import read_layer
from roadsight.report.site.plan_view import sight_view
from roadsight.report.wording import percent
from tests.unit.placement.sight.test_lanes import straight_lanes
from tests.unit.placement.stages.test_solve_cover_stage import FRAME, Site

SIGHT = {"a": "01", "b": "01", "c": "01", "d": "2345"}
SHARES = {"a": 0.9, "b": 0.8, "c": 0.6, "d": 0.995}


@pytest.fixture
def site(tmp_path):
    found = Site(tmp_path, {"S": SIGHT})
    assert found.check("p=S") == 0
    path = found.detections[0]
    table = read_detections([path])
    table["availability"] = [SHARES[name] for name in table["candidate"]]
    write_detections(path, table.astype({"candidate": str, "target": str}), {"sensor": "S"})
    return found


def chosen(site):
    return sorted(sensor["candidate"] for sensor in site.read("solution.json")["sensors"])


@pytest.mark.parametrize(
    ("level", "expected"),
    [(0.85, ["a", "d"]), (0.97, ["a", "b", "d"]), (0.99, ["a", "b", "c", "d"])],
)
def test_sensors_together_reach_the_level(site, level, expected):
    assert site.solve("S=1", options=["--availability", str(level)]) == 0
    assert chosen(site) == expected
    content = site.read("solution.json")
    assert content["status"] == "optimal"
    assert content["bound"] == len(expected)
    found = content["availability"]
    hidden = np.prod([1 - SHARES[name] for name in expected if name != "d"])
    assert found["least"] == pytest.approx(min(1 - hidden, 0.995), abs=1e-6)
    assert sum(found["histogram"]["targets"]) == 6


def test_targets_out_of_reach_stop_or_are_listed(site, capsys):
    options = ["--availability", "0.9999"]
    assert site.solve("S=1", options=options) == 2
    assert "6 of 6 targets are in sight less often" in capsys.readouterr().err
    assert site.solve("S=1", options=[*options, "--uncoverable", "exclude"]) == 0
    below = site.read("solution.json")["availability"]["below"]
    assert sorted(below) == [f"t{n}" for n in range(6)]
    assert all(share > 0 for share in below.values())
    assert len(chosen(site)) == 2


def test_common_vehicles_count_once(site, tmp_path):
    """Candidates 4 m apart look past the same trucks; the layer has the exact shares."""
    lanes = straight_lanes(1.5)
    lanes["z"], lanes["cars_per_m"], lanes["trucks_per_m"] = 9.5, 0.0, 0.01
    write_table(tmp_path / "lanes.parquet", lanes, {"availability": 0.5})
    options = ["--availability", "0.6", "--lanes", str(tmp_path / "lanes.parquet")]
    assert site.solve("S=1", options=options) == 0
    found = site.read("solution.json")["availability"]
    assert found["least"] <= found["independent"]["least"] + 1e-9
    assert found["least"] >= 0.6
    layer = read_layer(site.folder / "layers.gpkg", "targets", FRAME)
    assert layer["availability"].min() == pytest.approx(found["least"])


def test_targets_that_common_vehicles_keep_below_stop_or_are_listed(tmp_path, capsys):
    """Independent sensors would reach the level; the same trucks hide the target from all."""
    site = Site(tmp_path, {"S": dict.fromkeys("abcd", "012345")})
    assert site.check("p=S") == 0
    lanes = straight_lanes(1.5)
    lanes["z"], lanes["cars_per_m"], lanes["trucks_per_m"] = 9.5, 0.0, 0.2
    write_table(tmp_path / "lanes.parquet", lanes, {"availability": 0.5})
    options = ["--availability", "0.95", "--lanes", str(tmp_path / "lanes.parquet")]
    assert site.solve("S=1", options=options) == 2
    assert "1 of 6 targets are in sight less often" in capsys.readouterr().err
    assert site.solve("S=1", options=[*options, "--uncoverable", "exclude"]) == 0
    found = site.read("solution.json")["availability"]
    assert list(found["below"]) == ["t5"]
    assert found["below"]["t5"] < 0.95 < found["independent"]["least"]


def test_plans_without_the_option_stay_as_they_were(site):
    assert site.solve("S=1") == 0
    found = site.read("solution.json")["availability"]
    assert "level" not in found
    assert found["mean"] >= found["least"]
    assert len(read_table(site.folder / "targets.parquet")) == sum(found["histogram"]["targets"])


def test_availability_goes_with_no_other_option():
    Plan(title="p", sensors=["S"], availability=0.9)
    with pytest.raises(ValueError, match="no other option"):
        Plan(title="p", sensors=["S"], availability=0.9, spacing_m=5)


def test_the_report_shows_level_and_classes(site):
    assert site.solve("S=1", options=["--availability", "0.97"]) == 0
    counts = [1, 2, 0, 0, 3]
    found = site.read("solution.json")["availability"]
    view = sight_view({"availability": found, "in_sight_counts": counts})
    assert dict(view["rows"])["Asked for"] == percent(0.97)
    assert view["chart"].count("<rect") == 9
    assert "asked for" in view["chart"]
    assert [count for _, count in view["classes"]] == counts
    assert sight_view({}) is None
