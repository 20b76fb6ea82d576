"""Surfels by local density: what lies elsewhere changes nothing here."""

import numpy as np
import pytest

from roadsight.scene.surfels import Surfels, build_surfels
from roadsight.scene.voxel_planes import sum_moments


def plane(rng, count, west=0.0, side=20.0, noise=0.005):
    """Points of a tilted plane."""
    x = west + rng.uniform(0, side, count)
    y = rng.uniform(0, side, count)
    return np.column_stack([x, y, 0.05 * x + rng.normal(0, noise, count)])


def near(surfels: Surfels, east: float):
    """Surfels west of a line, as sorted rows."""
    rows = np.column_stack([surfels.centre_m, surfels.normal, surfels.half_m])
    rows = rows[rows[:, 0] < east]
    return rows[np.lexsort(rows.T)]


@pytest.mark.parametrize("kind", ["rough", "smooth"])
def test_300_000_sparse_points_far_away_change_nothing_here(rng, kind):
    dense = plane(rng, 200_000)
    x, y = rng.uniform(60, 900, (2, 300_000))
    z = rng.normal(0, 0.5, len(x)) if kind == "rough" else np.zeros(len(x))
    alone = build_surfels(sum_moments(dense, 0.1))
    both = build_surfels(sum_moments(np.concatenate([dense, np.column_stack([x, y, z])]), 0.1))
    assert np.array_equal(near(alone, 40.0), near(both, 40.0))


@pytest.mark.parametrize("per_m2", [400, 40, 8, 2])
def test_surfels_close_a_plane_of_any_density(rng, per_m2):
    surfels = build_surfels(sum_moments(plane(rng, 400 * per_m2), 0.1))
    flat = np.abs(surfels.normal[:, 2]) > 0.9
    cells = np.zeros((200, 200), bool)
    for (x, y, _), (half_x, half_y) in zip(
        surfels.centre_m[flat], surfels.half_m[flat], strict=True
    ):
        west, east = np.clip(np.round([(x - half_x) * 10, (x + half_x) * 10]).astype(int), 0, 200)
        south, north = np.clip(np.round([(y - half_y) * 10, (y + half_y) * 10]).astype(int), 0, 200)
        cells[west:east, south:north] = True
    assert cells[30:170, 30:170].mean() > 0.97


def test_dense_and_sparse_parts_keep_their_own_sizes(rng):
    dense = plane(rng, 200_000)
    sparse = plane(rng, 4_000, west=40.0)
    surfels = build_surfels(sum_moments(np.concatenate([dense, sparse]), 0.1))
    half_m = surfels.half_m.max(axis=1)
    lone = half_m < 0.06
    assert lone[surfels.centre_m[:, 0] < 20].mean() < 0.2
    assert np.median(half_m[surfels.centre_m[:, 0] > 40]) > 0.12


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_points(count):
    surfels = build_surfels(sum_moments(np.arange(3.0 * count).reshape(-1, 3), 0.1))
    assert len(surfels) == 3 * count
