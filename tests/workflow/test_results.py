"""What a run leaves behind."""

import json
import shutil

import geopandas as gpd
import laspy
import pytest
import rasterio

from tests.workflow.conftest import Checkout


def test_summary_holds_what_checks_rely_on(finished):
    summary = json.loads((finished.folder / "results/tiny/summary.json").read_text())
    assert {"site", "version", "seed", "inputs", "placement", "effects"} <= set(summary)
    for plan in ("os-32", "os-64"):
        result = summary["placement"][plan]
        assert result["status"] == "optimal"
        assert result["lower_bound"] == pytest.approx(result["cost"])
        assert result["gap"] == pytest.approx(0.0, abs=1e-9)
        covered = result["targets"] - result["uncoverable_targets"]
        assert result["covered_targets"] == covered > 100
        assert 1 <= result["sensors"] < result["candidates"]
    assert summary["placement"]["os-64"]["sensors"] <= summary["placement"]["os-32"]["sensors"]


def test_pavement_is_close_to_the_truth(finished):
    scores = json.loads((finished.folder / "results/tiny/scene/pavement_scores.json").read_text())
    assert scores["f1"] > 0.9
    assert scores["outline_median_m"] < 0.5


def test_layers_open_in_the_right_crs(finished):
    folder = finished.folder / "results/tiny"
    for name, layer in [
        ("scene/pavement.gpkg", "pavement"),
        ("placement/edges.gpkg", "edges"),
        ("placement/os-64/solution.gpkg", "sensors"),
        ("placement/os-64/solution.gpkg", "targets"),
        ("placement/os-64/obstacles.gpkg", "obstacles"),
    ]:
        features = gpd.read_file(folder / name, layer=layer)
        assert features.crs.to_epsg() == 32650
        if len(features):
            west, south, east, north = features.total_bounds
            assert 660_000 < west <= east < 680_000
            assert 3_540_000 < south <= north < 3_560_000
    with rasterio.open(folder / "scene/dem.tif") as dem:
        assert dem.crs.to_epsg() == 32650
    scan = laspy.read(folder / "placement/os-64/scans.laz")
    assert len(scan) > 1000
    assert scan.header.parse_crs().to_epsg() == 32650


def test_same_bytes_on_one_core_and_in_another_folder(finished, tmp_path):
    made = shutil.ignore_patterns("results", "logs", ".snakemake")
    shutil.copytree(finished.folder, tmp_path / "other", symlinks=True, ignore=made)
    other = Checkout(tmp_path / "other")
    result = other.snakemake("--cores", "1")
    assert result.returncode == 0, result.stderr[-4000:]
    timed = {"timing.json", "summary.json", "run.json", "page.json", "report.html", "report.pdf"}
    compared = 0
    for path in sorted((finished.folder / "results").rglob("*")):
        relative = path.relative_to(finished.folder)
        if path.is_file() and path.name not in timed and "benchmarks" not in path.parts:
            assert path.read_bytes() == (other.folder / relative).read_bytes(), relative
            compared += 1
    assert compared > 20
    shutil.rmtree(other.folder)
