import math

import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight_worlds.casting import simple_scenes as simple
from roadsight_worlds.casting.alignment import to_plan
from roadsight_worlds.casting.cellgrid import build_grid
from roadsight_worlds.casting.materials import TruthClass
from roadsight_worlds.casting.primitives import BOX
from roadsight_worlds.casting.primitives import ray_body as ray_body_part
from roadsight_worlds.casting.scene import NO_TERRAIN, Scene, SceneBuilder, rotation_zyx
from roadsight_worlds.casting.terrain import height_at
from roadsight_worlds.highway.highway import build_highway
from tests.helpers.kernels import from_python


@pytest.fixture(scope="module")
def highway():
    return build_highway(seed=3, length_m=60.0)


def unit_vectors(rng, n):
    vectors = rng.normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def views(highway, rng, n):
    """Rays from above and beside the road in all directions."""
    road = np.column_stack([rng.uniform(0, 60, n), rng.uniform(-30, 30, n)])
    xy = to_plan(highway.alignment, road)
    z = height_at(highway.terrain, xy) + rng.choice([0.05, 2.4, 15.0], n)
    return np.column_stack([xy, z]), unit_vectors(rng, n)


ray_body = from_python(ray_body_part)


def bodies_one_by_one(scene, origins, directions, reach):
    ranges = [
        min(ray_body(scene.bodies, i, *o, *d) for i in range(len(scene.bodies.kind)))
        for o, d in zip(origins, directions, strict=True)
    ]
    return np.where(np.array(ranges) <= reach, ranges, math.inf)


def ground_by_steps(terrain, origins, directions, reach, step=2e-3):
    """First sign change of the height above ground on a dense grid of ranges, to the step."""
    t = np.arange(2e-6, reach, step)
    ranges = np.full(len(origins), math.inf)
    for i, (o, d) in enumerate(zip(origins, directions, strict=True)):
        points = o + t[:, None] * d
        above = points[:, 2] - height_at(terrain, points[:, :2])
        known = np.isfinite(above)
        change = (np.sign(above[:-1]) != np.sign(above[1:])) & known[:-1] & known[1:]
        if change.any():
            ranges[i] = t[np.argmax(change)]
    return ranges


def test_the_grid_changes_nothing(highway, rng):
    origins, directions = views(highway, rng, 4000)
    ranges, ids, normals = highway.scene.cast(origins, directions, 80.0)
    assert 0.3 < np.isfinite(ranges).mean() < 0.95
    for cell in (0.37, 3.0, 500.0):
        scene = highway.scene
        other = Scene(
            scene.objects,
            scene.bodies,
            scene.terrain,
            build_grid(scene.bodies, scene.terrain, cell),
        )
        again = other.cast(origins, directions, 80.0)
        np.testing.assert_allclose(again[0], ranges, rtol=0, atol=1e-8)
        assert (again[1] == ids).mean() > 0.999  # an edge shared by two objects may go either way
        same = again[1] == ids
        np.testing.assert_allclose(again[2][same], normals[same], atol=1e-5)


def test_bodies_equal_one_by_one(highway, rng):
    origins, directions = views(highway, rng, 300)
    bodies = highway.scene.bodies
    aims = bodies.centre_m[rng.integers(len(bodies.kind), size=150)] - origins[:150]
    directions[:150] = aims / np.linalg.norm(aims, axis=1, keepdims=True)
    scene = Scene(highway.scene.objects, bodies, NO_TERRAIN, build_grid(bodies, NO_TERRAIN, 1.0))
    ranges, ids, _ = scene.cast(origins, directions, 60.0)
    expected = bodies_one_by_one(scene, origins, directions, 60.0)
    np.testing.assert_array_equal(ranges, expected)
    assert np.isfinite(ranges).sum() > 120
    assert np.array_equal(ids == -1, np.isinf(ranges))


def test_ground_equals_dense_sampling(highway, rng):
    builder = SceneBuilder()
    builder.add_ground(highway.terrain, "grass")
    origins, directions = views(highway, rng, 400)
    directions[:, 2] = -np.abs(directions[:, 2]) * rng.choice([0.02, 0.3, 1.0], 400)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ranges, ids, _ = builder.build().cast(origins, directions, 25.0)
    expected = ground_by_steps(builder.terrain, origins, directions, 25.0)
    hit = np.isfinite(ranges)
    assert hit.sum() > 200
    early = ranges < expected - 1e-6  # bumps thinner than the sampling's step
    assert early.mean() < 0.02
    point = origins[hit] + ranges[hit, None] * directions[hit]
    assert np.abs(point[:, 2] - height_at(builder.terrain, point[:, :2])).max() < 1e-8
    np.testing.assert_array_less(ranges[~early & hit], expected[~early & hit] + 2.1e-3)
    assert np.isinf(expected[~hit]).all()
    assert set(ids[hit]) == {builder.terrain.object_id}


def test_ground_is_met_from_below(highway):
    xy = to_plan(highway.alignment, [[20.0, -7.0]])
    z = height_at(highway.terrain, xy)
    ranges, _, normals = highway.scene.cast([[*xy[0], z[0] - 3.0]], [[0.0, 0.0, 1.0]], 10.0)
    assert ranges == pytest.approx([3.0], abs=1e-9)
    assert normals[0, 2] < -0.99  # on the side that the ray comes from


def test_plane():
    scene = simple.plane_scene(slope=0.1)
    angle = np.radians([-10.0, -30.0, -89.0, 5.0, 10.0, -90.0])
    directions = np.column_stack([np.cos(angle), np.zeros(6), np.sin(angle)])
    ranges, ids, normals = scene.cast(np.tile([0.0, 0.0, 2.0], (6, 1)), directions, 200.0)
    expected = 2.0 / (0.1 * np.cos(angle) - np.sin(angle))
    expected[4] = math.inf  # climbs faster than the plane
    assert ranges == pytest.approx(expected, abs=1e-9)
    assert list(ids) == [0, 0, 0, 0, -1, 0]
    assert normals[0] == pytest.approx(np.array([-0.1, 0.0, 1.0]) / math.hypot(0.1, 1.0))
    assert np.isnan(normals[4]).all()


def test_wall_and_maximum_range():
    scene = simple.wall_scene(distance_m=20.0)
    ray = [[0.0, 0.0, 1.5]], [[1.0, 0.0, 0.0]]
    ranges, _, normals = scene.cast(*ray, 100.0)
    assert ranges == pytest.approx([20.0])
    assert normals[0] == pytest.approx([-1.0, 0.0, 0.0])
    assert np.isfinite(scene.cast(*ray, 20.0)[0]).all()  # a surface at the limit counts
    assert np.isinf(scene.cast(*ray, 19.999)[0]).all()


def test_box_cylinder_ellipsoid_and_tunnel():
    box = simple.box_scene((10.0, 0.0, 1.0), (2.0, 2.0, 2.0), yaw_deg=45.0)
    assert box.cast([[0, 0, 1.0]], [[1.0, 0, 0]], 50.0)[0] == pytest.approx([10 - math.sqrt(2)])
    pole = simple.cylinder_scene(10.0, 0.0, 0.25, 6.0)
    assert pole.cast([[0, 0, 1.0]], [[1.0, 0, 0]], 50.0)[0] == pytest.approx([9.75])
    crown = simple.ellipsoid_scene((10.0, 0.0, 4.0), (2.0, 1.5, 3.0))
    assert crown.cast([[10.0, 0, 20.0]], [[0, 0, -1.0]], 50.0)[0] == pytest.approx([13.0])
    tunnel = simple.tunnel_scene(60.0, 6.0)
    up_and_across = [[0, 0, 1.0], [0, 1.0, 0], [0, 0, -1.0], [1.0, 0, 0]]
    ranges, ids, _ = tunnel.cast(np.tile([0.0, 0.0, 2.0], (4, 1)), up_and_across, 100.0)
    assert ranges == pytest.approx([4.0, math.sqrt(32.0), 2.0, math.inf])
    assert list(ids) == [1, 1, 0, -1]


def test_hill_hides_what_is_behind_it(rng):
    scene = simple.hill_scene(height_m=6.0, width_m=20.0)
    low = scene.cast([[-70.0, 0.0, 2.0]], [[1.0, 0.0, 0.0]], 200.0)[0]
    high = scene.cast([[-70.0, 0.0, 6.2]], [[1.0, 0.0, 0.0]], 200.0)[0]
    at = -20.0 * math.sqrt(2.0 * math.log(6.0 / 2.0))
    assert low == pytest.approx([70.0 + at], abs=0.05)  # the spline blurs the bell a little
    assert np.isinf(high).all()


def test_rays_along_the_axes_and_cell_borders(highway):
    scene = simple.hill_scene()
    corner = np.array([scene.grid.x_m, scene.grid.y_m])
    xy = corner + scene.grid.cell_m * np.array([[40, 40], [40, 90], [80, 80]])
    down = scene.cast(np.column_stack([xy, [50.0] * 3]), [[0.0, 0.0, -1.0]] * 3, 100.0)[0]
    assert down == pytest.approx(50.0 - height_at(scene.terrain, xy), abs=1e-9)
    along = scene.cast([[-60.0, xy[2, 1], 3.0]], [[1.0, 0.0, 0.0]], 200.0)[0]
    nudged = scene.cast([[-60.0, xy[2, 1] + 1e-9, 3.0]], [[1.0, 0.0, 0.0]], 200.0)[0]
    assert along == pytest.approx(nudged, abs=1e-6)


def test_a_ray_from_the_ground_leaves_it(highway):
    xy = to_plan(highway.alignment, [[10.0, 6.0], [20.0, -6.0], [30.0, 20.0]])
    origins = np.column_stack([xy, height_at(highway.terrain, xy)])
    assert np.isinf(highway.scene.cast(origins, [[0.0, 0.0, 1.0]] * 3, 5.0)[0]).all()


def test_an_empty_scene_returns_nothing():
    scene = SceneBuilder().build()
    ranges, ids, normals = scene.cast([[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]], 10.0)
    assert np.isinf(ranges).all()
    assert list(ids) == [-1]
    assert np.isnan(normals).all()
    assert [len(part) for part in scene.cast(np.empty((0, 3)), np.empty((0, 3)), 10.0)] == [0, 0, 0]


def test_nearest_of_two_and_tie_goes_to_the_first():
    builder = SceneBuilder()
    ids = [builder.add_object(name, "concrete", TruthClass.STRUCTURE) for name in "abc"]
    for object_id, x in zip(ids, (8.0, 5.0, 5.0), strict=True):
        builder.add_body(object_id, BOX, [x, 0, 0], [1, 1, 1])
    ranges, found, _ = builder.build().cast([[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], 50.0)
    assert ranges == pytest.approx([4.0])
    assert list(found) == [1]


@pytest.mark.parametrize(
    ("origins", "directions", "reach"),
    [
        ([[0.0, 0.0, np.nan]], [[0.0, 0.0, 1.0]], 10.0),
        ([[0.0, 0.0, 0.0]], [[0.0, 0.0, np.inf]], 10.0),
        ([[0.0, 0.0, 0.0]], [[0.0, 0.0, 2.0]], 10.0),
        ([[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0]], 10.0),
        ([[0.0, 0.0]], [[0.0, 1.0]], 10.0),
        ([[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]] * 2, 10.0),
        ([[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]], 0.0),
        ([[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]], np.nan),
    ],
)
def test_bad_rays_are_refused(origins, directions, reach):
    with pytest.raises(InputError, match=r"Scene\.cast"):
        simple.plane_scene().cast(origins, directions, reach)


def test_rotation_is_yaw_then_pitch_up_then_roll():
    rotation = rotation_zyx(math.pi / 2, math.radians(30.0))
    assert rotation @ [1, 0, 0] == pytest.approx([0, math.cos(math.pi / 6), 0.5])
    assert np.linalg.det(rotation_zyx(0.3, 0.2, 0.1)) == pytest.approx(1.0)
    assert rotation_zyx(0.0, 0.0, math.pi / 2) @ [0, 1, 0] == pytest.approx([0, 0, 1])
