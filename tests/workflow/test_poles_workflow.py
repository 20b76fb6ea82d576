"""The pole job as a workflow: what it leaves behind, and what makes which rules stale."""

import json
import shutil

import geopandas as gpd
import pandas as pd
import pytest
import rasterio

from tests.workflow.conftest import Checkout
from tests.workflow.test_staleness import check_what_steps_read

SITE = "config/sites/tiny_road.yaml"
SETTINGS = [
    ("voxels: {voxel_size_m: 0.5}", "rasterise_lidar"),
    ("road_edges: {smoothing_m: 0.8}", "extract_road_edges"),
    ("videolog: {heading_images: 2}", "read_videolog"),
    ("networks: {image_height_px: 256}", "segment_images estimate_depth"),
    ("image_edges: {gap_px: 5}", "trace_image_edges"),
    ("calibration: {images: 50}", "calibrate_drive"),
    ("alignment: {ties: skip}", "calibrate_drive"),
    ("alignment: {max_residual_px: 3}", "align_cameras"),
    ("alignment: {bound_m: 0.5}", "align_cameras"),
    ("effects: {terrain_occlusion: skip}", "calibrate_drive", "plan_effects"),
    ("effects: {side_views: skip}", "segment_images estimate_depth", "plan_effects"),
    ("effects: {grid_convergence: skip}", "measure_poles", "plan_effects"),
    ("effects: {scale_factor: simulate}", "rate_hazard", "plan_effects"),
    ("sightings: {farthest_m: 50}", "measure_poles"),
    ("triangulation: {min_views: 4}", "triangulate_poles"),
    ("triangulation: {sequence_m: 20}", "triangulate_poles"),
    ("hazard: {aadt: 900}", "rate_hazard"),
    ("hazard: {section_every_m: 50}", "rate_hazard"),
]
"""What is set, rules that are stale with all behind them, and one that is alone."""
MODULES = [
    ("roadsight/poles/images/lanes.py", "trace_image_edges measure_poles"),
    ("roadsight/poles/triangulate/site.py", "triangulate_poles"),
    ("roadsight/poles/risk/hazard.py", "rate_hazard"),
    ("roadsight/stages/poles/shared/hazard_layers.py", "rate_hazard"),
    # The profile measures how much of the road the terrain hides.
    ("roadsight/scene/terrain/tin.py", "build_terrain plan_effects", "profile_drive"),
    ("roadsight/poles/images/plumb_line.py", "plan_effects", "profile_drive"),
    ("roadsight/poles/calibration/calibration_landmarks.py", "calibrate_drive"),
    ("roadsight/effects/quantities.py", "plan_effects"),
    ("roadsight/poles/alignment/published.py", "align_cameras"),
    ("roadsight_worlds/rendering/rendering_look.py", "render_videolog"),
    ("roadsight/commands/triangulate.py", ""),
]
"""Where only the drive is measured anew, what hangs on its effects follows another decision."""


def remark(checkout: Checkout, module: str) -> None:
    """Edit a module without changing what it does."""
    path = checkout.folder / "workflow" / module
    path.write_text(path.read_text() + "\n# a remark\n")


def test_finished_run_leaves_nothing_to_do(finished_road):
    assert finished_road.stale_rules() == set()


def test_steps_read_what_their_rules_list(finished_road):
    check_what_steps_read(finished_road)


@pytest.mark.parametrize("change", SETTINGS, ids=[s[0] for s in SETTINGS])
def test_setting(copy_of_road, change):
    setting, rules, *alone = change
    copy_of_road.edit(SITE, "  shards: 2\n", f"  shards: 2\n  {setting}\n")
    # Every setting is on record in the summary, so the summary and the report follow it too.
    expected = copy_of_road.after(*rules.split(), "summarise_site") | set(alone)
    if setting == "effects: {side_views: skip}":
        expected -= {"turn_side_views"}
    assert copy_of_road.stale_rules() == expected


@pytest.mark.parametrize("change", MODULES, ids=[m[0] for m in MODULES])
def test_editing_a_module_re_runs_its_users_only(copy_of_road, change):
    module, rules, *alone = change
    remark(copy_of_road, module)
    assert copy_of_road.stale_rules() == copy_of_road.after(*rules.split()) | set(alone)


def jobs_after(checkout: Checkout, setting: str) -> set[str]:
    """Rules that a setting makes stale or adds."""
    checkout.edit(SITE, "  shards: 2\n", f"  shards: 2\n  {setting}\n")
    return checkout.stale_rules()


@pytest.mark.parametrize(
    ("setting", "module", "rule", "absent"),
    [
        ("alignment: {landmarks: skip}", "stages/poles/trace_pole_axes.py", "trace_pole_axes", ""),
        ("alignment: {ties: skip}", "stages/poles/match_images.py", "match_images",
         "trace_pole_axes segment_images"),
        ("effects: {terrain_occlusion: skip}", "scene/terrain/tin.py", "build_terrain", ""),
    ],
)  # fmt: skip
def test_rules_of_what_is_skipped_are_not_in_the_dag(copy_of_road, setting, module, rule, absent):
    remark(copy_of_road, f"roadsight/{module}")
    assert rule in copy_of_road.stale_rules()
    jobs = jobs_after(copy_of_road, setting)
    assert "calibrate_drive" in jobs
    assert not {rule, *absent.split()} & jobs


def test_decisions_are_measured_and_told(finished_road):
    folder = finished_road.folder / "results/tiny_road"
    made = {e["effect"]: e for e in json.loads((folder / "effects.json").read_text())}
    drive = json.loads((folder / "poles/drive.json").read_text())
    assert made["terrain_occlusion"]["value"] == drive["hidden_road_share"]
    assert made["grid_convergence"]["decision"] == "simulate"
    assert made["side_views"]["decision"] == "simulate"
    assert made["road_alignment"]["decision"] == "simulate"
    assert made["lens_distortion"]["decision"] == "skip"
    assert made["scale_factor"]["decision"] == made["sight_curvature"]["decision"] == "skip"
    assert (folder / "poles/terrain.npz").exists()
    assert not (folder / "poles/straight").exists()


def test_distorted_images_are_straightened_and_others_are_not(copy_of_road):
    jobs = jobs_after(copy_of_road, "effects: {lens_distortion: simulate}")
    assert {"undistort_views", "trace_image_edges", "measure_poles"} <= jobs
    assert not {"segment_images", "profile_drive"} & jobs


def test_skipped_side_views_are_not_segmented(copy_of_road):
    copy_of_road.edit(SITE, "  shards: 2\n", "  shards: 2\n  effects: {side_views: skip}\n")
    result = copy_of_road.snakemake("-n", "-p")
    told = result.stdout + result.stderr
    commands = [line for line in told.splitlines() if "stages.poles.segment_images" in line]
    assert len(commands) == 2
    assert all("--views front --" in command for command in commands)


def test_given_cameras_spare_the_alignment(copy_of_road):
    copy_of_road.edit(SITE, "jobs: [poles]\n", "jobs: [poles]\npoles: {cameras: sample}\n")
    jobs = copy_of_road.stale_rules()
    assert {"use_given_cameras", "measure_poles", "score_cameras"} <= jobs
    assert not {"calibrate_drive", "align_cameras", "segment_images"} & jobs


def test_before_the_drive_is_measured_a_dry_run_says_what_is_open(copy_of_road):
    shutil.rmtree(copy_of_road.folder / "results")
    result = copy_of_road.snakemake("-n")
    assert result.returncode == 0, result.stderr[-3000:]
    told = result.stdout + result.stderr
    assert "profile_drive" in told
    assert "segment_images" not in told
    assert "checkpoint jobs" in told


def test_summary_holds_what_checks_rely_on(finished_road):
    summary = json.loads((finished_road.folder / "results/tiny_road/summary.json").read_text())
    assert "placement" not in summary
    poles = summary["poles"]
    assert poles["images"] >= 25
    assert poles["aligned_images"] >= 0.4 * poles["images"]
    assert poles["poles"] >= 2
    assert poles["sightings"] >= 2 * poles["poles"]
    assert poles["validation"]["geodesic_m"]["mean"] < 2.0
    assert poles["cameras"]["errors"]["yaw_deg"]["median_abs"] < 0.2


def test_poles_open_in_the_right_crs(finished_road):
    folder = finished_road.folder / "results/tiny_road/poles"
    table = pd.read_csv(folder / "poles.csv")
    hazard = pd.read_csv(folder / "hazard.csv")
    points = gpd.read_file(folder / "poles.gpkg", layer="poles")
    points = points[points["kept"]].geometry.get_coordinates()
    for name in ("x", "y"):
        assert table[name].to_numpy() == pytest.approx(points[name].to_numpy(), abs=1e-3)
        assert hazard[name].to_numpy() == pytest.approx(table[name].to_numpy(), abs=1e-3)
    with_poles = ("poles", "ellipses", "rays", "guardrails")
    for layer in (*with_poles, "hazard", "cross_sections", "road_geometry"):
        features = gpd.read_file(folder / "poles.gpkg", layer=layer)
        assert features.crs.to_epsg() == 6543 or "North Carolina (ftUS)" in features.crs.name
    world = gpd.read_file(folder / "poles.geojson")
    assert len(world) == len(table)
    assert world.total_bounds == pytest.approx([-83.16, 35.33, -83.16, 35.33], abs=0.02)
    assert table["latitude"].between(35.3, 35.4).all()
    with rasterio.open(folder / "top.tif") as top:
        assert top.crs is not None
    edges = gpd.read_file(folder / "road_edges.gpkg")
    assert len(edges)
