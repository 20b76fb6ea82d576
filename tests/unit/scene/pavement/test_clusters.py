import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

from roadsight.scene.pavement.outline import euclidean_clusters


def brute_force(xyz, distance):
    """Connected components of the full distance matrix, numbered by size, then by first point."""
    difference = xyz[:, None] - xyz[None]
    squared = difference[..., 0] ** 2 + difference[..., 1] ** 2 + difference[..., 2] ** 2
    _, label = connected_components(squared < distance**2, directed=False)
    members = [np.flatnonzero(label == number) for number in range(label.max() + 1)]
    members.sort(key=lambda index: (-len(index), index[0]))
    out = np.empty(len(xyz), np.int64)
    for number, index in enumerate(members):
        out[index] = number
    return out


@pytest.mark.parametrize("distance", [0.05, 0.15, 0.3, 5.0])
@pytest.mark.parametrize("n", [1, 2, 50, 600])
def test_equals_brute_force(rng, n, distance):
    xyz = rng.uniform(-1, 1, (n, 3)) * [2, 2, 0.2]
    assert (euclidean_clusters(xyz, distance) == brute_force(xyz, distance)).all()


def test_equals_brute_force_with_points_on_cell_borders_and_duplicates(rng):
    xyz = rng.integers(-12, 12, (400, 3)) * 0.25
    xyz = np.concatenate([xyz, xyz[:50]])
    for distance in (0.25, 0.375, 0.5):
        assert (euclidean_clusters(xyz, distance) == brute_force(xyz, distance)).all()


def test_a_step_must_be_shorter_than_the_distance():
    xyz = np.array([[0.0, 0, 0], [0.25, 0, 0], [0.75, 0, 0]])
    assert euclidean_clusters(xyz, 0.25).tolist() == [0, 1, 2]
    assert euclidean_clusters(xyz, 0.5).tolist() == [0, 0, 1]


def test_a_long_chain_is_one_cluster():
    xyz = np.column_stack([np.arange(20_000) * 0.19, np.zeros(20_000), np.zeros(20_000)])
    assert (euclidean_clusters(xyz, 0.2) == 0).all()


def test_the_largest_is_0_and_ties_go_by_the_first_point():
    xyz = np.array([[9.0, 0, 0], [0, 0, 0], [5, 0, 0], [0.1, 0, 0], [5.1, 0, 0], [7, 0, 0]])
    assert euclidean_clusters(xyz, 0.2).tolist() == [2, 0, 1, 0, 1, 3]


def test_height_separates():
    xyz = np.array([[0.0, 0, 0], [0, 0, 0.5]])
    assert euclidean_clusters(xyz, 0.2).tolist() == [0, 1]


def test_no_points():
    assert euclidean_clusters(np.empty((0, 3)), 0.2).shape == (0,)


def test_a_site_of_10_km_with_centimetre_cells_does_not_overflow():
    xyz = np.array([[0.0, 0, 0], [10_000, 10_000, 500], [10_000.004, 10_000, 500]])
    assert euclidean_clusters(xyz, 0.01).tolist() == [1, 0, 0]
