import math
from pathlib import Path

import pytest

from roadsight.config.load import load_config, load_sites
from roadsight.evidence import paper, published
from roadsight.report.files import read_assets
from roadsight.report.paper_page import ASSETS, render_paper


def placement_run(plans: tuple[str, ...], sensors: int) -> dict:
    plan = {
        "sensors": sensors, "status": "optimal", "bound": sensors, "covered_share": 0.5,
        "sensors_m": [[float(n), 0.0, 5.0] for n in range(sensors)],
    }  # fmt: skip
    return {
        "cpu_s": {"build_dem": 1.0, "cluster_fpfh": 2.0, "extract_pavement": 3.0},
        "length_km": 0.1,
        "facts": {key: 2.0 for key, _, _ in published.SITE_FACTS},
        "pavement": {"accuracy": 0.9, "recall": 0.8, "f1": 0.85},
        "plans": dict.fromkeys(plans, plan),
        "seconds_per_candidate": {"table5-OS-64": 1.5, "table5-OS-128": 3.0},
        "maps": {},
    }


def pole_run(fewer: int) -> dict:
    errors = [
        {"geodesic_m": 1.0, "across_m": -0.5, "truth": "0", "scenarios": []},
        {"geodesic_m": 3.0, "across_m": None, "truth": "1", "scenarios": []},
    ]
    scores = {"precision": 0.5, "recall": 0.5, "f1": 0.5}
    scenarios = {name.split()[0]: {"count": 1, "mean": 2.0} for name in published.SCENARIOS}
    return {
        "cpu_s": {"segment_images": 60.0, "rasterise_lidar": 2.0},
        "length_km": 1.609344,
        "validation": {
            "mean_m": 2.0,
            "errors": errors,
            "thresholds": [{"threshold_m": n, **scores} for n in range(1, 17)],
            "scenarios": scenarios,
        },
        "components": [
            {"component": "all", "f1_3m": 1.0},
            {"component": "alignment", "f1_3m": 0.1},
        ],
        "voxels": 10,
        "road_edges": 5,
        "images": 4,
        "cameras_m": [[0.0, 0.0], [100.0, 10.0]],
        "shown": {"a": 2 - fewer, "b": 1},
        "poles_m": [[50.0, 3.0]],
    }


@pytest.fixture
def measured() -> dict:
    found = {}
    for name, run in paper.runs("short").items():
        if run.site == paper.POLE_SITE:
            found[name] = pole_run(fewer=int("256" in name))
        else:
            found[name] = placement_run(run.plans, 3 if "unet" in name else 2)
    return found


def row(rows: list[dict], item: str, name: str, quantity: str) -> dict:
    found = [r for r in rows if (r["item"], r["row"], r["quantity"]) == (item, name, quantity)]
    assert len(found) == 1, found
    return found[0]


@pytest.mark.parametrize("size", ["short", "long"])
def test_every_run_names_a_site_that_loads(project: Path, monkeypatch, size) -> None:
    monkeypatch.chdir(project)
    sites = load_sites(load_config({"sites": paper.site_files()}))
    runs = paper.runs(size)
    assert {paper.site_name(run.site, size) for run in runs.values()} <= set(sites)
    for name, run in runs.items():
        assert f"{run.site}-default" in runs, name
        assert paper.site_file(run.site, size) in paper.site_files()


def test_each_table_and_figure_has_rows(measured: dict) -> None:
    rows = paper.rows(measured)
    items = {(r["study"], r["item"]) for r in rows}
    placement = ("Table 2", "Table 4", "Fig. 18", "Fig. 19", "Fig. 20")
    poles = ("Table 1", "Table 2", "Table 3", "Table 4", "Fig. 12", "Image height", "Voxel size")
    wanted = {("placement", i) for i in placement} | {("poles", i) for i in poles}
    assert items == wanted
    assert all(set(r) == set(paper.COLUMNS) for r in rows)
    first = next(r for r in rows if (r["item"], r["site"]) == ("Fig. 18", "Site 1"))
    assert (first["published"], first["as_published"], first["default"]) == (31, 2, 2)
    at_3 = row(rows, "Table 2", "3 m", "f1")
    assert (at_3["published"], at_3["default"]) == (0.35, 0.5)
    assert row(rows, "Table 3", "straight road", "mean error")["default"] == 2.0
    assert row(rows, "Image height", "256 px", "images with fewer poles")["default"] == 25.0
    assert row(rows, "Image height", "native", "images with fewer poles")["default"] == 0.0
    assert row(rows, "Image height", "native", "time of a mile")["default"] == pytest.approx(1.0)


def test_distance_to_the_baseline_is_the_mean_of_the_nearest() -> None:
    baseline = [[0, 0, 0], [10, 0, 0]]
    assert paper.mean_distance_m([[1, 0, 0], [10, 3, 0]], baseline) == pytest.approx(2.0)
    assert paper.mean_distance_m(baseline, baseline) == 0.0
    assert math.isnan(paper.mean_distance_m([], baseline))


def test_images_with_fewer_poles_count_only_images_that_had_some() -> None:
    assert paper.fewer_poles_share({"a": 1}, {"a": 2, "b": 1}, 4) == 0.5
    assert paper.fewer_poles_share({"a": 3, "c": 1}, {"a": 2}, 4) == 0.0


def test_page_shows_every_item_and_is_the_same_twice(measured: dict) -> None:
    rows = paper.rows(measured)
    assets = read_assets(ASSETS)
    page = render_paper(rows, measured, "short", assets, "1")
    assert page == render_paper(rows, measured, "short", assets, "1")
    for item in ("Table 2", "Table 4", "Fig. 18", "Fig. 20", "Voxel size"):
        assert f"<h2>{item}</h2>" in page
    assert ">nan<" not in page
