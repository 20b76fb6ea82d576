import numpy as np
import pytest

from roadsight.scene.curbs import CurbSettings, find_curbs, follow, smooth_line

HALF_M = 4.0
STEP_M = 0.10


def street(rng, step_m=STEP_M, radius_m=None, forecourt=True, count=400_000):
    """Crowned road 8 m wide along x, a step on both sides, paving beyond; then a second step."""
    x, right = rng.uniform(0, 60, count), rng.uniform(-11, 11, count)
    away = np.abs(right)
    z = -0.02 * np.minimum(away, HALF_M) + np.where(away > HALF_M, step_m, 0.0)
    if forecourt:
        z += np.where(away > 8.0, 0.15, 0.0)
    z += rng.normal(0, 0.01, count)
    y = -right
    if radius_m:
        turn = x / radius_m
        x, y = (radius_m - right) * np.sin(turn), radius_m - (radius_m - right) * np.cos(turn)
        y = -y
    return np.column_stack([x, y, z])


def track(radius_m=None):
    s = np.arange(0, 60.1, 2.0)
    if not radius_m:
        return np.column_stack([s, np.zeros_like(s)])
    return np.column_stack(
        [radius_m * np.sin(s / radius_m), -radius_m * (1 - np.cos(s / radius_m))]
    )


def test_both_curbs_are_found_at_the_nearer_step(rng):
    curbs = find_curbs(street(rng), track())
    inner = (curbs.xyz_m[:, 0] > 2) & (curbs.xyz_m[:, 0] < 58)
    across = np.abs(curbs.xyz_m[inner, 1])
    assert np.abs(across - HALF_M).max() < 0.2
    assert np.median(across) == pytest.approx(HALF_M, abs=0.1)
    assert np.median(curbs.step_m) == pytest.approx(STEP_M, abs=0.03)
    assert set(curbs.polyline) == {0, 1}
    assert curbs.xyz_m[:, 2] == pytest.approx(-0.02 * HALF_M, abs=0.06)
    assert np.abs(curbs.tangent[inner, 0]) == pytest.approx(1.0, abs=0.02)


def test_lowered_curbs_and_bends(rng):
    curbs = find_curbs(street(rng, step_m=0.04, radius_m=80.0), track(80.0))
    away = np.hypot(curbs.xyz_m[:, 0], curbs.xyz_m[:, 1] + 80.0) - 80.0
    assert len(curbs.step_m) > 150
    assert np.quantile(np.abs(np.abs(away) - HALF_M), 0.9) < 0.25


def test_a_smooth_road_has_no_curb(rng):
    assert len(find_curbs(street(rng, step_m=0.0, forecourt=False), track()).step_m) == 0


def test_parked_cars_bound_the_carriageway(rng):
    cloud = street(rng)
    right = -cloud[:, 1]
    hidden = (right > 3.0) & (right < 9.0) & (cloud[:, 0] > 20) & (cloud[:, 0] < 40)
    car = rng.uniform([20, -3.2, 0.3], [40, -3.0, 1.5], (40_000, 3))
    curbs = find_curbs(np.concatenate([cloud[~hidden], car]), track())
    x, y = curbs.xyz_m[:, 0], curbs.xyz_m[:, 1]
    beside = (x > 24) & (x < 36)
    assert y[beside & (y < 0)] == pytest.approx(-3.0, abs=0.2)
    assert y[beside & (y > 0)] == pytest.approx(HALF_M, abs=0.2)


def test_nothing_gives_nothing():
    assert len(find_curbs(np.empty((0, 3)), track()).step_m) == 0
    assert len(find_curbs(np.zeros((5, 3)), np.zeros((3, 2))).step_m) == 0
    assert smooth_line(np.zeros((0, 2)), 0.5, 10.0).shape == (0, 2)


def test_the_followed_line_is_the_best_of_all(rng):
    """Against every line of a small table."""
    settings = CurbSettings(bend_cost=0.2)
    steps = np.where(rng.random((5, 6)) < 0.4, rng.uniform(0.02, 0.1, (5, 6)), 0.0)
    gain = np.minimum(steps / (2 * settings.least_step_m), 1.0) - 0.006 * np.arange(6)

    def worth(line):
        aside = np.abs(np.diff(line))
        if (aside > 3).any():
            return -np.inf
        return gain[np.arange(5), line].sum() - settings.bend_cost * aside.sum()

    lines = np.stack(np.meshgrid(*[np.arange(6)] * 5, indexing="ij"), -1).reshape(-1, 5)
    best = max(worth(line) for line in lines)
    assert worth(follow(steps, settings)) == pytest.approx(best)
