import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.scene.surfels import Patches, build_surfels, merge_coplanar, patches_of_planes
from roadsight.scene.voxel_planes import (
    add_moments,
    coarsen,
    fit_planes,
    pack_cells,
    sum_moments,
    unpack_keys,
)


def plane(rng, n, side=4.0, slope=(0.0, 0.0), noise=0.005):
    xy = rng.uniform(-side / 2, side / 2, (n, 2))
    return np.column_stack([xy, xy @ slope + rng.normal(0, noise, n)])


def test_keys_are_inverse_and_sorted(rng):
    cells = rng.integers(-(2**20) + 8, 2**20 - 8, (500, 3))
    assert (unpack_keys(pack_cells(cells)) == cells).all()
    order = np.argsort(pack_cells(cells))
    assert (order == np.lexsort(cells.T[::-1])).all()


def test_moments_equal_sums_over_points(rng):
    points = rng.normal([-40, 70, 3], 1, (3000, 3))
    voxels = sum_moments(points, 0.5)
    cells = np.floor(points / 0.5).astype(int)
    for row in range(0, len(voxels.keys), 7):
        cell = unpack_keys(voxels.keys[row : row + 1])[0]
        own = points[(cells == cell).all(axis=1)] / 0.5 - cell - 0.5
        second = own.T @ own
        expected = [len(own), *own.sum(axis=0), *second[np.triu_indices(3)]]
        np.testing.assert_allclose(voxels.moments[row], expected, atol=1e-4)
    assert voxels.moments[:, 0].sum() == 3000


def test_moments_of_parts_add_up_and_coarsen(rng):
    points = rng.normal(0, 1, (3000, 3))
    whole = sum_moments(points, 0.2)
    parts = add_moments([sum_moments(points[:1000], 0.2), sum_moments(points[1000:], 0.2)])
    assert (whole.keys == parts.keys).all()
    np.testing.assert_allclose(whole.moments, parts.moments, atol=1e-4)
    double = sum_moments(points, 0.4)
    assert (coarsen(whole).keys == double.keys).all()
    np.testing.assert_allclose(coarsen(whole).moments, double.moments, atol=1e-4)


def test_planes_equal_numpy_eigenvectors(rng):
    points = plane(rng, 4000, slope=(0.3, -0.2), noise=0.02)
    voxels = sum_moments(points, 0.2)
    planes = fit_planes(voxels.keys, voxels, 5, np.inf)
    for row in range(0, len(voxels.keys), 11):
        centre = (unpack_keys(voxels.keys[row : row + 1])[0] + 0.5) * 0.2
        near = points[(np.abs(points - centre) < 0.3).all(axis=1)]
        values, vectors = np.linalg.eigh(np.cov(near.T, bias=True))
        np.testing.assert_allclose(planes.variance[row] * 0.04, values, atol=1e-5)
        assert abs(planes.normal[row] @ vectors[:, 0]) == pytest.approx(1, abs=1e-4)
        assert abs(planes.axis[row] @ vectors[:, 2]) == pytest.approx(1, abs=1e-2)
        expected = (near.mean(axis=0) - centre) @ planes.normal[row] / 0.2
        assert planes.offset[row] == pytest.approx(expected, abs=1e-3)
        assert planes.points[row] == len(near)


def test_degenerate_neighbourhoods_have_finite_planes():
    for points in ([[0, 0, 0]] * 9, [[i / 100, 0, 0] for i in range(9)]):
        voxels = sum_moments(np.array(points, float) + 0.01, 0.2)
        planes = fit_planes(voxels.keys, voxels, 1, 0.08)
        assert np.isfinite(np.concatenate([np.ravel(column) for column in planes])).all()
        np.testing.assert_allclose(np.linalg.norm(planes.normal, axis=1), 1, atol=1e-6)


def covered_share(surfels, rng, side):
    """Share of random places of a horizontal square over which a surfel lies."""
    places = rng.uniform(-side / 2, side / 2, (400, 2))
    gap = np.abs(places[:, None] - surfels.centre_m[None, :, :2])
    return (gap <= surfels.half_m).all(axis=2).any(axis=1).mean()


@pytest.mark.parametrize("per_m2", [1000, 150, 40, 8])
@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.35, -0.1)])
def test_a_plane_is_closed_without_thickening(rng, per_m2, slope):
    surfels = build_surfels(sum_moments(plane(rng, 16 * per_m2, slope=slope), 0.1))
    normal = np.array([-slope[0], -slope[1], 1]) / np.hypot(np.hypot(*slope), 1)
    inner = np.abs(surfels.centre_m[:, :2]).max(axis=1) < 1.5
    assert covered_share(surfels, rng, 3.0) > 0.99
    assert np.abs(surfels.centre_m[inner] @ normal).max() < 0.02
    assert np.abs(surfels.normal[inner] @ normal).min() > 0.99
    reach = np.abs(surfels.centre_m[:, :2]) + surfels.half_m
    assert reach.max() < 2 + max(0.2, 4.6 / np.sqrt(per_m2))


def test_flat_parts_merge_into_larger_surfels(rng):
    surfels = build_surfels(sum_moments(plane(rng, 60_000, side=8.0, noise=0.002), 0.1))
    assert len(surfels) < 8 * 8 / 0.1**2 / 20
    assert surfels.half_m.max() > 0.5


def test_edges_of_a_box_stay_sharp(rng):
    top = rng.uniform([0, 0, 1], [3, 3, 1], (9000, 3))
    side = rng.uniform([0, 0, 0], [0, 3, 1], (3000, 3))
    surfels = build_surfels(sum_moments(np.concatenate([top, side]), 0.1))
    upright = np.abs(surfels.normal[:, 0]) > 0.5
    away_m = np.where(upright, surfels.centre_m[:, 0], surfels.centre_m[:, 2] - 1)
    assert (np.abs(away_m) < 0.05).mean() > 0.98  # few cut the corner
    assert np.abs(away_m).max() < 0.2


def test_a_wire_is_a_string_of_narrow_crossed_squares(rng):
    along = rng.uniform(0, 10, 4000)
    wire = np.column_stack([along, 0.2 * along, np.full(4000, 7.0)])
    wire += rng.normal(0, 0.005, wire.shape)
    surfels = build_surfels(sum_moments(wire, 0.1))
    assert surfels.half_m.max() <= 0.03
    direction = np.array([1, 0.2, 0]) / np.hypot(1, 0.2)
    assert np.abs(surfels.normal @ direction).max() < 0.2
    away = surfels.centre_m - [0, 0, 7]
    away -= (away @ direction)[:, None] * direction
    assert np.linalg.norm(away, axis=1).max() < 0.01
    stations = np.sort(surfels.centre_m[:, 0])
    assert np.diff(stations).max() < 0.1


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 0), (1, 2, 3)])
def test_a_perfect_line_is_seen_from_all_sides(direction):
    direction = np.array(direction) / np.linalg.norm(direction)
    line = np.array([3.05, 4.05, 5.05]) + np.linspace(0, 3, 600)[:, None] * direction
    surfels = build_surfels(sum_moments(line, 0.1))
    np.testing.assert_allclose(np.linalg.norm(surfels.normal, axis=1), 1, atol=1e-5)
    inside = np.abs((surfels.centre_m - line.mean(axis=0)) @ direction) < 1
    assert np.abs(surfels.normal[inside] @ direction).max() < 1e-3
    across = np.linalg.svd(surfels.normal[inside], full_matrices=False)[1]
    assert across[1] > 0.5 * across[0]


def test_lone_points_become_small_crosses():
    points = np.array([[0, 0, 0], [50, 0, 0], [0, 70, 9.0]])
    surfels = build_surfels(sum_moments(points, 0.1))
    assert len(surfels) == 9
    assert surfels.half_m == pytest.approx(0.025)
    assert sorted(map(tuple, np.unique(surfels.centre_m.round(3), axis=0).tolist())) == sorted(
        map(tuple, points.tolist())
    )


def test_a_stray_point_does_not_lift_the_ground(rng):
    ground = plane(rng, 16 * 30)
    points = np.concatenate([ground, [[0.3, 0.3, 0.6]]])
    surfels = build_surfels(sum_moments(points, 0.1))
    lifted = surfels.centre_m[surfels.centre_m[:, 2] > 0.05]
    np.testing.assert_allclose(lifted, np.tile([0.3, 0.3, 0.6], (3, 1)), atol=1e-5)


def test_scan_lines_are_a_surface_not_wires(rng):
    x = np.repeat(np.arange(-2, 2, 0.2), 800)
    y = rng.uniform(-2, 2, len(x))
    points = np.column_stack([x, y, rng.normal(0, 0.003, len(x))])
    surfels = build_surfels(sum_moments(points, 0.1))
    assert covered_share(surfels, rng, 3.0) > 0.98


def test_no_points_no_surfels():
    surfels = build_surfels(sum_moments(np.empty((0, 3)), 0.1))
    assert len(surfels) == 0
    assert surfels.centre_m.shape == surfels.normal.shape == (0, 3)


def test_result_does_not_depend_on_input_order_beyond_rounding(rng):
    points = plane(rng, 3000)
    first = build_surfels(sum_moments(points, 0.1))
    again = build_surfels(sum_moments(points, 0.1))
    shuffled = build_surfels(sum_moments(rng.permutation(points), 0.1))
    assert (first.centre_m == again.centre_m).all()
    assert len(shuffled) == pytest.approx(len(first), rel=0.02)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e7])
def test_stray_coordinates_are_refused(bad):
    with pytest.raises(InputError, match="not finite or too far"):
        sum_moments(np.array([[0, 0, 0], [bad, 0, 0]]), 0.1)


def grid_patches(size_m, heights):
    """Level patches over a grid of cells, heights (columns u, rows v)."""
    u, v = np.indices(heights.shape)
    n = heights.size
    cell = np.column_stack([u.ravel(), v.ravel()])
    return Patches(np.full(n, 2), cell, heights.ravel() * size_m, np.zeros((n, 2)))


def test_four_agreeing_patches_merge():
    merged, kept = merge_coplanar(grid_patches(0.1, np.full((4, 2), 5.0)), 0.1, 0.01)
    assert len(kept.axis) == 0
    assert merged.cell.tolist() == [[0, 0], [1, 0]]
    assert merged.height_m == pytest.approx([0.5, 0.5])


def test_steps_and_gaps_do_not_merge():
    step = np.full((2, 2), 5.0)
    step[0, 0] = 6.0
    merged, kept = merge_coplanar(grid_patches(0.1, step), 0.1, 0.01)
    assert (len(merged.axis), len(kept.axis)) == (0, 4)
    merged, kept = merge_coplanar(grid_patches(0.1, np.full((1, 2), 5.0)), 0.1, 0.01)
    assert (len(merged.axis), len(kept.axis)) == (0, 2)


def test_merged_patches_lie_on_the_same_tilted_plane():
    normal = np.array([0.2, -0.3, 1]) / np.linalg.norm([0.2, -0.3, 1])
    x, y = (part.ravel() for part in np.indices((4, 4)))
    on_plane = -(normal[0] * (x + 0.5) + normal[1] * (y + 0.5)) / normal[2]
    cells = np.column_stack([x, y, np.floor(on_plane).astype(int)])
    offset = -(cells + 0.5) @ normal
    patches = patches_of_planes(cells, np.tile(normal, (16, 1)), offset, 1.0)
    np.testing.assert_allclose(patches.height_m, on_plane)
    merged, kept = merge_coplanar(patches, 1.0, 1e-6)
    assert len(kept.axis) == 0
    centre = np.column_stack([(merged.cell + 0.5) * 2, merged.height_m])
    np.testing.assert_allclose(centre @ normal, 0, atol=1e-9)
    np.testing.assert_allclose(merged.slope, np.tile(-normal[:2] / normal[2], (4, 1)))
