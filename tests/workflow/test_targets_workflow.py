"""Cars as targets, past traffic, seen by sensors together: through the workflow."""

import json

import geopandas as gpd
import pytest

from tests.workflow.conftest import Checkout

SITE = "config/sites/tiny.yaml"
PLAIN = """\
  plans: [os-32, os-64]
settings:
  shards: 2
"""
TOGETHER = """\
  plans: [os-64]
  own_plans:
    together: {title: OS-64 together, sensors: [OS1-64], availability: 0.8}
settings:
  shards: 2
  conditions: {aadt: 8000, truck_share: 0.1, availability: 0.5}
"""

pytestmark = pytest.mark.full


def test_cars_past_traffic_reach_summary_layers_and_report(copy_of_finished: Checkout) -> None:
    checkout = copy_of_finished
    checkout.edit(SITE, PLAIN, TOGETHER)
    checkout.edit(SITE, "targets: {min_points: 10}", "targets: {min_points: 10, kind: car}")
    stale = checkout.stale_rules()
    assert {"place_targets", "trace_lanes", "build_detection_shard"} <= stale
    assert not {"build_edges", "build_surfels", "place_candidates"} & stale
    result = checkout.snakemake("--cores", "2")
    assert result.returncode == 0, result.stdout[-4000:] + result.stderr[-4000:]
    folder = checkout.folder / "results/tiny"
    summary = json.loads((folder / "summary.json").read_text())
    alone, together = (summary["placement"][name] for name in ("os-64", "together"))
    assert together["availability"]["level"] == 0.8
    below = together["availability"]["below"]
    targets = gpd.read_file(folder / "placement/together/solution.gpkg", layer="targets")
    asked = targets[~targets["target"].isin(list(below))]
    assert (asked["availability"] >= 0.8 - 1e-6).all()
    assert together["lower_bound"] <= together["cost"]
    assert together["sensors"] >= alone["sensors"]
    assert together["data"]["points_per_s"] == 64 * 2048 * 10 * together["sensors"]
    assert 0 < together["data"]["road_points_per_s"] < together["data"]["points_per_s"]
    quarters = together["data"]["heights"][0]["bands"]
    assert [band["to_m"] for band in quarters] == pytest.approx([0.325, 0.65, 0.975, 1.3])
    # More than eight beams of one sensor alone are asked.
    assert sum(band["mean"] for band in quarters) > 8
    assert 0.9 < together["data"]["probability"]["least"] <= 1
    report = (checkout.folder / "results/report.html").read_text()
    assert "In sight past traffic" in report
    assert "Hand-over and data" in report
    assert "Points on a target by height" in report
