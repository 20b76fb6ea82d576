"""What the studio does where something else changes while one draws and saves."""

import json

import pytest

from tests.e2e.studio_page import hold_back, key, noted, open_studio

pytestmark = pytest.mark.xdist_group("studio")
READY = "window.studio?.page?.preview && !studio.page.looking"
NOW = "studio.page.history.now"
EDGE = {"name": "e1", "kind": "edge", "points": [[20, 10], [30, 11], [40, 10]]}
ZONE = {"name": "z1", "points": [[20, 10], [30, 10], [30, 16]]}


@pytest.fixture
def page(browser, studio, project):
    return open_studio(browser, studio, ready=READY)


def add(page, layer, item):
    page.run(f"studio.page.history.change((now) => {{ now.{layer}.push({json.dumps(item)}); }})")


def save(page):
    key(page, "s", modifiers=2)
    page.until("!studio.page.history.dirty")


def test_what_is_drawn_while_a_save_is_under_way_stays(page, project):
    add(page, "edges", EDGE)
    hold_back(page, "PUT", "/drawing")
    key(page, "s", modifiers=2)
    page.until("window.held")
    add(page, "edges", EDGE | {"name": "e2"})
    page.run("release()")
    page.until("!studio.page.saving")
    assert len(page.run(NOW)["edges"]) == 2 and page.run("studio.page.history.dirty")
    path = project / "config/sites/tiny/edges.geojson"
    assert len(json.loads(path.read_text())["features"]) == 1
    save(page)
    assert len(json.loads(path.read_text())["features"]) == 2


def test_a_drawing_that_changed_elsewhere_is_not_saved_over(page, project):
    add(page, "edges", EDGE)
    save(page)
    path = project / "config/sites/tiny/edges.geojson"
    theirs = path.read_text().replace('"edge": "e1"', '"edge": "theirs"')
    assert "theirs" in theirs
    path.write_text(theirs)
    add(page, "zones", ZONE)
    key(page, "s", modifiers=2)
    noted(page, "changed meanwhile")
    assert path.read_text() == theirs and page.run("studio.page.history.dirty")
    assert not path.with_name("zones.geojson").exists()
    page.reload()
    page.until(READY)
    now = page.run(NOW)
    assert [edge["name"] for edge in now["edges"]] == ["theirs"] and len(now["zones"]) == 1
    assert page.run("!studio.page.history.conflict")
    save(page)
    assert path.read_text() == theirs and path.with_name("zones.geojson").exists()


def test_a_draft_that_changed_on_both_sides_is_told(page, project):
    add(page, "edges", EDGE | {"name": "mine"})
    key_ = page.run("studio.page.history.key")
    assert page.run("studio.project.id") in key_
    page.run(f"""(() => {{
        const draft = JSON.parse(localStorage.getItem({key_!r}));
        draft.saved = draft.saved.replace('"edges":[]', '"edges":[{{"name":"theirs"}}]');
        localStorage.setItem({key_!r}, JSON.stringify(draft));
        studio.page.history.keep = () => {{}};
    }})()""")
    page.reload()
    page.until(READY)
    assert page.run("studio.page.history.conflict")
    assert [edge["name"] for edge in page.run(NOW)["edges"]] == ["mine"]
