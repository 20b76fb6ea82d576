import re

import pytest

from roadsight.io.records.atomic import write_json
from roadsight.io.records.run_records import run_record
from roadsight.report.document import FILES, result_files, size_text
from roadsight.stages.evidence import write_report, write_site_page
from tests.helpers.report_site import ReportSite


@pytest.mark.parametrize(
    ("size", "text"),
    [(0, "0 bytes"), (999, "999 bytes"), (1000, "1.0 kB"), (12_345_678, "12 MB"), (2e9, "2.0 GB")],
)
def test_sizes(size, text):
    assert size_text(size) == text


def test_only_files_that_are_there_in_the_order_of_kinds(tmp_path):
    for name in ("summary.json", "report.pdf", "placement/b/solution.gpkg", "gis/a.qgs"):
        path = tmp_path / "bend" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x" * 2000)
    found = result_files(tmp_path, "bend")
    assert [file.path for file in found] == [
        "bend/report.pdf",
        "bend/gis/a.qgs",
        "bend/placement/b/solution.gpkg",
        "bend/summary.json",
    ]
    assert {file.size for file in found} == {"2.0 kB"}
    assert len({pattern for pattern, *_ in FILES}) == len(FILES)


def test_the_report_names_its_run_and_its_files(tmp_path, monkeypatch):
    site = ReportSite(tmp_path, "tiny")
    assert write_site_page.main(site.arguments) == 0
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    run = site.path("run.json")
    write_json(run, {"site": "tiny"} | run_record([], "1.2").to_dict())
    monkeypatch.delenv("SOURCE_DATE_EPOCH")
    out = tmp_path / "report.html"
    arguments = ["--pages", str(site.path("page.json")), "--runs", str(run), "--out", str(out)]
    assert write_report.main(arguments) == 0
    html = out.read_text(encoding="utf-8")
    assert "1970-01-02" in html and "roadsight 1.2" in html and "numpy" in html
    assert re.search(r"<code>tiny/scene/dem.tif</code>", html)
