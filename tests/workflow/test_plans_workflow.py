"""Options of plans through the workflow: what they make stale, and what comes of them."""

import json

import geopandas as gpd
import shapely

from tests.workflow.conftest import Checkout

APART = """\
placement:
  edges: sample
  plans: [os-32, os-64]
  own_plans:
    os-64: {title: OS-64 only, sensors: [OS1-64], spacing_m: 6}
"""
PLAIN = """\
placement:
  edges: sample
  plans: [os-32, os-64]
"""
MANY = """\
placement:
  edges: sample
  plans: [os-32]
  own_plans:
    os-64:
      title: OS-64, two of them
      sensors: [OS1-64]
      budget: {sensors: 2}
      areas: {file: areas.gpkg}
      forbidden: {file: zones.gpkg}
      alternatives: true
      curve: 4
    nothing: {title: Not worth it, sensors: [OS1-64], price: 1.0e-6}
"""
SITE = "config/sites/tiny.yaml"


def maps(checkout: Checkout) -> None:
    """Heavy targets in the west of the road, no sensors in its east."""
    folder = checkout.folder / "results/tiny/placement"
    targets = gpd.read_file(folder / "os-64/solution.gpkg", layer="targets")
    west, south, east, north = targets.total_bounds
    middle = (west + east) / 2
    half = shapely.box(west - 50, south - 50, middle, north + 50)
    other = shapely.box(middle + (east - middle) / 2, south - 50, east + 50, north + 50)
    for name, shape, columns in (("areas", half, {"weight": [3.0]}), ("zones", other, {})):
        features = gpd.GeoDataFrame(columns, geometry=[shape], crs=targets.crs)
        features.to_crs("EPSG:4326").to_file(checkout.folder / f"config/sites/{name}.gpkg")


def test_an_option_makes_one_plan_stale_and_options_reach_the_summary(
    copy_of_finished: Checkout,
) -> None:
    checkout = copy_of_finished
    before = (checkout.folder / "results/tiny/placement/os-32/solution.json").read_bytes()
    checkout.edit(SITE, PLAIN, APART)
    planned = checkout.snakemake("-n").stdout
    assert "placement/os-64/solution.json" in planned
    assert "output: results/tiny/placement/os-32/" not in planned
    rules = {"solve_cover", "find_obstacles", "render_scans", "summarise_site", "write_site_page"}
    rules |= {"measure_data", "measure_tolerance", "try_removals"}
    handed_over = {"write_report", "write_pdf", "write_handover", "write_stakeout"}
    assert checkout.stale_rules() == rules | handed_over
    maps(checkout)
    checkout.edit(SITE, APART, MANY)
    result = checkout.snakemake("--cores", "2")
    assert result.returncode == 0, result.stdout[-4000:] + result.stderr[-4000:]
    summary = json.loads((checkout.folder / "results/tiny/summary.json").read_text())
    two, nothing = (summary["placement"][name] for name in ("os-64", "nothing"))
    assert (two["sensors"], two["lower_bound"]) == (2, None)
    goal, weight = two["options"]["goal"], two["options"]["weight"]
    assert weight["seen"] == goal["value"] <= goal["bound"] <= weight["of"]
    assert weight["of"] > two["targets"]
    assert [p["budget"] for p in two["options"]["curve"]["points"]] == [1.0, 2.0]
    assert len(two["options"]["alternatives"]["replaceable"]) == 2
    assert (nothing["sensors"], nothing["covered_targets"]) == (0, 0)
    assert (checkout.folder / "results/tiny/placement/os-32/solution.json").read_bytes() == before
    report = (checkout.folder / "results/report.html").read_text()
    assert "How unique the answer is" in report
    assert "What the plan asks for" in report
