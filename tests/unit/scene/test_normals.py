import numpy as np
import pytest

from roadsight.scene.pavement.fpfh import nearest_neighbours, upward_normals


class TestNearestNeighbours:
    def test_equals_the_full_distance_matrix(self, rng):
        xyz = rng.normal(size=(200, 3))
        distance, index = nearest_neighbours(xyz, 7)
        full = np.linalg.norm(xyz[:, None] - xyz[None], axis=2)
        np.fill_diagonal(full, np.inf)
        expected = np.argsort(full, axis=1)[:, :7]
        assert (index == expected).all()
        np.testing.assert_allclose(distance, np.take_along_axis(full, expected, 1), rtol=1e-12)

    @pytest.mark.parametrize("n", [0, 1, 2, 3])
    def test_too_few_others_leave_empty_places(self, n):
        xyz = np.arange(3 * n, dtype=float).reshape(n, 3)
        distance, index = nearest_neighbours(xyz, 4)
        assert distance.shape == index.shape == (n, 4)
        assert index.dtype == np.int64
        missing = index < 0
        assert (missing.sum(axis=1) == 4 - max(n - 1, 0)).all()
        assert (np.isinf(distance) == missing).all()

    def test_others_out_of_reach_leave_empty_places(self):
        xyz = np.array([[0.0, 0, 0], [1, 0, 0], [5, 0, 0]])
        distance, index = nearest_neighbours(xyz, 2, max_distance_m=2.0)
        assert index.tolist() == [[1, -1], [0, -1], [-1, -1]]
        assert distance.tolist() == [[1, np.inf], [1, np.inf], [np.inf, np.inf]]

    def test_a_point_is_never_its_own_neighbour_even_among_many_duplicates(self, rng):
        xyz = np.repeat(rng.normal(size=(3, 3)), 20, axis=0)
        distance, index = nearest_neighbours(xyz, 5)
        assert (index != np.arange(60)[:, None]).all()
        assert (index >= 0).all()
        assert (distance == 0).all()
        assert (index // 20 == np.arange(60)[:, None] // 20).all()


class TestUpwardNormals:
    @pytest.mark.parametrize("normal", [(0, 0, 1), (0.3, -0.2, 0.9), (0.9, 0.1, 0.05)])
    def test_a_plane_has_its_own_normal_upwards(self, rng, normal):
        normal = np.array(normal) / np.linalg.norm(normal)
        axes = np.linalg.svd(normal[None])[2][1:]
        xyz = rng.uniform(-2, 2, (300, 2)) @ axes
        found, variation = upward_normals(xyz, nearest_neighbours(xyz, 10)[1])
        np.testing.assert_allclose(found, np.broadcast_to(normal, found.shape), atol=1e-6)
        assert variation.max() < 1e-12

    def test_equals_a_literal_principal_component_analysis(self, rng):
        xyz = rng.normal(size=(60, 3)) * [1, 1, 0.3]
        index = nearest_neighbours(xyz, 6)[1]
        found, variation = upward_normals(xyz, index)
        for i in range(60):
            values, vectors = np.linalg.eigh(np.cov(xyz[[i, *index[i]]].T, bias=True))
            expected = vectors[:, 0] if vectors[2, 0] > 0 else -vectors[:, 0]
            np.testing.assert_allclose(found[i], expected, atol=1e-9)
            assert variation[i] == pytest.approx(values[0] / values.sum(), rel=1e-9)

    def test_missing_neighbours_are_left_out(self, rng):
        xyz = rng.normal(size=(10, 3))
        index = np.array([[1, 2, 3, 4]] + [[0, 1, 2, 3]] * 9)
        padded = np.column_stack([index, np.full((10, 3), -1)])
        for plain, with_gaps in zip(
            upward_normals(xyz, index), upward_normals(xyz, padded), strict=True
        ):
            np.testing.assert_allclose(plain, with_gaps, atol=1e-12)

    @pytest.mark.parametrize(
        "xyz",
        [
            [[1, 2, 3]], [[0, 0, 0], [1, 0, 0]], [[1, 1, 1]] * 12,
            [[t, 2 * t, -t] for t in range(12)], [[t, 0, 1e-9 * (-1) ** t] for t in range(12)],
        ],
        ids=["alone", "pair", "duplicates", "line", "line with rounding"],
    )  # fmt: skip
    def test_what_has_no_plane_has_no_normal(self, xyz):
        xyz = np.array(xyz, float)
        normals, variation = upward_normals(xyz, nearest_neighbours(xyz, 5)[1])
        assert np.isnan(normals).all()
        assert np.isnan(variation).all()

    def test_three_points_make_a_plane(self):
        xyz = np.array([[0.0, 0, 0], [1, 0, 0.1], [0, 1, 0]])
        normals, variation = upward_normals(xyz, nearest_neighbours(xyz, 2)[1])
        np.testing.assert_allclose(
            normals, np.tile([-0.1, 0, 1] / np.sqrt(1.01), (3, 1)), atol=1e-9
        )
        assert np.abs(variation).max() < 1e-12

    def test_no_points(self):
        normals, variation = upward_normals(np.empty((0, 3)), np.empty((0, 5), np.int64))
        assert normals.shape == (0, 3)
        assert variation.shape == (0,)

    def test_ten_kilometres_from_the_origin_nothing_is_lost(self, rng):
        xyz = rng.uniform(0, 3, (500, 3)) * [1, 1, 0.01]
        index = nearest_neighbours(xyz, 10)[1]
        near, _ = upward_normals(xyz, index)
        far, _ = upward_normals(xyz + np.array([10_000, -10_000, 500]), index)
        angle = np.degrees(np.arccos(np.clip((near * far).sum(axis=1), -1, 1)))
        assert angle.max() < 1e-3
