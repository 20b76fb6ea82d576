import numpy as np
import pytest

from roadsight.poles.sightings.trees import CROWN, NO_TRUNK, TRUNK, Crowns, find_trunks

CELL_M = 0.5


def crown(rng, x, y, per_m2=24.0):
    """Returns above 3.5 m, 3 m in radius."""
    count = int(9 * np.pi * per_m2)
    turn, out = rng.uniform(0, 2 * np.pi, count), 3.0 * np.sqrt(rng.uniform(0, 1, count))
    z = rng.uniform(3.5, 9.0, count)
    return np.column_stack([x + out * np.cos(turn), y + out * np.sin(turn), z])


def stem(rng, x, y, count, radius_m=0.15):
    """Returns on the half of a trunk that faces west."""
    turn = rng.uniform(0.5 * np.pi, 1.5 * np.pi, count)
    z = np.linspace(0.7, 3.4, count)
    return np.column_stack([x + radius_m * np.cos(turn), y + radius_m * np.sin(turn), z])


def ground(rng, per_m2, free=()):
    count = int(20 * 20 * per_m2)
    points = np.column_stack([rng.uniform(-10, 10, (count, 2)), np.zeros(count)])
    for place in free:
        points = points[np.hypot(*(points[:, :2] - place).T) > 0.2]
    return points


def found(*parts, tops=((0.0, 0.0),), cell_m=CELL_M):
    xyz, tops = np.concatenate(parts), np.array(tops)
    cls = np.where(xyz[:, 2] > 0.5, 5, 2).astype(np.uint8)
    crowns = Crowns(tops, np.full(len(tops), 9.0), np.full(len(tops), 6.0))
    return find_trunks(crowns, xyz, xyz[:, 2], cls, cell_m)


@pytest.mark.parametrize(("returns", "per_m2"), [(5, 10), (400, 300)])
def test_a_trunk_is_found_beside_its_crowns_top(rng, returns, per_m2):
    place = (1.1, -0.6)
    parts = ground(rng, per_m2, [place]), crown(rng, 0, 0), stem(rng, *place, returns)
    told = found(*parts)
    assert told.shows.tolist() == [TRUNK]
    assert np.hypot(*(told.xy_m[0] - place)) < 0.2 and 0.05 < told.sigma_m[0] < 0.3
    turned = found(*(part[::-1] for part in parts[::-1]))
    np.testing.assert_array_equal(told.xy_m, turned.xy_m)


def test_a_cloud_without_returns_on_trunks_says_nothing(rng):
    told = found(ground(rng, 10), crown(rng, 0, 0))
    assert told.shows.tolist() == [CROWN] and np.isnan(told.xy_m).all()
    # Returns of a sparse cloud that lie above each other by chance are none.
    place = stem(rng, 0.5, 0.5, 5)
    assert found(ground(rng, 2), crown(rng, 0, 0), place, cell_m=0.7).shows.tolist() == [CROWN]


def test_ground_without_a_gap_says_that_there_is_none(rng):
    told = found(ground(rng, 1500), crown(rng, 0, 0))
    assert told.shows.tolist() == [NO_TRUNK]
    gap = found(ground(rng, 1500, [(0.8, 0.9)]), crown(rng, 0, 0))
    assert gap.shows.tolist() == [CROWN]


def test_walls_hedges_and_low_leaves_are_no_trunks(rng):
    z = rng.uniform(0.6, 3.4, 3000)
    wall = np.column_stack([rng.uniform(-3, 3, 3000), 0.5 + rng.normal(0, 0.03, 3000), z])
    hedge = np.column_stack([rng.uniform(-1, 1, (3000, 2)), z])
    middle = rng.uniform(-3, 3, (40, 3)) * [1, 1, 0.5] + [0, 0, 2.2]
    leaves = (middle[:, None] + rng.normal(0, 0.15, (40, 8, 3))).reshape(-1, 3)
    for thing in (wall, hedge, leaves):
        assert found(ground(rng, 10), crown(rng, 0, 0), thing).shows.tolist() == [CROWN]


def test_a_trunk_is_of_one_tree(rng):
    parts = ground(rng, 10), crown(rng, 0, 0), stem(rng, 0.4, 0.0, 6)
    told = found(*parts, tops=((0.0, 0.0), (1.7, 0.0)))
    assert told.shows.tolist() == [TRUNK, CROWN]
    assert np.isnan(told.xy_m[1]).all() and np.isnan(told.sigma_m[1])
    assert len(found(*parts, tops=np.empty((0, 2))).shows) == 0
