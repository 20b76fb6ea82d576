import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from roadsight.placement.plans.acceptance import Target, lost_targets, planned_scan, register

PLACE_M = np.array([3.0, 2.0, 6.0])
STEP_DEG = np.array([1.0, 1.0])
POLE = Target(0.25, 0.6, 8)


def scan(position_m, boxes, rotation=None):
    """Returns of a sensor (rows and columns of 1 degree) on level ground with boxes."""
    azimuth, elevation = np.meshgrid(np.arange(-180, 180), np.arange(-45, 11))
    azimuth, elevation = np.radians(azimuth.ravel()), np.radians(elevation.ravel())
    level = np.cos(elevation)
    rays = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    rays = rays if rotation is None else rays @ rotation.T
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(rays[:, 2] < 0, -position_m[2] / rays[:, 2], np.inf)
        for low, high in boxes:
            one, two = ((np.array(end) - position_m) / rays for end in (low, high))
            near = np.minimum(one, two).max(axis=1)
            far = np.maximum(one, two).min(axis=1)
            reach = np.where((near <= far) & (near > 0), np.minimum(reach, near), reach)
    found = reach < 60
    return position_m + reach[found, None] * rays[found]


def street(seed):
    """A wall with a step, houses and poles; another seed, another street."""
    rng = np.random.default_rng(seed)
    boxes = [((-30, 12, 0), (30, 13, 4)), ((5, -15, 0), (20, -14, 9)), ((22, 0, 0), (23, 10, 5))]
    if seed:
        boxes = [((-7, -30, 0), (-6, 30, 8)), ((5, -30, 0), (6, 30, 5)), ((-3, 8, 0), (3, 9, 4))]
    for x, y in rng.uniform(-25, 25, (12, 2)):
        boxes.append(((x, y, 0), (x + 0.6, y + 0.6, 5)))
    return boxes


@pytest.mark.parametrize(
    ("moved_m", "turned_deg"),
    [((0, 0, 0), (0, 0, 0)), ((0.15, -0.1, 0.05), (2.0, 0.6, -0.4)), ((0.4, 0.3, 0), (130, 1, 0))],
)
def test_a_known_pose_is_found_with_noise_and_a_truck(moved_m, turned_deg):
    boxes = street(0)
    planned = planned_scan(scan(PLACE_M, boxes), PLACE_M, STEP_DEG)
    turn = Rotation.from_euler("ZYX", turned_deg, degrees=True).as_matrix()
    position_m = PLACE_M + np.array(moved_m)
    truck = ((-12, 4, 0), (-4, 7, 3.5))
    measured = scan(position_m, [*boxes[:-2], truck], turn)
    rng = np.random.default_rng(1)
    measured = (measured + rng.normal(0, 0.02, measured.shape))[rng.random(len(measured)) < 0.8]
    as_placed = (measured - position_m) @ turn + PLACE_M  # as if it stood as planned
    found = register(as_placed, planned)
    np.testing.assert_allclose(found.rotation @ PLACE_M + found.shift_m, position_m, atol=0.02)
    off = Rotation.from_matrix(found.rotation @ turn.T).magnitude()
    assert np.degrees(off) < 0.1
    assert 0.75 < found.share < 0.99
    assert found.same_place
    feet = np.array([[-9.0, 8.2, 0.0], [8.0, -6.0, 0.0], [4.0, 8.0, 0.0]])
    placed = as_placed @ found.rotation.T + found.shift_m
    seen, lost = lost_targets(planned, placed, position_m, feet, Target(0.5, 1.0, 8))
    assert seen.tolist() == [True, True, True]
    assert lost.tolist() == [True, False, False]


def test_a_scan_of_another_place_does_not_agree():
    planned = planned_scan(scan(PLACE_M, street(0)), PLACE_M, STEP_DEG)
    other = np.array([0.0, 0.0, 7.5])
    found = register(scan(other, street(3)) - other + PLACE_M, planned)
    assert not found.same_place


def test_scans_with_next_to_nothing_agree_with_nothing():
    planned = planned_scan(scan(PLACE_M, street(0)), PLACE_M, STEP_DEG)
    nothing = np.empty((0, 3))
    assert register(nothing, planned).share == 0.0
    assert register(np.zeros((5, 3)), planned).share == 0.0
    empty = planned_scan(nothing, PLACE_M)
    assert register(planned.xyz_m, empty).share == 0.0
    assert lost_targets(planned, nothing, PLACE_M, np.empty((0, 3)), POLE)[0].shape == (0,)


def test_what_is_seen_and_lost_follows_the_targets_that_the_plan_asks_for():
    whole = scan(PLACE_M, street(0))
    planned = planned_scan(whole, PLACE_M, STEP_DEG)
    feet = np.array([[-4.0, 6.0, 0.0], [4.0, 8.0, 0.0], [-20.0, 5.0, 0.0]])

    def seen(*target):
        return lost_targets(planned, whole, PLACE_M, feet, Target(*target))[0].sum()

    assert seen(0.25, 0.6, 8) < seen(0.25, 0.6, 0) <= seen(0.6, 2.0, 0)
    assert seen(0.6, 2.0, 8) > seen(0.25, 0.6, 8) > seen(0.25, 0.6, 200) == 0
    # One beam that comes back is enough where the plan asks for no more.
    seen_by_one, lost = lost_targets(planned, whole, PLACE_M, feet, Target(0.05, 0.6, 0))
    assert not (seen_by_one & lost).any()
