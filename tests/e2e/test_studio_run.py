"""The page Run in a real browser, with a real Snakemake on a workflow of a second."""

import json
import sys

import pytest

from tests.e2e.studio_page import LOOKS, check_look, click, key, open_studio, text
from tests.e2e.studio_project import Studio, make_project

from tests.helpers.small_workflow import small_project  # isort: skip  # studio_project says where it is

pytestmark = pytest.mark.xdist_group("studio")
EFFECT = {
    "effect": "rain", "job": "placement", "decision": "simulate", "quantity": "lost range",
    "value": 0.25, "unit": "m", "threshold": 0.01, "reason": "it <rains>",
    "expected_change": 0.1, "expected_seconds": 1.0,
}  # fmt: skip
PAGE = "<!doctype html><title>Own</title><p id=own>own</p><script>own.textContent = origin</script>"


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    with Studio(small_project(folder / "project"), folder / "log") as started:
        yield started


@pytest.fixture
def page(browser, studio):
    return open_studio(browser, studio, "run/small")


def at_rest(page):
    page.until("studio.page?.state && !studio.page.state.running && !studio.page.waiting")


def test_look_start_fail_and_finish(page, studio):
    key(page, "l")
    page.until("studio.page.plan")
    assert "5 steps: 5 stale" in text(page, "[aria-label='What is stale']")
    assert "Missing output files" in text(page, "table.stale")
    (studio.folder / "fail").touch()
    key(page, "s")
    page.until("document.querySelector('pre.log')")
    assert text(page, "pre.log") == "begins 2\nthe <b>reason</b>\n"
    at_rest(page)
    (studio.folder / "fail").unlink()
    click(page, "[data-do=start]")
    page.until("document.querySelector('.message.good')?.textContent.includes('Finished')")
    assert "steps, 100 %" in text(page, ".count")
    click(page, "[data-do=look]")
    page.until("studio.page.plan?.jobs === 0")
    assert "up to date" in text(page, "[aria-label='What is stale']")
    assert page.complaints == []


def test_a_run_survives_a_reload_and_a_studio_that_ends_and_is_stopped(page, browser, studio):
    (studio.folder / "slow").touch()
    (studio.folder / "given.txt").write_text("changed\n")
    click(page, "[data-do=start]")
    page.until("studio.page.state.steps?.length === 2")
    page.reload()
    page.until("window.studio?.page?.state?.steps?.length === 2")
    assert "count_steps" in text(page, ".steps")
    with Studio(studio.folder, studio.folder.parent / "log2") as second:
        other = open_studio(browser, second, "run/small")
        other.until("studio.page.state.running")
        key(other, "x")
        other.until("studio.page.state.status === 'stopped'")
        assert "Stopped" in text(other, "[aria-label=Progress]")
        assert not other.run("studio.page.state.locked")
    (studio.folder / "slow").unlink()


def test_a_lock_that_was_left_behind_is_removed_by_a_person(page, studio):
    lock = studio.folder / ".snakemake/locks/0.input.lock"
    lock.parent.mkdir(exist_ok=True)
    lock.write_text("given.txt\n")
    page.until("document.querySelector('[data-do=unlock]')")
    assert page.run("document.querySelector('[data-do=start]').disabled")
    click(page, "[data-do=unlock]")
    click(page, "dialog button.primary")
    page.until("!document.querySelector('[data-do=unlock]')")
    assert not lock.exists()


def test_effects_pages_and_what_is_ordered(page, studio):
    results = studio.folder / "results"
    (results / "small").mkdir(parents=True, exist_ok=True)
    (results / "small/effects.json").write_text(json.dumps([EFFECT]))
    (results / "report.html").write_text(PAGE)
    open_studio(page, studio, "run/small")
    assert "it <rains>" in text(page, "[aria-label='Effects at small']")
    url = page.run("document.querySelector('.pages a').href")
    page.run("document.querySelector('[data-value=all]').click()")
    page.run("""(() => { const list = document.querySelector('[data-do=target]');
        list.value = 'poles'; list.dispatchEvent(new Event('change')); })()""")
    assert page.run("studio.page.order") == {"site": None, "target": "poles", "cores": 2}
    (results / "small/effects.json").write_text("{}")
    open_studio(page, studio, "run/small")
    assert "is damaged" in text(page, "[aria-label='Effects at small']")
    page.open(url)
    assert page.run("own.textContent") == "null"


@pytest.mark.parametrize(("width", "height", "dark"), LOOKS)
def test_texts_stand_out_and_nothing_is_cut_off(page, width, height, dark):
    key(page, "l")
    page.until("studio.page.plan")
    check_look(page, width, height, dark)


def test_a_workflow_that_cannot_be_planned_is_told_in_a_sentence(browser, tmp_path):
    project = make_project(tmp_path / "project", poles=False)
    with Studio(project, tmp_path / "log") as studio:
        page = open_studio(browser, studio, "run/tiny")
        click(page, "[data-do=look]")
        page.until("studio.page.problem")
        told = text(page, "[aria-label='What is stale']")
    assert "no site file config/sites/tradeoffs_highway.yaml" in told
    assert "Traceback" not in told and sys.executable not in told
