import numpy as np
import pytest

from roadsight.base.sections.poles import Columns
from roadsight.poles.sightings.lidar_poles import (
    _NOISE_M,
    _RADII_M,
    _SPREAD_OF_RADII_M,
    _USUAL_RADIUS_M,
    NO_COLUMN,
    _hangs,
    find_pole_columns,
    stem_axis,
)

CELL = 0.3


def columns(*parts: np.ndarray, cls: int = 1):
    xyz = np.unique(np.floor(np.concatenate(parts) / CELL), axis=0) * CELL + CELL / 2
    return find_pole_columns(xyz, xyz[:, 2], np.full(len(xyz), cls, np.uint8))


def pole(x: float, y: float, height: float = 9.0) -> np.ndarray:
    z = np.arange(0, height, 0.25)
    return np.column_stack([np.full(len(z), x), np.full(len(z), y), z])


def wire(y: float, z: float) -> np.ndarray:
    x = np.arange(-30, 30, 0.3)
    return np.column_stack([x, np.full(len(x), y), np.full(len(x), z)])


def crown(rng: np.random.Generator, x: float, y: float) -> np.ndarray:
    return rng.normal([x, y, 6.0], [1.5, 1.5, 1.5], (4000, 3)).clip(min=[-99, -99, 1.5])


def test_poles_are_found_where_they_stand(rng):
    found = columns(pole(0, 0), pole(10, 3, 7.0), wire(0, 8.5), wire(0.6, 8.4))
    order = np.argsort(found.xy_m[:, 0])
    assert len(found) == 2
    assert np.abs(found.xy_m[order] - [[0, 0], [10, 3]]).max() < 0.3
    assert found.top_m[order] == pytest.approx([9.0, 7.0], abs=0.6)
    assert found.sigma_m.max() < 0.2


def test_trees_wires_walls_and_low_things_are_no_poles(rng):
    wall = np.stack(np.meshgrid(np.arange(0, 10, 0.25), [40.0], np.arange(0, 6, 0.25)), -1)
    assert len(columns(crown(rng, 0, 0))) == 0
    assert len(columns(wire(0, 8.0))) == 0
    assert len(columns(wall.reshape(-1, 3))) == 0
    assert len(columns(pole(0, 0, 2.5))) == 0


@pytest.mark.parametrize("cls", [0, 1, 5, 6, 14, 15, 64])
def test_returns_of_any_class_but_ground_noise_water_and_road_make_a_column(cls):
    assert len(columns(pole(0, 0), cls=cls)) == 1


@pytest.mark.parametrize("cls", NO_COLUMN)
def test_ground_noise_water_and_road_make_none(cls):
    assert len(columns(pole(0, 0), cls=cls)) == 0


def test_nothing_known_gives_nothing():
    empty = find_pole_columns(np.empty((0, 3)), np.empty(0), np.empty(0, np.uint8))
    assert len(empty) == 0
    xyz = pole(0, 0)
    unknown = find_pole_columns(xyz, np.full(len(xyz), np.nan), np.ones(len(xyz), np.uint8))
    assert len(unknown) == 0


def test_order_of_the_voxels_does_not_matter(rng):
    xyz = np.concatenate([pole(0.1, 0.1), pole(8.2, 1.1), wire(0, 8.0), crown(rng, 20, 20)])
    cls = np.ones(len(xyz), np.uint8)
    a = find_pole_columns(xyz, xyz[:, 2], cls)
    order = rng.permutation(len(xyz))
    b = find_pole_columns(xyz[order], xyz[order, 2], cls)
    assert len(a) == 2
    assert np.allclose(a.xy_m, b.xy_m)


def test_axis_of_a_stem_seen_from_one_side(rng):
    """The mean of the returns would be 9 cm off; sigmas are honest."""
    errors, sigmas = [], []
    for _ in range(40):
        angle = rng.uniform(-np.pi / 2, np.pi / 2, 12)
        hits = 0.14 * np.column_stack([np.cos(angle), np.sin(angle)]) + rng.normal(
            0, 0.025, (12, 2)
        )
        xy, sigma, used = stem_axis(hits + np.array([5.0, -3.0]))
        errors.append(xy - [5.0, -3.0])
        sigmas.append(sigma)
    assert np.sqrt(np.mean(np.square(errors))) < 0.05
    assert 0.5 < np.sqrt(np.mean((np.array(errors) / np.array(sigmas)[:, None]) ** 2)) < 1.5
    assert used >= 8


@pytest.mark.parametrize("noise_m", [0.02, 0.035])
def test_errors_of_axes_are_as_their_sigmas_say(noise_m):
    """Stems of 7 to 19 cm seen from one side, by scanners whose noise nobody stated."""
    rng, squared = np.random.default_rng(5), []
    for count in np.tile([4, 8, 12], 50):
        angle = rng.uniform(0, 2 * np.pi) + rng.uniform(-1.4, 1.4, count)
        hits = rng.uniform(0.07, 0.19) * np.column_stack([np.cos(angle), np.sin(angle)])
        xy, sigma, _ = stem_axis(hits + rng.normal(0, noise_m, hits.shape))
        squared.append(xy @ xy / sigma**2)
    within = [np.mean(np.array(squared) < limit) for limit in (1.0, 5.99)]
    assert 0.3 < within[0] < 0.75
    assert within[1] > 0.9


@pytest.mark.parametrize("count", [2, 3, 4])
def test_one_ellipse_cannot_hold_what_few_returns_leave_open(count):
    """Even of stems that the prior itself draws: two places fit, and one Gaussian is wide for both.

    `docs/decisions/018-poles-are-landmarks.md`.
    """
    rng, squared = np.random.default_rng(count), []
    likely = np.exp(-0.5 * ((_RADII_M - _USUAL_RADIUS_M) / _SPREAD_OF_RADII_M) ** 2)
    for _ in range(150):
        radius, noise = rng.choice(_RADII_M, p=likely / likely.sum()), rng.choice(_NOISE_M)
        angle = rng.uniform(0, 2 * np.pi) + rng.uniform(-np.pi / 2, np.pi / 2, count)
        away = radius + rng.normal(0, noise, count)
        xy, sigma, _ = stem_axis(away[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
        squared.append(xy @ xy / sigma**2)
    within = [np.mean(np.array(squared) < limit) for limit in (1.0, 5.99)]
    assert 0.45 < within[0] < 0.75
    assert within[1] > 0.95


def test_many_returns_place_a_stem_as_some_do_and_are_all_counted(rng):
    angle = rng.uniform(0, 2 * np.pi, 20_000)
    hits = 0.14 * np.column_stack([np.cos(angle), np.sin(angle)])
    hits += rng.normal(0, 0.02, hits.shape)
    xy, sigma, used = stem_axis(hits)
    assert np.hypot(*xy) < 3 * sigma < 0.03
    assert 0.97 * len(hits) < used <= len(hits)


def test_arms_do_not_move_the_axis(rng):
    angle = rng.uniform(0, 2 * np.pi, 14)
    hits = 0.14 * np.column_stack([np.cos(angle), np.sin(angle)]) + rng.normal(0, 0.02, (14, 2))
    alone, _, _ = stem_axis(hits)
    arm = np.column_stack([np.linspace(0.25, 0.55, 4), np.zeros(4)])
    with_arm, _, _ = stem_axis(np.concatenate([hits, arm]))
    assert np.hypot(*(with_arm - alone)) < 0.03
    lone, sigma, used = stem_axis(hits[:1])
    assert used == 1 and sigma > 0.08 and np.hypot(*(lone - hits[0])) < 0.2


def test_settings_say_what_a_column_is(rng):
    """Its classes, its least height, its radius, and how much may stand around it."""
    stem = np.column_stack([rng.normal(0, 0.05, (80, 2)), rng.uniform(1.2, 9.0, 80)])
    around = np.column_stack([rng.uniform(0.7, 1.5, (25, 2)), rng.uniform(1.2, 4.4, 25)])

    def count(points, cls=5, **asked):
        classes = np.full(len(points), cls, np.uint8)
        return len(find_pole_columns(points, points[:, 2], classes, Columns(**asked)))

    assert count(stem) == 1 and count(stem, cls=9) == 0
    assert count(stem, cls=9, excluded_classes=[2]) == 1
    assert count(stem, min_top_m=9.5) == 0
    crowded = np.concatenate([stem, around])
    assert count(crowded) == 0
    assert count(crowded, around_trunk=2.0) >= 1
    assert count(crowded, around_m=0.8) >= 1


def at_heights(*height_m: float) -> np.ndarray:
    return np.column_stack([np.zeros(len(height_m)), np.zeros(len(height_m)), height_m])


def test_what_hangs_in_the_air_is_no_column():
    """Wires above each other have no returns below; few returns of a stem may have none."""
    wires = at_heights(*np.arange(6.0, 9.1, 0.3))
    assert len(columns(wires)) == 0
    assert len(columns(wires, at_heights(2.0, 3.1))) == 1
    assert not _hangs(np.array([8.0, 9.0]))
    assert _hangs(np.array([8.0, 8.5, 9.0]))
