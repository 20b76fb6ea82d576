"""The page Results in a real browser: what-if on a plan, and decisions on poles."""

import shutil

import pytest
import yaml

from tests.e2e.studio_page import LOOKS, check_look, click, hold_back, key, open_studio, text
from tests.e2e.studio_project import Studio, make_project

pytestmark = pytest.mark.xdist_group("studio")
PART = "studio.page.part"


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    with Studio(make_project(folder / "project"), folder / "log") as started:
        yield started


@pytest.fixture
def plan(browser, studio):
    page = open_studio(browser, studio, "results/tiny")
    page.until(f"{PART}?.about && studio.page.view.settled")
    return page


def at_rest(page):
    page.until(f"!{PART}.turn")


def press(page, x, y):
    """Click a place of the view, in pixels of the view."""
    box = page.run(
        "(({left, top}) => [left, top])(studio.page.view.element.getBoundingClientRect())"
    )
    for kind in ("mousePressed", "mouseReleased"):
        page.call(
            "Input.dispatchMouseEvent", type=kind, x=x + box[0], y=y + box[1], button="left",
            clickCount=1,
        )  # fmt: skip


def pixel(page, row):
    return page.run(f"studio.page.view.project(...{PART}.place({row}))")


def counts(page):
    return page.run(f"(({{covered, lost, gained}}) => [covered, lost, gained])({PART}.coverage)")


@pytest.fixture
def both(studio):
    """The site tiny asks for poles, too, which were not computed."""
    sites = studio.folder / "config/sites"
    before = (sites / "tiny.yaml").read_bytes()
    content = yaml.safe_load(before)
    poles = yaml.safe_load((sites / "drive.yaml").read_text())["poles"]
    content |= {"jobs": ["placement", "poles"], "poles": poles}
    (sites / "tiny.yaml").write_text(yaml.safe_dump(content))
    yield
    (sites / "tiny.yaml").write_bytes(before)


def test_what_is_asked_for_last_is_shown(both, plan):
    hold_back(plan, "GET", "/poles")
    key(plan, "j")
    plan.until("window.held")
    key(plan, "j")
    plan.until(f"studio.page.name === 'sensors' && {PART}.about && !studio.page.loading")
    plan.run("release()")
    plan.run("new Promise((done) => setTimeout(done, 1500))")
    assert "Sensors" in text(plan, ".panel") and not text(plan, ".panel [role=alert]")
    key(plan, "j")
    plan.until("document.querySelector('.panel [role=alert]')")
    assert "is not there yet" in text(plan, ".panel [role=alert]")


def test_a_sensor_is_switched_off_and_on_by_keys(plan):
    covered = counts(plan)[0]
    key(plan, "n")
    alone = plan.run(f"{PART}.coverage.only[0]")
    key(plan, "o")
    at_rest(plan)
    assert counts(plan) == [covered - alone, alone, 0] and alone > 0
    assert f"\N{MINUS SIGN}{alone}" in text(plan, ".facts")
    key(plan, "z", modifiers=2)
    at_rest(plan)
    assert counts(plan) == [covered, 0, 0]
    click(plan, "[data-do=on0]")
    at_rest(plan)
    assert counts(plan)[1] == alone
    click(plan, "[data-do=best]")
    at_rest(plan)
    assert counts(plan)[1] < alone and "added" in text(plan, ".list.tall")
    click(plan, "[data-do=reset]")
    plan.until(f"!{PART}.changed")
    assert plan.complaints == []


def test_a_sensor_is_moved_to_another_candidate_by_a_click_and_by_keys(plan):
    key(plan, "n")
    row = plan.run(f"{PART}.sensors[0].row")
    other = plan.run(f"""(() => {{ const p = {PART}; const {{ xyz }} = p.about.choices;
        const far = [...p.about.choices.name.keys()].filter((r) => p.sensors.every((s) =>
            Math.hypot(xyz[3 * s.row] - xyz[3 * r], xyz[3 * s.row + 1] - xyz[3 * r + 1]) > 3));
        return p.best(p.atPlace(far[0])); }})()""")
    click(plan, "[data-do=move]")
    press(plan, *pixel(plan, other))
    at_rest(plan)
    assert plan.run(f"{PART}.sensors[0].row") == other
    assert "moved" in text(plan, ".list.tall")
    key(plan, ";")
    at_rest(plan)
    lower = plan.run(f"{PART}.about.choices.height_m[{PART}.sensors[0].row]")
    assert lower <= plan.run(f"{PART}.about.choices.height_m[{other}]")
    key(plan, ".")
    at_rest(plan)
    assert plan.run(f"{PART}.sensors[0].row") not in (row, other)


def test_a_sensor_is_added_by_a_click_and_taken_away(plan):
    before = plan.run(f"{PART}.rows.length")
    click(plan, "[data-do=add]")
    free = plan.run(f"""(() => {{ const p = {PART}; const {{ xyz }} = p.about.choices;
        return [...p.about.choices.name.keys()].find((r) => p.sensors.every((s) =>
            Math.hypot(xyz[3 * s.row] - xyz[3 * r], xyz[3 * s.row + 1] - xyz[3 * r + 1]) > 3));
        }})()""")
    press(plan, *pixel(plan, free))
    at_rest(plan)
    assert plan.run(f"{PART}.rows.length") == before + 1
    key(plan, "Delete")
    at_rest(plan)
    assert plan.run(f"{PART}.rows.length") == before and counts(plan)[1:] == [0, 0]


def test_other_plans_three_dimensions_and_obstacles(plan):
    plan.run("""(() => { const list = document.querySelector('[data-do=plan]');
        list.value = 'os-64'; list.dispatchEvent(new Event('change')); })()""")
    plan.until(f"{PART}.plan === 'os-64' && {PART}.about.sensors[0].name === 'OS1-64'")
    assert "object, 2.4 m high" in text(plan, ".panel")
    assert "hidden" in text(plan, ".panel")
    click(plan, "[data-do=obstacles]")
    key(plan, "p")
    plan.until("studio.page.view.mode === '3d' && studio.page.view.settled")
    assert plan.complaints == []


def test_broken_results_are_told_in_a_sentence(plan, studio):
    path = studio.folder / "results/tiny/placement/os-128/solution.json"
    before = path.read_text()
    path.write_text("{")
    plan.run(f"{PART}.plan = 'os-128'; studio.page.turnTo('sensors')")
    plan.until("document.querySelector('.panel .message.bad')")
    assert "os-128/solution.json" in text(plan, ".panel .message.bad")
    path.write_text(before)


@pytest.mark.parametrize(("width", "height", "dark"), LOOKS)
def test_texts_stand_out_and_nothing_is_cut_off(plan, width, height, dark):
    key(plan, "n")
    key(plan, "o")
    at_rest(plan)
    check_look(plan, width, height, dark)


@pytest.fixture
def poles(browser, studio):
    page = open_studio(browser, studio, "results/drive")
    page.until(f"{PART}?.about && studio.page.view.settled")
    yield page
    folder = studio.folder / "config/sites"
    shutil.rmtree(folder / "drive", ignore_errors=True)
    text = (folder / "drive.yaml").read_text()
    (folder / "drive.yaml").write_text(text.replace("  decisions: drive/pole_decisions.csv\n", ""))


def decisions(page):
    found = page.run(f"{PART}.history.now.decisions")
    return {one["pole"]: one["decision"] for one in found}


def test_poles_are_accepted_rejected_moved_and_saved(poles, studio):
    names = poles.run(f"{PART}.about.poles.slice(0, 3).map(({{ id }}) => id)")
    for letter in "ar":
        key(poles, "n")
        key(poles, letter)
    key(poles, "n")
    click(poles, "[data-do=move]")
    place = poles.run(f"{PART}.about.poles[2].base.map((value, n) => value + 2 - 3 * n)")
    u, v = poles.run(f"studio.page.view.project({place[0]}, {place[1]})")
    press(poles, u, v)
    assert decisions(poles) == dict(zip(names, ("accept", "reject", "move"), strict=True))
    before = poles.run(f"{PART}.history.now.decisions[2].to_x")
    key(poles, "ArrowRight", modifiers=8)
    assert abs(poles.run(f"{PART}.history.now.decisions[2].to_x") - before - 1) < 1e-6
    poles.reload()
    poles.until(f"window.{PART.replace('.', '?.')}?.about")
    assert len(decisions(poles)) == 3
    key(poles, "s", modifiers=2)
    poles.until(f"!{PART}.history.dirty")
    table = (studio.folder / "config/sites/drive/pole_decisions.csv").read_text().splitlines()
    assert table[0] == "decision,kind,x,y,to_x,to_y,pole" and len(table) == 4
    key(poles, "n")
    key(poles, "u")
    key(poles, "z", modifiers=2)
    assert len(decisions(poles)) == 3
    assert poles.run("document.querySelector('[data-do=save]').disabled")


def test_the_list_is_filtered_and_a_missing_image_is_told(poles):
    click(poles, "[data-do=filter-decided]")
    assert poles.run("document.querySelectorAll('.list.tall li').length") == 0
    click(poles, "[data-do=filter-all]")
    seen = poles.run(f"{PART}.about.poles.findIndex((pole) => pole.seen.length)")
    poles.run(f"{PART}.about.poles[{seen}].seen[0].image = 'gone.jpg'; {PART}.choose({seen})")
    poles.until("document.querySelector('.panel .message')")
    assert "no such image" in text(poles, ".panel .message")


def test_the_image_is_shown_with_the_pole_marked(poles):
    seen = poles.run(f"{PART}.about.poles.findIndex((pole) => pole.seen.length)")
    poles.run(f"{PART}.choose({seen})")
    poles.until("document.querySelector('canvas.shot')")
    yellow = poles.run("""(() => {
        const canvas = document.querySelector('canvas.shot');
        const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
        return Array.from({ length: data.length / 4 }, (_, n) => 4 * n)
            .filter((n) => data[n] === 255 && data[n + 1] === 212 && data[n + 2] === 0).length;
    })()""")
    assert yellow > 20

    poles.run("document.querySelector('[data-do=enlarge]').focus()")
    poles.call("Input.dispatchKeyEvent", type="keyDown", key="Enter", code="Enter", text="\r")
    poles.until("document.querySelector('dialog.large canvas')")
    assert poles.run(
        "document.querySelector('dialog.large canvas').getBoundingClientRect().width > 900"
    )
    key(poles, "Escape")
    poles.until("!document.querySelector('dialog')")


@pytest.mark.parametrize(("width", "height", "dark"), LOOKS)
def test_poles_stand_out_too(poles, width, height, dark):
    key(poles, "n")
    key(poles, "r")
    check_look(poles, width, height, dark)
