import gc

import numpy as np
import pytest

from roadsight.geometry.ray_casting import RayScene


def _pairs(corners_m, triangles, origins_m, ways):
    """Range, u and v (rays, triangles) of every ray at every triangle; infinite where it passes."""
    a, b, c = (corners_m[triangles[:, k]].astype(float) for k in range(3))
    edges = np.stack([b - a, c - a], axis=-1)
    ways = np.broadcast_to(ways, (len(ways), 3)).astype(float)
    matrix = np.empty((len(ways), len(triangles), 3, 3))
    matrix[..., :2], matrix[..., 2] = edges, -ways[:, None]
    from_a = np.broadcast_to(origins_m, ways.shape)[:, None] - a
    u, v, t = np.moveaxis(np.linalg.solve(matrix, from_a[..., None])[..., 0], -1, 0)
    met = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return np.where(met, t, np.inf), u, v


@pytest.fixture
def soup(rng):
    middle = rng.uniform(-20, 20, (300, 1, 3))
    corners = (middle + rng.normal(0, 2.0, (300, 3, 3))).reshape(-1, 3)
    return corners.astype(np.float32), np.arange(900, dtype=np.int32).reshape(-1, 3)


SQUARE = [(-1, -1), (1, -1), (1, 1), (-1, 1)]


def _ways(rng, n):
    ways = rng.normal(size=(n, 3))
    return (ways / np.linalg.norm(ways, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("count", [0, 1, 15, 16, 17, 400])
@pytest.mark.parametrize("shared", [True, False], ids=["one point", "own points"])
@pytest.mark.parametrize("robust", [True, False])
def test_first_triangles_are_the_nearest_of_all(rng, soup, count, shared, robust):
    scene, ways = RayScene(*soup, robust=robust), _ways(rng, count)
    origins = rng.uniform(-5, 5, 3 if shared else (count, 3)).astype(np.float32)
    found = scene.first_hits(origins, ways)
    range_m, u, v = _pairs(*soup, origins, ways)
    nearest = range_m.argmin(axis=1)
    met = np.isfinite(range_m.min(axis=1))
    assert np.array_equal(found.triangle, np.where(met, nearest, -1))
    assert found.range_m[met] == pytest.approx(range_m.min(axis=1)[met], abs=1e-4)
    assert np.all(np.isinf(found.range_m[~met]))
    rows = np.flatnonzero(met)
    assert found.u[met] == pytest.approx(u[rows, nearest[met]], abs=1e-3)
    assert found.v[met] == pytest.approx(v[rows, nearest[met]], abs=1e-3)
    assert np.array_equal(scene.occluded(origins, ways), met)


def test_what_is_met_beyond_the_limit_does_not_count(rng, soup):
    scene, ways = RayScene(*soup), _ways(rng, 400)
    nearest = _pairs(*soup, np.zeros(3), ways)[0].min(axis=1)
    found = scene.first_hits(np.zeros(3), ways, 8.0)
    assert np.array_equal(found.triangle >= 0, nearest < 8.0)
    assert np.all(found.range_m[nearest >= 8.0] == 8.0)
    assert np.array_equal(scene.occluded(np.zeros(3), ways, 8.0), nearest < 8.0)


def test_ranges_are_in_lengths_of_the_direction(rng, soup):
    scene, ways = RayScene(*soup), _ways(rng, 100)
    one, four = scene.first_hits(np.zeros(3), ways), scene.first_hits(np.zeros(3), 4 * ways)
    met = one.triangle >= 0
    assert met.any()
    assert four.range_m[met] == pytest.approx(one.range_m[met] / 4, rel=1e-5)


def test_a_scene_keeps_its_triangles_and_gives_them_back(rng, soup):
    corners, triangles = (part.copy() for part in soup)
    scene, ways = RayScene(corners, triangles), _ways(rng, 50)
    before = scene.first_hits(np.zeros(3), ways)
    corners += 100.0
    triangles[:] = 0
    for _ in range(20):
        RayScene(*soup)
    gc.collect()
    after = scene.first_hits(np.zeros(3), ways)
    assert np.array_equal(before.range_m, after.range_m)


def test_a_scene_of_nothing_stops_no_ray():
    scene = RayScene(np.empty((0, 3)), np.empty((0, 3), int))
    assert scene.first_hits(np.zeros(3), np.eye(3)).triangle.tolist() == [-1, -1, -1]
    assert not scene.occluded(np.zeros(3), np.eye(3)).any()


@pytest.mark.parametrize(
    ("origins", "ways"), [((2, 3), (40, 3)), ((1, 3), (3, 40)), ((3, 1), (1, 3)), ((4,), (4, 3))]
)
def test_what_are_no_rays_are_refused(soup, origins, ways):
    with pytest.raises(ValueError, match="are no rays"):
        RayScene(*soup).first_hits(np.zeros(origins), np.ones(ways))


@pytest.mark.parametrize("faces", [[0, 1, 2], [], [[0, 1]], [[0, 1, 2, 3, 4]]])
def test_what_are_no_faces_are_refused(soup, faces):
    with pytest.raises(ValueError, match="are no rows"):
        RayScene(soup[0], faces)


def test_a_flat_triangle_is_one():
    corners = np.array([[-1, -1, 5], [1, -1, 5], [0, 1, 5]])
    assert RayScene(corners, [[0, 1, 2]]).first_hits(np.zeros(3), [[0, 0, 1]]).range_m == 5.0


def test_a_flat_face_of_four_corners_is_its_two_triangles(rng):
    middle = rng.uniform(-10, 10, (200, 3))
    across = rng.normal(size=(200, 2, 3))
    corners = [middle + a * across[:, 0] + b * across[:, 1] for a, b in SQUARE]
    corners_m = np.stack(corners, axis=1).reshape(-1, 3).astype(np.float32)
    faces = np.arange(800).reshape(-1, 4)
    halves = faces[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    ways = _ways(rng, 4000)
    scenes = RayScene(corners_m, faces), RayScene(corners_m, halves)
    face, half = (scene.first_hits(np.zeros(3), ways) for scene in scenes)
    assert 0.3 < np.mean(half.triangle >= 0) < 1.0
    same = face.triangle == np.where(half.triangle < 0, -1, half.triangle // 2)
    assert np.mean(same) > 0.999  # a ray along an edge may pass on either side
    met = same & (face.triangle >= 0)
    assert face.range_m[met] == pytest.approx(half.range_m[met], abs=1e-4)
