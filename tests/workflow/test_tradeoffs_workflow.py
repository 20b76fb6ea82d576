"""`snakemake tradeoffs` on a tiny site: the sweep, its table and its page."""

import pandas as pd
import pytest

from roadsight.evidence.tradeoffs import COLUMNS
from tests.workflow.conftest import Checkout

STUDIES = """\
sites: {placement: tiny, poles: tiny}
published_stages: []
studies:
  dem_cell:
    job: placement
    title: Cell of the terrain model
    knob: ground.dem_cell_m
    levels: [4.0, 0.5]
    measures:
      - {stage: build_dem, metric: dem_rmse_m}
    why: finer follows the ground better
  cover_limit:
    job: placement
    title: Work of the solver
    knob: cover.time_limit_s
    levels: [30.0, 300.0]
    reference: "300"
    repeats: 1
    measures:
      - {stage: solve_cover, metric: sensors}
    why: the proof is found before
  asked:
    job: placement
    title: What the plan asks for
    knob: plan
    levels: {one sensor: one, sees all: ""}
    reference: sees all
    repeats: 1
    measures:
      - {stage: solve_cover, metric: unseen}
      - {stage: solve_cover, metric: plan_cost}
      - {stage: solve_cover, metric: lost_to_a_failure}
    why: a road must be seen
"""


ONE_SENSOR = """\
  own_plans:
    one: {title: The most for one sensor, sensors: [OS1-32], budget: {sensors: 1}, on_request: true}
settings:
"""


def test_a_sweep_from_settings_to_the_page(copy_of_finished: Checkout) -> None:
    checkout = copy_of_finished
    (checkout.folder / "config/tradeoffs.yaml").write_text(STUDIES)
    checkout.edit("config/sites/tiny.yaml", "settings:\n", ONE_SENSOR)
    solution = checkout.folder / "results/tiny/placement/os-64/solution.json"
    before = solution.read_bytes(), solution.stat().st_mtime_ns
    result = checkout.snakemake("tradeoffs", "--cores", "2")
    assert result.returncode == 0, result.stdout[-4000:] + result.stderr[-4000:]
    folder = checkout.folder / "results/tradeoffs"

    table = pd.read_csv(folder / "tradeoffs.csv", keep_default_na=False)
    assert tuple(table.columns) == COLUMNS
    rows = table.set_index(["knob", "level", "metric"])
    coarse, usual = (rows.loc[("ground.dem_cell_m", name, "dem_rmse_m")] for name in ("4", "0.5"))
    assert coarse["value"] > 1.5 * usual["value"] > 0
    assert usual["is_default"]
    assert usual["on_frontier"]
    assert (table["cpu_seconds"] > 0).all()
    assert (table["peak_mib"] > 20).all()
    same = rows.loc["cover.time_limit_s"]
    assert same["value"].nunique() == 1
    plans = rows.loc["plan"]["value"]
    assert plans["one sensor", "plan_cost"] == 1.0 < plans["sees all", "plan_cost"]
    # One target of 1,183 is hidden from all candidates.
    assert plans["one sensor", "unseen"] > 0.01 > 0.002 > plans["sees all", "unseen"]
    failure = plans[:, "lost_to_a_failure"]
    assert failure["one sensor"] == pytest.approx(1 - plans["one sensor", "unseen"])
    assert 0.0 < failure["sees all"] < 1.0
    assert (rows.loc["coordinates"]["value"] >= 0).all()
    assert "<svg" in (folder / "index.html").read_text()
    assert not list(folder.glob("work/*"))

    assert (solution.read_bytes(), solution.stat().st_mtime_ns) == before
    assert checkout.stale_rules("tradeoffs") == set()
    report = checkout.snakemake("report", "--cores", "2")
    assert report.returncode == 0, report.stderr[-4000:]
    html = (checkout.folder / "results/report.html").read_text()
    assert '<a href="tradeoffs/index.html">Accuracy and time</a>' in html


def test_an_unknown_stage_is_told(copy_of_finished: Checkout) -> None:
    checkout = copy_of_finished
    wrong = STUDIES.replace("stage: solve_cover", "stage: solve_covers")
    (checkout.folder / "config/tradeoffs.yaml").write_text(wrong)
    result = checkout.snakemake("-n", "tradeoffs")
    assert result.returncode == 2
    assert "unknown stage 'solve_covers'" in result.stderr
