import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Transformer

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight_worlds.rural.rural_ground import SIDE_ROAD
from roadsight_worlds.rural.rural_line import random_line
from roadsight_worlds.rural.rural_materials import CLOUD_OF_GROUND, Ground, Material
from roadsight_worlds.rural.rural_mesh import MeshBuilder, face_normals
from roadsight_worlds.rural.rural_road import EPSG, build_rural
from roadsight_worlds.rural.rural_surface import ground_kinds
from roadsight_worlds.rural.rural_truth import rural_layers
from roadsight_worlds.rural.videolog_tables import pole_table


@pytest.fixture(scope="module")
def site():
    return build_rural(3, 300.0, detail=0.02)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_line_goes_both_ways_without_doubling_back(seed):
    line = random_line(-50.0, 600.0, np.random.default_rng(seed))
    road = np.random.default_rng(seed).uniform([-40.0, -90.0], [590.0, 90.0], (200, 2))
    assert np.abs(line.road(line.plan(*road.T)) - road).max() < 1e-3
    assert np.ptp(line.heading_rad) < np.radians(100.0)
    assert np.abs(line.grade(line.station_m)).max() < 0.11


def test_line_bends_both_ways_and_grade_is_the_slope_of_height():
    line = random_line(-100.0, 1100.0, np.random.default_rng(1))
    curvature = np.gradient(line.heading_rad, line.station_m)
    assert curvature.max() > 1.0 / 400.0 and curvature.min() < -1.0 / 400.0
    assert np.abs(curvature).max() < 1.0 / 185.0
    s = np.linspace(0.0, 1000.0, 50)
    slope = (line.height(s + 1e-4) - line.height(s - 1e-4)) / 2e-4
    np.testing.assert_allclose(slope, line.grade(s), atol=1e-7)
    assert line.plan(0.0, 0.0) == pytest.approx([0.0, 0.0], abs=1e-9)


def test_same_seed_same_site_and_another_seed_another(site):
    again, other = build_rural(3, 300.0, detail=0.02), build_rural(4, 100.0, detail=0.02)
    for mine, theirs in zip(site.mesh, again.mesh, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert site.poles == again.poles
    assert site.poles != other.poles
    assert not np.array_equal(site.line.heading_rad, other.line.heading_rad)


def test_mesh_is_sound(site):
    mesh = site.mesh
    assert np.isfinite(mesh.vertices_m).all() and np.isfinite(mesh.normal).all()
    assert mesh.triangles.min() >= 0 and mesh.triangles.max() < len(mesh.vertices_m)
    assert (mesh.material[: site.corridor_triangles] == Material.GROUND).all()
    assert not (mesh.material[site.corridor_triangles :] == Material.GROUND).any()
    assert np.allclose(np.linalg.norm(mesh.normal, axis=1), 1.0, atol=1e-5)
    assert mesh.object_id.max() == len(site.kinds) - 1
    # Nowhere does the corridor fold over itself in plan.
    corners = mesh.vertices_m[mesh.triangles[: site.corridor_triangles]]
    up = face_normals(corners)[:, 2]
    assert (up < 0.0).all() or (up > 0.0).all()


def test_ground_height_follows_profile_and_crossfall(site):
    s = np.linspace(10.0, 290.0, 40)
    pavement = site.ground.section.pavement_m
    middle, edge = site.ground.height(s, 0.0), site.ground.height(s, pavement)
    np.testing.assert_allclose(middle, site.line.height(s))
    np.testing.assert_allclose(middle - edge, 0.02 * pavement)
    xy = site.line.plan(s, 2.0)
    np.testing.assert_allclose(site.height(xy), site.ground.height(s, 2.0), atol=1e-4)


def test_what_the_ground_is_agrees_with_the_truth_polygons(site):
    rng = np.random.default_rng(0)
    road = rng.uniform([0.0, -30.0], [300.0, 30.0], (20_000, 2))
    xy = site.line.plan(*road.T)
    kinds = ground_kinds(site.surface, xy, road)
    layers = rural_layers(site)
    paved = shapely.union_all(layers["pavement"].geometry.to_numpy())
    inside = shapely.contains_xy(paved, *xy.T)
    near = shapely.distance(shapely.boundary(paved), shapely.points(xy)) < 0.02
    shoulder_of_bridge = (kinds == Ground.BRIDGE) & (
        np.abs(road[:, 1]) > site.ground.section.pavement_m
    )
    is_road = np.isin(CLOUD_OF_GROUND[kinds], (11, 17)) & ~shoulder_of_bridge
    assert (is_road == inside)[~near].all()
    assert {Ground.GRASS, Ground.ROAD, Ground.WHITE_LINE, Ground.YELLOW_LINE} <= set(kinds)


def test_side_road_has_no_lines_and_its_mouth_no_edge_line(site):
    side_road = next(b for b in site.ground.branches if b.kind == SIDE_ROAD)
    lane = site.ground.section.lane_m - 0.06
    s = side_road.station_m
    for side, wanted in ((side_road.side, Ground.ROAD), (-side_road.side, Ground.WHITE_LINE)):
        road = np.array([[s, side * lane]])
        assert ground_kinds(site.surface, site.line.plan(*road.T), road)[0] == wanted
    xy = side_road.start_m + 10.0 * side_road.ahead
    assert ground_kinds(site.surface, xy, site.line.road(xy))[0] == Ground.SIDE_ROAD


def test_posts_stand_on_the_ground_beside_the_road(site):
    assert sum(p.kind == "utility" for p in site.poles) >= 8
    for pole in site.poles:
        assert site.ground.section.pavement_m < abs(pole.offset_m) < 20.0
        x, y, z = pole.xyz_m
        assert site.line.plan(pole.station_m, pole.offset_m) == pytest.approx([x, y])
        assert site.height([[x, y]])[0] == pytest.approx(z, abs=0.02)
    kinds = ground_kinds(
        site.surface,
        [p.xyz_m[:2] for p in site.poles],
        [(p.station_m, p.offset_m) for p in site.poles],
    )
    assert set(kinds) <= {Ground.GRASS, Ground.SHOULDER}


def test_trees_and_guardrails_of_the_truth_are_those_of_the_mesh(site):
    layers, kinds = rural_layers(site), np.array(site.kinds)
    assert len(layers["trees"]) == len(site.trees) == (kinds == "tree").sum() > 20
    owners = site.mesh.object_id
    for number, tree in zip(np.flatnonzero(kinds == "tree"), site.trees, strict=True):
        trunk = np.unique(site.mesh.triangles[owners == number][:14])
        middle = site.mesh.vertices_m[trunk, :2].mean(axis=0)
        assert np.abs(middle - tree.xyz_m[:2]).max() < 0.05
    rails = site.mesh.triangles[np.isin(owners, np.flatnonzero(kinds == "guardrail"))]
    beams = shapely.points(site.mesh.vertices_m[np.unique(rails), :2])
    lines = shapely.union_all(layers["guardrails"].geometry.to_numpy())
    assert shapely.distance(beams, lines).max() < 0.1
    assert lines.length == pytest.approx(80.0, abs=0.5)


def test_the_full_site_has_thirty_to_forty_utility_poles():
    site = build_rural(1, 1000.0, detail=0.01)
    assert 30 <= sum(pole.kind == "utility" for pole in site.poles) <= 40
    assert {pole.kind for pole in site.poles} == {
        "utility", "sign", "delineator", "fence", "mailbox",
    }  # fmt: skip


def test_the_site_lies_in_western_north_carolina_in_us_feet(site):
    table = pole_table(site)
    frame = site.frame()
    assert isinstance(frame, Frame) and frame.unit_m == frame.vertical_unit_m == 1200 / 3937
    lon, lat = Transformer.from_crs(EPSG, 4326, always_xy=True).transform(
        table["easting_usft"], table["northing_usft"]
    )
    np.testing.assert_allclose(lon, table["longitude"], atol=1e-8)
    np.testing.assert_allclose(lat, table["latitude"], atol=1e-8)
    assert -84.0 < lon[0] < -82.5 and 35.0 < lat[0] < 36.0


@pytest.mark.parametrize("arguments", [(-1, 300.0), (1, 10.0), (1, 1e6), (1, float("nan"))])
def test_bad_arguments_are_refused(arguments):
    with pytest.raises(InputError):
        build_rural(*arguments)


def test_a_round_post_keeps_its_volume():
    builder = MeshBuilder()
    builder.start("post")
    builder.post([1.0, 2.0, 3.0], 10.0, (0.15, 0.15), 12, Material.POLE_WOOD)
    mesh = builder.build()
    ring = mesh.vertices_m[:12, :2] - [1.0, 2.0]
    area = shapely.Polygon(ring).area
    assert area == pytest.approx(np.pi * 0.15**2, rel=1e-9)
    assert mesh.vertices_m[:, 2].min() == pytest.approx(2.6)
    assert mesh.vertices_m[:, 2].max() == pytest.approx(13.0)


def test_panels_of_any_kind_stand_beside_an_unchanged_road(site):
    more = build_rural(3, 300.0, detail=0.02, panels_per_km=60.0)
    assert more.poles[: len(site.poles)] == site.poles and more.trees == site.trees
    own = more.poles[len(site.poles) :]
    assert 15 < len(own) < 34 and {pole.kind for pole in own} == {"sign"}
    away = np.abs([pole.offset_m for pole in own])
    assert away.min() > 4.7 and away.max() < 9.6
    assert np.ptp([pole.height_m for pole in own]) > 1.0
    shown = more.mesh.triangles[more.mesh.material == Material.SIGN_PAINT]
    painted = more.mesh.tint[more.mesh.material == Material.SIGN_PAINT]
    assert len(np.unique(np.floor(10 * painted))) > 7
    feet = np.array([pole.xyz_m for pole in own])
    apart = np.hypot(
        *(more.mesh.vertices_m[shown[:, 0], None, :2] - feet[:, :2]).transpose(2, 0, 1)
    )
    assert apart.min(axis=1).max() < 1.0
    assert not (site.mesh.material == Material.SIGN_PAINT).any()
