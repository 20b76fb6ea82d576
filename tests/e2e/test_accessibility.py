"""No page of the report or the studio has a serious or critical finding of axe-core."""

import pytest
import yaml

from roadsight.evidence.truth_catalogue import AREAS, Figure, truth_rows
from roadsight.report import audit_page, hardcases_page, truth_page
from roadsight.report.files import read_assets
from roadsight.stages.evidence import write_poles_page, write_report, write_site_page
from roadsight_hardcases.case import CaseResult
from roadsight_hardcases.catalogue import all_cases
from tests.conftest import PROJECT
from tests.e2e.accessible import axe, findings
from tests.e2e.studio_page import click, key, open_studio, set_size
from tests.e2e.studio_project import Studio, make_project
from tests.helpers.report_poles import PolesSite
from tests.helpers.report_site import ReportSite
from tests.unit.evidence.test_tradeoffs import TestPage as TradeoffsPage
from tests.unit.report.test_bench_page import ROW
from tests.unit.report.test_bench_page import page as bench_page

pytestmark = pytest.mark.xdist_group("accessibility")
SIZES = {"desk": (1280, 720), "phone": (390, 844)}


@pytest.fixture(scope="module")
def rules():
    return axe()


@pytest.fixture(params=[False, True], ids=["light", "dark"])
def themed(browser, request):
    browser.set_theme(request.param)
    browser.dark = request.param
    yield browser
    browser.set_theme(False)
    set_size(browser, *SIZES["desk"])


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """A report of a placement, a placement with poles, and poles alone."""
    folder = tmp_path_factory.mktemp("report")
    tiny = ReportSite(folder, "tiny", hidden=0.1, unproven=("vlp-16",), traffic=("vlp-16",))
    both = PolesSite(folder, "both", length_m=80.0, poles=3, known=0, points=500)
    valley = PolesSite(folder, "valley", length_m=200.0, poles=7, points=500)
    pages, poles = [], []
    for site in (tiny, both):
        assert write_site_page.main(site.arguments) == 0
        pages.append(str(site.path("page.json")))
    for site in (both, valley):
        assert write_poles_page.main(site.poles_arguments) == 0
        poles.append(str(site.poles_page))
    out = folder / "report.html"
    asked = ["--pages", *pages, "--poles-pages", *poles, "--out", str(out)]
    assert write_report.main(asked) == 0
    return out


@pytest.mark.parametrize("size", SIZES)
def test_the_report(themed, report, rules, size):
    themed.open("about:blank")
    set_size(themed, *SIZES[size])
    themed.open(report.as_uri())
    links = themed.run("[...document.querySelectorAll('.site-link')].map(({ hash }) => hash)")
    assert len(links) == 3
    for link in links:
        themed.run(f"location.hash = {link!r}")
        themed.until(
            "[...document.querySelectorAll('canvas.map')].some((e) => e.checkVisibility())"
        )
        themed.run("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
        assert findings(themed, rules) == [], link


def audit():
    row = {"site": "a", "effect": "rain", "decision": "skip", "quantity": "rain rate"}
    row |= {"value": 1.0, "unit": "mm/h", "threshold": 2.0, "found_with": 3, "found_without": 3}
    row |= {"seen_with": 90, "seen_without": 91, "change": 0.01, "tolerance": 0.02}
    row |= {"right": True, "cpu_seconds": 5.0}
    rows = [row, row | {"effect": "fog", "decision": "simulate", "right": False, "change": 0.3}]
    assets = read_assets((audit_page.TEMPLATE, *audit_page.STYLES))
    return audit_page.render_page(rows, assets, "1.0")


def hardcases():
    first, second = all_cases()[:2]
    results = [CaseResult(first, 1.0, 7.5), CaseResult(second, 10 * second.bound, 0.0)]
    return hardcases_page.render_hardcases(results, read_assets(hardcases_page.ASSETS), "1.0")


def truth():
    name, area = next(iter(AREAS.items()))
    figures = {next(iter(area.datasets)): [Figure(next(iter(area.metrics)), 3.5, 4.5, 0.1)]}
    table = truth_rows(name, area, figures)
    return truth_page.render_truth(table, read_assets(truth_page.ASSETS), "1.0")


@pytest.fixture(params=["audit", "bench", "hardcases", "tradeoffs", "truth"])
def evidence(request, tmp_path, project_root):
    """A page of evidence, written."""
    made = {
        "audit": audit,
        "bench": lambda: bench_page([ROW, ROW | {"ratio": 0.2}]),
        "hardcases": hardcases,
        "tradeoffs": lambda: TradeoffsPage().page(project_root, tmp_path)[1],
        "truth": truth,
    }
    path = tmp_path / "index.html"
    path.write_text(made[request.param](), encoding="utf-8")
    return path


@pytest.fixture
def project_root(monkeypatch):
    monkeypatch.chdir(PROJECT)
    return PROJECT


@pytest.mark.parametrize("size", SIZES)
def test_pages_of_evidence(themed, evidence, rules, size):
    set_size(themed, *SIZES[size])
    themed.open(evidence.as_uri())
    assert findings(themed, rules) == []


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    """A studio whose site tiny has a plan of its own."""
    folder = make_project(tmp_path_factory.mktemp("studio") / "project")
    file = folder / "config/sites/tiny.yaml"
    content = yaml.safe_load(file.read_text())
    mine = {"title": "Mine", "sensors": ["VLP-16"], "on_request": True}
    content["placement"] = {"own_plans": {"mine": mine}}
    file.write_text(yaml.safe_dump(content))
    with Studio(folder, folder.parent / "log") as started:
        yield started


PAGES = {
    "edges/tiny": "studio.page?.view?.settled",
    "results/tiny": "studio.page?.part?.about && studio.page.view.settled",
    "results/drive": "studio.page?.part && studio.page.view.settled",
    "registration/drive": "studio.page",
    "run/tiny": "document.querySelector('[data-do=edit-mine]')",
    "run/empty": "studio.page",
    "registration/tiny": "document.querySelector('main [role=alert]')",
}


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("place", PAGES)
def test_the_studio(themed, studio, rules, place, size):
    page = open_studio(themed, studio, place, PAGES[place])
    show(page, size)
    assert findings(page, rules) == []


DIALOGS = {
    "a plan": ("results/tiny", "[data-do=save-as]"),
    "a cloud": ("edges/tiny", "#add"),
    "keys": ("edges/tiny", "#help"),
    "a question": ("run/tiny", "[data-do=remove-mine]"),
}


@pytest.mark.parametrize("name", DIALOGS)
def test_dialogs_of_the_studio(themed, studio, rules, name):
    place, opener = DIALOGS[name]
    page = open_studio(themed, studio, place, PAGES[place])
    show(page, "desk")
    click(page, opener)
    page.until("document.querySelector('dialog[open]')")
    assert findings(page, rules) == []
    key(page, "Escape")


def test_a_sensor_and_a_note_in_the_studio(themed, studio, rules):
    page = open_studio(themed, studio, "results/tiny", PAGES["results/tiny"])
    show(page, "desk")
    page.run("studio.page.part.choose(0); studio.page.part.toggle(0)")
    click(page, "[data-do=export-csv]")
    page.until("!studio.page.part.turn && document.querySelector('#notes .note')")
    assert findings(page, rules) == []


def show(page, size):
    """Size of the window, and the studio's theme as the browser's."""
    set_size(page, *SIZES[size])
    if page.run("document.documentElement.dataset.theme === 'dark'") != page.dark:
        page.run("document.getElementById('theme').click()")


def test_a_page_with_grave_faults_is_noticed(browser, rules, tmp_path):
    bad = "<html><title>t</title><img src=x.png><p style='color: #aaa'>faint<input>"
    (tmp_path / "bad.html").write_text(bad)
    browser.open((tmp_path / "bad.html").as_uri())
    found = {one[0] for one in findings(browser, rules)}
    assert {"html-has-lang", "image-alt", "color-contrast", "label"} <= found
