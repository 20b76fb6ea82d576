from dataclasses import replace

import numpy as np
import pytest

from roadsight.geometry.cameras import Intrinsics, cam_from_world, pixel_directions, project
from roadsight.poles.images.kinds import PixelClass
from roadsight_worlds.casting import primitives
from roadsight_worlds.rendering import rendering_noise
from roadsight_worlds.rendering.images import Camera, Finish, RuralRenderer
from roadsight_worlds.rendering.rendering_look import drive_look, random_look, random_training_views
from roadsight_worlds.rural.rural_materials import Material
from roadsight_worlds.rural.rural_mesh import MeshBuilder
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.videolog import random_drives, shots
from tests.helpers.kernels import from_python

LOOK, FINISH = random_look(np.random.default_rng(0)), Finish()
SMALL = Intrinsics.from_field_of_view(160, 104, 40.0)


@pytest.fixture(scope="module")
def site():
    return build_rural(5, 200.0, detail=0.05)


@pytest.fixture(scope="module")
def renderer(site):
    return RuralRenderer(site)


def bare_renderer(site, fill):
    """Renderer of a scene of its own, without the corridor's ground."""
    builder = MeshBuilder()
    builder.start("thing")
    fill(builder)
    return RuralRenderer(replace(site, mesh=builder.build(), corridor_triangles=0))


def rays(camera):
    lens = camera.intrinsics
    uv = np.indices((lens.height_px, lens.width_px))[::-1].reshape(2, -1).T
    return pixel_directions(lens, camera.rotation, uv)


def test_depth_of_a_plane_is_exact(site):
    corners = [[-500, -500, 1.0], [500, -500, 1.0], [500, 500, 1.0], [-500, 500, 1.0]]
    renderer = bare_renderer(site, lambda b: b.quad(corners, Material.CONCRETE))
    camera = Camera(SMALL, cam_from_world(33.0, -4.0, 1.5), np.array([3.0, -2.0, 3.2]))
    view = renderer.render_view(camera, LOOK, FINISH, 0)
    ray = rays(camera)
    with np.errstate(divide="ignore"):
        wanted = (1.0 - 3.2) / ray[:, 2]
    depth = wanted * (ray @ camera.rotation[2])
    near = (wanted > 0.0) & (wanted < 300.0)
    got = view.depth_m.ravel()
    assert near.sum() > 5000
    np.testing.assert_allclose(got[near], depth[near], rtol=2e-5)
    assert np.isinf(got[wanted < 0.0]).all()
    assert (view.classes.ravel()[wanted < 0.0] == PixelClass.SKY).all()
    assert (view.classes.ravel()[near] == PixelClass.OTHER).all()


def test_depth_of_a_pole_is_that_of_a_cylinder(site):
    foot = np.array([2.0, 30.0, 0.0])

    def pole(builder):
        builder.post(foot, 10.0, (0.15, 0.15), 12, Material.POLE_WOOD)

    renderer = bare_renderer(site, pole)
    lens = Intrinsics.from_field_of_view(200, 120, 6.0)
    camera = Camera(lens, cam_from_world(4.0, 3.0, 0.0), np.array([0.0, 0.0, 2.0]))
    view = renderer.render_view(camera, LOOK, FINISH, 0)
    start = camera.position_m - foot - [0.0, 0.0, 4.8]
    ray_cylinder = from_python(primitives.ray_cylinder)
    wanted = np.array([ray_cylinder(*start, *ray, 0.15, 5.2) for ray in rays(camera)])
    wanted = (wanted * (rays(camera) @ camera.rotation[2])).reshape(view.depth_m.shape)
    both = np.isfinite(wanted) & np.isfinite(view.depth_m)
    # The prism of the same volume is nowhere farther than 2.5 % of its radius from the cylinder.
    assert np.abs(view.depth_m[both] - wanted[both]).mean() < 0.006
    assert both.sum() > 0.98 * np.isfinite(wanted).sum()
    assert ((view.classes == PixelClass.POLE) == np.isfinite(view.depth_m)).all()
    assert view.classes[60].tolist().count(PixelClass.POLE) == pytest.approx(
        lens.focal_px * 0.3 / 30.0, abs=1.5
    )


def test_depth_of_the_road_is_that_of_the_ground(site, renderer):
    eye = np.array([*site.line.plan(50.0, -1.6), site.line.height(50.0) + 2.0])
    heading = 90.0 - np.degrees(site.line.heading(50.0))
    camera = Camera(SMALL, cam_from_world(heading, -8.0, 0.0), eye)
    view = renderer.render_view(camera, LOOK, FINISH, 0)
    ray = rays(camera)
    road = (view.classes == PixelClass.ROAD) | (view.classes == PixelClass.MARKING)
    reach = view.depth_m.ravel() / (ray @ camera.rotation[2])
    place = eye + reach[:, None] * ray
    place_road = site.line.road(np.where(np.isfinite(place[:, :2]), place[:, :2], 0.0))
    own = np.abs(place_road[:, 1]) < site.ground.section.pavement_m
    rows = np.flatnonzero(road.ravel() & own & (reach < 60.0))
    assert len(rows) > 2000
    # Metre-long chords of the profile's curve are off by less than a millimetre.
    assert np.abs(place[rows, 2] - site.height(place[rows, :2])).max() < 2e-3


@pytest.mark.parametrize("count", [1, 3000])
def test_stations_are_linear_over_the_triangles_that_rays_end_on(site, renderer, rng, count):
    origins = np.array([*site.line.plan(80.0, 0.0), 40.0]) + rng.uniform(-20.0, 20.0, (count, 3))
    ways = np.column_stack([rng.uniform(-2.0, 2.0, (count, 2)), np.full(count, -1.0)])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    cast = renderer.cast(origins, ways)
    for row in range(count):
        number = cast.triangle[row]
        reach = cast.range_m[row] if number >= 0 else 0.0
        assert cast.place_m[row] == pytest.approx(origins[row] + reach * ways[row])
        if not 0 <= number < site.corridor_triangles:
            assert not cast.road_m[row].any()
            continue
        corners = site.mesh.triangles[number]
        a, b, c = site.mesh.vertices_m[corners]
        shares = np.linalg.lstsq(np.array([b - a, c - a]).T, cast.place_m[row] - a)[0]
        expected = np.array([1.0 - shares.sum(), *shares]) @ site.road_m[corners]
        assert cast.road_m[row] == pytest.approx(expected, abs=2e-3)
    assert count == 1 or (cast.triangle < site.corridor_triangles).mean() > 0.1


def test_poles_are_where_the_truth_projects_them(site, renderer):
    found = visible = 0
    for shot in shots(site, random_drives(5, (320, 208))[0], 5):
        camera = shot.cameras["front"]
        view = renderer.render_view(camera, LOOK, FINISH, 0)
        for pole in site.poles:
            if pole.kind != "utility":
                continue
            place = np.add([pole.xyz_m], [0.0, 0.0, 3.0])
            uv, depth = project(camera.intrinsics, camera.rotation, camera.position_m, place)
            if not camera.intrinsics.contains(uv, -2.0)[0] or not 8.0 < depth[0] < 60.0:
                continue
            u, v = np.rint(uv[0]).astype(int)
            if view.depth_m[v, u] < depth[0] - 0.3:
                continue  # something stands before it
            visible += 1
            found += view.classes[v, u] == PixelClass.POLE
            assert view.depth_m[v, u] == pytest.approx(depth[0] - 0.15, abs=0.1)
    assert visible >= 5
    assert found == visible


def test_the_same_view_twice_has_the_same_pixels(site, renderer):
    camera = Camera(SMALL, cam_from_world(10.0, 0.0, 0.0), np.array([0.0, 0.0, 5.0]))
    one, two = (RuralRenderer(site).render_view(camera, LOOK, FINISH, 3) for _ in range(2))
    np.testing.assert_array_equal(one.colour, two.colour)
    np.testing.assert_array_equal(one.depth_m, two.depth_m)
    other = renderer.render_view(camera, LOOK, FINISH, 4)
    assert (one.colour != other.colour).any()
    np.testing.assert_array_equal(one.classes, other.classes)


def test_inverse_depth_grows_towards_the_camera(site, renderer):
    camera = Camera(SMALL, cam_from_world(10.0, -5.0, 0.0), np.array([0.0, 0.0, 5.0]))
    view = renderer.render_view(camera, LOOK, FINISH, 3)
    inverse = view.inverse_depth()
    assert inverse.dtype == np.uint16 and (inverse[np.isinf(view.depth_m)] == 0).all()
    order = np.argsort(view.depth_m.ravel(), kind="stable")
    assert (np.diff(inverse.ravel()[order].astype(int)) <= 0).all()


def test_sun_and_shade(site):
    def post(builder):
        builder.quad([[-90, -90, 0], [90, -90, 0], [90, 90, 0], [-90, 90, 0]], Material.CONCRETE)
        builder.box([0.0, 0.0, 2.0], [0.5, 0.5, 2.0], 0.0, Material.CONCRETE)

    renderer = bare_renderer(site, post)
    sun = np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)
    down = np.tile([0.0, 0.0, -1.0], (2, 1))
    cast = renderer.cast(np.array([[-2.5, 0.0, 9.0], [2.5, 0.0, 9.0]]), down)
    assert renderer.sunlit(cast, sun).tolist() == [0.0, 1.0]


def test_training_views_differ_and_repeat():
    one, two = (list(random_training_views(1005, 2, 96, 64, 60.0)) for _ in range(2))
    np.testing.assert_array_equal(one[1].colour, two[1].colour)
    assert one[0].colour.shape == (64, 96, 3) and one[0].classes.shape == (64, 96)
    assert (one[0].colour != one[1].colour).mean() > 0.5


def test_noise_is_bounded_and_continuous():
    noise2, hashed = from_python(rendering_noise.noise2), from_python(rendering_noise.hashed)
    values = [noise2(x, 0.3, 7) for x in np.linspace(-5.0, 5.0, 2001)]
    assert -1.0 <= min(values) < -0.3 and 0.3 < max(values) <= 1.0
    assert np.abs(np.diff(values)).max() < 0.025
    many = [hashed(i, j, 1) for i in range(-40, 40) for j in range(-40, 40)]
    assert np.mean(many) == pytest.approx(0.5, abs=0.02)
    assert len(set(many)) > 6000


def test_one_drive_has_one_weather_and_both_drives_one_road():
    a, b = drive_look(1, 0), drive_look(1, 1)
    np.testing.assert_array_equal(a.sun, drive_look(1, 0).sun)
    assert a.seed == b.seed and a.wear == b.wear
    assert not np.array_equal(a.sun, b.sun)
