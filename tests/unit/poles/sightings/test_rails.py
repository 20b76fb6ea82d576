import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from roadsight.poles.sightings.rails import find_rail_returns, join_rails


def rail(rng, way, height_m=0.65, per_m=2.5, ground_m=0.0):
    """Returns at random along a way (s, xy) with the scatter of a W-beam."""
    length = np.hypot(*np.diff(way, axis=0).T)
    station = np.concatenate([[0.0], np.cumsum(length)])
    at = np.sort(rng.uniform(0, station[-1], int(per_m * station[-1])))
    at = np.concatenate([[0.0], at, [station[-1]]])
    xy = np.column_stack([np.interp(at, station, way[:, k]) for k in (0, 1)])
    z = rng.uniform(height_m - 0.2, height_m + 0.1, len(at))
    return np.column_stack([xy + rng.normal(0, 0.03, xy.shape), ground_m + z])


def straight(length_m, y=0.0):
    x = np.linspace(0, length_m, 50)
    return np.column_stack([x, np.full(50, y)])


def bend(radius_m, degrees):
    turn = np.radians(np.linspace(0, degrees, 200))
    return radius_m * np.column_stack([np.sin(turn), 1 - np.cos(turn)])


def lines(*parts, cls=None, ground_m=0.0):
    xyz = np.concatenate(parts)
    classes = np.ones(len(xyz), np.uint8) if cls is None else cls
    return join_rails(find_rail_returns(xyz, xyz[:, 2] - ground_m, classes))


def length_of(line):
    return np.hypot(*np.diff(line[:, :2], axis=0).T).sum()


@pytest.mark.parametrize("way", [straight(40), bend(60, 45)], ids=["line", "r60"])
def test_a_rail_is_found_by_length_and_place(rng, way):
    (line,) = lines(rail(rng, way))
    true_m = np.hypot(*np.diff(way, axis=0).T).sum()
    assert length_of(line) == pytest.approx(true_m, abs=1.5)
    off = np.hypot(*(line[:, None, :2] - way[None]).transpose(2, 0, 1)).min(axis=1)
    assert off.max() < 0.5
    assert np.abs(line[:, 2]).max() < 1e-9


def test_two_rails_of_a_road_are_two(rng):
    found = lines(rail(rng, straight(40, -4.5)), rail(rng, straight(30, 4.5)))
    assert sorted(float(line[0, 1]) for line in found) == pytest.approx([-4.5, 4.5], abs=0.2)
    assert sorted(round(length_of(line)) for line in found) == [30, 40]


def test_hedges_walls_vehicles_and_short_things_are_no_rails(rng):
    hedge = rng.uniform([0, -0.8, 0.3], [40, 0.8, 1.0], (1500, 3))
    wall = rng.uniform([0, -0.05, 0.3], [40, 0.05, 2.2], (800, 3))
    car = np.concatenate(
        [rng.uniform([0, y, 0.3], [4.5, y + 0.05, 1.5], (300, 3)) for y in (0, 1.8)]
    )
    assert lines(hedge) == [] and lines(wall) == [] and lines(car) == []
    assert lines(rail(rng, straight(6))) == []
    bushes = rng.uniform([0, 0, 0.4], [40, 40, 1.0], (1500, 3))
    assert lines(bushes) == []


def test_bushes_behind_a_rail_do_not_hide_it(rng):
    bushes = rng.uniform([0, 2.0, 0.4], [40, 8.0, 1.0], (1500, 3))
    (line,) = lines(rail(rng, straight(40)), bushes)
    assert length_of(line) == pytest.approx(40, abs=2.0)


def test_on_a_bridge_heights_count_from_the_deck(rng):
    """The ground is a valley 6 m below, so that the rail is 6.65 m above it."""
    deck = np.column_stack([rng.uniform([0, 0.3], [40, 7.0], (4000, 2)), np.zeros(4000)])
    beam = rail(rng, straight(40))
    cls = np.concatenate([np.full(len(deck), 17), np.ones(len(beam))]).astype(np.uint8)
    (line,) = lines(deck, beam, cls=cls, ground_m=-6.0)
    assert length_of(line) == pytest.approx(40, abs=1.5)
    assert lines(beam, ground_m=-6.0) == []


def test_nothing_gives_nothing():
    assert lines(np.empty((0, 3))) == []


def means_of_cells(points):
    cells = np.floor(points[:, :2] / 0.1).astype(int)
    _, number = np.unique(cells, axis=0, return_inverse=True)
    return np.array([points[number.ravel() == k].mean(axis=0) for k in range(number.max() + 1)])


def direction_by_lists(point, points, above):
    """Direction in which a point is a rail's, or None: the rules one by one, on lists of pairs."""
    near, over = (
        tree[cKDTree(tree[:, :2]).query_ball_point(point[:2], 4.0)][:, :2] - point[:2]
        for tree in (points, above)
    )
    best = (0.0, None)
    for turn in np.arange(48) * np.pi / 48:
        along, across = np.array([np.cos(turn), np.sin(turn)]), [np.sin(turn), -np.cos(turn)]
        off, higher = np.abs(near @ across), np.abs(over @ across)
        on, beside = off <= 0.15, (off >= 0.3) & (off <= 1.0)
        pieces = set(np.floor(near[on] @ along).clip(-4, 3))
        gapless = len(pieces) >= 6 or pieces >= {-4, -3, -2, -1} or pieces >= {0, 1, 2, 3}
        if not gapless or beside.sum() > 0.7 * on.sum() or (higher <= 0.3).sum() > 0.3 * on.sum():
            continue
        score = on.sum() - off[on].sum() / 0.15
        best = max(best, (score, turn), key=lambda one: one[0])
    return best[1]


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([2.5, 20.0, 400.0]), st.sampled_from([1, 20, 300]))
def test_returns_are_those_that_lists_of_pairs_give(seed, rail_per_m, plants_per_m2):
    """Sparse and dense, beside plants that fill all cells, and below something high."""
    rng = np.random.default_rng(seed)
    way = straight(10) @ [[np.cos(seed), np.sin(seed)], [-np.sin(seed), np.cos(seed)]]
    low = np.concatenate(
        [
            rail(rng, way, per_m=rail_per_m),
            rng.uniform([-3, 1, 0.4], [3, 4, 1.0], (18 * plants_per_m2, 3)),
        ]
    )
    high = rng.uniform([2, -4, 1.3], [6, 0, 1.9], (rng.integers(1, 60), 3))
    xyz = np.concatenate([low, high])
    found = find_rail_returns(xyz, xyz[:, 2], np.ones(len(xyz), np.uint8))
    points, above = (means_of_cells(part) for part in (low, high))
    turns = [direction_by_lists(point, points, above) for point in points]
    rails = np.array([turn is not None for turn in turns])
    assert found.xyz_m[:, :2] == pytest.approx(points[rails, :2], abs=1e-9)
    true = np.array([[np.cos(turn), np.sin(turn)] for turn in turns if turn is not None])
    assert found.direction == pytest.approx(true.reshape(-1, 2), abs=1e-9)


def test_memory_goes_with_returns_and_not_with_pairs(rng):
    find = find_rail_returns
    plants = rng.uniform([0, 0, 0.4], [15, 15, 1.0], (9000, 3))
    cls = np.ones(len(plants), np.uint8)
    find(plants[:10], plants[:10, 2], cls[:10])  # compiles
    tracemalloc.start()
    find(plants, plants[:, 2], cls)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 500 * len(plants)
