"""The poles' part of the report in a real browser."""

import re

import pytest

from roadsight.stages.evidence import write_poles_page, write_report, write_site_page
from tests.e2e.chromium import BINARY
from tests.e2e.test_report_page import HELPERS, MOUSE, click, pixels, unscripted
from tests.helpers.report_poles import PolesSite

pytestmark = pytest.mark.skipif(BINARY is None, reason="no Chromium to open the report with")


@pytest.fixture(scope="module")
def sites(tmp_path_factory):
    folder = tmp_path_factory.mktemp("poles")
    return [
        PolesSite(folder, "valley", length_m=200.0, poles=7, points=500),
        PolesSite(folder, "both", length_m=80.0, poles=3, known=0, points=500),
    ]


@pytest.fixture(scope="module")
def report(sites):
    for site in sites:
        assert write_poles_page.main(site.poles_arguments) == 0
    assert write_site_page.main(sites[1].arguments) == 0
    out = sites[0].folder.parent / "report.html"
    scene, *poles = (
        str(p) for p in (sites[1].path("page.json"), *(site.poles_page for site in sites))
    )
    assert write_report.main(["--pages", scene, "--poles-pages", *poles, "--out", str(out)]) == 0
    return out


def opened(browser, report):
    """The report, freshly opened at the site that has poles alone."""
    browser.complaints.clear()
    browser.requests.clear()
    browser.open("about:blank")
    browser.open(f"{report.as_uri()}#site-1-poles")
    browser.run(HELPERS)
    browser.until("shown('canvas.map')[0]?.closest('#site-1')")
    browser.until("Object.keys(colours()).length > 5 && colours()[colourOf('top-road')]")
    browser.until("shown('.strip img').every((e) => e.complete) && shown('.strip img').length")
    return browser


def photo(page, name):
    """How many pixels of the photograph have a colour of the style sheet."""
    return page.run(
        f"""drawn().then(() => {{
        const [canvas] = shown("canvas.photo"), wanted = colourOf("{name}").split(",").map(Number);
        const {{ data }} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        let count = 0;
        for (let i = 0; i < data.length; i += 4) {{
          if (wanted.every((value, n) => data[i + n] === value)) count++;
        }}
        return count;
        }})"""
    )


def centre_of_pole(page, number):
    """Where a pole lies in the window when it alone is chosen and centred on the map."""
    click(page, "summary")
    click(page, "[data-choose-pole]", number)
    x, y = page.run("middleOf('canvas.map')")
    click(page, "[data-pole-text] button")
    return x, y


def test_nothing_goes_wrong_and_nothing_is_requested(page, report):
    for selector in ("[data-poles-layer]", "[data-photo-layer]", "[data-photo]", "[data-sort-by]"):
        for number in range(page.run(f"shown('{selector}').length")):
            click(page, selector, number)
    for button in ("in", "out", "fit"):
        click(page, f'.poles-map ~ .map-buttons [data-map="{button}"]')
    click(page, ".site-link", 0)
    page.run("drawn()")
    click(page, ".site-link", 1)
    assert [text for text in page.complaints if "willReadFrequently" not in text] == []
    outside = {url.partition("#")[0] for url in page.requests if not url.startswith("data:")}
    assert outside <= {report.as_uri()}


def test_theme_follows_the_reader_and_texts_stand_out(themed):
    dark = themed.run("matchMedia('(prefers-color-scheme: dark)').matches")
    assert themed.run("faintTexts()") == []
    text = themed.run("getComputedStyle(shown('.chart text')[0]).fill")
    assert (sum(map(int, re.findall(r"\d+", text)[:3])) > 3 * 128) == dark
    assert pixels(themed, "top-road") > 500


@pytest.mark.parametrize(
    ("layer", "colour"),
    [("poles", "pole"), ("cameras", "camera"), ("lidar", "lidar-edge"), ("raster", "top-road")],
)
def test_layers_of_the_map_can_be_hidden(page, layer, colour):
    for _ in range(3):
        click(page, '.poles-map ~ .map-buttons [data-map="in"]')
    before = pixels(page, colour)
    assert before > 20
    click(page, f'[data-poles-layer="{layer}"]')
    assert pixels(page, colour) < before / 4
    click(page, f'[data-poles-layer="{layer}"]')
    assert pixels(page, colour) == before


def test_sightings_left_out_are_hidden_at_first(page):
    for layer in ("raster", "lidar", "cameras", "poles", "rays"):
        click(page, f'[data-poles-layer="{layer}"]')
    bare = page.run("drawn().then(() => Object.keys(colours()).length)")
    click(page, '[data-poles-layer="dropped"]')
    assert page.run("drawn().then(() => Object.keys(colours()).length)") > bare + 2


def test_pole_of_the_table_tells_its_images(page, sites):
    click(page, "summary")
    click(page, "[data-choose-pole]", 1)
    text = page.run("shown('[data-pole-text]')[0].textContent")
    pole = sites[0].poles.iloc[1]
    assert text.startswith(f"Pole {pole.id}, seen in {pole.score} images")
    assert "m from the known pole" in text
    assert "m from the road edge" in text
    assert page.run("shown('.seen-in li').map((e) => e.textContent)") == pole.images.split(";")
    assert pixels(page, "accent") > 30
    click(page, "[data-pole-text] button")
    assert page.run("shown('[data-pole-text]')[0].textContent").startswith("All poles")


def test_click_on_a_pole_of_the_map(page, sites):
    x, y = centre_of_pole(page, 2)
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    assert page.run("shown('.tooltip')[0].textContent").startswith("Pole p002")
    for kind in ("mousePressed", "mouseReleased"):
        page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **MOUSE)
    page.run("drawn()")
    assert page.run("shown('[data-pole-text]')[0].textContent").startswith("Pole p002")
    page.run("press('Escape')")
    assert page.run("shown('[data-pole-text]')[0].textContent").startswith("All poles")


def test_thumbnail_of_a_pole_shows_its_image(page):
    click(page, "summary")
    click(page, "[data-choose-pole]")
    name = page.run("shown('.seen-in button')[0].textContent")
    click(page, ".seen-in button")
    assert page.run("shown('[data-photo-text]')[0].textContent").startswith(f"{name}: aligned")
    assert photo(page, "photo-chosen") > 30


def test_overlays_of_an_image_can_be_hidden(page):
    accepted = page.run("shown('[data-photo]').findIndex((e) => !e.matches('.rejected'))")
    click(page, "[data-photo]", accepted)
    for layer, colour in (("lidar", "photo-lidar"), ("edges", "photo-image")):
        before = photo(page, colour)
        assert before > 30
        click(page, f'[data-photo-layer="{layer}"]')
        assert photo(page, colour) == 0
        click(page, f'[data-photo-layer="{layer}"]')
        assert photo(page, colour) > 20


def test_rejected_image_says_why(page):
    click(page, ".strip .rejected")
    text = page.run("shown('[data-photo-text]')[0].textContent")
    assert "rejected (no <edges> in the image)" in text
    assert photo(page, "photo-lidar") > 30
    assert photo(page, "photo-image") == 0


def test_images_can_be_browsed_by_keyboard(page):
    names = page.run("shown('[data-photo]').map((e) => e.textContent.trim().split(' ').pop())")

    def arrow(key):
        page.run(f"shown('canvas.photo')[0].dispatchEvent(new KeyboardEvent('keydown', {key}))")
        return page.run("shown('[data-photo-text]')[0].textContent").partition(":")[0]

    assert arrow("{ key: 'ArrowRight' }") == names[1]
    assert arrow("{ key: 'ArrowLeft' }") == names[0]
    assert arrow("{ key: 'ArrowLeft' }") == names[-1]


def test_hazard_table_is_sorted_by_its_headings(page):
    column = page.run("shown('.sortable th').findIndex((e) => e.textContent.startsWith('Offset'))")
    values = f"shown('.sortable tbody tr').map((r) => Number(r.cells[{column}].dataset.value))"
    click(page, f'[data-sort-by="{column}"]')
    assert page.run(values) == sorted(page.run(values))
    click(page, f'[data-sort-by="{column}"]')
    assert page.run(values) == sorted(page.run(values), reverse=True)
    assert page.run("shown('[aria-sort]').length") == 1


def test_cross_sections_are_drawn_and_lead_to_their_pole(page):
    assert page.run("shown('.profiles svg').length") == 3
    texts = page.run("shown('.profiles figure').map((e) => e.textContent)")
    assert all("foreslope 1V:2.5H" in text and "[RDG 3.1]" in text for text in texts)
    click(page, ".profiles [data-choose-pole]")
    assert "hazard: high" in page.run("shown('[data-pole-text]')[0].textContent")


def test_the_map_shows_ratings_where_asked(themed):
    assert pixels(themed, "rated-high") == 0
    click(themed, '[data-poles-layer="rated"]')
    assert pixels(themed, "rated-high") > 20
    assert pixels(themed, "rated-low") > 20
    click(themed, '[data-poles-layer="rated"]')


def test_site_with_both_jobs_has_both_maps(page):
    click(page, ".site-link", 0)
    page.until("shown('canvas.map').length === 2")
    page.until("Object.keys(colours()).length > 3")
    assert page.run("shown('.scene3d').length") == 1


def test_page_fits_its_window_and_controls_have_names(page):
    root = "document.documentElement"
    assert page.run(f"{root}.scrollWidth - {root}.clientWidth") <= 0
    assert page.run("unnamedControls()") == []


def test_page_reads_without_scripts(browser, report, tmp_path):
    headings = unscripted(browser, report, tmp_path, "#site-1")
    assert {"Alignment of the images", "Against known poles", "Roadside hazard"} <= set(headings)
    assert browser.run("document.querySelectorAll('#site-1 .chart').length") >= 8
