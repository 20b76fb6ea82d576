"""The placement study as published, by its configuration file, from a cloud to its obstacles."""

import json

import geopandas as gpd
import pytest

from roadsight.io.records.depth_maps import DepthMaps
from roadsight.io.records.tables import read_about, read_table
from tests.workflow.conftest import Checkout

CONFIG = "config/published.yaml"
FEWER = (
    "overrides={candidates: {spacing_m: 15, height_step_m: 3},"
    " coverage: {rounds: 2, closest_m: 1.5, shards: 1}}"
)
"""Fewer candidates than published, for the sake of time; all other settings are the file's."""


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Checkout:
    checkout = Checkout.copy_to(tmp_path_factory.mktemp("published") / "project")
    fewer = ("--config", "sites=[tiny]", "plans=[table5-os-64]", FEWER)
    command = ("--cores", "2", "placement", "--configfile", CONFIG, *fewer)
    result = checkout.snakemake(*command, timeout_s=1800)
    assert result.returncode == 0, result.stdout + result.stderr
    return checkout


def test_every_step_is_the_published_one(published: Checkout) -> None:
    scene = published.folder / "results/tiny/scene"
    about = read_about(scene / "ground.parquet")["settings"]
    assert (about["method"], about["pillar_width_m"], about["height_threshold_m"]) == (
        "pillars",
        0.2,
        0.1,
    )
    clusters = read_about(scene / "fpfh_clusters.parquet")
    assert (clusters["thinning"], clusters["intensity_used"]) == ("voxels", False)
    assert read_about(scene / "pavement.parquet")["source"] == "fpfh"
    folder = published.folder / "results/tiny/placement"
    maps = DepthMaps(folder / "round-0/depth/table5-OS-64/0.parquet")
    assert (maps.info.model, maps.info.columns) == ("hybrid", 3600)
    assert read_table(folder / "targets.parquet")["points"].min() >= 25
    assert not (folder / "effects").exists()  # rain, lanes, dark targets: none is simulated
    assert not (folder / "round-0/tilts.parquet").exists()


def test_the_answer_is_sane(published: Checkout) -> None:
    folder = published.folder / "results/tiny/placement"
    # Two carriageways of 60 m; grass beside them is rougher.
    area_m2 = read_about(published.folder / "results/tiny/scene/pavement.parquet")["area_m2"]
    assert 500 < area_m2 < 1800
    solution = json.loads((folder / "table5-os-64/solution.json").read_text())
    assert 1 <= len(solution["sensors"]) <= 12
    assert 0 < solution["bound"] <= solution["objective"] == len(solution["sensors"])
    coverage = json.loads((folder / "round-2/coverage.json").read_text())
    assert coverage["targets"] > 300
    left = coverage["plans"]["table5-os-64"]["uncovered"]
    assert len(left) < 0.1 * coverage["targets"]


def test_obstacles_and_reasons_are_told(published: Checkout) -> None:
    folder = published.folder / "results/tiny/placement"
    file = folder / "table5-os-64/obstacles.gpkg"
    obstacles = gpd.read_file(file, layer="obstacles")
    assert len(obstacles) and (obstacles["targets"] > 0).all()
    coverage = json.loads((folder / "round-2/coverage.json").read_text())
    gaps = gpd.read_file(file, layer="uncovered")
    assert set(gaps["target"]) == set(coverage["plans"]["table5-os-64"]["uncovered"])
    assert gaps["reason"].str.len().gt(0).all()


def test_what_a_published_step_cannot_use_is_told(published: Checkout) -> None:
    cars = ("--config", "sites=[tiny]", "overrides={targets: {kind: car}}")
    result = published.snakemake("-n", "placement", "--configfile", CONFIG, *cars)
    assert result.returncode == 2
    assert "obstacles by cells are for cylinders" in result.stderr
    assert "found targets.kind: car" in result.stderr
