"""Every case of the catalogue, and that the catalogue covers every stage that computes."""

import csv
import re
from dataclasses import replace

import numpy as np
import pytest

from roadsight.report.files import read_assets
from roadsight.report.hardcases_page import ASSETS, render_hardcases, share_of_bound
from roadsight.stages.evidence.run_hardcases import case_table, main
from roadsight_hardcases.case import CaseResult, hard_case, measure
from roadsight_hardcases.catalogue import all_cases

CASES = all_cases()
NO_NUMERICS = {
    "alignment_inputs": "reads what two stages share",
    "chosen_points": "part of measure_data: counts by the kernels of build_detection_shard",
    "doubts": "tells what others measured",
    "command": "shared by all stages",
    "compare_components": "runs other stages",
    "cover_inputs": "reads what a plan's options name",
    "detection_inputs": "reads what two stages share",
    "level_cover": "part of solve_cover",
    "allowed": "reads places, part of several stages",
    "changed_sight": "renders as render_depth_maps, whose cases hold for it",
    "dense_inputs": "reads what two stages share",
    "gather_objects": "joins surfels to pieces, by counting cells",
    "measure_tolerance": "renders as render_depth_maps, whose cases hold for it",
    "plan_choices": "reads what two stages share",
    "try_removals": "solves as solve_cover, whose cases hold for it",
    "measure_base": "runs other stages",
    "measure_paper": "runs other stages",
    "published_inputs": "part of align_cameras: reads the registered camera",
    "measure_data": "counts what detections and scans say",
    "measure_precision": "compares single and double precision",
    "measure_tradeoff": "runs other stages",
    "plan_effects": "compares measured numbers with thresholds",
    "hazard_layers": "part of rate_hazard: writes what it found",
    "roadside_inputs": "part of rate_hazard: reads what the user gave",
    "ahead": "threads around any stage",
    "progress": "shared by all stages",
    "render_depth_pairs": "the maps of render_depth_maps, whose cases hold for it",
    "render_videolog": "generates a sample",
    "run_hardcases": "runs this catalogue",
    "match_inputs": "counts what lies at the site",
    "summarise_site": "collects results",
    "view_inputs": "counts files",
    "use_given_cameras": "takes poses as they are",
}
"""Stages without a case, and why."""
SHOWN_OR_GENERATED = ("audit_", "generate_", "truth_", "write_")
"""How names of stages begin that compare, generate or show results."""


OPEN = {"scans_10_cm_apart"}
"""Cases whose bound ours does not hold yet: mended ones leave the list, none joins it unseen."""


@pytest.mark.parametrize("case", [c for c in CASES if not c.known], ids=lambda case: case.name)
def test_ours_holds_the_bound_where_the_naive_way_does_not(case):
    result = measure(case, seed=1)
    shown = f"naive {result.naive_error:g}, ours {result.our_error:g}, bound {case.bound:g}"
    assert result.our_error <= case.bound, shown
    assert result.naive_error > case.bound, f"not shown to be hard: {shown}"


@pytest.mark.parametrize("case", [c for c in CASES if c.known], ids=lambda case: case.name)
def test_what_is_known_to_fail_does(case):
    """Where ours holds the bound by now, take the case's `known` and its name in OPEN away."""
    result = measure(case, seed=1)
    assert min(result.our_error, result.naive_error) > case.bound


def test_open_cases_are_these():
    assert {case.name for case in CASES if case.known} == OPEN


@pytest.mark.full
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_the_verdict_does_not_hang_on_the_seed(seed):
    failed = {case.name for case in CASES if not measure(case, seed).passed}
    assert failed == OPEN


def test_every_stage_that_computes_has_a_case(project):
    folder = project / "workflow/roadsight/stages"
    stages = {path.stem for path in folder.rglob("*.py")} - {"__init__"}
    covered = {case.stage for case in CASES}
    assert covered <= stages
    assert covered.isdisjoint(NO_NUMERICS)
    others = {stage for stage in stages if stage.startswith(SHOWN_OR_GENERATED)}
    missing = stages - covered - set(NO_NUMERICS) - others
    assert not missing, f"add a hard case, or say in NO_NUMERICS why there is none: {missing}"


def test_the_catalogue_is_whole():
    assert len(CASES) >= 110
    assert len({case.name for case in CASES}) == len(CASES)
    for case in CASES:
        assert case.bound > 0 and case.unit
        assert re.fullmatch(r"[A-Z_a-z0-9].*[.]", case.hazard), case.name


def test_a_case_gives_the_same_numbers_again():
    cases = [case for case in CASES if case.stage in ("triangulate_poles", "render_scans")]
    first = [measure(case, 5) for case in cases]
    assert first == [measure(case, 5) for case in reversed(cases)][::-1]


def measured(naive, ours):
    @hard_case("build_dem", bound=1.0, unit="m")
    def made_up(rng):
        """Nothing."""
        return naive, ours

    return measure(made_up, 1)


def test_errors_that_are_no_sizes_are_refused():
    with pytest.raises(ValueError, match="made_up"):
        measured(-1.0, 0.0)


@pytest.mark.parametrize("none", [np.nan, np.inf])
def test_an_answer_that_is_no_number_is_as_wrong_as_can_be(none):
    """It once scored 0, or ended the run."""
    assert measured(none, 0.5).passed
    assert measured(none, 0.5).naive_error == np.inf
    assert not measured(2.0, none).passed


@pytest.mark.parametrize(
    ("naive", "ours", "passed"), [(2.0, 1.0, True), (1.0, 0.5, False), (3.0, 2.0, False)]
)
def test_a_case_passes_only_if_it_is_hard_and_held(naive, ours, passed):
    case = replace(CASES[0], bound=1.0)
    assert CaseResult(case, naive, ours).passed is passed


def test_table_and_page(tmp_path, project, monkeypatch):
    few = CASES[:3]
    monkeypatch.setattr("roadsight.stages.evidence.run_hardcases.all_cases", lambda: few)
    table, page = tmp_path / "hardcases.csv", tmp_path / "index.html"
    assert main(["--table", str(table), "--page", str(page)]) == 0
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [
        "case", "stage", "hazard", "naive_error", "our_error", "bound", "unit", "passed",
        "known",
    ]  # fmt: skip
    assert [row["case"] for row in rows] == [case.name for case in few]
    assert all(row["passed"] == "true" for row in rows)
    html = page.read_text()
    assert all(case.hazard in html for case in few)
    assert html.count('class="naive" d="M') == len(few) + 1  # one more in the key


def test_a_failed_case_is_shown_as_such(project):
    assets = read_assets(ASSETS)
    failed = CaseResult(CASES[0], 1.0, 7.5)
    html = render_hardcases([failed], assets, "1")
    assert "chip warn" in html and "chip good" not in html and "0 of 1 cases" in html
    assert case_table([failed])["passed"].tolist() == ["false"]


def test_a_known_failure_says_why(project):
    assets = read_assets(ASSETS)
    known = replace(CASES[0], known="walls <leak>")
    failed = CaseResult(known, float("inf"), 7.5)
    html = render_hardcases([failed], assets, "1")
    assert ">open</span>" in html and "Open: walls &lt;leak&gt;." in html and "0 of 1 cases" in html
    table = case_table([failed])
    assert table[["naive_error", "passed", "known"]].iloc[0].tolist() == [
        "inf", "false", "walls <leak>",
    ]  # fmt: skip


def test_errors_stay_within_the_picture():
    assert share_of_bound(0.0, 1.0) == share_of_bound(1e-30, 1.0) == -9
    assert share_of_bound(1e30, 1.0) == 9
    assert share_of_bound(0.1, 0.1) == 0
