"""The whole pole job on a tiny lane that is moved, turned, mirrored, shuffled, in feet or tiles."""

from dataclasses import replace

import numpy as np
import pytest

from roadsight.geometry.cameras import wrap_deg
from tests.properties.poles_job import PolesJob, make_lane

pytestmark = [pytest.mark.full, pytest.mark.xdist_group("poles_job")]


@pytest.fixture(scope="module")
def scene():
    return make_lane()


@pytest.fixture(scope="module")
def lane(scene):
    return scene[0]


@pytest.fixture(scope="module")
def here(scene, tmp_path_factory):
    lane, shown = scene
    return PolesJob(tmp_path_factory.mktemp("job") / "here", shown).run(lane)


@pytest.fixture
def run(scene, tmp_path):
    """Function that runs the job on a changed lane."""
    return lambda lane, **options: PolesJob(tmp_path / "job", scene[1], **options).run(lane)


def assert_same(job, changed, here, lane, matrix=None, apart_m=0.03, turn_deg=0.1):
    """The same poles at the same places, and the same cameras but for what the move turns."""
    move = np.eye(2) if matrix is None else np.asarray(matrix, float)
    found, expected = job.poles(changed), here.poles(lane) @ move.T
    assert len(found) == len(expected)
    assert np.hypot(*(found - expected).T).max() <= apart_m
    assert (job.cameras["accepted"] == here.cameras["accepted"]).all()
    heading = np.radians(here.cameras["heading_deg"])
    way = np.column_stack([np.sin(heading), np.cos(heading)]) @ move.T
    turned = np.degrees(np.arctan2(*way.T))
    assert np.abs(wrap_deg(job.cameras["heading_deg"] - turned)).max() <= turn_deg


def test_the_lane_has_poles_to_find(here, lane):
    """Else the tests below would show nothing."""
    assert here.cameras["accepted"].mean() > 0.9
    found = here.poles(lane)
    assert len(found) >= 7
    gaps = np.hypot(*(found[:, None] - lane.poles).transpose(2, 0, 1)).min(axis=1)
    assert gaps.max() < 0.05


@pytest.mark.parametrize("east_m", [500_000.5, 5_500_000.0])
def test_moving_the_map_keeps_the_poles(run, lane, here, east_m):
    """By half a metre and by 5,000 km; voxels are anchored in the map, so edges move in them."""
    moved = replace(lane, east_m=east_m)
    assert_same(run(moved), moved, here, lane)


def test_order_tiles_and_shards_keep_the_poles(run, lane, here):
    """To a micrometre: whole numbers are summed wherever the order of points could tell."""
    order = np.random.default_rng(4).permutation(len(lane.xyz))
    job = run(lane.rows(order), tile_size_m=48.0, shards=3)
    assert_same(job, lane, here, lane, apart_m=1e-6, turn_deg=1e-6)


@pytest.mark.parametrize("images", [2, 5])
def test_a_drive_of_fewer_images_than_shards(tmp_path, images):
    """Each shard has an image at most, and every stage takes those without."""
    lane, shown = make_lane(images=images)
    job = PolesJob(tmp_path / "job", shown, shards=7).run(lane)
    assert job.cameras["image"].tolist() == [f"i{number:03d}.png" for number in range(images)]
    assert job.cameras["accepted"].all()
    assert len(job.poles(lane)) >= 1


def test_repeated_points_keep_the_poles(run, lane, here):
    rows = np.concatenate([np.arange(len(lane.xyz)), np.arange(0, len(lane.xyz), 7)])
    assert_same(run(lane.rows(rows)), lane, here, lane)


def test_feet_keep_the_poles(run, lane, here):
    """US survey feet in plan and height; voxels stay 0.3048 m."""
    feet = replace(lane, units="us-ft")
    assert_same(run(feet), feet, here, lane)


def test_turning_the_lane_turns_the_poles(run, lane, here):
    """The raster's cells lie across the road at another angle."""
    cosine, sine = np.cos(np.radians(33.0)), np.sin(np.radians(33.0))
    matrix = [[cosine, -sine], [sine, cosine]]
    turned = lane.turned(matrix)
    assert_same(run(turned), turned, here, lane, matrix, apart_m=0.05, turn_deg=0.2)


def test_mirroring_the_lane_mirrors_the_poles(run, lane, here):
    """Images and cloud are exchanged left and right."""
    matrix = np.diag([-1.0, 1.0])
    mirrored = lane.turned(matrix)
    assert_same(run(mirrored), mirrored, here, lane, matrix, apart_m=0.05, turn_deg=0.2)
