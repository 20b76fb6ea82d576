"""The pole job as a workflow: what it leaves behind, and what makes which rules stale."""

import json
import shutil

import geopandas as gpd
import pandas as pd
import pytest
import rasterio

from tests.workflow.conftest import Checkout, with_followers

# Who reads whose outputs, written down here on purpose and not taken from the rules.
READERS = {
    "generate_rural": {
        "ingest_cloud",
        "read_videolog",
        "score_cameras",
        "validate_poles",
        "summarise_site",
    },
    "render_videolog": {
        "read_videolog",
        "profile_drive",
        "segment_images",
        "estimate_depth",
        "match_images",
        "write_poles_page",
    },
    "ingest_cloud": {
        "profile_scene",
        "profile_drive",
        "plan_effects",
        "build_dem",
        "rasterise_lidar",
        "extract_road_edges",
        "find_pole_columns",
        "build_terrain",
        "read_videolog",
        "calibrate_drive",
        "align_cameras",
        "score_cameras",
        "measure_poles",
        "triangulate_poles",
        "rate_hazard",
        "validate_poles",
        "summarise_site",
        "write_poles_page",
        "write_handover",
    },
    "profile_scene": {"build_dem", "plan_effects", "summarise_site"},
    "plan_effects": {"summarise_site"},
    # What it measures decides on these.
    "profile_drive": {
        "plan_effects",
        "segment_images",
        "estimate_depth",
        "trace_image_edges",
        "trace_pole_axes",
        "match_images",
        "calibrate_drive",
        "align_cameras",
        "turn_side_views",
        "measure_poles",
        "rate_hazard",
        "score_cameras",
        "summarise_site",
        "write_poles_page",
    },
    "build_dem": {
        "rasterise_lidar",
        "profile_drive",
        "find_pole_columns",
        "read_videolog",
        "calibrate_drive",
        "align_cameras",
        "measure_poles",
        "triangulate_poles",
        "rate_hazard",
        "write_poles_page",
        "write_handover",
    },
    "rasterise_lidar": {
        "extract_road_edges",
        "read_videolog",
        "triangulate_poles",
        "write_poles_page",
    },
    "extract_road_edges": {
        "calibrate_drive",
        "align_cameras",
        "score_cameras",
        "rate_hazard",
        "validate_poles",
        "write_poles_page",
        "write_handover",
    },
    "find_pole_columns": {"calibrate_drive", "align_cameras", "measure_poles"},
    "build_terrain": {"calibrate_drive", "align_cameras"},
    "read_videolog": {
        "profile_drive",
        "segment_images",
        "estimate_depth",
        "trace_image_edges",
        "trace_pole_axes",
        "match_images",
        "calibrate_drive",
        "align_cameras",
        "turn_side_views",
        "measure_poles",
        "rate_hazard",
        "validate_poles",
        "summarise_site",
        "write_poles_page",
    },
    "segment_images": {"trace_image_edges", "trace_pole_axes", "measure_poles", "write_poles_page"},
    "estimate_depth": {"measure_poles", "write_poles_page"},
    "trace_image_edges": {"calibrate_drive", "align_cameras", "write_poles_page"},
    "trace_pole_axes": {"calibrate_drive", "align_cameras"},
    "match_images": {"calibrate_drive"},
    "calibrate_drive": {"align_cameras", "turn_side_views", "measure_poles"},
    "align_cameras": {
        "score_cameras",
        "turn_side_views",
        "measure_poles",
        "summarise_site",
        "write_poles_page",
    },
    "turn_side_views": {"measure_poles"},
    "score_cameras": {"summarise_site"},
    "measure_poles": {"triangulate_poles", "summarise_site", "write_poles_page"},
    "triangulate_poles": {"rate_hazard", "validate_poles", "summarise_site", "write_poles_page"},
    "rate_hazard": {"write_poles_page", "write_handover", "summarise_site"},
    "validate_poles": {"summarise_site", "write_poles_page"},
    "summarise_site": {"write_poles_page"},
    "write_poles_page": {"write_report", "write_pdf"},
    "write_pdf": {"write_report"},
    "write_handover": {"write_report"},
    "write_report": set(),
}


def after(*rules: str) -> set[str]:
    return with_followers(READERS, *rules)


SITE = "config/sites/tiny_road.yaml"
SETTINGS = [
    ("voxels: {voxel_size_m: 0.5}", after("rasterise_lidar")),
    ("road_edges: {smoothing_m: 0.8}", after("extract_road_edges")),
    ("videolog: {heading_images: 2}", after("read_videolog")),
    ("networks: {image_height_px: 256}", after("segment_images", "estimate_depth")),
    ("image_edges: {gap_px: 5}", after("trace_image_edges")),
    ("calibration: {images: 50}", after("calibrate_drive")),
    ("alignment: {ties: skip}", after("calibrate_drive")),
    ("alignment: {max_residual_px: 3}", after("align_cameras")),
    ("alignment: {bound_m: 0.5}", after("align_cameras")),
    ("effects: {terrain_occlusion: skip}", {"plan_effects"} | after("calibrate_drive")),
    (
        "effects: {side_views: skip}",
        {"plan_effects"} | after("segment_images", "estimate_depth") - {"turn_side_views"},
    ),
    ("effects: {grid_convergence: skip}", {"plan_effects"} | after("measure_poles")),
    ("effects: {scale_factor: simulate}", {"plan_effects"} | after("rate_hazard")),
    ("sightings: {farthest_m: 50}", after("measure_poles")),
    ("triangulation: {min_views: 4}", after("triangulate_poles")),
    ("triangulation: {sequence_m: 20}", after("triangulate_poles")),
    ("hazard: {aadt: 900}", after("rate_hazard")),
    ("hazard: {section_every_m: 50}", after("rate_hazard")),
]
MODULES = [
    ("roadsight/poles/images/lanes.py", after("trace_image_edges", "measure_poles")),
    ("roadsight/poles/triangulate/site.py", after("triangulate_poles")),
    ("roadsight/poles/risk/hazard.py", after("rate_hazard")),
    ("roadsight/stages/poles/shared/hazard_layers.py", after("rate_hazard")),
    # The profile measures how much of the road the terrain hides.
    ("roadsight/scene/terrain/tin.py", after("build_terrain", "plan_effects") | {"profile_drive"}),
    ("roadsight/poles/images/plumb_line.py", after("profile_drive")),
    ("roadsight/poles/calibration/calibration_landmarks.py", after("calibrate_drive")),
    ("roadsight/effects/quantities.py", after("plan_effects")),
    ("roadsight/poles/alignment/published.py", after("align_cameras")),
    ("roadsight_worlds/rendering/rendering_look.py", after("render_videolog")),
    ("roadsight/commands/triangulate.py", set()),
]


def check(checkout: Checkout, expected: set[str]) -> None:
    """That a dry run plans exactly what is expected, with the drive's last decisions.

    Where only the drive is measured anew, what hangs on its effects follows another decision alone.
    """
    measured_only = expected == after("profile_drive")
    by_data = {"profile_drive"} | after("plan_effects") if measured_only else expected
    assert checkout.stale_rules() == by_data


def remark(checkout: Checkout, module: str) -> None:
    """Edit a module without changing what it does."""
    path = checkout.folder / "workflow" / module
    path.write_text(path.read_text() + "\n# a remark\n")


def test_finished_run_leaves_nothing_to_do(finished_road):
    assert finished_road.stale_rules() == set()


@pytest.mark.parametrize(("setting", "expected"), SETTINGS, ids=[s[0] for s in SETTINGS])
def test_setting(copy_of_road, setting, expected):
    copy_of_road.edit(SITE, "  shards: 2\n", f"  shards: 2\n  {setting}\n")
    # Every setting is on record in the summary, so the summary and the report follow it too.
    check(copy_of_road, expected | after("summarise_site"))


@pytest.mark.parametrize(("module", "expected"), MODULES, ids=[m[0] for m in MODULES])
def test_editing_a_module_re_runs_its_users_only(copy_of_road, module, expected):
    remark(copy_of_road, module)
    check(copy_of_road, expected)


def test_skipped_landmarks_are_not_in_the_dag(copy_of_road):
    remark(copy_of_road, "roadsight/stages/poles/trace_pole_axes.py")
    assert "trace_pole_axes" in copy_of_road.stale_rules()
    jobs = jobs_after(copy_of_road, "alignment: {landmarks: skip}")
    assert "calibrate_drive" in jobs
    assert "trace_pole_axes" not in jobs


def test_skipped_ties_are_not_in_the_dag(copy_of_road):
    remark(copy_of_road, "roadsight/stages/poles/match_images.py")
    assert "match_images" in copy_of_road.stale_rules()
    jobs = jobs_after(copy_of_road, "alignment: {ties: skip}")
    assert "calibrate_drive" in jobs
    assert not {"match_images", "trace_pole_axes", "segment_images"} & jobs


def jobs_after(checkout: Checkout, setting: str) -> set[str]:
    """Rules that a setting makes stale or adds."""
    checkout.edit(SITE, "  shards: 2\n", f"  shards: 2\n  {setting}\n")
    return checkout.stale_rules()


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


def test_skipped_terrain_is_not_triangulated(copy_of_road):
    remark(copy_of_road, "roadsight/scene/terrain/tin.py")
    assert "build_terrain" in copy_of_road.stale_rules()
    jobs = jobs_after(copy_of_road, "effects: {terrain_occlusion: skip}")
    assert "calibrate_drive" in jobs
    assert "build_terrain" not in jobs


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
