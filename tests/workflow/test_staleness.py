"""Change this -> exactly these rules are stale, and no others."""

import os
import re
from pathlib import Path

import pytest

from tests.helpers.engines import needs_open3d

SITE = "config/sites/tiny.yaml"
PACKAGE = "workflow"
SHARDS, TARGETS, STEP = "  shards: 2\n", "min_points: 10", "height_step_m: 2.0"
PLACES = "place_candidates densify_candidates"
SETTINGS = [
    (SHARDS, f"{SHARDS}  ground: {{dem_cell_m: 0.6}}\n", "build_dem"),
    (SHARDS, f"{SHARDS}  pavement: {{neighbours: 12}}\n", "cluster_fpfh"),
    (SHARDS, f"{SHARDS}  pavement: {{closing_m: 1.5}}\n", "extract_pavement"),
    (SHARDS, f"{SHARDS}  lidar: {{surfel_size_m: 0.12}}\n", "build_surfels"),
    (SHARDS, f"{SHARDS}  lidar: {{outlier_radius_m: 0.5}}\n", "build_surfels"),
    (SHARDS, f"{SHARDS}  pavement: {{cluster_engine: open3d}}\n", "extract_pavement"),
    (SHARDS, f"{SHARDS}  lidar: {{engine: open3d}}\n",
     "render_depth_maps find_obstacles render_scans measure_tolerance try_removals"),
    (SHARDS, f"{SHARDS}  lidar: {{clear_below_m: 4.5}}\n", "build_surfels", "mark_traffic"),
    (SHARDS, f"{SHARDS}  lidar: {{frames_hz: 20}}\n", "measure_data"),
    # No network is read before it is chosen.
    (SHARDS, f"{SHARDS}  lidar: {{network: none.onnx}}\n", ""),
    (SHARDS, f"{SHARDS}  lidar: {{model: unet}}\n", "render_depth_maps", "plan_effects"),
    (SHARDS, f"{SHARDS}  conditions: {{speed_kmh: 90}}\n", "", "plan_effects"),
    (SHARDS, f"{SHARDS}  effects: {{overhead_cover: skip}}\n", PLACES, "plan_effects"),
    (TARGETS, "min_points: 12", "place_targets"),
    (TARGETS, f"{TARGETS}, height_m: 0.5", "build_detection_shard find_obstacles", "plan_effects"),
    (TARGETS, f"{TARGETS}, min_probability: 0.95", "build_detection_shard", "plan_effects"),
    # More than 8 beams: what is asked anyhow.
    (TARGETS, f"{TARGETS}, min_probability: 0.99", ""),
    (TARGETS, f"{TARGETS}, lidar_curve: [0.1, 0.5]", "measure_data"),
    (TARGETS, f"{TARGETS}, rcs_m2: 1.0", ""),
    # Other parameters of the rule have both values.
    (STEP, "height_step_m: 0.5", PLACES, "plan_effects"),
    (STEP, "height_step_m: 3.0", PLACES, "plan_effects"),
    (SHARDS, f"{SHARDS}  cover: {{time_limit_s: 200}}\n", "solve_cover"),
    ("title: Sixty", "title: Seventy", "write_site_page write_handover"),
]  # fmt: skip
"""What is replaced, by what, rules that are stale with all behind them, and one that is alone."""
MODULES = [
    ("roadsight/scene/pavement/fpfh.py", "cluster_fpfh"),
    ("roadsight/effects/quantities.py", "plan_effects"),
    ("roadsight/scene/pavement/outline.py", "extract_pavement"),
    ("roadsight/placement/sight/obstacles.py", "find_obstacles"),
    ("roadsight/evidence/scores.py", "score_pavement"),
    ("roadsight/placement/candidates/candidates.py", PLACES),
    ("roadsight_worlds/highway/highway.py", "generate_sample"),
    ("roadsight/commands/ground.py", ""),
    # The report explains each setting in the schema's words; nothing else reads the schema.
    ("roadsight/config/schema.py", "write_pdf"),
]


def after(checkout, rules):
    found = checkout.after(*rules.split())
    # Whether ground is clustered is known once the profile is there again.
    return found - {"cluster_fpfh"} if "profile_scene" in found else found


def check_what_steps_read(checkout):
    """A command names each file of another step that is an input of its rule, and no other."""
    records = checkout.records()
    for name, record in records.items():
        words = set(re.findall(r"results/[\w./+-]*[\w+-]", record["shellcmd"] or ""))
        told = {file for file in records if {file, *map(str, Path(file).parents)} & words}
        listed = set(record["input"]) & set(records)
        own = {file for file in records if records[file]["rule"] == record["rule"]}
        # The report links to what lies beside it.
        assert told - own == listed - own or record["rule"] == "write_report", name
    assert len({record["rule"] for record in records.values()}) > 20


def test_steps_read_what_their_rules_list(finished):
    check_what_steps_read(finished)


def test_finished_run_leaves_nothing_to_do(finished):
    assert finished.stale_rules() == set()


def test_touching_every_file_makes_nothing_stale(copy_of_finished):
    for path in copy_of_finished.folder.rglob("*"):
        if path.is_file() and ".snakemake" not in path.parts:
            os.utime(path)
    assert copy_of_finished.stale_rules() == set()


@pytest.mark.parametrize("change", SETTINGS, ids=[s[1].strip() for s in SETTINGS])
def test_setting(copy_of_finished, change):
    old, new, rules, *alone = change
    if "open3d" in new:
        needs_open3d()
    copy_of_finished.edit(SITE, old, new)
    # Every setting is on record in the summary, so the summary and the report follow it too.
    recorded = " summarise_site" if old != "title: Sixty" else ""
    expected = after(copy_of_finished, rules + recorded) | set(alone)
    assert copy_of_finished.stale_rules() == expected


@pytest.mark.parametrize(("module", "rules"), MODULES, ids=[m[0] for m in MODULES])
def test_editing_a_module_re_runs_its_users_only(copy_of_finished, module, rules):
    path = copy_of_finished.folder / PACKAGE / module
    original = path.read_text()
    path.write_text(original + "\n# a remark\n")
    assert copy_of_finished.stale_rules() == after(copy_of_finished, rules)
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
    assert copy_of_finished.stale_rules() == copy_of_finished.after("plan_effects")
    copy_of_finished.edit("config/effects.yaml", "threshold: 11\n", "threshold: 1000000\n")
    assert copy_of_finished.stale_rules() == after(copy_of_finished, f"plan_effects {PLACES}")


def test_dry_run_gives_the_reason(copy_of_finished):
    copy_of_finished.edit(SITE, "min_points: 10", "min_points: 12")
    result = copy_of_finished.snakemake("-n")
    assert "Params have changed since last execution" in result.stdout + result.stderr
