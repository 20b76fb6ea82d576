"""What is drawn and saved in the studio makes exactly what depends on it stale."""

import re

from roadsight.studio.drawing import Drawing, load_drawing, save_drawing
from roadsight.studio.drive_views import SiteDrive
from roadsight.studio.pole_review import Decision, review, save_decisions
from roadsight.studio.project import Project
from roadsight.studio.registering import PoseBody, save_correction
from tests.workflow.test_small_changes import after_detection


def saved(checkout, monkeypatch, **layers):
    """Save layers of the small site as the studio does."""
    monkeypatch.chdir(checkout.folder)
    return save_drawing(Project(checkout.folder), "tiny", Drawing.model_validate(layers))


def drawn(checkout, monkeypatch):
    monkeypatch.chdir(checkout.folder)
    return load_drawing(Project(checkout.folder).site("tiny"))


def test_saved_edges_make_the_edges_and_what_follows_stale(copy_of_finished, monkeypatch):
    edges = drawn(copy_of_finished, monkeypatch)["edges"]
    edges[0]["points"][1][0] += 0.5
    assert "config/sites/tiny/edges.geojson" in saved(copy_of_finished, monkeypatch, edges=edges)
    expected = copy_of_finished.after("build_edges") | {"match_inputs"}
    assert copy_of_finished.stale_rules() == expected


def test_saved_zones_make_the_covers_and_what_follows_stale(copy_of_finished, monkeypatch):
    x, y = drawn(copy_of_finished, monkeypatch)["edges"][0]["points"][0]
    zone = {"name": "z", "points": [[x, y], [x + 9, y], [x + 9, y + 9], [x, y + 9]]}
    saved(copy_of_finished, monkeypatch, zones=[zone])
    assert copy_of_finished.stale_rules() == after_detection(copy_of_finished) | {"match_inputs"}
    saved(copy_of_finished, monkeypatch, zones=[])
    assert copy_of_finished.stale_rules() == set()


def test_a_corrected_image_makes_its_shard_stale_alone(copy_of_road, monkeypatch):
    monkeypatch.chdir(copy_of_road.folder)
    project = Project(copy_of_road.folder)
    drive = SiteDrive(project.site(copy_of_road.site))
    pose = PoseBody.model_validate(drive.expected(drive.place(3)))
    assert len(save_correction(project, drive, 3, pose)) == 2
    result = copy_of_road.snakemake("-n")
    output = result.stdout + result.stderr
    assert re.search(r"^align_cameras +1$", output, re.MULTILINE), output
    for rule in ("segment_images", "calibrate_drive", "trace_image_edges", "ingest_cloud"):
        assert not re.search(rf"^{rule} +\d+$", output, re.MULTILINE)


def test_decisions_on_poles_make_the_poles_and_what_follows_stale(copy_of_road, monkeypatch):
    monkeypatch.chdir(copy_of_road.folder)
    project = Project(copy_of_road.folder)
    pole = next(one for one in review(project.site("tiny_road"))["poles"] if one["kept"])
    x, y = pole["base"]
    asked = Decision(decision="reject", kind=pole["kind"], x=x, y=y, pole=pole["id"])
    save_decisions(project, "tiny_road", [asked])
    assert copy_of_road.stale_rules() == copy_of_road.after("triangulate_poles")
    result = copy_of_road.snakemake("--cores", "2", "results/tiny_road/poles/hazard.parquet")
    assert result.returncode == 0, result.stdout + result.stderr
    found = next(one for one in review(project.site("tiny_road"))["poles"] if one["decision"] == 0)
    assert not found["kept"] and found["reason"] == "rejected by a person"
    save_decisions(project, "tiny_road", [])
    assert "triangulate_poles" in copy_of_road.stale_rules()


def test_corrections_of_no_image_of_a_sample_are_refused(copy_of_road, monkeypatch):
    monkeypatch.chdir(copy_of_road.folder)
    project = Project(copy_of_road.folder)
    drive = SiteDrive(project.site(copy_of_road.site))
    pose = PoseBody.model_validate(drive.expected(drive.place(3)))
    save_correction(project, drive, 3, pose)
    table = copy_of_road.folder / "config/sites/tiny_road/corrections.csv"
    table.write_text(table.read_text().replace("sr1427e_", "sr9999e_"))
    result = copy_of_road.snakemake("-n")
    assert result.returncode != 0
    assert (
        "it names sr9999e_0004.jpg, the videolog sr1427e_0001.jpg" in result.stdout + result.stderr
    )
