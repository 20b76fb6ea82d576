import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.__main__ import main
from roadsight.base.errors import InputError
from roadsight.evidence.costs import (
    STEPS,
    STORED,
    Amounts,
    Line,
    Record,
    StepCost,
    fit,
    fit_line,
    held_out,
    typical_factor,
)
from roadsight.evidence.estimate import (
    SHIPPED,
    CostTable,
    StepEstimate,
    _wall_h,
    estimate,
    read_amounts,
    read_costs,
    read_records,
    read_stored,
)
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import write_table
from tests.conftest import PROJECT
from tests.helpers.las_files import random_points, wkt_of, write_las

FOOT_M = 1200 / 3937
numbers = st.floats(0.01, 100)


@given(base=numbers, rate=numbers, units=st.lists(numbers, min_size=3, max_size=9, unique=True))
def test_an_exact_line_is_found(base, rate, units):
    line = fit_line([2.0] * len(units), units, [2 * base + rate * u for u in units])
    assert line.at(0) == pytest.approx(base, rel=1e-3, abs=1e-4 * rate * max(units))
    assert line.at(50) == pytest.approx(base + 50 * rate, rel=1e-3)


@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=8))
def test_no_part_is_negative_and_no_perturbation_is_better(points):
    units, costs = (np.array(column) for column in zip(*points, strict=True))
    line = fit_line([1.0] * len(units), units, costs)

    def loss(base, rate):
        return (((base + rate * units) / costs - 1) ** 2).sum()

    least = loss(line.base, line.rate)
    assert line.base >= 0
    assert line.rate >= 0
    for base, rate in [(1.01, 1), (0.99, 1), (1, 1.01), (1, 0.99)]:
        assert loss(line.base * base, line.rate * rate) >= least - 1e-9
    assert loss(line.base + 1e-3, line.rate) >= least - 1e-9
    assert loss(line.base, line.rate + 1e-3) >= least - 1e-9


def records_of(site, points_m, factor=1.0):
    cost = {"ingest_cloud": (0.5, 0.8), "build_dem": (0.6, 0.2)}
    return [
        Record(site, step, 1, points_m, factor * (b + r * points_m), 200 + 40 * points_m)
        for step, (b, r) in cost.items()
    ]


def test_a_held_out_site_is_not_seen():
    sites = [*records_of("a", 1), *records_of("b", 3), *records_of("c", 9, factor=2.0)]
    ratios = held_out(sites)
    # Of sites that follow the same line, c is told from a and b alone: half of what it needed.
    assert ratios["c"] == pytest.approx(0.5)
    assert held_out([*records_of("a", 1), *records_of("b", 3), *records_of("c", 9)])[
        "c"
    ] == pytest.approx(1.0)
    assert held_out(records_of("a", 1)) == {}


def test_factor_counts_both_directions_alike():
    assert typical_factor([0.5, 2.0, 1.0]) == pytest.approx(typical_factor([2.0, 0.5, 1.0]))
    assert typical_factor([0.5, 2.0, 2.0]) == pytest.approx(2.0)
    assert np.isnan(typical_factor([]))


@settings(max_examples=50)
@given(
    jobs=st.lists(st.tuples(st.integers(1, 6), st.floats(0.1, 9)), min_size=1, max_size=6),
    cores=st.integers(1, 8),
)
def test_wall_time_bounds_a_simulated_schedule(jobs, cores):
    """Steps one after the other, each spread over the cores as they come free."""
    steps = [StepEstimate("s", n, n * s / 3600, s, 1.0) for n, s in jobs]
    now = 0.0
    for count, seconds in jobs:
        now += -(-count // cores) * seconds
    assert _wall_h(steps, cores, 0.0) * 3600 >= now - 1e-6
    assert _wall_h(steps, 1, 0.0) == pytest.approx(sum(n * s for n, s in jobs) / 3600)


TABLE = CostTable(
    {name: StepCost(Line(1.0, 0.01), Line(100.0, 2.0), 3) for name in STEPS},
    {kind: Line(0.0, 1000.0) for kind in STORED},
    (Line(3.0, 0.01), Line(150.0, 0.1)),
    1.0,
)


def test_runs_add_up():
    amounts = Amounts(5, 900, 2, 4000, 3, 700, shards=4, rounds=2)
    one = estimate(TABLE, amounts, ("placement", "poles"), 1, 8)
    many = estimate(TABLE, amounts, ("placement", "poles"), 10, 8)
    assert many.core_h == pytest.approx(10 * one.core_h)
    assert many.jobs == 10 * one.jobs
    assert many.storage_gib == pytest.approx(10 * one.storage_gib)
    assert many.jobs_a_run == one.jobs_a_run == one.jobs
    assert many.peak_mib == one.peak_mib
    assert one.wall_h < many.wall_h < 10 * one.wall_h
    by_step = {step.step: step for step in one.steps}
    assert by_step["render_depth_maps"].jobs == 4 * 2 * 2
    assert by_step["solve_cover"].jobs == 3
    assert by_step["segment_images"].jobs == 4
    poles = estimate(TABLE, amounts, ("poles",), 1, 8)
    assert {s.step for s in poles.steps} & {"solve_cover", "render_depth_maps"} == set()
    assert poles.core_h < one.core_h


@pytest.fixture
def finished_site(tmp_path):
    """Results and logs of a small placement run."""
    site = tmp_path / "results/small"
    write_json(site / "scene/frame.json", {"points": 2_000_000})
    for number, count in ((0, 30), (1, 5)):
        names = pd.DataFrame({"candidate": [f"c{number}{i}" for i in range(count)]})
        write_table(site / f"placement/round-{number}/candidates.parquet", names)
    for sensor in ("A", "B"):
        for shard in range(3):
            file = site / f"placement/round-0/depth/{sensor}/{shard}.parquet"
            write_table(file, pd.DataFrame({"x": [1]}))
            for number in (0, 1):
                name = f"round-{number}/{sensor}/{shard}/render_depth_maps"
                bench = site / f"benchmarks/{name}.tsv"
                bench.parent.mkdir(parents=True, exist_ok=True)
                bench.write_text("s\tmax_rss\tcpu_time\n9.0\t300.5\t7.5\n")
                log = tmp_path / f"logs/small/{name}.log"
                log.parent.mkdir(parents=True, exist_ok=True)
                log.write_text("INFO used 2.50 CPU s, at most 321 MiB\n")
    (site / "benchmarks/ingest_cloud.tsv").write_text("s\tmax_rss\tcpu_time\n2.0\t-\t1.5\n")
    write_table(site / "placement/targets.parquet", pd.DataFrame({"x": range(70)}))
    write_json(site / "placement/os-64/solution.json", {})
    return site


def test_records_of_a_finished_site(finished_site):
    amounts = read_amounts(finished_site)
    assert amounts == Amounts(2.0, 35, 2, 70, 1, 0, shards=3, rounds=2)
    by_step = {record.step: record for record in read_records(finished_site)}
    maps = by_step["render_depth_maps"]
    # The log counts where it has its last line, the benchmark file where it has not.
    assert (maps.jobs, maps.units, maps.cpu_s, maps.peak_mib) == (12, 70, 30.0, 321)
    assert by_step["ingest_cloud"].cpu_s == 1.5
    assert np.isnan(by_step["ingest_cloud"].peak_mib)
    stored = read_stored(finished_site)
    assert stored["placement"] > 0
    assert sum(stored.values()) < sum(
        p.stat().st_size for p in finished_site.rglob("*") if p.is_file()
    )


def test_a_step_without_known_memory_is_fitted():
    cost = fit([Record("a", "ingest_cloud", 1, 2.0, 1.5, float("nan"))])["ingest_cloud"]
    assert cost.peak_mib.at(2.0) == 0.0
    assert cost.cpu_s.at(2.0) == pytest.approx(1.5)


WHOLE = {"common", "step", "evidence", "truth"}
"""Files of rules whose steps are not a site's."""

LEFT_OUT = {
    "all sites": {"write_report"},
    "samples": {"generate_rural", "generate_sample", "render_videolog", "render_depth_pairs"},
    "scores": {"score_cameras", "score_pavement", "validate_poles"},
    "studies": {"compare_components", "match_inputs"},
    "effects": {"measure_reflectivity", "model_fog", "model_rain", "tilt_mounts", "trace_lanes"},
    "some sites": {"detect_poses", "find_roadside_objects", "undistort_views", "use_given_cameras"},
}
"""Steps that an estimate leaves out, by what they are for."""


def test_every_step_of_the_rules_is_estimated_or_left_out_on_purpose():
    files = [path for path in (PROJECT / "workflow/rules").rglob("*.smk") if path.stem not in WHOLE]
    rules = "\n".join(path.read_text("utf-8") for path in files)
    steps = set(re.findall(r"^(?:use rule \w+ as|checkpoint) (\w+)", rules, flags=re.MULTILINE))
    assert steps == set(STEPS) | set().union(*LEFT_OUT.values())


def test_shipped_model_knows_every_step():
    table = read_costs(SHIPPED)
    assert set(table.steps) == set(STEPS)
    assert set(table.stored) == set(STORED)
    assert 1.0 <= table.factor < 3.0
    assert all(cost.cpu_s.at(1) > 0 and cost.peak_mib.at(1) > 50 for cost in table.steps.values())


def run(*arguments):
    return main(["estimate", *map(str, arguments)])


def test_a_state(tmp_path, capsys):
    out = tmp_path / "state.json"
    assert run("--miles", 54000, "--job", "poles", "--cores", 1000, "-o", out) == 0
    printed = capsys.readouterr().out
    assert "5,400 run(s)" in printed
    (content,) = json.loads(out.read_text())
    assert content["amounts_a_run"]["images"] * 5400 == pytest.approx(43e6, rel=0.01)
    assert content["core_h"] / 1000 < content["wall_h"] < content["core_h"]
    assert content["jobs"] == sum(step["jobs"] for step in content["steps"])


def test_a_site_of_the_configuration(tmp_path, project, monkeypatch):
    monkeypatch.chdir(project)
    out = tmp_path / "sample.json"
    assert run("sample", "sample_rural", "-o", out) == 0
    highway, rural = json.loads(out.read_text())
    assert highway["amounts_a_run"]["points_m"] == pytest.approx(3.5, rel=0.1)
    assert highway["amounts_a_run"]["plans"] == 6
    assert highway["amounts_a_run"]["candidates"] == pytest.approx(1228, rel=0.05)
    assert rural["amounts_a_run"]["images"] == pytest.approx(441, rel=0.3)
    # What was measured when the model was fitted, within a factor of two.
    assert 0.5 < rural["amounts_a_run"]["points_m"] / 3.2 < 2


def test_a_site_of_ones_own(tmp_path, project, monkeypatch):
    """A hundred thousand points on 1.2 km in feet."""
    monkeypatch.chdir(project)
    extent = (1200.0 / FOOT_M, 9.0, 9.0)
    points = random_points(5000, extent=extent, corner=(2_000_000.0, 700_000.0, 100.0))
    write_las(tmp_path / "a.laz", points, wkt_of("EPSG:2264"))
    site = {"site": "own", "clouds": ["a.laz"], "placement": {"plans": ["os-64", "vlp-16"]}}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(site))
    out = tmp_path / "own.json"
    assert run(tmp_path / "own.yaml", "--shards", 3, "-o", out) == 0
    amounts = json.loads(out.read_text())[0]["amounts_a_run"]
    assert amounts["points_m"] == pytest.approx(0.005)
    assert amounts["candidates"] == pytest.approx(7900 * 1200 / 1609.344, rel=0.01)
    assert (amounts["sensors"], amounts["plans"], amounts["shards"]) == (2, 2, 3)
    assert amounts["images"] == 0


def test_a_model_of_ones_own(finished_site, tmp_path):
    own = tmp_path / "costs.json"
    assert run("--fit", finished_site, "-o", own) == 0
    assert set(read_costs(own).steps) == {"render_depth_maps", "ingest_cloud"}
    out = tmp_path / "out.json"
    assert run("--miles", 1, "--job", "placement", "--costs", own, "-o", out) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give either sites or --miles"),
        (["sample", "--miles", "3"], "give either sites or --miles"),
        (["--miles", "-1"], "--miles: is no usable number"),
        (["--miles", "nan"], "--miles: is no usable number"),
        (["--miles", "5", "--cores", "0"], "--cores: is no usable number"),
        (["--miles", "5", "--images", "inf"], "--images: is no usable number"),
        (["--fit", "nowhere"], "needs -o"),
        (["--fit", "nowhere", "-o", "x.json"], "holds no results of a site"),
        (["no_such_site"], "no site file"),
    ],
)
def test_what_cannot_be_estimated(arguments, message, project, monkeypatch, capsys):
    monkeypatch.chdir(project)
    assert run(*arguments) == 2
    assert message in capsys.readouterr().err
    assert not Path("x.json").exists()


@pytest.mark.parametrize("content", [{}, [], {"steps": 3}, {"steps": {"a": {}}}])
def test_a_file_that_is_no_cost_model(tmp_path, content):
    write_json(tmp_path / "costs.json", content)
    with pytest.raises(InputError, match="is no cost model"):
        read_costs(tmp_path / "costs.json")
