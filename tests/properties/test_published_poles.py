"""The pole job as published, by `config/published.yaml`, on a small lane to its end."""

import numpy as np
import pytest

from roadsight.base.sections.poles import Triangulation
from roadsight.evidence.studies import load_overrides
from roadsight.io.records.tables import read_about, read_table
from roadsight.poles.risk.validation import score_thresholds
from tests.conftest import PROJECT
from tests.properties.poles_job import LENS, PolesJob, make_lane

pytestmark = pytest.mark.xdist_group("poles_job")
PUBLISHED = str(PROJECT / "config/published.yaml")


@pytest.fixture(scope="module")
def lane_and_job(tmp_path_factory):
    lane, shown = make_lane()
    folder = tmp_path_factory.mktemp("job") / "published"
    return lane, PolesJob(folder, shown, settings=load_overrides(PUBLISHED)).run(lane)


def test_the_named_configuration_is_the_published_one():
    """Each setting is known, and those of the study have its numbers."""
    found = load_overrides(PUBLISHED)
    assert found["alignment"]["method"] == "published"
    assert found["sightings"]["side_views"] == "stitched"
    sweep = Triangulation(**found["triangulation"])
    assert 1.0 - sweep.depth_weight - sweep.spread_weight == pytest.approx(0.78)
    assert sweep.sweep_distance_m == 25.0


def test_the_job_runs_to_its_end(lane_and_job):
    _, job = lane_and_job
    cameras = job.cameras
    assert cameras["accepted"].all()
    np.testing.assert_allclose(cameras["focal_px"], LENS.focal_px)
    sightings = read_table(job.path("sightings0"))
    kept = sightings[sightings["kept"]]
    assert (kept["method"] == "lidar").all()
    assert (kept["depth_from"] == "network").all()
    assert kept["sigma_depth_m"].isna().all()
    assert kept["depth_m"].max() <= 50.0
    frames = read_table(job.path("frames")).set_index("image")
    np.testing.assert_allclose(kept["x"], frames.loc[kept["image"], "x"])
    assert read_about(job.path("poles"))["method"] == "sweep"


def test_poles_that_two_images_show_within_25_m_are_found(lane_and_job):
    """Three of the ten (F1 0.46 at 3 m); of each other, at most one image within 25 m shows it."""
    lane, job = lane_and_job
    (row,) = score_thresholds(job.poles(lane), lane.poles, (3,))
    assert row["precision"] == 1.0
    assert row["recall"] == pytest.approx(0.3)
    poles = read_table(job.path("poles"))
    assert poles["sigma_major_m"].isna().all()
    assert (poles["score"] >= 2).all()
