"""The whole placement job on a tiny street that is moved, turned, shuffled, in feet, in tiles."""

from dataclasses import replace

import numpy as np
import pytest

from roadsight.io.records.tables import read_table
from tests.properties.placement_job import PlacementJob, make_street

pytestmark = [pytest.mark.full, pytest.mark.xdist_group("placement_job")]
FEET = 3937 / 1200


@pytest.fixture(scope="module")
def street():
    return make_street()


@pytest.fixture(scope="module")
def here(street, tmp_path_factory):
    return PlacementJob(tmp_path_factory.mktemp("job") / "here").run(street)


def targets(job):
    return read_table(job.path("targets"))


def assert_same(job, here, apart_m=0.002):
    """The same sensors at the same places, the same targets, the same proof."""
    assert job.chosen == here.chosen
    np.testing.assert_allclose(job.places_m, here.places_m.loc[job.places_m.index], atol=apart_m)
    assert targets(job)["target"].tolist() == targets(here)["target"].tolist()
    for name in ("status", "objective", "bound", "covered_targets"):
        assert job.solution[name] == here.solution[name]


def assert_alike(job, here):
    """Cells elsewhere on the road: as many sensors, give or take one, and targets within 3 %."""
    assert job.solution["status"] == here.solution["status"] == "optimal"
    assert abs(job.solution["objective"] - here.solution["objective"]) <= 1
    assert job.solution["targets"] == pytest.approx(here.solution["targets"], rel=0.03)
    share = [one.solution["covered_targets"] / one.solution["targets"] for one in (job, here)]
    assert share[0] == pytest.approx(share[1], abs=0.02)


def test_the_street_needs_a_choice(here):
    """Else the tests below would show nothing."""
    assert here.solution["status"] == "optimal"
    assert 2 <= here.solution["objective"] < len(here.places_m) / 4
    assert here.solution["covered_targets"] > 200


@pytest.mark.parametrize(
    "shift", [(0.5, 0.5), (5_000_000.0, -4_999_999.5), (-632_000.25, 4_123_000.125)]
)
def test_moving_the_map_changes_nothing(street, here, tmp_path, shift):
    """The local origin is the cloud's least corner, wherever that lies: the same to the digit."""
    job = PlacementJob(tmp_path / "job").run(street.moved(np.eye(2), shift))
    assert_same(job, here)


def test_other_tiles_and_shards_change_nothing(street, here, tmp_path):
    assert_same(PlacementJob(tmp_path / "job", tile_size_m=16.0, shards=3).run(street), here)


def test_the_order_of_the_points_changes_nothing(street, here, tmp_path):
    order = np.random.default_rng(3).permutation(len(street.xyz))
    assert_same(PlacementJob(tmp_path / "job").run(street.rows(order)), here)


def test_feet_change_only_ties(street, here, tmp_path):
    """US survey feet, written to a ten-thousandth, which moves points by up to 0.015 mm.

    That takes points off the faces of cells, on which many of a cloud in whole millimetres lie, so
    that among equally good sets of sensors another one may come first.
    """
    edges = {name: line * FEET for name, line in street.edges.items()}
    feet = replace(street, xyz=street.xyz * FEET, edges=edges, units="us-survey-foot", scale=0.0001)
    job = PlacementJob(tmp_path / "job").run(feet)
    assert_alike(job, here)
    assert job.solution["objective"] == here.solution["objective"]
    np.testing.assert_allclose(job.places_m, here.places_m.loc[job.places_m.index], atol=0.01)


def test_repeated_points_change_little(street, here, tmp_path):
    """Every tenth point twice: the cloud looks denser, so a few more cells hold a target."""
    rows = np.concatenate([np.arange(len(street.xyz)), np.arange(0, len(street.xyz), 10)])
    assert_alike(PlacementJob(tmp_path / "job").run(street.rows(rows)), here)


def test_mirrored_left_and_right(street, here, tmp_path):
    """The grids of ground, pavement and targets start at the other side of the road."""
    assert_alike(PlacementJob(tmp_path / "job").run(street.moved(np.diag([1.0, -1.0]))), here)


def test_turned_about_the_vertical(street, here, tmp_path):
    """All grids lie across the road at another angle."""
    cosine, sine = np.cos(np.radians(33.0)), np.sin(np.radians(33.0))
    turned = street.moved([[cosine, -sine], [sine, cosine]])
    assert_alike(PlacementJob(tmp_path / "job").run(turned), here)
