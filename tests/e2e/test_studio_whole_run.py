"""The real workflow on a small site, from nothing to its results, by the studio's pages alone."""

import pytest

from roadsight.io.records.atomic import read_json
from tests.e2e.chromium import BINARY
from tests.e2e.studio_page import check_look, click, key, open_studio, text
from tests.e2e.studio_project import Studio
from tests.workflow.conftest import Checkout

pytestmark = [
    pytest.mark.skipif(BINARY is None, reason="no Chromium to open the studio with"),
    pytest.mark.xdist_group("studio"),
]
LONGEST_S = 400
ZONE = "{ name: 'zone1', points: [[10, 0], [30, 0], [30, 40], [10, 40]] }"


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "checkout"
    Checkout.copy_to(folder)
    with Studio(folder, folder.parent / "log") as started:
        yield started


def run_to_the_end(page):
    click(page, "[data-do=start]")
    page.until("studio.page.state.running")
    page.until("studio.page.state && !studio.page.state.running", LONGEST_S)
    state = page.run("studio.page.state")
    assert (state["status"], state["failed"]) == ("done", []), state["complaint"]
    return state


def test_from_nothing_to_results_and_again_after_a_zone_was_drawn(browser, studio):
    page = open_studio(browser, studio, "run/tiny")
    key(page, "l")
    page.until("studio.page.plan", 120)
    # The page that the studio begins with was refused a cloud that is not there yet, perhaps late.
    assert all("422" in complaint for complaint in page.complaints)
    page.complaints.clear()
    planned = page.run("studio.page.plan.jobs")
    assert planned > 10
    assert run_to_the_end(page)["total"] >= planned
    assert "Finished" in text(page, "[aria-label=Progress]")
    key(page, "l")
    page.until("studio.page.plan?.jobs === 0", 120)
    for dark in (False, True):
        check_look(page, 1280, 720, dark)
    summary = read_json(studio.folder / "results/tiny/summary.json")
    sensors = {name: plan["sensors"] for name, plan in summary["placement"].items()}
    for dark in (False, True):
        page.run("location.hash = '#/results/tiny'")
        page.until("studio.page?.part?.coverage && studio.page.view.settled", 120)
        plan = page.run("studio.page.part.plan")
        assert page.run("studio.page.part.sensors.length") == sensors[plan]
        check_look(page, 1280, 720, dark)
    assert page.complaints == []
    page.run("location.hash = '#/edges/tiny'")
    page.until("studio.page?.preview && !studio.page.looking")
    page.run(f"studio.page.history.change((now) => {{ now.zones.push({ZONE}); }})")
    key(page, "s", modifiers=2)
    page.until("!studio.page.history.dirty")
    page.run("location.hash = '#/run/tiny'")
    page.until("studio.page?.state")
    key(page, "l")
    page.until("studio.page.plan?.jobs > 0", 120)
    stale = text(page, "table.stale")
    assert "check_coverage" in stale and "build_dem" not in stale
    run_to_the_end(page)
