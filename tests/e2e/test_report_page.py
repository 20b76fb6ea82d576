"""The report in a real browser: it works from disk, offline, without a complaint."""

import base64
import io
import re
from pathlib import Path

import pytest
from pypdf import PdfReader
from pyproj import Transformer

from roadsight.io.records.atomic import write_json
from roadsight.io.records.run_records import run_record
from roadsight.stages.evidence import write_report, write_site_page
from tests.e2e.chromium import BINARY
from tests.helpers.orthophoto import photo
from tests.helpers.report_site import PLANS, ReportSite

pytestmark = pytest.mark.skipif(BINARY is None, reason="no Chromium to open the report with")

HELPERS = Path(__file__).with_name("report_page.js").read_text(encoding="utf-8")
TARGETS = 320
MOUSE = {"button": "left", "buttons": 1, "clickCount": 1}


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    sites = [
        ReportSite(folder, "tiny", hidden=0.1, unproven=("vlp-16",), traffic=("vlp-16",)),
        ReportSite(folder, "bare", placed=False, crs=None, coloured=False, truth=False),
    ]
    for site in sites:
        assert write_site_page.main(site.arguments) == 0
    pages = [str(site.path("page.json")) for site in sites]
    runs = [str(site.path("run.json")) for site in sites]
    for site, run in zip(sites, runs, strict=True):
        write_json(run, {"site": site.name} | run_record([], "1.2").to_dict())
    out = folder / "report.html"
    assert write_report.main(["--pages", *pages, "--runs", *runs, "--out", str(out)]) == 0
    return folder / "report.html"


def opened(browser, report):
    browser.complaints.clear()
    browser.requests.clear()
    browser.open(report.as_uri())
    browser.run(HELPERS)
    browser.until("Object.keys(colours()).length > 5")
    return browser


def pixels(page, name):
    """How many pixels of the map have a colour of the style sheet."""
    return page.run(f"pixelsOf('{name}')")


def click(page, selector, number=0):
    page.run(f"shown('{selector}')[{number}].click()")
    page.run("drawn()")


def open_scene(page):
    page.run("shown('.scene3d')[0].scrollIntoView({ behavior: 'instant' })")
    page.until("shown('.scene3d canvas').length && shown('.scene3d')[0].data")


def test_nothing_goes_wrong_and_nothing_is_requested(page, report):
    open_scene(page)
    for plan in PLANS:
        click(page, f'[data-choose-plan="{plan}"]')
    click(page, "[data-choose-sensor]")
    for box in range(page.run("shown('[data-layer]').length")):
        click(page, "[data-layer]", box)
    for camera in ("side", "top", "oblique"):
        click(page, f'[data-camera="{camera}"]')
    for colour in ("intensity", "colour"):
        page.run(f"choose('[data-scene=\"colour\"]', '{colour}')")
    click(page, ".site-link", 1)
    open_scene(page)
    page.run("drawn()")
    # Chromium's advice on a canvas that plotly.js reads back.
    assert [text for text in page.complaints if "willReadFrequently" not in text] == []
    outside = [url for url in page.requests if not url.startswith(("data:", "blob:"))]
    assert set(outside) == {report.as_uri()}


def test_theme_follows_the_reader_and_texts_stand_out(themed):
    dark = themed.run("matchMedia('(prefers-color-scheme: dark)').matches")
    colour = themed.run("getComputedStyle(document.body).color")
    assert (sum(map(int, re.findall(r"\d+", colour)[:3])) > 3 * 128) == dark
    assert themed.run("faintTexts()") == []


@pytest.mark.parametrize(
    ("layer", "colour"), [("targets", "seen-1"), ("sensors", "sensor"), ("obstacles", "obstacle")]
)
def test_layers_of_the_map_can_be_hidden(page, layer, colour):
    before = pixels(page, colour)
    click(page, f'.map-panel [data-layer="{layer}"]')
    assert pixels(page, colour) < before / 2
    click(page, f'.map-panel [data-layer="{layer}"]')
    assert pixels(page, colour) == before


def test_map_and_histogram_tell_the_same(page):
    counts = page.run(
        """shown('.histogram tr').map(({ cells }) =>
        [Number(cells[0].textContent), Number(cells[2].textContent.replace(',', ''))])"""
    )
    assert sum(count for _, count in counts) == TARGETS
    for layer in ("candidates", "sensors", "obstacles", "edges"):
        click(page, f'.map-panel [data-layer="{layer}"]')
    areas = [pixels(page, f"seen-{times}") for times, _ in counts if times < 4]
    shares = [count / TARGETS for times, count in counts if times < 4]
    for area, share in zip(areas, shares, strict=True):
        assert area / sum(areas) == pytest.approx(share, abs=0.12)


def test_targets_are_coloured_by_time_in_sight_where_there_is_traffic(page):
    by = "shown('[data-targets-by]').map(({ value }) => value)"
    assert page.run(by) == []
    click(page, '[data-choose-plan="vlp-16"]')
    assert page.run(by) == ["sensors"]
    page.run("choose('[data-targets-by]', 'sight')")
    counts = page.run(
        "shown('.histogram tr').map(({ cells }) => Number(cells[1].textContent.replace(',', '')))"
    )
    assert sum(counts) == TARGETS
    assert min(counts) > 0
    for layer in ("candidates", "sensors", "obstacles", "edges"):
        click(page, f'.map-panel [data-layer="{layer}"]')
    areas = [pixels(page, f"seen-{number}") for number in range(1, 5)]
    for area, count in zip(areas, counts[1:], strict=True):
        assert area / sum(areas) == pytest.approx(count / sum(counts[1:]), abs=0.05)
    click(page, f'[data-choose-plan="{list(PLANS)[1]}"]')
    assert page.run("shown('[data-targets-legend=\"sight\"]').length") == 0
    click(page, '[data-choose-plan="vlp-16"]')
    assert page.run(by) == ["sight"]


def test_tables_follow_the_plan(page):
    click(page, '[data-choose-plan="vlp-16"]')
    shown = page.run("[...new Set(shown('[data-for-plan]').map((e) => e.dataset.forPlan))]")
    assert shown == ["vlp-16"]
    assert page.run("shown('.planbar input:checked')[0].value") == "vlp-16"
    assert page.run("shown('[data-plan-row][aria-current]')[0].dataset.planRow") == "vlp-16"


def test_plans_can_be_chosen_by_keyboard(page):
    page.run("shown('.planbar input')[0].focus(); shown('.planbar input')[0].click()")
    arrow = {"key": "ArrowRight", "code": "ArrowRight", "windowsVirtualKeyCode": 39}
    for kind in ("keyDown", "keyUp"):
        page.call("Input.dispatchKeyEvent", type=kind, **arrow)
    second = list(PLANS)[1]
    assert page.run("shown('.planbar input:checked')[0].value") == second
    assert page.run("shown('[data-plan-row][aria-current]')[0].dataset.planRow") == second


def test_sensor_shows_what_it_sees(page):
    click(page, '[data-choose-plan="vlp-16"]')
    before = pixels(page, "seen-1")
    click(page, "[data-choose-sensor]", 1)
    assert page.run("shown('[data-selection]')[0].textContent").startswith("Sensor 2: ")
    assert page.run("""shown('[aria-pressed="true"]').length""") == 1
    assert pixels(page, "seen-1") < before
    click(page, "[data-selection] button")
    assert pixels(page, "seen-1") == before


def test_map_moves_by_keyboard_and_mouse(page):
    start = pixels(page, "seen-1")
    page.run("press('+')")
    assert pixels(page, "seen-1") != start
    page.run("press('0')")
    assert pixels(page, "seen-1") == start
    x, y = page.run("middleOf('canvas.map')")
    page.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **MOUSE)
    for shift in (300, -300, 300):
        page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x + shift, y=y, **MOUSE)
    page.call("Input.dispatchMouseEvent", type="mouseReleased", x=x + 300, y=y, **MOUSE)
    assert pixels(page, "seen-1") < start


def test_pointing_tells_what_is_there(page):
    x, y = page.run("middleOf('canvas.map')")
    texts = set()
    for step in range(-120, 121, 6):
        page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y + step)
        texts |= set(page.run("shown('.tooltip').map((e) => e.textContent.split(/[ :]/)[0])"))
    assert {"Target", "Candidate"} <= texts


def test_scene_holds_cloud_targets_and_sensors(page):
    open_scene(page)
    traces = page.run("shown('.scene3d')[0].data.map((trace) => [trace.type, trace.x.length])")
    assert {kind for kind, _ in traces} == {"scatter3d"}
    assert traces[0][1] == 4000
    assert traces[1][1] + traces[2][1] == TARGETS
    assert page.run("heightScale()") == pytest.approx(1)


def test_one_site_is_shown_at_a_time(page):
    open_scene(page)
    click(page, ".site-link", 1)
    page.until("shown('.site').map((e) => e.id).join() === 'site-1'")
    assert page.run("document.querySelectorAll('#site-0 .scene3d canvas').length") == 0
    page.until("Object.keys(colours()).length > 5")
    assert page.run("shown('[data-choose-plan], .planbar').length") == 0


def test_page_fits_its_window_and_controls_have_names(page):
    root = "document.documentElement"
    assert page.run(f"{root}.scrollWidth - {root}.clientWidth") <= 0
    assert page.run("unnamedControls()") == []


def unscripted(browser, report, tmp_path, within=""):
    """Headings that are seen where no script runs."""
    text = report.read_text(encoding="utf-8")
    bare = tmp_path / "bare.html"
    bare.write_text(re.sub(r"<script>.*?</script>", "", text, flags=re.S), encoding="utf-8")
    browser.open(bare.as_uri())
    return browser.run(
        f"[...document.querySelectorAll('{within} h2')].filter((e) => e.checkVisibility())"
        ".map((e) => e.textContent)"
    )


def test_page_reads_without_scripts(browser, report, tmp_path):
    headings = unscripted(browser, report, tmp_path)
    for title, _ in PLANS.values():
        assert f"Chosen sensors {title}" in headings


def pressed(page, x, y):
    for kind in ("mousePressed", "mouseReleased"):
        page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **MOUSE)


def said(page):
    """What the line below the map says."""
    page.run("drawn()")
    found = page.run("shown('[data-coordinates]')[0].textContent")
    return found.replace("\u00a0", " ")


def test_the_background_of_the_map_can_be_chosen(page):
    names = page.run("[...shown('[data-below]')[0].options].map((o) => o.value)")
    assert names == ["relief", "colour", "intensity", "height", "plain"]
    picture = "shown('canvas.map')[0].toDataURL()"
    looks = set()
    for name in names:
        page.run(
            f"(() => {{ const s = shown('[data-below]')[0]; s.value = '{name}';"
            " s.dispatchEvent(new Event('change', { bubbles: true })); })()"
        )
        page.run("drawn()")
        looks.add(page.run(picture))
    assert len(looks) == len(names)


def test_an_orthophoto_is_the_first_background(browser, tmp_path):
    site = ReportSite(tmp_path, "photo", placed=False, truth=False)
    picture = photo(site.path("photo.tif"), site.frame, epsg=25832)
    assert write_site_page.main([*site.arguments, "--orthophoto", str(picture)]) == 0
    out = tmp_path / "report.html"
    assert write_report.main(["--pages", str(site.path("page.json")), "--out", str(out)]) == 0
    page = opened(browser, out)
    assert page.run("shown('[data-below]')[0].value") == "orthophoto"
    reddish = "Object.entries(colours()).filter(([key]) => { const [r, g, b] ="
    reddish += " key.split(',').map(Number); return r > 150 && g < 60 && b < 60; })"
    page.until(f"{reddish}.reduce((sum, [, count]) => sum + count, 0) > 2000")
    page.run("choose('[data-below]', 'relief')")
    page.run("drawn()")
    assert page.run(f"{reddish}.length") == 0


def test_the_ruler_measures_as_the_map_is_scaled(page):
    click(page, '[data-map="measure"]')
    assert page.run("shown('[data-map=\"measure\"]')[0].getAttribute('aria-pressed')") == "true"
    x, y = page.run("middleOf('canvas.map')")
    lengths = []
    for right in (60, 120):
        pressed(page, x - 60, y)
        pressed(page, x - 60 + right, y)
        lengths.append(float(re.match(r"[\d.,]+", said(page)).group().replace(",", "")))
        page.run("press('Escape')")
    assert lengths[0] > 0
    assert lengths[1] == pytest.approx(2 * lengths[0], abs=0.02)
    page.run("press('Escape')")
    assert said(page).startswith("E ")


def test_coordinates_are_native_ones_and_lead_to_an_online_map(page):
    x, y = page.run("middleOf('canvas.map')")
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    east, north = (
        float(value.replace(",", ""))
        for value in re.match(r"E ([\d,.]+), N ([\d,.]+)", said(page)).groups()
    )
    rows = page.run(
        "shown('[data-sensor-row]').map((row) => [...row.cells].slice(9, 11)"
        ".map((cell) => Number(cell.textContent.replaceAll(',', ''))))"
    )
    assert min(abs(e - east) + abs(n - north) for e, n in rows) < 200
    address = page.run("shown('.map-status a')[0].href")
    lat, lon = (float(v) for v in re.search(r"mlat=([-\d.]+)&mlon=([-\d.]+)", address).groups())
    told = [float(v) for v in re.findall(r"([\d.]+)°", said(page))]
    assert told == pytest.approx([lat, lon], abs=2e-6)
    assert [a for a in page.requests if not a.startswith("data:")] == [page.run("location.href")]


def test_a_site_without_crs_has_no_online_map(page):
    click(page, ".site-link", 1)
    page.until("Object.keys(colours()).length > 5")
    assert said(page).startswith("x ")
    assert page.run("shown('.map-status a').length") == 0


def test_typed_prices_cost_the_plans(page):
    page.run("shown('.prices summary')[0].click()")
    assert page.run("shown('[data-plan-price]').length") == 0
    page.run(
        "shown('[data-price]').forEach((input, i) => { input.value = 1000 * (i + 1);"
        " input.dispatchEvent(new Event('input', { bubbles: true })); })"
    )
    prices = page.run("shown('[data-price]').map((i) => [i.dataset.price, i.valueAsNumber])")
    shown = page.run(
        "shown('td[data-plan-price]').map((c) => [c.dataset.planPrice, c.textContent])"
    )
    assert len(shown) == len(PLANS)
    for name, text in shown:
        click(page, f'[data-choose-plan="{name}"]')
        models = page.run(
            "shown('[data-sensor-row]').map((row) => row.cells[1].firstChild.textContent)"
        )
        cost = sum(dict(prices)[model] for model in models)
        assert int(text.replace(",", "")) == cost


def test_a_chosen_row_lies_in_the_map(page):
    click(page, '[data-choose-plan="vlp-16"]')
    for number in (0, 1):
        for _ in range(12):  # so near that no other sensor is in view
            page.run("press('+')")
        click(page, "[data-choose-sensor]", number)
        assert pixels(page, "accent") > 100


@pytest.mark.parametrize("section", ["gaps", "scene"])
def test_rows_of_places_and_lines_are_marked_on_the_map(page, section):
    row = f'[id$="-{section}"] button[aria-pressed]'
    before, home = pixels(page, "accent"), page.run("shown('.map-status a')[0].href")
    click(page, row)
    page.until("shown('.map-status a')[0].href !== " + repr(home))
    assert pixels(page, "accent") > before + 50
    page.until("shown('canvas.map')[0].getBoundingClientRect().top >= 0")
    assert page.run(f"shown('{row}').map((b) => b.ariaPressed)").count("true") == 1
    click(page, row)
    assert pixels(page, "accent") == before
    assert page.run(f"shown('{row}').map((b) => b.ariaPressed)").count("true") == 0


def test_the_online_map_is_that_of_the_chosen_row(page):
    rows = page.run(
        "shown('[id$=\"-gaps\"] tr:has([data-show-place])').map((row) =>"
        " [...row.cells].slice(1, 3).map((cell) => Number(cell.textContent.replaceAll(',', ''))))"
    )
    click(page, '[id$="-gaps"] [data-show-place]')
    address = page.run("shown('.map-status a')[0].href")
    lat, lon = (float(v) for v in re.search(r"mlat=([-\d.]+)&mlon=([-\d.]+)", address).groups())
    to_wgs84 = Transformer.from_crs("EPSG:25832", "EPSG:4326", always_xy=True)
    assert to_wgs84.transform(*rows[0]) == pytest.approx((lon, lat), abs=2e-6)


def test_sheets_of_the_printed_page_say_what_they_are(page):
    printed = page.call("Page.printToPDF", preferCSSPageSize=True, printBackground=True)
    reader = PdfReader(io.BytesIO(base64.b64decode(printed["data"])))
    title = page.run("document.querySelector('.site:not([hidden]) h1').textContent")
    assert len(reader.pages) > 2
    for number, sheet in enumerate(reader.pages, start=1):
        text = sheet.extract_text().replace("\n", " ")
        assert text.count(title) >= 1 and f"{number} / {len(reader.pages)}" in text
        assert "roadsight 1.2" in text and "commit" in text


def test_paper_is_light_and_maps_keep_their_shape(browser, report):
    browser.set_theme(dark=True)
    page = opened(browser, report)
    dark = page.run("colours()")
    page.run("window.dispatchEvent(new Event('beforeprint'))")
    assert page.run("getComputedStyle(document.documentElement).getPropertyValue('--ground')") != ""
    assert page.run("colours()") != dark
    dark_screen = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    browser.call("Emulation.setEmulatedMedia", media="print", **dark_screen)
    shape = page.run(
        "(() => { const m = shown('canvas.map')[0]; const box = m.getBoundingClientRect();"
        " return [m.width / m.height, box.width / box.height,"
        " getComputedStyle(m).objectFit]; })()"
    )
    assert shape[2] == "contain" or shape[0] == pytest.approx(shape[1], rel=0.02)
    assert page.run("document.querySelector('.site:not([hidden]) .still')?.src.length ?? 0") > 1000
    browser.call("Emulation.setEmulatedMedia", media="", **dark_screen)
    page.run("window.dispatchEvent(new Event('afterprint'))")
    page.run("drawn()")
    assert page.run("colours()") == dark
    browser.set_theme(dark=False)


def test_a_phone_scrolls_past_the_map(browser, report):
    size = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": False}
    browser.call("Emulation.setDeviceMetricsOverride", **size)
    page = opened(browser, report)
    root = "document.documentElement"
    assert page.run(f"{root}.scrollWidth - {root}.clientWidth") <= 0
    assert page.run("getComputedStyle(shown('canvas.map')[0]).touchAction") == "pan-y"
    ends = page.run("shown('td.value').map((cell) => cell.getBoundingClientRect().right)")
    assert ends and max(ends) <= 390
    heights = page.run("['.map-stage', '.map-status'].map((s) => shown(s)[0].clientHeight)")
    assert heights[0] <= 590 and heights[1] <= 45
    order = page.run(
        "['.card:nth-child(3)', '.sketch-link', '.cautions', '.card:nth-child(4)']"
        ".map((s) => shown('.first ' + s)[0].getBoundingClientRect().top)"
    )
    assert order == sorted(order)
    open_scene(page)
    for finger in (1, 2):
        page.run("shown('.scene3d')[0].scrollIntoView({ behavior: 'instant', block: 'center' })")
        touched = page.run(f"touch('.scene3d canvas', {finger})")
        assert touched == (finger == 2)  # whether the view, and not the page, gets the touch
    size |= {"width": 1280, "height": 720}
    browser.call("Emulation.setDeviceMetricsOverride", **size)
