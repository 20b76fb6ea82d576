"""Pages that are generated: complete, and honest about what was not measured."""

import ast
import json
import re
from pathlib import Path

import pytest
import yaml

from roadsight.config.schema import Config
from roadsight.config.sites import Site
from scripts.pages import api, decisions, markdown, results, sensors, settings, verbs
from scripts.pages.build import DOCS, PACKAGE
from tests.conftest import PROJECT


def test_every_setting_is_listed_once():
    page = settings.settings_page()
    for name, field in Config.model_fields.items():
        assert f"\n## {name}\n" in page or f"\n| `{name}` |" in page, name
        section = type(field.get_default())
        for key in getattr(section, "model_fields", {}):
            assert f"\n| `{key}` |" in page, f"{name}.{key}"
    for name in Site.model_fields:
        assert f"\n| `{name}` |" in page, name


def test_a_setting_has_type_default_range_unit_and_sentence():
    page = settings.settings_page()
    assert (
        "| `slope` | number | `0.12` | > 0, ≤ 2 |  | slope, rise over run, kept without help"
        " from the ground beside it |" in page
    )
    assert "| `tile_size_m` | number | `50` | > 0, ≤ 1000 | m | side of a storage tile" in page
    assert "| `intensity` | choice | `auto` | `auto`, `use`, `ignore` |" in page
    assert "| `extent.box` | list of number | `null` | 4 entries |" in page


@pytest.mark.parametrize(
    ("key", "description", "unit"),
    [
        ("range_m", "", "m"),
        ("a.hole_m2", "", "m²"),
        ("pulses_per_m2", "", "1/m²"),
        ("rain_mm_h", "", "mm/h"),
        ("min_marking_px", "smaller markings are dropped, px2", "px"),
        ("closing_cells", "gaps up to this, cells", "cells"),
        ("seed", "seed of everything random", ""),
    ],
)
def test_units_come_from_names(key: str, description: str, unit: str):
    assert settings.unit_of(key, description) == unit


def test_all_sensors_are_there_with_what_they_take_over():
    file = PROJECT / "config" / "sensors.yaml"
    page = sensors.sensors_page(file)
    for name in yaml.safe_load(file.read_text("utf-8"))["sensors"]:
        assert f"\n### {name}\n" in page
    assert "### OS1-64-512x20" in page
    slower = page.split("### OS1-64-512x20\n")[1].split("\n### ")[0]
    assert "| `range_m` |" in slower


def test_verbs_say_what_their_help_says():
    page = verbs.verbs_page()
    assert "## roadsight init" in page
    assert "usage: roadsight depthmap" in page


def test_the_index_of_decisions_has_each_of_them():
    page = decisions.decisions_page(DOCS / "decisions")
    assert len(re.findall(r"\n\| \d{3} \|", page)) == len(list((DOCS / "decisions").glob("*.md")))


@pytest.mark.parametrize(
    ("names", "heads", "text"),
    [
        (["001-a.md"], ["# A"], "must begin with"),
        (["001-a.md"], ["# 002 A"], "must begin with"),
        (["001-a.md", "001-b.md"], ["# 001 A", "# 001 B"], "same number: 001"),
    ],
)
def test_a_decision_that_is_numbered_wrongly_stops_the_build(
    tmp_path: Path, names: list[str], heads: list[str], text: str
):
    for name, head in zip(names, heads, strict=True):
        (tmp_path / name).write_text(head)
    with pytest.raises(ValueError, match=text):
        decisions.titles(tmp_path)


def test_every_public_function_of_a_package_is_in_its_page():
    page = api.package_page(PACKAGE / "geometry", PACKAGE)
    for name in ("frames", "cameras", "north"):
        assert f"\n## roadsight.geometry.{name}\n" in page
        tree = ast.parse((PACKAGE / "geometry" / f"{name}.py").read_text("utf-8"))
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name[0] != "_":
                assert f"\n### {node.name}\n" in page


def test_docstrings_of_the_house_become_lists():
    text = "Say it.\n\nParameters\n----------\na : (n, 2)\n    metres. b : one.\nc, d : <two>.\n"
    assert api.prose(text) == (
        "Say it.\n\n**Parameters**\n\n- a : (n, 2) metres. b : one.\n- c, d : &lt;two>.\n\n"
    )


def test_long_signatures_get_a_line_for_each_parameter():
    source = f"def long(a: tuple[int, str], b: str = 'x, y', {'c' * 80}: int = 1) -> None: ..."
    definition = ast.parse(source).body[0]
    assert isinstance(definition, ast.FunctionDef)
    lines = api.signature(definition).split("\n")
    assert lines[1:3] == ["    a: tuple[int, str],", "    b: str='x, y',"]
    assert lines[-1] == ") -> None"


def test_what_looks_like_html_is_text_and_code_stays():
    assert markdown.escaped("a <b> `x<y` *c* $1") == "a &lt;b> `x<y` \\*c\\* \\$1"


def test_results_that_are_not_there_are_said_to_be_missing(tmp_path: Path):
    for text in results.results_pages(tmp_path).values():
        assert "Not measured here" in text
        assert "|" not in text


def test_results_are_those_of_the_files(tmp_path: Path):
    for name in ("tradeoffs", "truth", "bench"):
        (tmp_path / name).mkdir()
    (tmp_path / "tradeoffs" / "tradeoffs.csv").write_text(
        "job,stage,knob,level,cpu_seconds,wall_seconds,peak_mib,metric,value,unit,reference,"
        "error_vs_reference,repeats,is_default,on_frontier\n"
        "placement,solve_cover,cover.gap,5 %,1.5,2,300,sensors,4,count,finest,0,3,False,True\n"
        "placement,solve_cover,cover.gap,0,1.75,2,300,sensors,4,count,finest,0,3,True,False\n"
    )
    (tmp_path / "truth" / "truth.csv").write_text(
        "area,dataset,metric,unit,ours,peer,peer_name,published,goal,cpu_s\n"
        "ground,samp11,total_error,%,7.25,9.1,SMRF,,,1.5\n"
        "ground,mean,total_error,%,3.4,4.4,SMRF,,<4.4,1.5\n"
        "ground,samp12,missing,,,,,,,\n"
        "cover,sc_157_0,over_best_known,%,0,1.4e-11,HiGHS,,,0.2\n"
    )
    row = {
        "kernel": "depth map", "ours": "surfel", "against": "published hybrid", "cpu_s_ours": 0.057,
        "cpu_s_against": 0.54, "ratio": 9.47, "peak_mib_ours": None, "peak_mib_against": None,
        "agreement": 93.9, "agreement_metric": "% of beams", "workload": "OS1-128",
    }  # fmt: skip
    bound = {**row, "against": "bound: the rays alone", "agreement": None, "agreement_metric": ""}
    bound |= {"wall_s_ours": 0.04, "wall_s_against": 0.05, "peak_mib_against": 12.5}
    (tmp_path / "bench" / "bench.json").write_text(json.dumps([row, bound]))
    pages = results.results_pages(tmp_path)
    assert "### cover.gap" in pages["tradeoffs"]
    assert "| **0** | solve_cover | 1.8 | 300 |" in pages["tradeoffs"]
    assert "| **mean** | 3.4 | 4.4 | SMRF |" in pages["truth"]
    assert "&lt;4.4 (kept)" in pages["truth"]
    assert "Not there: `samp12`" in pages["truth"]
    assert "| depth map | OS1-128 | published hybrid | 0.057 | 0.54 | 9.47 |" in pages["bench"]
    assert "| sc 157 0 | 0 | 0 | HiGHS |" in pages["truth"]
    bounds = pages["bench"].split("## Bounds")[1]
    assert "| the rays alone | 0.057 | 0.54 | 9.47 | 1.25 | – | 12.5 |" in bounds  # noqa: RUF001


def test_published_figures_are_those_of_the_studies():
    file = PROJECT / "config" / "tradeoffs.yaml"
    page = results.published_page(file)
    for study in yaml.safe_load(file.read_text("utf-8"))["studies"].values():
        for row in study.get("published", {"rows": []})["rows"]:
            assert "| " + " | ".join(map(str, row)) + " |" in page
    alone = "| Camera parameters by road alignment | 4.47 | 96 |  | 429 |"
    assert f"{alone} `calibrate_drive`, `align_cameras` |" in page
