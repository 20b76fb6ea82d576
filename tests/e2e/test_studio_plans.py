"""Plans in a real browser: a what-if that is saved, files to take away, the editor, new sites."""

import shutil
import time

import numpy as np
import pytest
import yaml

from tests.e2e.studio_page import check_look, click, key, noted, open_studio, set_size, text
from tests.helpers.las_files import random_points, wkt_of, write_las

pytestmark = pytest.mark.xdist_group("studio")
PART = "studio.page.part"


@pytest.fixture
def plan(browser, studio, project):
    page = open_studio(browser, studio, "results/tiny")
    page.until(f"{PART}?.about && studio.page.view.settled")
    return page


def own_plans(project):
    content = yaml.safe_load((project / "config/sites/tiny.yaml").read_text())
    return content.get("placement", {}).get("own_plans", {})


def fill(page, name, value):
    page.run(f"document.querySelector('[data-do={name}]').value = {value!r}")


def test_a_what_if_becomes_a_plan_that_is_edited_and_removed(plan, project):
    standing = plan.run(f"{PART}.rows.length") - 1
    click(plan, "[data-do=on0]")
    plan.until(f"!{PART}.turn")
    click(plan, "[data-do=save-as]")
    plan.until("document.querySelector('dialog.form')")
    fill(plan, "plan-name", "mine")
    click(plan, "[data-do=save-plan]")
    noted(plan, "config/sites/tiny/mine.mandatory.csv")
    assert own_plans(project)["mine"] == {
        "title": plan.run(f"{PART}.plans[{PART}.plan]") + ", as drawn",
        "sensors": plan.run(f"{PART}.about.sensors.map(({{ name }}) => name)"),
        "mandatory": {"file": "tiny/mine.mandatory.csv"},
        "forbidden": {"file": "tiny/mine.forbidden.geojson"},
        "budget": {"sensors": standing},
    }
    plan.run("location.hash = '#/run/tiny'")
    click(plan, "[data-do=edit-mine]")
    plan.until("document.querySelector('dialog.form')")
    plan.run("""(() => { const goal = document.querySelector('[data-do=goal]');
        goal.value = 'cover'; goal.dispatchEvent(new Event('change')); })()""")
    fill(plan, "plan-title", "With all targets")
    click(plan, "[data-do=save-plan]")
    plan.until("!document.querySelector('dialog')")
    plan.until("document.querySelector('[data-do=edit-mine]')?.textContent === 'With all targets'")
    assert "budget" not in own_plans(project)["mine"]
    assert own_plans(project)["mine"]["mandatory"]["file"] == "tiny/mine.mandatory.csv"
    click(plan, "[data-do=remove-mine]")
    click(plan, "dialog button.primary")
    plan.until("!document.querySelector('[data-do=edit-mine]')")
    assert own_plans(project) == {} and not list((project / "config/sites/tiny").iterdir())
    assert plan.complaints == []


def test_what_is_wrong_with_a_plan_is_told_beside_it(plan, project):
    click(plan, "[data-do=save-as]")
    plan.until("document.querySelector('dialog.form')")
    fill(plan, "plan-name", "mine")
    fill(plan, "mandatory-text", "here, there")
    click(plan, "[data-do=save-plan]")
    plan.until("document.querySelector('dialog [role=alert] .message')")
    assert "is no number" in text(plan, "dialog [role=alert]") and own_plans(project) == {}
    key(plan, "Escape")
    plan.until("!document.querySelector('dialog')")


def test_places_may_have_decimal_commas_and_come_back_as_written(plan):
    module = "import('/assets/js/plans/places.js')"
    lines = ["412345,12; 5400000,5; OS1-32", "1.5, 2, OS1-32, 4", "1,5\t2\t\t4,5\ta@y+30p-10r+0"]
    written = "\n".join(lines)
    places, again = plan.run(f"""{module}.then(({{ readStanding, standingText }}) => {{
        const places = readStanding({written!r});
        return [places, readStanding(standingText(places))]; }})""")
    squares = "1,5;2;3\n1.5, 2, 3"
    barred = plan.run(f"{module}.then(({{ readBarred }}) => readBarred({squares!r}))")
    assert places == again
    assert [tuple(place.values()) for place in places] == [
        (412345.12, 5400000.5, "OS1-32", None, ""),
        (1.5, 2, "OS1-32", 4, ""),
        (1.5, 2, "", 4.5, "a@y+30p-10r+0"),
    ]
    assert barred == [{"x": 1.5, "y": 2, "half_m": 3}] * 2


def test_a_plan_that_somebody_else_changed_is_not_overwritten(plan, project):
    click(plan, "[data-do=save-as]")
    plan.until("document.querySelector('dialog.form')")
    fill(plan, "plan-name", "mine")
    site = project / "config/sites/tiny.yaml"
    content = yaml.safe_load(site.read_text())
    other = {"title": "Other", "sensors": ["VLP-16"]}
    content.setdefault("placement", {})["own_plans"] = {"other": other}
    site.write_text(yaml.safe_dump(content))
    click(plan, "[data-do=save-plan]")
    plan.until("document.querySelector('dialog [role=alert] .message')")
    assert "changed meanwhile" in text(plan, "dialog [role=alert]")
    assert own_plans(project) == {"other": other}
    key(plan, "Escape")


def test_figures_that_could_not_be_counted_are_marked(plan):
    assert "Figures of before" not in text(plan, ".panel")
    version = plan.run(f"{PART}.about.version")
    plan.run(f"{PART}.about.version = 'old'")
    click(plan, "[data-do=on0]")
    plan.until(f"!{PART}.turn")
    assert "Figures of before" in text(plan, ".panel")
    plan.run(f"{PART}.about.version = {version!r}")
    click(plan, "[data-do=on0]")
    plan.until(f"!{PART}.turn && !{PART}.outdated")
    assert "Figures of before" not in text(plan, ".panel")


def test_what_a_what_if_does_not_count_is_said(plan):
    plan.run(f"{PART}.about.notes = ['That is not counted here.']; studio.page.show()")
    assert "That is not counted here." in text(plan, ".panel")


def test_files_are_taken_away(plan, tmp_path):
    plan.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    for kind, name in (
        ("csv", "tiny-vlp-16-sensors.csv"),
        ("geojson", "tiny-vlp-16-sensors.geojson"),
        ("yaml", "tiny-vlp-16-plan.yaml"),
    ):
        click(plan, f"[data-do=export-{kind}]")
        noted(plan, name)
        end = time.monotonic() + 20
        while not (tmp_path / name).exists() and time.monotonic() < end:
            time.sleep(0.05)
        assert "VLP-16" in (tmp_path / name).read_text()


def test_a_cloud_becomes_a_site(plan, project, tmp_path):
    cloud = write_las(tmp_path / "Cart Road.laz", random_points(500), wkt_of("EPSG:25832"))
    click(plan, "#add")
    fill(plan, "cloud-path", str(cloud))
    click(plan, "[data-do=look-cloud]")
    plan.until("document.querySelector('dialog .told.doubt')")
    told = text(plan, "dialog")
    assert "500 points" in told and "from the header" in told and "sparse" in told
    file = project / "config/sites/cart_road.yaml"
    assert not file.exists()
    click(plan, "[data-do=write-site]")
    plan.until("location.hash === '#/run/cart_road' && studio.page")
    assert file.exists()
    assert plan.run("document.querySelector('#site optgroup').label") == "Own sites"
    assert "no cloud yet" in text(plan, "#tabs [aria-disabled=true]")
    file.unlink()


def test_a_length_is_measured_by_clicks_and_by_keys(plan):
    key(plan, "d")
    places = plan.run("""(() => { const { view } = studio.page;
        const { left, top } = view.element.getBoundingClientRect();
        return [[300, 300], [420, 300], [420, 350]].map(([x, y]) => [x + left, y + top]); })()""")
    for x, y in places:
        for kind in ("mousePressed", "mouseReleased"):
            plan.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    across = plan.run("studio.page.view.metresPerPixel")
    measured = float(text(plan, ".measured").split(" m")[0])
    assert measured == pytest.approx(170 * across, abs=0.006)
    assert plan.run(f"{PART}.chosen") is None
    key(plan, "Backspace")
    assert float(text(plan, ".measured").split(" m")[0]) == pytest.approx(120 * across, abs=0.006)
    key(plan, "Escape")
    assert text(plan, ".measured") == ""
    assert plan.run("document.querySelector('[data-do=measure]').ariaPressed") == "false"
    width = plan.run("document.querySelector('.scale div').getBoundingClientRect().width")
    assert width * across == pytest.approx(float(text(plan, ".scale div").split(" ")[0]), rel=0.01)


def test_lengths_are_told_in_the_units_of_the_files_too(plan):
    told = plan.run("""import('/assets/js/cloud/ruler.js').then(({ lengthText, roundBelow }) => [
        lengthText(12, { name: 'metre', metres: 1 }),
        lengthText(12, { name: 'us-survey-foot', metres: 1200 / 3937 }),
        ...[0.9, 1, 4.9, 73].map(roundBelow)])""")
    assert told[:2] == ["12.00 m", "12.00 m = 39.37 US ft"]
    assert told[2:] == pytest.approx([0.5, 1, 2, 50])


def test_a_page_that_cannot_work_says_why_and_leads_nowhere(plan):
    tab = "document.querySelector('#tabs [aria-disabled=true]')"
    assert plan.run(f"{tab}.textContent") == "Registration no images asked for"
    assert plan.run(f"{tab}.hasAttribute('href')") is False
    plan.run("location.hash = '#/registration/tiny'")
    plan.until("document.querySelector('main [role=alert]')")
    assert "cannot work on tiny: no images asked for" in text(plan, "main [role=alert]")


def test_notes_leave_the_legend_free(plan):
    click(plan, "[data-do=export-csv]")
    noted(plan, "Saved by the browser")
    for size in ((1280, 720), (1440, 900), (390, 844)):
        set_size(plan, *size)
        boxes = plan.run("""['#notes', '.legend', '.scale'].map((one) => {
            const box = document.querySelector(one).getBoundingClientRect();
            return [box.left, box.top, box.right, box.bottom]; })""")
        note, *others = np.array(boxes)
        for box in others:
            assert (note[2:] <= box[:2]).any() or (box[2:] <= note[:2]).any(), (size, boxes)


@pytest.mark.parametrize("place", ["results", "edges", "run"])
def test_a_phone_scrolls_past_no_map(browser, studio, place):
    page = open_studio(browser, studio, f"{place}/tiny")
    check_look(page, 390, 844, False)
    scrolling = page.run("""[...document.querySelectorAll('.view canvas')].flatMap((one) => {
        const found = [];
        for (let e = one.parentElement; e; e = e.parentElement) {
            if (e.scrollHeight > e.clientHeight + 1 && getComputedStyle(e).overflowY !== 'visible'
                && getComputedStyle(e).overflowY !== 'hidden') found.push(e.className);
        }
        return found; })""")
    assert scrolling == []


def test_the_form_fits_a_phone(plan):
    set_size(plan, 390, 844)
    click(plan, "[data-do=save-as]")
    plan.until("document.querySelector('dialog.form')")
    inside = plan.run("""[...document.querySelectorAll('dialog *')].every((one) => {
        const { left, right } = one.getBoundingClientRect();
        return left >= 0 && right <= innerWidth; })""")
    assert inside


@pytest.fixture(autouse=True)
def _no_site_left(studio):
    yield
    shutil.rmtree(studio.folder / "config/sites/cart_road", ignore_errors=True)
    (studio.folder / "config/sites/cart_road.yaml").unlink(missing_ok=True)
