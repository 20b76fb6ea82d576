import numpy as np

from roadsight.scene.pavement.fpfh import column_means


def test_columns_equal_a_literal_loop(rng):
    xyz, values = rng.uniform(-2, 2, (400, 3)), rng.normal(size=(400, 2))
    centroid, mean, count = column_means(xyz, values, 0.5)
    cells = {}
    for point, value in zip(xyz, values, strict=True):
        key = int(np.floor(point[1] / 0.5)), int(np.floor(point[0] / 0.5))
        cells.setdefault(key, []).append((*point, *value))
    expected = [np.mean(cells[key], axis=0) for key in sorted(cells)]
    np.testing.assert_allclose(np.column_stack([centroid, mean]), expected, atol=1e-12)
    assert count.tolist() == [len(cells[key]) for key in sorted(cells)]


def test_cubes_equal_a_literal_loop(rng):
    xyz, values = rng.uniform(-2, 2, (400, 3)), rng.normal(size=(400, 2))
    centroid, mean, count = column_means(xyz, values, 0.5, "voxels")
    cubes = {}
    for point, value in zip(xyz, values, strict=True):
        x, y, z = np.floor(point / 0.5).astype(int)
        cubes.setdefault((y, x, z), []).append((*point, *value))
    expected = [np.mean(cubes[key], axis=0) for key in sorted(cubes)]
    np.testing.assert_allclose(np.column_stack([centroid, mean]), expected, atol=1e-12)
    assert count.tolist() == [len(cubes[key]) for key in sorted(cubes)]


def test_height_does_not_split_a_column():
    xyz = np.array([[0.05, 0.05, 0.0], [0.05, 0.05, 9.0]])
    centroid, _, count = column_means(xyz, np.empty((2, 0)), 0.1)
    np.testing.assert_allclose(centroid, [[0.05, 0.05, 4.5]])
    assert count.tolist() == [2]


def test_cells_hang_on_the_origin_and_not_on_the_first_point():
    xyz = np.array([[0.09, 0.0, 0.0], [0.11, 0.0, 0.0], [-0.01, 0.0, 0.0]])
    assert len(column_means(xyz, np.empty((3, 0)), 0.1)[0]) == 3


def test_no_points_give_no_columns():
    centroid, mean, count = column_means(np.empty((0, 3)), np.empty((0, 1)), 0.1)
    assert centroid.shape == (0, 3)
    assert mean.shape == (0, 1)
    assert count.shape == (0,)
