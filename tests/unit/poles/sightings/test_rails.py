from __future__ import annotations

import numpy as np
import pytest

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
