"""The report in a real browser: it works from disk, offline, without a complaint."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from chromium import BINARY, Chromium

from roadsight.stages import write_report, write_site_page

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "unit"))
from report_site import PLANS, ReportSite

pytestmark = pytest.mark.skipif(BINARY is None, reason="no Chromium to open the report with")

HELPERS = """
window.shown = (selector) => [...document.querySelectorAll(selector)].filter((e) => e.checkVisibility());
window.colours = () => {
  const map = shown("canvas.map")[0];
  const { data } = map.getContext("2d").getImageData(0, 0, map.width, map.height);
  const counts = {};
  for (let i = 0; i < data.length; i += 4) {
    const key = `${data[i]},${data[i + 1]},${data[i + 2]}`;
    counts[key] = (counts[key] ?? 0) + 1;
  }
  return counts;
};
window.colourOf = (name) => {
  const hex = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)).join(",");
};
window.drawn = () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
"""


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    sites = [
        ReportSite(folder, "tiny", hidden=0.1, unproven=("vlp-16",)),
        ReportSite(folder, "bare", placed=False, crs=None, coloured=False, truth=False),
    ]
    for site in sites:
        assert write_site_page.main(site.arguments) == 0
    pages = [str(site.path("page.json")) for site in sites]
    assert write_report.main(["--pages", *pages, "--out", str(folder / "report.html")]) == 0
    return folder / "report.html"


@pytest.fixture(scope="module", params=[False, True], ids=["light", "dark"])
def browser(request, tmp_path_factory):
    with Chromium(tmp_path_factory.mktemp("profile"), dark=request.param) as started:
        yield started


@pytest.fixture
def page(browser, report):
    """The report, freshly opened, all its sites unread but the first."""
    browser.complaints.clear()
    browser.requests.clear()
    browser.open(report.as_uri())
    browser.run(HELPERS)
    browser.until("Object.keys(colours()).length > 5")
    return browser


def pixels(page, name):
    """How many pixels of the map have a colour of the style sheet."""
    return page.run(f"drawn().then(() => colours()[colourOf('{name}')] ?? 0)")


def click(page, selector, number=0):
    page.run(f"shown('{selector}')[{number}].click()")
    page.run("drawn()")


def open_scene(page):
    page.run("shown('.scene3d')[0].scrollIntoView({ behavior: 'instant' })")
    page.until("shown('.scene3d')[0].querySelector('canvas') && shown('.scene3d')[0]._fullLayout")


def test_nothing_goes_wrong_and_nothing_is_requested(page, report):
    open_scene(page)
    for plan in PLANS:
        click(page, f'[data-choose-plan="{plan}"]')
    click(page, "[data-choose-sensor]")
    for box in range(page.run("shown('[data-layer]').length")):
        click(page, "[data-layer]", box)
    for camera in ("side", "top", "oblique"):
        click(page, f'[data-camera="{camera}"]')
    for option in ("intensity", "colour"):
        page.run(
            f"""(() => {{ const select = shown('[data-scene="colour"]')[0]; select.value = '{option}';
            select.dispatchEvent(new Event('change', {{ bubbles: true }})); }})()"""
        )
    click(page, ".site-link", 1)
    open_scene(page)
    page.run("drawn()")
    # Chromium's advice on a canvas that plotly.js reads back.
    assert [text for text in page.complaints if "willReadFrequently" not in text] == []
    assert {url for url in page.requests if not url.startswith(("data:", "blob:"))} == {
        report.as_uri()
    }


def test_theme_follows_the_reader(page):
    dark = page.run("matchMedia('(prefers-color-scheme: dark)').matches")
    red, green, blue = map(
        int, re.findall(r"\d+", page.run("getComputedStyle(document.body).color"))[:3]
    )
    assert (red + green + blue > 3 * 128) == dark


def test_map_shows_every_layer_and_hides_it(page):
    layers = {"pavement": None, "targets": "seen-1", "sensors": "sensor", "obstacles": "obstacle"}
    assert pixels(page, "seen-0") > 20
    for layer, colour in layers.items():
        if colour is None:
            continue
        before = pixels(page, colour)
        click(page, f'.map-panel [data-layer="{layer}"]')
        assert pixels(page, colour) < before / 2, layer
        click(page, f'.map-panel [data-layer="{layer}"]')
        assert pixels(page, colour) == before, layer


def test_counts_on_the_map_are_those_of_the_table(page):
    """Far out, a target is a few pixels, so areas of colours go with the histogram."""
    counts = page.run(
        """shown('.histogram tr').map((row) => [
            Number(row.cells[0].textContent), Number(row.cells[2].textContent.replace(',', ''))])"""
    )
    assert sum(count for _, count in counts) == len(page.run("[...shown('.site')]")) * 320
    for layer in ("candidates", "sensors", "obstacles", "edges"):
        click(page, f'.map-panel [data-layer="{layer}"]')
    areas = [pixels(page, f"seen-{min(times, 4)}") for times, _ in counts]
    assert [area > 0 for area in areas] == [count > 0 for _, count in counts]


def test_tables_follow_the_plan(page):
    click(page, '[data-choose-plan="vlp-16"]')
    assert page.run("[...new Set(shown('[data-for-plan]').map((e) => e.dataset.forPlan))]") == [
        "vlp-16"
    ]
    assert page.run("shown('.planbar input:checked')[0].value") == "vlp-16"
    assert page.run("shown('[data-plan-row][aria-current]')[0].dataset.planRow") == "vlp-16"


def test_plans_can_be_chosen_by_keyboard(page):
    page.run("shown('.planbar input')[0].focus(); shown('.planbar input')[0].click()")
    for kind in ("keyDown", "keyUp"):
        page.call(
            "Input.dispatchKeyEvent",
            type=kind,
            key="ArrowRight",
            code="ArrowRight",
            windowsVirtualKeyCode=39,
        )
    assert page.run("shown('.planbar input:checked')[0].value") == list(PLANS)[1]


def test_sensor_shows_what_it_sees(page):
    before = pixels(page, "seen-1")
    click(page, "[data-choose-sensor]", 1)
    assert page.run("shown('[data-selection]')[0].textContent").startswith("Sensor 2: ")
    assert page.run("""shown('[aria-pressed="true"]').length""") == 1
    assert pixels(page, "seen-1") < before
    click(page, "[data-selection] button")
    assert pixels(page, "seen-1") == before


def test_map_moves_by_keyboard_and_mouse(page):
    key = "shown('canvas.map')[0].dispatchEvent(new KeyboardEvent('keydown', { key: '%s' }))"
    start = pixels(page, "seen-1")
    page.run(key % "+")
    assert pixels(page, "seen-1") > 1.2 * start
    page.run(key % "0")
    assert pixels(page, "seen-1") == start
    x, y = page.run(
        "(() => { const b = shown('canvas.map')[0]; b.scrollIntoView({ behavior: 'instant', block: 'center' });"
        " const r = b.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()"
    )
    mouse = {"button": "left", "buttons": 1, "clickCount": 1}
    page.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **mouse)
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x + 2000, y=y, **mouse)
    page.call("Input.dispatchMouseEvent", type="mouseReleased", x=x + 2000, y=y, **mouse)
    assert pixels(page, "seen-1") == 0


def test_pointing_tells_what_is_there(page):
    x, y = page.run(
        "(() => { const b = shown('canvas.map')[0]; b.scrollIntoView({ behavior: 'instant', block: 'center' });"
        " const r = b.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()"
    )
    texts = set()
    for step in range(-40, 41, 5):
        page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y + step)
        texts |= set(page.run("shown('.tooltip').map((e) => e.textContent.split(/[ :]/)[0])"))
    assert {"Target", "Candidate"} <= texts


def test_scene_holds_cloud_targets_and_sensors(page):
    open_scene(page)
    traces = page.run("shown('.scene3d')[0].data.map((t) => [t.type, t.x.length])")
    assert {kind for kind, _ in traces} == {"scatter3d"}
    assert traces[0][1] == 4000
    assert traces[1][1] + traces[2][1] == 320
    scale = page.run(
        """(() => { const { aspectratio, xaxis, zaxis } = shown('.scene3d')[0].layout.scene;
        const scale = (side, { range }) => side / (range[1] - range[0]);
        return scale(aspectratio.z, zaxis) / scale(aspectratio.x, xaxis); })()"""
    )
    assert scale == pytest.approx(1)


def test_one_site_is_shown_at_a_time(page):
    open_scene(page)
    click(page, ".site-link", 1)
    page.until("shown('.site').map((e) => e.id).join() === 'site-1'")
    assert page.run("document.querySelectorAll('#site-0 .scene3d canvas').length") == 0
    page.until("Object.keys(colours()).length > 5")
    assert page.run("shown('[data-choose-plan], .planbar').length") == 0


def test_page_fits_its_window_and_controls_have_names(page):
    assert (
        page.run("document.documentElement.scrollWidth - document.documentElement.clientWidth") <= 0
    )
    unnamed = page.run(
        """shown('button, select, input').filter((e) => !(e.textContent.trim() || e.ariaLabel
        || e.labels?.length)).map((e) => e.outerHTML)"""
    )
    assert unnamed == []


def test_text_can_be_read(page):
    """Contrast of at least 4.5 to 1 between every shown text and what it stands on (WCAG AA)."""
    poor = page.run(
        """(() => {
        const numbers = (text) => text.match(/[\\d.]+/g).map(Number);
        const light = ([r, g, b]) => [r, g, b].reduce((sum, value, i) => {
          const s = value / 255;
          return sum + [0.2126, 0.7152, 0.0722][i] * (s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4);
        }, 0);
        const behind = (element) => {
          for (let e = element; e; e = e.parentElement) {
            const colour = getComputedStyle(e).backgroundColor;
            if (colour.startsWith('rgb') && (numbers(colour)[3] ?? 1) === 1) return numbers(colour);
          }
        };
        return shown('body *').filter((e) => [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim()))
          .filter((e) => !e.closest('.scene3d, script, style, option'))
          .map((e) => {
            const [a, b] = [light(numbers(getComputedStyle(e).color)), light(behind(e))];
            return [(Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05), e.className, e.textContent.slice(0, 40)];
          }).filter(([ratio]) => ratio < 4.5);
        })()"""
    )
    assert poor == []


def test_page_reads_without_scripts(browser, report, tmp_path):
    text = report.read_text(encoding="utf-8")
    bare = tmp_path / "bare.html"
    bare.write_text(re.sub(r"<script>.*?</script>", "", text, flags=re.S), encoding="utf-8")
    browser.open(bare.as_uri())
    headings = browser.run(
        "[...document.querySelectorAll('h2')].filter((e) => e.checkVisibility()).map((e) => e.textContent)"
    )
    for title, _ in PLANS.values():
        assert f"Chosen sensors {title}" in headings
