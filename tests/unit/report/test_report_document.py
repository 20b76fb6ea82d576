import base64
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from roadsight.io.records.atomic import read_json, write_json
from roadsight.report.document import css_text, embedded
from roadsight.stages.evidence import write_report, write_site_page
from tests.helpers.report_site import PLANS, ReportSite

TITLE = 'Route <script>alert(1)</script> & "quotes"'


@pytest.fixture(scope="module")
def sites(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sites")
    return [
        ReportSite(folder, "tiny", hidden=0.1, unproven=("vlp-16",), title=TITLE),
        ReportSite(folder, "bare", placed=False, crs=None, coloured=False, truth=False),
    ]


@pytest.fixture(scope="module")
def pages(sites):
    for site in sites:
        assert write_site_page.main(site.arguments) == 0
    return [site.path("page.json") for site in sites]


@pytest.fixture(scope="module")
def html(pages, tmp_path_factory):
    out = tmp_path_factory.mktemp("report") / "report.html"
    assert write_report.main(["--pages", *map(str, pages), "--out", str(out)]) == 0
    return out.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def tiny(pages):
    return read_json(pages[0])


class Elements(HTMLParser):
    """Tags with their attributes, and all text outside scripts and styles."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.texts, self.silent = [], [], 0
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        self.silent += tag in ("script", "style")

    def handle_endtag(self, tag):
        self.silent -= tag in ("script", "style")

    def handle_data(self, data):
        if not self.silent:
            self.texts.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.texts).split())


@pytest.fixture(scope="module")
def elements(html):
    return Elements(html)


def effect(decision, **about):
    """A decision of summary.json."""
    plain = {"job": "placement", "quantity": "size", "value": 1.0, "unit": "m", "threshold": 0.5}
    figures = {"expected_change": 0.1, "expected_seconds": 3.0, "reason": "it is so"}
    return plain | figures | {"decision": decision} | about


def rendered(page, folder):
    """Visible text of the report of one page."""
    write_json(folder / "given.json", page)
    out = folder / "report.html"
    assert write_report.main(["--pages", str(folder / "given.json"), "--out", str(out)]) == 0
    return Elements(out.read_text(encoding="utf-8")).text


class TestPage:
    def test_same_artifacts_give_the_same_bytes(self, sites, pages, tmp_path):
        again = tmp_path / "page.json"
        arguments = [str(again) if a == str(pages[0]) else a for a in sites[0].arguments]
        assert write_site_page.main(arguments) == 0
        assert again.read_bytes() == pages[0].read_bytes()

    def test_plans_agree_with_their_solutions(self, sites, tiny):
        assert [plan["name"] for plan in tiny["plans"]] == list(PLANS)
        for plan in tiny["plans"]:
            solution = sites[0].solutions[plan["name"]]
            assert len(plan["gaps"]) == solution["uncoverable_targets"] > 0
            assert plan["proven"] == (plan["name"] != "vlp-16")
            for shown, given in zip(plan["sensors"], solution["sensors"], strict=True):
                keys = ("candidate", "sensor", "targets", "only", "height_m")
                assert [shown[key] for key in keys] == [given[key] for key in keys]
                assert shown["native"] == pytest.approx(given["native"], abs=1e-3)

    def test_histogram_counts_every_target_once(self, tiny):
        for plan in tiny["plans"]:
            assert (
                sum(plan["histogram"]) == plan["targets"] == len(tiny["layers"]["targets"]["names"])
            )
            assert plan["histogram"][0] == len(plan["gaps"])

    def test_positions_lie_on_earth_where_the_site_is(self, tiny):
        lon, lat = tiny["plans"][0]["sensors"][0]["lon_lat_deg"]
        assert 8.4 < lon < 8.5
        assert 48.9 < lat < 49.1

    def test_simulated_returns_name_their_sensor(self, tiny):
        for plan in tiny["plans"]:
            data = base64.b64decode(plan["returns"]["sensor"]["data"])
            numbers = np.frombuffer(data, "<u2")
            assert set(numbers.tolist()) == set(range(len(plan["sensors"])))

    def test_cloud_is_all_there_when_small(self, tiny):
        cloud = tiny["layers"]["cloud"]
        assert cloud["total"] == cloud["xyz"]["count"] // 3 == 4000
        assert cloud["colour"]["count"] == 3 * 4000

    def test_only_sensors_of_the_detections_are_listed(self, tiny):
        assert list(tiny["sensors"]) == sorted(["VLP-16", "VLP-32C", "OS1-32", "OS1-64", "OS1-128"])

    def test_scene_alone(self, pages):
        page = read_json(pages[1])
        assert page["plans"] == []
        assert set(page["layers"]) == {"cloud", "relief", "pavement", "edges", "below"}
        assert page["layers"]["cloud"]["colour"] is None

    def test_solution_of_an_unknown_plan_is_refused(self, sites, tmp_path, capsys):
        arguments = ["vlp=x" if a.startswith("vlp-16=") else a for a in sites[0].arguments]
        arguments[arguments.index(str(sites[0].path("page.json")))] = str(tmp_path / "p.json")
        assert write_site_page.main(arguments) == 2
        assert "unknown plan; found vlp-16" in capsys.readouterr().err
        assert not (tmp_path / "p.json").exists()


class TestReport:
    def test_same_pages_give_the_same_bytes(self, pages, html, tmp_path):
        out = tmp_path / "again.html"
        write_report.main(["--pages", *map(str, pages), "--out", str(out)])
        assert out.read_text(encoding="utf-8") == html

    def test_nothing_is_loaded_from_elsewhere(self, elements):
        for tag, attributes in elements.tags:
            assert tag not in ("link", "iframe", "img", "object", "embed")
            assert "src" not in attributes
            assert attributes.get("href", "#").startswith("#")
        policy = next(
            a["content"] for t, a in elements.tags if "content" in a and "default" in a["content"]
        )
        assert policy.startswith("default-src 'none'")

    def test_plotly_is_there_once(self, html):
        assert html.count("plotly.js v") == 1

    def test_texts_from_data_are_escaped(self, html, elements):
        assert "<script>alert" not in html
        assert TITLE in elements.text
        assert "clouds/road <1>.laz" in elements.text

    def test_every_anchor_leads_somewhere(self, elements):
        identifiers = [attributes["id"] for _, attributes in elements.tags if "id" in attributes]
        assert len(identifiers) == len(set(identifiers))
        anchors = {a["href"][1:] for tag, a in elements.tags if tag == "a"}
        assert anchors - {"content"} == {
            i for i in identifiers if re.fullmatch(r"site-\d+(-\w+)?", i)
        } - {"site-0-title", "site-1-title"}

    def test_key_texts(self, elements):
        for text in (
            "Deployment plans compared",
            *(title for title, _ in PLANS.values()),
            "Not proven",
            "Proven optimal",
            "VLP-16 only: not proven optimal. The solution costs",
            "All plans: no sensor sees",
            "Targets by number of sensors that see them",
            "Chosen sensors",
            "Latitude",
            "Uncovered targets and obstacles",
            "No candidate sees it: hidden",
            "Targets hidden",
            "87.5",
            "choices for",
            "Pavement against the reference",
            "No reference for the pavement of this site",
            "candidates.spacing_m",
            "0f" * 32,
            "roadsight 0.1.0",
        ):
            assert text in elements.text, text

    def test_every_sensor_has_its_row(self, tiny, elements):
        rows = [a for _, a in elements.tags if "data-choose-sensor" in a]
        assert len(rows) == sum(len(plan["sensors"]) for plan in tiny["plans"])

    def test_controls_have_names(self, html):
        for button in re.findall(r"<button[^>]*>(.*?)</button>", html):
            assert button.strip()
        assert 'aria-label="Cloud colour"' in html

    def test_plan_with_the_fewest_sensors_is_shown_first(self, tiny, elements):
        checked = [
            a["value"]
            for tag, a in elements.tags
            if tag == "input" and "checked" in a and "value" in a
        ]
        fewest = min(tiny["plans"], key=lambda plan: len(plan["sensors"]))
        assert checked == [fewest["name"]]

    def test_data_is_read_back(self, html, tiny):
        blocks = re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', html, re.S)
        assert len(blocks) == 2
        assert json.loads(blocks[0])["plans"] == tiny["plans"]
        assert json.loads(blocks[1])["plans"] == []

    def test_embedded_data_cannot_end_its_script(self):
        text = embedded({"a": "</script><!-- & \u2028"})
        assert not re.search("[<>&]", text)
        assert json.loads(text) == {"a": "</script><!-- & \u2028"}

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"format": "roadsight.page/0"}, "no page of this version"),
            ({}, "two pages of one site"),
        ],
    )
    def test_wrong_pages_are_refused(self, pages, tmp_path, capsys, change, message):
        write_json(tmp_path / "page.json", read_json(pages[1]) | change)
        given = [str(pages[1]), str(tmp_path / "page.json")]
        assert write_report.main(["--pages", *given, "--out", str(tmp_path / "r.html")]) == 2
        assert message in capsys.readouterr().err
        assert not (tmp_path / "r.html").exists()

    def test_plan_without_gaps(self, tmp_path):
        site = ReportSite(tmp_path, "whole")
        assert write_site_page.main(site.arguments) == 0
        text = rendered(read_json(site.path("page.json")), tmp_path)
        assert "None: every target is seen by at least 1 sensor." in text
        assert "no sensor sees" not in text

    def test_two_sensors_asked_for_each_target(self, pages, tmp_path):
        page = read_json(pages[0])
        for plan in page["plans"]:
            plan["at_least"] = 2
        text = rendered(page, tmp_path)
        assert "are seen by fewer than 2 sensors" in text
        assert "seen by at least 2 sensors" in text

    def test_effects_are_tabled(self, pages, tmp_path):
        page = read_json(pages[1])
        page["summary"]["effects"] = {
            "rain": effect("skip", quantity="rate", value=0.0, reason="it is <dry>"),
            "tilt": effect("simulate", threshold=0.02),
        }
        text = rendered(page, tmp_path)
        assert "1 of 2 effects simulated" in text
        assert "it is <dry>" in text
        assert "simulate" in text


@pytest.mark.parametrize("text", ["plain", 'a "b" \\ c', "</style>\n<b>;}", "Łódź · 50 %"])
def test_texts_in_style_sheets_stay_texts(text):
    told = css_text(text)
    assert not set(told) & set('"<>;{}\n%')
    back = re.sub(r"\\([0-9a-f]+) ", lambda found: chr(int(found[1], 16)), told)
    assert back == text
