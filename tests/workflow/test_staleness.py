"""Change this -> exactly these rules are stale, and no others."""

from __future__ import annotations

import os

import pytest

from tests.helpers.engines import needs_open3d
from tests.workflow.conftest import with_followers

# Who reads whose outputs, written down here on purpose and not taken from the rules.
READERS = {
    "generate_sample": {"ingest_cloud", "build_edges", "score_pavement", "summarise_site"},
    "ingest_cloud": {
        "profile_scene",
        "plan_effects",
        "build_dem",
        "cluster_fpfh",
        "extract_pavement",
        "build_edges",
        "score_pavement",
        "place_candidates",
        "place_targets",
        "build_surfels",
        "check_coverage",
        "densify_candidates",
        "solve_cover",
        "find_obstacles",
        "render_scans",
        "measure_data",
        "measure_tolerance",
        "summarise_site",
        "write_site_page",
        "try_removals",
        "gather_objects",
        "write_handover",
        "write_stakeout",
    },
    "profile_scene": {
        "build_dem",
        "cluster_fpfh",
        "extract_pavement",
        "build_surfels",
        "plan_effects",
        "summarise_site",
    },
    "plan_effects": {"summarise_site"},
    "build_dem": {
        "cluster_fpfh",
        "extract_pavement",
        "build_edges",
        "score_pavement",
        "place_candidates",
        "densify_candidates",
        "find_obstacles",
        "write_site_page",
        "gather_objects",
        "write_handover",
    },
    "cluster_fpfh": {"extract_pavement"},
    "extract_pavement": {
        "build_edges",
        "score_pavement",
        "place_candidates",
        "place_targets",
        "densify_candidates",
        "measure_data",
        "summarise_site",
        "write_site_page",
        "write_handover",
    },
    # Digitised edges bound the road on which targets stand.
    "build_edges": {
        "place_candidates",
        "place_targets",
        "densify_candidates",
        "measure_data",
        "write_site_page",
        "write_handover",
        "write_stakeout",
    },
    "score_pavement": {"summarise_site"},
    "place_candidates": {
        "render_depth_maps",
        "build_detection_shard",
        "check_coverage",
        "densify_candidates",
        "solve_cover",
        "find_obstacles",
        "measure_data",
        "summarise_site",
        "write_site_page",
        "try_removals",
    },
    "place_targets": {
        "build_detection_shard",
        "check_coverage",
        "densify_candidates",
        "solve_cover",
        "find_obstacles",
        "measure_data",
        "measure_tolerance",
        "summarise_site",
        "write_site_page",
        "try_removals",
        "write_handover",
    },
    "gather_objects": {"find_obstacles", "try_removals"},
    "try_removals": {"summarise_site"},
    "build_surfels": {
        "gather_objects",
        "try_removals",
        "render_depth_maps",
        "find_obstacles",
        "render_scans",
        "measure_tolerance",
    },
    "render_depth_maps": {"build_detection_shard", "measure_data"},
    "build_detection_shard": {
        "check_coverage",
        "solve_cover",
        "find_obstacles",
        "measure_data",
        "write_site_page",
        "try_removals",
    },
    "check_coverage": {
        "densify_candidates",
        "solve_cover",
        "find_obstacles",
        "summarise_site",
        "write_site_page",
    },
    "densify_candidates": {
        "render_depth_maps",
        "build_detection_shard",
        "check_coverage",
        "solve_cover",
        "find_obstacles",
        "measure_data",
        "write_site_page",
        "try_removals",
    },
    "solve_cover": {
        "find_obstacles",
        "render_scans",
        "measure_data",
        "measure_tolerance",
        "summarise_site",
        "write_site_page",
        "try_removals",
        "write_handover",
        "write_stakeout",
    },
    "find_obstacles": {"try_removals", "write_site_page", "write_handover"},
    "render_scans": {"measure_data", "write_site_page"},
    "measure_data": {"summarise_site"},
    "measure_tolerance": {"summarise_site", "write_site_page"},
    "summarise_site": {"write_site_page"},
    "write_site_page": {"write_report", "write_pdf"},
    "write_pdf": {"write_report"},
    "write_handover": {"write_report"},
    "write_stakeout": {"write_report"},
    "write_report": set(),
}


def after(*rules: str) -> set[str]:
    found = with_followers(READERS, *rules)
    # Whether ground is clustered is known once the profile is there again.
    return found - {"cluster_fpfh"} if "profile_scene" in found else found


SITE = "config/sites/tiny.yaml"
PACKAGE = "workflow"
SETTINGS = [
    ("  shards: 2\n", "  shards: 2\n  ground: {dem_cell_m: 0.6}\n", after("build_dem")),
    ("  shards: 2\n", "  shards: 2\n  pavement: {neighbours: 12}\n", after("cluster_fpfh")),
    ("  shards: 2\n", "  shards: 2\n  pavement: {closing_m: 1.5}\n", after("extract_pavement")),
    ("  shards: 2\n", "  shards: 2\n  lidar: {surfel_size_m: 0.12}\n", after("build_surfels")),
    ("  shards: 2\n", "  shards: 2\n  lidar: {outlier_radius_m: 0.5}\n", after("build_surfels")),
    (
        "  shards: 2\n",
        "  shards: 2\n  pavement: {cluster_engine: open3d}\n",
        after("extract_pavement"),
    ),
    (
        "  shards: 2\n",
        "  shards: 2\n  lidar: {engine: open3d}\n",
        after("render_depth_maps", "find_obstacles", "render_scans", "measure_tolerance")
        | after("try_removals"),
    ),
    (
        "  shards: 2\n",
        "  shards: 2\n  lidar: {clear_below_m: 4.5}\n",
        {"mark_traffic"} | after("build_surfels"),
    ),
    ("  shards: 2\n", "  shards: 2\n  lidar: {frames_hz: 20}\n", after("measure_data")),
    # No network is read before it is chosen.
    ("  shards: 2\n", "  shards: 2\n  lidar: {network: none.onnx}\n", set()),
    (
        "  shards: 2\n",
        "  shards: 2\n  lidar: {model: unet}\n",
        {"plan_effects"} | after("render_depth_maps"),
    ),
    ("  shards: 2\n", "  shards: 2\n  conditions: {speed_kmh: 90}\n", {"plan_effects"}),
    (
        "  shards: 2\n",
        "  shards: 2\n  effects: {overhead_cover: skip}\n",
        {"plan_effects"} | after("place_candidates", "densify_candidates"),
    ),
    ("min_points: 10", "min_points: 12", after("place_targets")),
    (
        "min_points: 10",
        "min_points: 10, height_m: 0.5",
        {"plan_effects"} | after("build_detection_shard", "find_obstacles"),
    ),
    (
        "min_points: 10",
        "min_points: 10, min_probability: 0.95",
        {"plan_effects"} | after("build_detection_shard"),
    ),
    # More than 8 beams: what is asked anyhow.
    ("min_points: 10", "min_points: 10, min_probability: 0.99", set()),
    ("min_points: 10", "min_points: 10, lidar_curve: [0.1, 0.5]", after("measure_data")),
    ("min_points: 10", "min_points: 10, rcs_m2: 1.0", set()),
    (
        "height_step_m: 2.0",
        "height_step_m: 0.5",
        # Other parameters of the rule have both values.
        {"plan_effects"} | after("place_candidates", "densify_candidates"),
    ),
    (
        "height_step_m: 2.0",
        "height_step_m: 3.0",
        {"plan_effects"} | after("place_candidates", "densify_candidates"),
    ),
    ("  shards: 2\n", "  shards: 2\n  cover: {time_limit_s: 200}\n", after("solve_cover")),
    ("title: Sixty", "title: Seventy", after("write_site_page", "write_handover")),
]
MODULES = [
    ("roadsight/scene/pavement/fpfh.py", after("cluster_fpfh")),
    ("roadsight/effects/quantities.py", after("plan_effects")),
    ("roadsight/scene/pavement/outline.py", after("extract_pavement")),
    ("roadsight/placement/sight/obstacles.py", after("find_obstacles")),
    ("roadsight/evidence/pavement_scores.py", after("score_pavement")),
    (
        "roadsight/placement/candidates/candidates.py",
        after("place_candidates", "densify_candidates"),
    ),
    ("roadsight_worlds/highway/highway.py", after("generate_sample")),
    ("roadsight/commands/ground.py", set()),
    # The report explains each setting in the schema's words; nothing else reads the schema.
    ("roadsight/config/schema.py", after("write_pdf")),
]


def test_finished_run_leaves_nothing_to_do(finished):
    assert finished.stale_rules() == set()


def test_touching_every_file_makes_nothing_stale(copy_of_finished):
    for path in copy_of_finished.folder.rglob("*"):
        if path.is_file() and ".snakemake" not in path.parts:
            os.utime(path)
    assert copy_of_finished.stale_rules() == set()


@pytest.mark.parametrize(("old", "new", "expected"), SETTINGS, ids=[s[1].strip() for s in SETTINGS])
def test_setting(copy_of_finished, old, new, expected):
    if "open3d" in new:
        needs_open3d()
    copy_of_finished.edit(SITE, old, new)
    # Every setting is on record in the summary, so the summary and the report follow it too.
    recorded = after("summarise_site") if old != "title: Sixty" else set()
    assert copy_of_finished.stale_rules() == expected | recorded


@pytest.mark.parametrize(("module", "expected"), MODULES, ids=[m[0] for m in MODULES])
def test_editing_a_module_re_runs_its_users_only(copy_of_finished, module, expected):
    path = copy_of_finished.folder / PACKAGE / module
    original = path.read_text()
    path.write_text(original + "\n# a remark\n")
    assert copy_of_finished.stale_rules() == expected
    path.write_text(original)
    assert copy_of_finished.stale_rules() == set()


def test_a_network_is_an_input_where_it_is_chosen_and_nowhere_else(copy_of_finished):
    path = copy_of_finished.folder / "resources/models/depth_unet.onnx"
    path.write_bytes(path.read_bytes() + b"\0")
    assert copy_of_finished.stale_rules() == set()
    copy_of_finished.edit(SITE, "  shards: 2\n", "  shards: 2\n  lidar: {model: unet_mask}\n")
    listed = copy_of_finished.snakemake("-n").stdout
    rendering = [line for line in listed.splitlines() if "sources/render_depth_maps" in line]
    assert rendering
    assert all("resources/models/depth_unet.onnx" in line for line in rendering)


def test_a_missing_network_ends_in_one_message(copy_of_finished):
    chosen = "  shards: 2\n  lidar: {model: unet, network: none.onnx}\n"
    copy_of_finished.edit(SITE, "  shards: 2\n", chosen)
    result = copy_of_finished.snakemake("-n")
    assert result.returncode == 2
    assert "lidar.network: no such file; found none.onnx" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_new_sensor_makes_nothing_stale(copy_of_finished):
    path = copy_of_finished.folder / "config/sensors.yaml"
    entry = "\n  New-8:\n    elevation_min_deg: -10\n    elevation_max_deg: 10\n"
    path.write_text(path.read_text() + entry + "    channels: 8\n    range_m: 50\n")
    assert copy_of_finished.stale_rules() == set()


def test_one_sensor_changed_renders_that_sensor_alone(copy_of_finished):
    path = copy_of_finished.folder / "config/sensors.yaml"
    before, name, rest = path.read_text().partition("  OS1-32: {like: OS1-64")
    path.write_text(f"{before}{name}, range_m: 110{rest}")
    result = copy_of_finished.snakemake("-n")
    rendered = [
        line
        for line in (result.stdout + result.stderr).splitlines()
        # Denser candidates of later rounds may follow from any sensor's gaps.
        if "output:" in line and "round-0/depth/" in line
    ]
    assert rendered
    assert all("/OS1-32/" in line for line in rendered)


def test_a_renamed_site_file_with_other_cloud_content_is_noticed(copy_of_finished):
    cloud = copy_of_finished.folder / "results/tiny/sample/cloud.laz"
    cloud.write_bytes(cloud.read_bytes() + b"\0")
    assert "ingest_cloud" in copy_of_finished.stale_rules()


def test_a_threshold_re_runs_rules_only_where_it_changes_a_decision(copy_of_finished):
    copy_of_finished.edit("config/effects.yaml", "threshold: 10\n", "threshold: 11\n")
    assert copy_of_finished.stale_rules() == after("plan_effects")
    copy_of_finished.edit("config/effects.yaml", "threshold: 11\n", "threshold: 1000000\n")
    moved = after("plan_effects", "place_candidates", "densify_candidates")
    assert copy_of_finished.stale_rules() == moved


def test_dry_run_gives_the_reason(copy_of_finished):
    copy_of_finished.edit(SITE, "min_points: 10", "min_points: 12")
    result = copy_of_finished.snakemake("-n")
    assert "Params have changed since last execution" in result.stdout + result.stderr
