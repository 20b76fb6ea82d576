"""Road edges in a real browser: draw, undo, save, reload, and what the files then say."""

import json
import re

import numpy as np
import pytest
import yaml

from roadsight.base.texts import read_yaml
from roadsight.config.load import load_config, load_site
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.vector.vectors import read_lines, read_polygons
from tests.e2e import studio_page
from tests.e2e.studio_page import check_look, key, open_studio

pytestmark = pytest.mark.xdist_group("studio")
READY = "window.studio?.page?.preview && studio.page.view.settled && !studio.page.looking"


@pytest.fixture
def page(browser, studio, project):
    return open_studio(browser, studio, ready=READY)


def pixel(page, x, y):
    """Where a place of the plan is in the window."""
    box = "studio.page.view.element.getBoundingClientRect()"
    return page.run(
        f"(([u, v], box) => [u + box.left, v + box.top])(studio.page.view.project({x}, {y}), {box})"
    )


def click(page, x, y, count=1, modifiers=0):
    studio_page.click_at(page, *pixel(page, x, y), count, modifiers)


def drag(page, start, end):
    studio_page.drag(page, pixel(page, *start), pixel(page, *end))


def tool(page, name):
    page.run(f"document.querySelector('.tools [data-value={name}]').click()")


def drawing(page):
    return page.run("studio.page.history.now")


def save(page):
    key(page, "s", modifiers=2)
    page.until("!studio.page.history.dirty")


def site_of(project, monkeypatch, name="tiny"):
    monkeypatch.chdir(project)
    site = load_site(name, load_config(read_yaml("config/config.yaml")))
    frame = Frame.from_dict(read_json(f"results/{name}/scene/frame.json"))
    return site, frame


def test_an_edge_is_drawn_snapped_saved_and_read_back(page, project, monkeypatch):
    tool(page, "edge")
    ring = page.run("studio.page.area[0]")
    onto = [(ring[i], ring[i + 1]) for i in (12, 24, 36)]
    for x, y in onto:
        click(page, x + 0.3, y - 0.3)
    key(page, "Enter")
    edge = drawing(page)["edges"][0]
    assert len(edge["points"]) == 3
    for (x, y), (u, v) in zip(onto, edge["points"], strict=True):
        assert abs(x - u) + abs(y - v) < 1.0
    page.until(f"!studio.page.looking && studio.page.preview.edges.length === 1 && {READY}")
    assert page.run("studio.page.preview.forbidden.length") >= 3
    save(page)
    site, frame = site_of(project, monkeypatch)
    lines = read_lines(site.beside(site.site.placement.edges), frame, site.site.placement.edges_crs)
    assert list(lines["edge"]) == [edge["name"]]
    read = [list(point) for point in lines.geometry[0].coords]
    for (x, y), (u, v) in zip(edge["points"], read, strict=True):
        assert abs(x - u) < 1e-3 and abs(y - v) < 1e-3
    assert page.complaints == []


def test_alt_draws_where_the_mouse_is(page):
    tool(page, "edge")
    ring = page.run("studio.page.area[0]")
    x, y = ring[12] + 0.3, ring[13] - 0.3
    click(page, x, y, modifiers=1)
    u, v = drawing(page)["edges"][0]["points"][0]
    across = page.run("studio.page.view.metresPerPixel")
    assert abs(x - u) <= across and abs(y - v) <= across


def test_undo_redo_and_work_that_survives_a_reload(page):
    tool(page, "edge")
    for x in (20, 30, 40):
        click(page, x, 10, modifiers=1)
    key(page, "Enter")
    before = drawing(page)["edges"]
    key(page, "z", modifiers=2)
    assert len(drawing(page)["edges"][0]["points"]) == 2
    key(page, "y", modifiers=2)
    assert drawing(page)["edges"] == before
    page.reload()
    page.until(READY)
    assert drawing(page)["edges"] == before
    assert "unsaved changes are back" in page.run("document.getElementById('notes').textContent")
    assert page.run("document.querySelector('[data-do=save]').disabled") is False


def test_points_are_moved_inserted_and_removed(page):
    tool(page, "edge")
    for x in (20, 40):
        click(page, x, 10, modifiers=1)
    key(page, "Enter")
    tool(page, "select")
    start = drawing(page)["edges"][0]["points"][1]
    page.run("studio.page.editor.snap = false")
    drag(page, start, (44, 6))
    moved = drawing(page)["edges"][0]["points"][1]
    assert abs(moved[0] - 44) < 0.5 and abs(moved[1] - 6) < 0.5
    key(page, "ArrowRight", modifiers=8)
    assert drawing(page)["edges"][0]["points"][1][0] == pytest.approx(moved[0] + 1, abs=1e-3)
    key(page, ",")
    key(page, "i")
    assert len(drawing(page)["edges"][0]["points"]) == 3
    key(page, "Delete")
    assert len(drawing(page)["edges"][0]["points"]) == 2
    key(page, "Delete")
    assert drawing(page)["edges"] == []


def test_everything_by_keys(page):
    page.run("studio.page.view.canvas.focus()")
    key(page, "e")
    for _ in range(3):
        key(page, " ")
        key(page, "ArrowRight")
    key(page, "Enter")
    assert len(drawing(page)["edges"][0]["points"]) == 3
    key(page, "z")
    for arrow in ("ArrowUp", "ArrowRight", "ArrowDown"):
        key(page, " ")
        key(page, arrow)
    key(page, "Enter")
    assert len(drawing(page)["zones"][0]["points"]) == 3
    key(page, "p")
    assert page.run("studio.page.view.mode") == "3d"
    key(page, "?")
    assert page.run("document.querySelector('dialog').open")
    page.run("document.querySelector('dialog').close()")


def test_zones_take_candidates_away(page, project, monkeypatch):
    page.run("""studio.page.history.change((drawing) => {
        drawing.edges.push({ name: "north", kind: "edge", points: [[15, 27], [40, 28], [70, 31]] });
    })""")
    page.until("!studio.page.looking && studio.page.preview.forbidden.length > 5")
    tool(page, "zone")
    for x, y in ((30, 24), (50, 24), (50, 34), (30, 34)):
        click(page, x, y)
    key(page, "Enter")
    page.until("!studio.page.looking && studio.page.preview.forbidden.includes(1)")
    assert page.run("studio.page.preview.forbidden.includes(0)")
    save(page)
    site, frame = site_of(project, monkeypatch)
    zones = read_polygons(site.beside(site.site.placement.zones), frame)
    assert len(zones) == 1 and zones.geometry[0].area > 150


def test_poles_become_mounts(page, project):
    tool(page, "mount")
    click(page, 40, 14)
    page.run("""(() => {
        const height = document.querySelector('[data-list=mounts] input');
        height.value = 9; height.dispatchEvent(new Event('change'));
    })()""")
    save(page)
    written = json.loads((project / "config/sites/tiny/mounts.geojson").read_text())
    assert written["features"][0]["properties"] == {"name": "p1", "height_m": 9.0}


def test_the_monitored_area_is_added_to_and_cut(page, project, monkeypatch):
    before = page.run("studio.page.preview.area_m2")
    tool(page, "add")
    for x, y in ((40, 8), (52, 8), (52, 14), (40, 14)):
        click(page, x, y)
    key(page, "Enter")
    page.until(f"!studio.page.looking && studio.page.preview.area_m2 > {before} + 50")
    tool(page, "remove")
    for x, y in ((16, 8), (30, 8), (30, 32), (16, 32)):
        click(page, x, y)
    key(page, "Enter")
    page.until("!studio.page.looking && studio.page.preview.area")
    expected = page.run("studio.page.preview.area_m2")
    save(page)
    site, frame = site_of(project, monkeypatch)
    area = read_polygons(site.beside(site.site.placement.tma), frame).union_all().area
    assert area == pytest.approx(expected, rel=1e-4)
    page.until("!studio.page.looking")
    page.run(
        "[...document.querySelectorAll('button')].find((b) => b.textContent === 'As found').click()"
    )
    save(page)
    assert load_text(project).get("placement", {}).get("tma") is None


def load_text(project):
    return yaml.safe_load((project / "config/sites/tiny.yaml").read_text())


def test_names_are_changed_and_edges_taken_over(page, project):
    page.run("""studio.page.references.automatic =
        [{ name: "a1", kind: "edge", points: [[15, 27], [40, 28]] }]; studio.page.panel.fill()""")
    page.run("""[...document.querySelectorAll('button')]
        .find((b) => b.textContent.startsWith('Take over')).click()""")
    assert [edge["name"] for edge in drawing(page)["edges"]] == ["a1"]
    page.run(
        "studio.page.references.poles = [{ name: 'p7', x: 30, y: 12 }]; studio.page.panel.fill()"
    )
    page.run("""[...document.querySelectorAll('button')]
        .find((b) => b.textContent === 'Take over the 1 pole found').click()""")
    assert drawing(page)["mounts"] == [{"name": "p7", "x": 30, "y": 12, "height_m": None}]
    page.run("document.querySelector('[aria-label=\"Rename a1\"]').click()")
    name = "document.querySelector('dialog input')"
    assert page.run(f"({name}.value = 'two words', {name}.checkValidity())") is False
    assert page.run(f"({name}.value = 'a-b_c.d', {name}.checkValidity())") is True
    page.run("""(() => {
        document.querySelector('dialog input').value = 'kerb';
        document.querySelector('dialog form').requestSubmit();
    })()""")
    assert drawing(page)["edges"][0]["name"] == "kerb"


def test_mistakes_are_told_and_nothing_is_written(page, project):
    before = (project / "config/sites/tiny.yaml").read_bytes()
    page.run("""studio.page.history.change((drawing) => { drawing.edges.push(
        { name: "bow", kind: "edge", points: [[10, 10], [30, 30], [30, 10], [10, 30]] }); })""")
    page.until("document.querySelector('.panel .message')?.textContent.includes('crosses itself')")
    key(page, "s", modifiers=2)
    page.until("document.querySelector('.note.bad')?.textContent.includes('crosses itself')")
    assert (project / "config/sites/tiny.yaml").read_bytes() == before
    assert not (project / "config/sites/tiny").exists()


def test_looks(page):
    for dark in (False, True):
        for size in ((1280, 720), (1920, 1080)):
            check_look(page, *size, dark)


def test_colours_and_three_dimensions(page):
    for colour in ("ground", "intensity", "class", "height"):
        page.run(f"studio.page.colour('{colour}')")
        page.until("studio.page.view.settled")
    page.run("studio.page.setMode('3d')")
    page.until("studio.page.view.settled")
    assert page.run("studio.page.view.stats.points") > 10_000
    assert re.search("3D", page.run("studio.page.foot.textContent"))
    assert page.complaints == []


def test_without_results_it_says_what_to_run(page):
    page.run("location.hash = '#/edges/empty'")
    page.until("document.querySelector('main .message')")
    assert "sites=[empty]" in page.run("document.querySelector('main').textContent")


def test_a_point_lands_on_an_edge_that_only_the_cloud_shows(page):
    """Brightness changes at the pavement's side, which is taken out of what was found."""
    x, y = page.run("studio.page.area[0]")[24:26]
    page.run("studio.page.references.lines = []; studio.page.area = studio.page.preview.area = []")
    tool(page, "edge")
    clicked = x + 0.1, y - 0.7
    click(page, *clicked)
    page.until("studio.page.history.alike && studio.page.editor.refined")
    u, v = drawing(page)["edges"][0]["points"][0]
    assert abs(v - y) < 0.35
    assert np.hypot(u - clicked[0], v - clicked[1]) > 0.35
    key(page, "z", modifiers=2)
    assert drawing(page)["edges"] == []
