import math

import numpy as np
import pytest
import shapely

from roadsight.base.errors import InputError
from roadsight_worlds.casting.alignment import to_plan, to_road
from roadsight_worlds.casting.materials import MATERIAL_NAMES, TruthClass
from roadsight_worlds.casting.terrain import height_at
from roadsight_worlds.highway.highway import build_highway
from roadsight_worlds.highway.highway_ground import CrossSection, is_marking
from roadsight_worlds.highway.truth import digitised_edges, truth_layers


@pytest.fixture(scope="module")
def site():
    return build_highway(seed=1, length_m=100.0)


@pytest.fixture(scope="module")
def layers(site):
    return truth_layers(site)


def kinds_of(site, ids):
    return [site.scene.objects[i].kind if i >= 0 else "none" for i in ids]


def down_from(site, road, above_m=30.0):
    """What a plumb ray meets: height above the grade plane, and kind."""
    xy = to_plan(site.alignment, road)
    origins = np.column_stack([xy, np.full(len(xy), site.terrain.height_m + above_m)])
    ranges, ids, _ = site.scene.cast(origins, [[0.0, 0.0, -1.0]] * len(xy), 100.0)
    plane = site.terrain.height_m + site.terrain.grade * np.asarray(road)[:, 0]
    return origins[:, 2] - ranges - plane, kinds_of(site, ids)


def test_the_section_has_its_widths():
    section = CrossSection()
    assert section.lane_edges_m == (1.75, 5.5, 9.25)
    assert section.pavement_m == (1.0, 11.75)
    offset, height = section.profile()
    assert np.all(np.diff(offset) > 0)
    assert np.interp([-11.75, -1.0, 1.0, 11.75], offset, height) == pytest.approx(
        [-0.215, 0.0, 0.0, -0.215]
    )
    assert np.interp([-30.0, 0.0, 35.0], offset, height) == pytest.approx(
        [-4.9, 0.12, 7.65], abs=0.1
    )


def test_pavement_is_smooth_and_the_rest_is_rough(site, rng):
    profile = site.section.profile()

    def residual(low, high):
        road = np.column_stack([rng.uniform(1, 70, 5000), rng.uniform(low, high, 5000)])
        z = height_at(site.terrain, to_plan(site.alignment, road))
        plane = site.terrain.height_m + site.terrain.grade * road[:, 0]
        return z - plane - np.interp(road[:, 1], *profile)

    for low, high in ((1.0, 11.75), (-11.75, -1.0)):
        assert np.abs(residual(low, high)).max() < 0.02
    verge, slope = residual(12.2, 13.2), residual(-25.0, -16.0)
    assert 0.01 < verge.std() < 0.04
    assert 0.05 < slope.std() < 0.2


def test_classes_and_materials_follow_the_offset(site):
    road = [[10.0, o] for o in (0.0, 0.99, 1.01, 5.0, 9.25, 11.74, 11.76, -5.0, -20.0)]
    xy = to_plan(site.alignment, road)
    classes, heights = site.ground_classes(xy), height_at(site.terrain, xy)
    assert list(classes) == [2, 2, 11, 11, 11, 11, 2, 11, 2]
    assert np.isfinite(heights).all()
    names = [MATERIAL_NAMES[code] for code in site.ground_materials(xy)]
    assert names == [
        "soil", "soil", "asphalt", "asphalt", "marking", "asphalt", "grass", "asphalt", "grass",
    ]  # fmt: skip


def test_lane_lines_are_dashed_and_edge_lines_solid():
    section = CrossSection()
    station = np.arange(0.0, 150.0, 0.1)
    assert is_marking(section, station, np.full(1500, 9.25)).all()
    assert is_marking(section, station, np.full(1500, -5.5)).mean() == pytest.approx(0.4, abs=0.01)
    assert not is_marking(section, station, np.full(1500, 3.0)).any()


def test_barrier_tunnel_and_cars_stand_where_they_should(site):
    heights, kinds = down_from(site, [[20.0, 0.0], [20.0, 0.5], [50.0, 3.0], [90.0, 6.0]])
    assert kinds == ["median_barrier", "ground", "ground", "tunnel"]
    assert heights[0] == pytest.approx(1.02, abs=0.01)
    assert heights[3] == pytest.approx(7.8, abs=0.02)
    car = 0.26 * site.tunnel_start_m, -10.55
    assert down_from(site, [car])[1] == ["car"]
    assert site.ground_classes(to_plan(site.alignment, [car]))[0] == TruthClass.ROAD


def test_the_tunnel_is_high_and_wide_enough(site):
    road = np.array([[s, o] for s in (80.0, 90.0, 99.0) for o in (-11.7, -6.0, 2.0, 11.7)])
    xy = to_plan(site.alignment, road)
    origins = np.column_stack([xy, height_at(site.terrain, xy)])
    up = site.scene.cast(origins, [[0.0, 0.0, 1.0]] * len(xy), 20.0)
    assert up[0].min() > 6.5
    assert set(kinds_of(site, up[1])) == {"tunnel"}
    open_road = to_plan(site.alignment, [[70.0, -6.0]])
    origin = np.column_stack([open_road, height_at(site.terrain, open_road)])
    assert np.isinf(site.scene.cast(origin, [[0.0, 0.0, 1.0]], 20.0)[0]).all()


def test_every_pole_is_where_the_truth_says(site):
    assert {pole.kind for pole in site.poles} == {"lamp", "utility_pole", "gantry", "sign"}
    for pole in site.poles:
        x, y, z = pole.xyz_m
        assert to_road(site.alignment, [[x, y]])[0] == pytest.approx(
            [pole.station_m, pole.offset_m]
        )
        assert z == pytest.approx(height_at(site.terrain, [[x, y]])[0])
        origin = [[x - 1.0, y, z + 0.8 * pole.height_m]]
        ranges, ids, _ = site.scene.cast(origin, [[1.0, 0.0, 0.0]], 5.0)
        if pole.kind != "sign":  # its panel may be in the way
            assert ranges == pytest.approx([1.0 - pole.radius_m])
            assert kinds_of(site, ids) == [pole.kind]


def test_crowns_let_light_through(site, rng):
    bodies = site.scene.bodies
    trees = [i for i, o in enumerate(site.scene.objects) if o.kind == "tree"]
    assert len(trees) >= 5
    passed = []
    for tree in trees:
        centres = bodies.centre_m[bodies.object_id == tree]
        middle = centres.mean(axis=0)
        origins = middle + np.column_stack([np.full(200, -5.0), rng.uniform(-1, 1, (200, 2))])
        ranges, ids, _ = site.scene.cast(origins, [[1.0, 0.0, 0.0]] * 200, 10.0)
        passed.append((ids != tree).mean())
        depth = ranges[ids == tree]
        assert depth.std() > 0.2  # not a shell
    assert 0.05 < np.mean(passed) < 0.7


def test_the_same_seed_gives_the_same_site_and_another_another():
    first, again, other = (build_highway(seed, 50.0) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.terrain.coefficient_m, again.terrain.coefficient_m)
    np.testing.assert_array_equal(first.scene.bodies.centre_m, again.scene.bodies.centre_m)
    assert not np.array_equal(first.terrain.coefficient_m, other.terrain.coefficient_m)
    scene = build_highway(5, 50.0).scene
    np.testing.assert_array_equal(scene.bodies.centre_m, first.scene.bodies.centre_m)


@pytest.mark.parametrize("length", [39.9, 601.0, math.nan, -5.0])
def test_lengths_out_of_range_are_refused(length):
    with pytest.raises(InputError, match="length"):
        build_highway(1, length)


def test_negative_seeds_are_refused():
    with pytest.raises(InputError, match="seed"):
        build_highway(-1)


def test_true_pavement_and_edges_fit_each_other(site, layers):
    pavement, edges = layers["pavement"], layers["edges"].set_index("edge")
    assert list(pavement["carriageway"]) == ["left", "right"]
    arc = 100.0 * (1.0 - np.array([6.375, -6.375]) / 600.0)
    assert pavement.geometry.area.to_numpy() == pytest.approx(arc * 10.75, rel=1e-5)
    assert edges.geometry["median"].length == pytest.approx(100.0, abs=1e-3)
    for name, side in (("left", 0), ("right", 1)):
        assert edges.geometry[name].distance(pavement.geometry[side]) < 1e-9
        assert edges.geometry[f"median_{name}"].hausdorff_distance(
            edges.geometry["median"]
        ) == pytest.approx(1.0, abs=1e-3)
    assert set(edges["kind"]) == {"edge", "median"}


def test_points_inside_the_true_pavement_are_road(site, layers, rng):
    road = np.column_stack([rng.uniform(1, 99, 2000), rng.uniform(-14, 14, 2000)])
    xy = to_plan(site.alignment, road)
    inside = shapely.contains_xy(layers["pavement"].union_all(), *xy.T)
    near_edge = np.min(np.abs(np.abs(road[:, 1:]) - [1.0, 11.75]), axis=1) < 1e-3
    agree = inside == (site.ground_classes(xy) == TruthClass.ROAD)
    assert agree[~near_edge].all()


def test_objects_have_footprints_and_heights(site, layers):
    objects = layers["objects"]
    assert len(objects) == len(site.scene.objects) - 1
    assert objects.geometry.is_valid.all()
    assert (objects.geometry.area > 0).all()
    building = objects[objects["kind"] == "building"].iloc[0]
    assert building.geometry.area == pytest.approx(8.0 * 6.0)
    assert building["top_m"] - building["bottom_m"] == pytest.approx(4.8)
    poles = layers["poles"]
    lamps = objects[objects["kind"] == "lamp"]
    for foot in poles[poles["kind"] == "lamp"].geometry:
        assert lamps.geometry.contains(shapely.Point(foot.x, foot.y)).sum() == 1


def test_clicks_are_near_the_edges(site, layers, rng):
    clicked, exact = digitised_edges(site, rng), layers["edges"].set_index("edge").geometry
    assert list(clicked["edge"]) == ["left", "median", "right"]
    assert list(clicked["kind"]) == ["edge", "median", "edge"]
    for name, line in zip(clicked["edge"], clicked.geometry, strict=True):
        points = shapely.get_coordinates(line)
        off = [exact[name].distance(shapely.Point(p)) for p in points]
        assert max(off) < 0.3
        assert max(off) > 0.005
        gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        assert np.all(gaps[:-1] > 13.5)
        assert np.all(gaps < 26.5)
