"""What must not change the result: where the scene lies, its units, the order of its points."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from roadsight.base.sections.scene import GroundFilter
from roadsight.geometry.frames import Frame
from roadsight.scene.grids import Grid
from roadsight.scene.pavement.fpfh import column_means, fpfh, nearest_neighbours, upward_normals
from roadsight.scene.pavement.outline import euclidean_clusters
from roadsight.scene.terrain.coarse import coarse_ground, lowest_supported
from roadsight.scene.terrain.ground import ground_mask

# Cells are binary fractions and points lie on a binary raster, so that moving them is exact.
SETTINGS = GroundFilter(pillar_width_m=0.25, coarse_cell_m=1.0)
RASTER = 1 / 1024
SEEDS = st.integers(0, 2**31)
FEW = settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))


def street(seed, n=2500):
    """A sloping street with a hedge, a car roof and noise, local metres on the raster."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 14, (2, n))
    z = 0.04 * x - 0.02 * y + rng.normal(0, 0.02, n)
    z += np.where(y > 12, rng.uniform(0, 2, n), 0)
    z += np.where((np.abs(x - 7) < 2) & (np.abs(y - 5) < 0.9), 1.5, 0)
    return np.round(np.column_stack([x, y, z]) / RASTER) * RASTER


def label(xyz):
    x, y, z = xyz.T
    grid = Grid.around(x, y, SETTINGS.coarse_cell_m)
    coarse = coarse_ground(grid, lowest_supported(grid, x, y, z), SETTINGS)
    return ground_mask(x, y, z, coarse, SETTINGS)


def describe(xyz, k=10):
    distance, near = nearest_neighbours(xyz, k)
    normals, variation = upward_normals(xyz, near)
    return normals, variation, fpfh(xyz, normals, distance, near)


def share_equal(first, second):
    """Share of points whose histograms agree: rounding may move an angle across a bin's border."""
    return (np.abs(first - second).max(axis=1) < 0.01).mean()


def same_partition(first, second):
    pairs = set(zip(first.tolist(), second.tolist(), strict=True))
    return len(pairs) == len(set(first.tolist())) == len(set(second.tolist()))


whole_metres = st.integers(-5_000_000, 5_000_000)


@FEW
@given(seed=SEEDS, east=whole_metres, north=whole_metres, up=st.integers(-400, 8000))
def test_moving_the_native_coordinates_changes_nothing(seed, east, north, up):
    """Up to 5,000 km: a frame at the scene's origin takes the translation out, to the last bit."""
    local = street(seed)
    frame = Frame((float(east), float(north), float(up)))
    moved = frame.to_local(local + np.array(frame.origin))
    assert (moved == local).all()
    assert (label(moved) == label(local)).all()


@FEW
@given(seed=SEEDS, east=whole_metres, north=whole_metres)
def test_native_millimetres_far_away_give_the_same_description(seed, east, north):
    local = np.round(street(seed, 600), 3)
    native = np.round(local + np.array([east, north, 0]), 3)
    far = Frame((float(east), float(north), 0.0)).to_local(native)
    np.testing.assert_allclose(far, local, atol=2e-9)
    here, there = describe(local), describe(far)
    np.testing.assert_allclose(here[0], there[0], atol=1e-5)
    np.testing.assert_allclose(here[1], there[1], atol=1e-7)
    assert share_equal(here[2], there[2]) > 0.99


@FEW
@given(seed=SEEDS, cells=st.tuples(*[st.integers(-4000, 4000)] * 2), up=st.integers(-500, 500))
def test_moving_by_whole_cells_keeps_the_labels_and_moves_the_columns(seed, cells, up):
    xyz = street(seed)
    shift = np.array([*cells, up], float)
    assert (label(xyz + shift) == label(xyz)).all()
    centroid, _, count = column_means(xyz, np.empty((len(xyz), 0)), 0.25)
    moved, _, moved_count = column_means(xyz + shift, np.empty((len(xyz), 0)), 0.25)
    np.testing.assert_allclose(moved - shift, centroid, atol=1e-9)
    assert (moved_count == count).all()


@FEW
@given(seed=SEEDS)
def test_the_order_of_the_points_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    xyz = street(seed)
    order = rng.permutation(len(xyz))
    assert (label(xyz[order]) == label(xyz)[order]).all()
    assert same_partition(euclidean_clusters(xyz[order], 0.4), euclidean_clusters(xyz, 0.4)[order])
    columns, shuffled = (column_means(p, p[:, 2:], 0.25) for p in (xyz, xyz[order]))
    for first, second in zip(columns, shuffled, strict=True):
        np.testing.assert_allclose(first, second, atol=1e-9)
    xyz = rng.normal(size=(300, 3)) * [1, 1, 0.05]
    order = rng.permutation(300)
    here, there = describe(xyz), describe(xyz[order])
    np.testing.assert_allclose(there[0], here[0][order], atol=1e-6)
    assert share_equal(there[2], here[2][order]) > 0.99


@FEW
@given(seed=SEEDS)
def test_repeated_points_hardly_matter(seed):
    """Noise and density count points: equal ones are left out where files are read."""
    rng = np.random.default_rng(seed)
    xyz = street(seed)
    again = rng.integers(0, len(xyz), 500)
    doubled = np.concatenate([xyz, xyz[again]])
    mask, labels = label(doubled), euclidean_clusters(doubled, 0.4)
    assert (mask[: len(xyz)] == label(xyz)).mean() > 0.98
    assert (mask[len(xyz) :] == mask[again]).all()
    assert same_partition(labels[: len(xyz)], euclidean_clusters(xyz, 0.4))
    assert (labels[len(xyz) :] == labels[again]).all()


@FEW
@given(seed=SEEDS, angle=st.floats(-np.pi, np.pi))
def test_turning_about_the_vertical_turns_normals_and_keeps_fpfh(seed, angle):
    rng = np.random.default_rng(seed)
    xyz = rng.normal(size=(300, 3)) * [1, 1, 0.1]
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    here, there = describe(xyz), describe(xyz @ turn.T)
    np.testing.assert_allclose(there[0], here[0] @ turn.T, atol=1e-6)
    np.testing.assert_allclose(there[1], here[1], atol=1e-9)
    assert share_equal(there[2], here[2]) > 0.99


@FEW
@given(seed=SEEDS, scale=st.sampled_from([0.01, 0.1, 7.0, 100.0]))
def test_fpfh_does_not_know_the_scale(seed, scale):
    xyz = np.random.default_rng(seed).normal(size=(300, 3)) * [1, 1, 0.1]
    here, there = describe(xyz), describe(scale * xyz)
    np.testing.assert_allclose(there[0], here[0], atol=1e-6)
    assert share_equal(there[2], here[2]) > 0.99


@FEW
@given(
    seed=SEEDS,
    unit_m=st.sampled_from([0.3048, 1200 / 3937]),
    vertical_m=st.sampled_from([1.0, 0.3048]),
)
def test_feet_give_the_labels_of_metres(seed, unit_m, vertical_m):
    """Native feet, or feet in plan and metres in height, a million feet from the native origin."""
    metres = street(seed) + RASTER / 2  # off the cells' borders, where rounding decides
    frame = Frame((1_000_000.0, 4_000_000.0, 100.0), unit_m, vertical_m)
    local = frame.to_local(frame.to_native(metres))
    np.testing.assert_allclose(local, metres, atol=1e-9)
    assert (label(local) == label(metres)).mean() > 0.999
    assert (frame.to_native(metres)[:, 0].min() - 1_000_000) * unit_m == pytest.approx(
        metres[:, 0].min(), abs=1e-6
    )
