import os
import re
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pypdf import PdfReader

from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.run_records import RunRecord, run_record
from roadsight.report.packing import pack, pack_points, unpack, unpack_points
from roadsight.report.printed import paper_content, still, view_of
from roadsight.report.printed_map import (
    HATCH,
    HATCH_COLOUR,
    SCALES,
    Drawing,
    fit,
    legend,
    plan_map,
    times_seen,
)
from roadsight.stages.evidence import write_pdf, write_poles_page, write_site_page
from tests.helpers.report_poles import PolesSite
from tests.helpers.report_site import ReportSite

finite = st.floats(-1e5, 1e5, allow_nan=False)
length = st.floats(0.5, 2e4, allow_nan=False)


@given(finite, finite, length, length, st.floats(20, 400), st.floats(20, 400))
def test_the_largest_usual_scale_that_fits(west, south, wide, high, width_mm, height_mm):
    paper = fit((west, south, west + wide, south + high), width_mm, height_mm)
    assert paper.width_mm <= width_mm * (1 + 1e-9)
    assert paper.height_mm <= height_mm * (1 + 1e-9)
    assert paper.scale in SCALES or paper.scale % SCALES[-1] == 0
    larger = [scale for scale in SCALES if scale < paper.scale]
    if paper.scale in SCALES and larger:
        shown = 1000 / larger[-1]
        assert wide * shown > width_mm * (1 - 1e-9) or high * shown > height_mm * (1 - 1e-9)


@given(length, length, st.lists(st.tuples(finite, finite), min_size=2, max_size=6))
def test_distances_on_paper_are_those_of_the_world(wide, high, places):
    paper = fit((0, 0, wide, high), 160, 190)
    xy = np.array(places)
    on_paper = paper.millimetres(xy)
    for (a, b), (p, q) in zip(pairwise(xy), pairwise(on_paper), strict=True):
        shown = np.hypot(*(q - p)) * paper.scale / 1000
        assert shown == pytest.approx(np.hypot(*(b - a)), rel=1e-9, abs=1e-6)


def test_a_point_has_a_map():
    paper = fit((3, 4, 3, 4), 100, 100)
    assert paper.west_m < 3 < paper.east_m
    assert np.isfinite(paper.millimetres(np.array([[3, 4]]))).all()


def test_marks_stay_round_and_the_bar_is_true():
    paper = fit((0, 0, 400, 120), 160, 190)
    drawing = Drawing(paper)
    drawing.dots(np.array([[10.0, 10.0]]), 2, 'fill="red"')
    svg = drawing.svg((500_000.0, 5_400_000.0), 1.0)
    assert "<ellipse" not in svg
    width, height = (
        float(v) for v in re.search(r'width="([\d.]+)mm" height="([\d.]+)mm"', svg).groups()
    )
    box = [float(v) for v in re.search(r'viewBox="([^"]+)"', svg)[1].split()]
    assert box[2:] == pytest.approx([width, height])
    length_m = int(re.search(r">(\d+) m, ", svg)[1])
    parts = re.findall(r'<rect x="([\d.]+)" y="[\d.]+" width="([\d.]+)" height="1.4"', svg)
    drawn = float(parts[-1][0]) + float(parts[-1][1])
    assert drawn == pytest.approx(length_m * 1000 / paper.scale, abs=0.02)


@pytest.mark.parametrize("unit_m", [1.0, 0.3048006096])
def test_ticks_stand_at_whole_native_coordinates(unit_m):
    paper = fit((-20, -10, 300, 200), 160, 190)
    svg = Drawing(paper).svg((1_000_123.4, 2_000_456.7), unit_m)
    ticks = re.findall(r'<text x="([\d.-]+)" y="-2.00"[^>]*>(\d+)</text>', svg)
    assert len(ticks) > 1
    for x_mm, text in ticks:
        local_m = (int(text) - 1_000_123.4) * unit_m
        assert float(x_mm) == pytest.approx(paper.millimetres([[local_m, 0]])[0, 0], abs=0.01)


def test_a_still_shows_all_points_and_every_sensor():
    rng = np.random.default_rng(1)
    xyz = rng.uniform((0, 0, 0), (200, 30, 2), (5000, 3))
    pixels, depth = view_of(xyz).project(xyz)
    assert (depth > 0).all()
    assert (pixels >= -1).all() and (pixels <= (1801, 901)).all()
    colours = np.full((len(xyz), 3), 90, np.uint8)
    sensors = np.array([[20.0, 15.0, 6.0], [150.0, 15.0, 6.0]])
    picture = still(xyz, colours, sensors, sensors - (0, 0, 6))
    assert picture == still(xyz, colours, sensors, sensors - (0, 0, 6))
    assert picture != still(xyz, colours, sensors[:1], sensors[:1] - (0, 0, 6))


def test_near_points_hide_far_ones():
    far = np.array([[0.0, 50.0, 0.0]])
    flat = np.array([[x, y, 0.0] for x in (-40.0, 40.0) for y in (0.0, 60.0)])
    view = view_of(np.vstack([flat, far]))
    between = (view.eye_m + far[0]) / 2
    xyz = np.vstack([flat, far, between[None]])
    colours = np.array([[0, 0, 0]] * 4 + [[255, 0, 0], [0, 255, 0]], np.uint8)
    none = np.empty((0, 3))
    for order in (np.arange(6), np.arange(6)[::-1]):
        data = np.frombuffer(still(xyz[order], colours[order], none, none), np.uint8)
        picture = cv2.imdecode(data, cv2.IMREAD_COLOR)
        assert (picture == (0, 255, 0)).all(axis=2).any()


@given(st.lists(st.integers(0, 2**32 - 1), max_size=20))
def test_unpacking_undoes_packing(values):
    assert unpack(pack(values, "u4")).tolist() == values


def test_unpacked_points_are_within_half_a_step():
    xyz = np.random.default_rng(2).uniform(-100, 300, (50, 3))
    packed = pack_points(xyz)
    assert np.abs(unpack_points(packed) - xyz).max() <= max(packed["step_m"]) / 2 + 1e-9


class TestRunRecord:
    def test_sums_and_times_of_the_steps(self, tmp_path, monkeypatch):
        head = "s\th:m:s\tmax_rss\tcpu_time\n"
        (tmp_path / "a.tsv").write_text(head + "2.0\t0:00:02\t300\t1.5\n")
        (tmp_path / "deep").mkdir()
        (tmp_path / "deep" / "b.tsv").write_text(head + "4.0\t0:00:04\t-\tNA\n")
        os.utime(tmp_path / "a.tsv", (86402, 86402))
        os.utime(tmp_path / "deep" / "b.tsv", (86470, 86470))
        (tmp_path / "deep" / "of a former run.tsv").write_text(head + "9.0\t0:00:09\t9\t9.0\n")
        os.utime(tmp_path / "deep" / "of a former run.tsv", (500, 500))
        monkeypatch.setenv("SOURCE_DATE_EPOCH", "90000")
        record = run_record([tmp_path, tmp_path / "none"], "1.2")
        assert (record.cpu_s, record.wall_s, record.peak_mib, record.steps) == (1.5, 6.0, 300.0, 2)
        assert (record.started, record.date) == ("1970-01-02T00:00:00", "1970-01-02")
        assert record.elapsed_s == 3600
        assert ["First step to last", "1970-01-02 00:00 to 1970-01-02 01:00 UTC, 1 h 0 min"] in (
            record.rows()
        )
        assert record.version == "1.2" and "commit" in record.line()
        assert RunRecord.from_dict({"site": "a", **record.to_dict()}) == record
        assert "numpy" in record.packages and "pytest" not in record.packages


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper")
    site = ReportSite(folder, "tiny", hidden=0.1, unproven=("vlp-16",))
    bare = ReportSite(folder, "bare", placed=False, crs=None, coloured=False, truth=False)
    poles = PolesSite(folder, "valley", length_m=176.0, poles=6, points=500)
    assert write_site_page.main(site.arguments) == 0
    assert write_site_page.main(bare.arguments) == 0
    assert write_poles_page.main(poles.poles_arguments) == 0
    write_json(folder / "run.json", run_record([], "1.2").to_dict())
    places = {"page": site.path("page.json"), "bare": bare.path("page.json")}
    places["run"] = folder / "run.json"
    return places | {"poles-page": poles.poles_page}


def printed(pages, out, *names):
    arguments = [text for name in names for text in (f"--{name}", str(pages[name]))]
    assert write_pdf.main([*arguments, "--out", str(out)]) == 0
    return PdfReader(out)


def test_each_sheet_says_site_version_and_its_number(pages, tmp_path):
    reader = printed(pages, tmp_path / "report.pdf", "page", "run")
    texts = [sheet.extract_text() for sheet in reader.pages]
    title = read_json(pages["page"])["title"]
    for number, text in enumerate(texts, start=1):
        assert title in text
        assert "roadsight 1.2 · commit" in text
        assert f"{number} / {len(texts)}" in text.replace("\n", " ")


def test_every_plan_and_setting_is_there(pages, tmp_path):
    page = read_json(pages["page"])
    reader = printed(pages, tmp_path / "report.pdf", "page")
    text = " ".join(sheet.extract_text() for sheet in reader.pages)
    for plan in page["plans"]:
        assert text.count(plan["title"]) >= 2
        for sensor in plan["sensors"]:
            assert f"{sensor['native'][0]:.2f}" in text
    for digest in page["summary"]["inputs"].values():
        assert digest[:16] in text.replace("\n", "").replace(" ", "")
    for caution in page["cautions"]:
        assert caution["text"].split(".")[0][:20] in text.replace("\n", " ")


def test_what_both_jobs_say_is_printed_once(pages, tmp_path):
    page, poles_page = read_json(pages["page"]), read_json(pages["poles-page"])
    said = {"level": "warning", "text": "The ground is noisy."}
    both = {"page": page, "poles-page": poles_page}
    for name, content in both.items():
        content["cautions"].insert(0, said)
        write_json(tmp_path / f"{name}.json", content)
    found = {name: tmp_path / f"{name}.json" for name in both}
    reader = printed(found, tmp_path / "both.pdf", *both)
    text = " ".join(sheet.extract_text() for sheet in reader.pages)
    assert text.count(said["text"]) == 1


def test_poles_alone(pages, tmp_path):
    reader = printed(pages, tmp_path / "poles.pdf", "poles-page")
    text = " ".join(sheet.extract_text() for sheet in reader.pages)
    for pole in read_json(pages["poles-page"])["layers"]["poles"]:
        assert pole["id"] in text


def test_a_site_without_plans_or_crs(pages, tmp_path):
    reader = printed({"page": pages["bare"]}, tmp_path / "bare.pdf", "page")
    assert "Ground, pavement and road edges" in reader.pages[0].extract_text()


def test_markup_in_names_is_only_text(pages, tmp_path):
    page = read_json(pages["page"])
    page["title"] = '#panic("x") $ _a_ <b> \\'
    pages = {"page": tmp_path / "page.json"}
    write_json(pages["page"], page)
    reader = printed(pages, tmp_path / "report.pdf", "page")
    assert '#panic("x")' in reader.pages[0].extract_text().replace("”", '"').replace("“", '"')


def test_the_map_counts_what_the_page_holds(pages):
    page = read_json(pages["page"])
    plan = next(plan for plan in page["plans"] if plan["sensors"])
    counts = times_seen(plan, len(page["layers"]["targets"]["names"]))
    assert np.bincount(counts, minlength=2)[0] == len(counts) - np.count_nonzero(counts)
    svg = plan_map(page, plan, 160, 190)
    assert svg.count('r="2"') == len(plan["sensors"])


def test_crowded_marks_keep_their_numbers_legible():
    drawing = Drawing(fit((0, 0, 100, 100), 100, 100))
    xy = np.column_stack([np.arange(0.0, 60.0, 2.0), np.zeros(30)])
    drawing.numbered(xy, [str(number) for number in range(1, 31)], "#000000")
    svg = "".join(drawing.parts)
    places = [float(x) for x in re.findall(r'<circle cx="([\d.]+)" cy="[\d.]+" r="2"', svg)]
    assert svg.count("<circle") == 30 and 10 < len(places) < 30
    assert min(b - a for a, b in pairwise(sorted(places))) >= 3.4
    assert svg.count("<text") == len(places)


def test_the_legend_holds_what_the_map_draws(pages):
    page = read_json(pages["page"])
    edges = page["layers"]["edges"]
    page["layers"]["edges"] = [edges[0] | {"kind": "median", "source": "digitised"}, *edges]
    page["layers"]["unexamined"] = page["layers"]["pavement"]
    keys = legend(page)
    svg = plan_map(page, page["plans"][0], 160, 190)
    for kind, colour, name in keys:
        assert name and colour in svg, kind
    assert ["hatch", HATCH_COLOUR, "pavement not examined"] in keys
    assert f'fill="url(#{HATCH})"' in svg
    assert ["line", "#8a6d1f", "median"] in keys
    page["layers"]["unexamined"] = []
    assert f'fill="url(#{HATCH})"' not in plan_map(page, page["plans"][0], 160, 190)


def test_costs_are_printed_where_they_tell_something(pages, tmp_path):
    page = read_json(pages["page"])
    for sensor in page["sensors"].values():
        sensor["cost"] = 1
    for plan in page["plans"]:
        plan["objective"] = len(plan["sensors"])
    content, _ = paper_content(page, None, None)
    assert "Cost" not in content["columns"]
    assert all(len(row) == len(content["columns"]) for row in content["compared"])
    assert not any("cost" in plan["line"] for plan in content["plans"])
    page["plans"][0]["objective"] += 1
    page["plans"][0]["sensors"][0] |= {"pitch_deg": -15.0, "roll_deg": 0.0}
    content, _ = paper_content(page, None, None)
    assert "Cost" in content["columns"]
    faces = {plan["title"]: plan["sensors"][0][4] for plan in content["plans"]}
    assert faces[page["plans"][0]["title"]].endswith("15° down")
    assert all(plan["verdict"][0].isupper() for plan in content["plans"])
