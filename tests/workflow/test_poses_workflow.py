"""Sensors in poses: their rules enter the DAG only where a plan or a setting asks for them."""

from tests.workflow.test_layer_fields import check_posed

SCENE = {"ingest_cloud", "build_dem", "extract_pavement", "build_surfels", "place_candidates"}


def test_no_rule_of_poses_runs_where_no_sensor_needs_one(finished):
    placement = finished.folder / "results/tiny/placement"
    assert list(placement.glob("round-0/detection/*/*.parquet"))
    assert not list(placement.glob("round-*/poses"))
    assert not list(placement.glob("round-*/depth/panorama*"))


def test_a_plan_of_cameras_adds_panoramas_and_poses_alone(finished):
    stale = finished.stale_rules("--config", "sites=[tiny]", "plans=[camera]")
    assert {"render_depth_maps", "detect_poses", "solve_cover", "render_scans"} <= stale
    assert not stale & (SCENE | {"build_detection_shard"})


def test_turning_spinning_lidars_judges_them_from_panoramas(finished):
    turned = "overrides={poses: {spinning: {pitch_deg: [-10, 0]}}}"
    stale = finished.stale_rules("--config", "sites=[tiny]", turned)
    assert {"render_depth_maps", "detect_poses", "solve_cover"} <= stale
    assert not stale & (SCENE | {"build_detection_shard"})


def test_every_field_of_a_plan_of_cameras_reads_back(copy_of_finished, monkeypatch):
    folder = copy_of_finished.folder
    monkeypatch.chdir(folder)
    result = copy_of_finished.snakemake(
        "--cores", "2", "--config", "sites=[tiny]", "plans=[camera]"
    )
    assert result.returncode == 0, result.stderr[-4000:]
    check_posed(folder / "results/tiny", "camera")
