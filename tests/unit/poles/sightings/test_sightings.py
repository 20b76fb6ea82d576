from dataclasses import replace

import numpy as np
import pytest

from roadsight.base.sections.poles import Sightings
from roadsight.geometry.cameras import Intrinsics, project, wrap_deg
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.sightings.distances import fit_front_depth
from roadsight.poles.sightings.lidar_poles import PoleColumns
from roadsight.poles.sightings.sighting_bearing import (
    OWN_COLUMN,
    TURNED_COLUMNS,
    ViewCamera,
    image_bearings,
    matching_columns,
    nearest_projected,
    with_place,
)
from roadsight.poles.sightings.sightings import Evidence, measure_view

NONE = PoleColumns(np.empty((0, 2)), np.empty(0), np.empty(0))
CAMERA = ViewCamera(
    Intrinsics.from_field_of_view(1000, 600, 60.0), (5.0, -3.0, 2.5), 355.0, -2.0, 1.0,
    sigma_heading_deg=0.1, sigma_pitch_deg=0.1, sigma_lateral_m=0.1, sigma_along_m=0.3,
)  # fmt: skip


def level(x, y):
    return np.zeros(np.shape(x))


def place(bearing_deg: float, distance_m: float) -> np.ndarray:
    angle = np.radians(bearing_deg)
    return np.array([5.0, -3.0]) + distance_m * np.array([np.sin(angle), np.cos(angle)])


def rendered(poles, camera=CAMERA, height_m=9.0, background_m=200.0):
    """Road mask and inverse depth of level ground with upright poles of radius 0.15 m."""
    rows, columns = camera.intrinsics.height_px, camera.intrinsics.width_px
    v, u = np.mgrid[:rows, :columns]
    rays = camera.rays(np.column_stack([u.ravel(), v.ravel()]))
    along = rays @ camera.rotation()[2]
    with np.errstate(divide="ignore"):
        z = np.where(rays[:, 2] < 0, -2.5 / rays[:, 2] * along, np.inf).reshape(rows, columns)
    mask = np.where(z < 300, PixelClass.ROAD, PixelClass.SKY).astype(np.uint8)
    inverse = 1 / np.minimum(z, background_m)
    for xy in sorted(poles, key=lambda p: -np.hypot(*(p - camera.position_m[:2]))):
        ends = np.array([[*xy, 0.0], [*xy, height_m]])
        (foot, top), depth = project(camera.intrinsics, camera.rotation(), camera.position_m, ends)
        half = 0.15 * camera.intrinsics.focal_px / depth[0]
        for row in range(max(round(top[1]), 0), min(round(foot[1]) + 1, rows)):
            centre = foot[0] + (row - foot[1]) * (top[0] - foot[0]) / (top[1] - foot[1])
            cells = slice(max(round(centre - half), 0), max(round(centre + half) + 1, 0))
            mask[row, cells], inverse[row, cells] = PixelClass.POLE, 1 / depth[0]
    packed = np.clip(1 + 65000 * (inverse * 3 + 0.02), 1, 65535)
    return mask, packed.astype(np.uint16)


def test_bearing_of_the_axis_is_the_heading_and_sigma_has_its_parts():
    camera = ViewCamera(Intrinsics.centred(801, 601, 800.0), (0, 0, 2), 10.0, sigma_heading_deg=0.3)
    bearing, sigma = image_bearings(camera, [[400.0, 300.0]], 4.0)
    assert float(bearing[0]) == pytest.approx(10.0)
    assert float(sigma[0]) == pytest.approx(np.hypot(np.degrees(4 / 800), 0.3), rel=1e-3)
    assert float(with_place(camera, bearing, sigma, [20.0])[0]) == pytest.approx(float(sigma[0]))
    beside = ViewCamera(camera.intrinsics, (0, 0, 2), 10.0, sigma_lateral_m=0.5)
    seen = with_place(beside, [10.0, 100.0], [0.0, 0.0], [20.0, 20.0])
    assert seen == pytest.approx([np.degrees(np.arctan(0.5 / 20)), 0.0], abs=1e-6)


def test_bearing_and_distances_of_upright_poles_are_right():
    truth = [(335.0, 30.0), (350.0, 12.0), (15.0, 20.0)]
    mask, depth = rendered([place(*one) for one in truth])
    table = measure_view(CAMERA, mask, depth, Evidence(level, NONE, np.empty((0, 3))))
    assert table["kept"].tolist() == [True, True, True]
    bearing = np.array([one[0] for one in truth])
    distance = np.array([one[1] for one in truth])
    error = wrap_deg(table["bearing_grid_deg"] - bearing)
    assert np.abs(error).max() < 0.1
    assert (np.abs(error) < 3 * table["sigma_bearing_deg"]).all()
    for name in ("depth_network_m", "depth_ground_m", "depth_m"):
        assert np.allclose(table[name], distance, rtol=0.03)
    apart = np.abs(table["depth_m"] - distance)
    assert (apart < 3 * table["sigma_depth_m"]).all()
    assert np.allclose(table["height_m"][[0, 2]], 9.0, rtol=0.12)
    assert set(table["depth_from"]) == {"network+ground"}


def test_the_parts_of_a_bearings_sigma_are_all_of_it():
    camera = replace(CAMERA, sigma_cx_px=3.0, heading_by_cx_deg=0.08, sigma_focal_ratio=0.01)
    mask, depth = rendered([place(*one) for one in ((335.0, 30.0), (350.0, 12.0), (15.0, 20.0))])
    table = measure_view(camera, mask, depth, Evidence(level, NONE, np.empty((0, 3))))
    turned = table[[*TURNED_COLUMNS]].to_numpy()
    bearing = table["bearing_grid_deg"].to_numpy()
    across = np.degrees(np.arctan(camera.sigma_across_m(bearing) / table["depth_m"]))
    whole = np.sqrt(table[OWN_COLUMN] ** 2 + (turned**2).sum(axis=1) + across**2)
    np.testing.assert_allclose(whole, table["sigma_bearing_deg"])
    # A longer lens sees things nearer to its axis, on either side of it.
    assert turned[0, 1] > 0.1 > -0.1 > turned[2, 1]


def test_a_single_lidar_column_sharpens_bearing_and_distance():
    mask, depth = rendered([place(350.0, 20.0)])
    column = PoleColumns(place(350.05, 20.4)[None], np.array([9.0]), np.array([0.1]))
    points = np.empty((0, 3))
    plain = measure_view(CAMERA, mask, depth, Evidence(level, NONE, points)).iloc[0]
    sharp = measure_view(CAMERA, mask, depth, Evidence(level, column, points)).iloc[0]
    assert (plain["method"], sharp["method"]) == ("image", "fused")
    assert sharp["depth_m"] == pytest.approx(20.4, abs=0.1)
    # The column's own error: where the camera stands does not move it.
    assert sharp["sigma_depth_m"] <= 0.1 < CAMERA.sigma_along_m < plain["sigma_depth_m"]
    low, high = sorted([plain["bearing_grid_deg"], 350.05])
    assert low <= sharp["bearing_grid_deg"] <= high
    assert sharp["sigma_bearing_deg"] < plain["sigma_bearing_deg"]
    image_only = Sightings(bearing="image")
    unmoved = measure_view(CAMERA, mask, depth, Evidence(level, column, points), image_only).iloc[0]
    assert unmoved["bearing_grid_deg"] == plain["bearing_grid_deg"]


@pytest.mark.parametrize("behind_m", [-1.2, 0.0, 1.2])
def test_a_ray_that_ends_at_a_column_ends_there(behind_m):
    """Also where the camera stands 2 sigmas off along the road, so that the others disagree."""
    camera = replace(CAMERA, sigma_along_m=0.6)
    mask, depth = rendered([place(350.0, 12.0)], camera)
    column = PoleColumns(place(350.0, 12.0 + behind_m)[None], np.array([9.0]), np.array([0.03]))
    evidence = Evidence(level, column, np.empty((0, 3)))
    found = measure_view(camera, mask, depth, evidence).iloc[0]
    assert found["depth_lidar_m"] == pytest.approx(12.0 + behind_m)
    assert (found["depth_m"], found["depth_from"]) == (found["depth_lidar_m"], "lidar")
    assert found["sigma_depth_m"] == pytest.approx(0.03)


def test_two_columns_that_agree_are_not_used():
    two = PoleColumns(
        np.array([place(350.0, 20.0), place(350.1, 20.5)]), np.full(2, 9.0), np.full(2, 0.1)
    )
    found = matching_columns(
        CAMERA, two, np.array([350.0]), np.array([0.2]), np.array([20.0]), np.array([1.0]), 60.0
    )
    assert found.tolist() == [-1]
    far = PoleColumns(
        np.array([place(350.0, 20.0), place(350.0, 45.0)]), np.full(2, 9.0), np.full(2, 0.1)
    )
    known = matching_columns(
        CAMERA, far, np.array([350.0]), np.array([0.2]), np.array([20.0]), np.array([1.0]), 60.0
    )
    unknown = matching_columns(
        CAMERA, far, np.array([350.0]), np.array([0.2]), np.array([np.nan]), np.array([np.nan]),
        60.0,
    )  # fmt: skip
    assert (known.tolist(), unknown.tolist()) == ([0], [-1])


def one_column(away_m):
    """A column of 9 m at a bearing of 350 degrees, on level ground."""
    return PoleColumns(place(350.0, away_m)[None], *np.array([[9.0], [0.05], [0.0], [8.0], [0.0]]))


@pytest.mark.parametrize(
    ("away_m", "matches"), [(20.0, True), (15.0, True), (12.0, True), (8.0, False), (28.0, False)]
)
def test_a_foot_behind_grass_looks_farther_than_the_column_it_belongs_to(away_m, matches):
    """A ray from 2.2 m up that meets the ground at 20 m is 0.9 m up at 12 m, and 1.3 m at 8 m."""
    column = PoleColumns(
        place(350.0, away_m)[None], *np.array([[9.0], [0.05], [0.0], [8.0], [0.0]])
    )
    eye = np.asarray(CAMERA.position_m)
    seen = np.array([350.0]), np.array([0.1]), np.array([20.0]), np.array([0.5])
    found = matching_columns(CAMERA, column, *seen, 60.0, np.array([[-eye[2] / 20.0, 0.3]]))
    assert (found[0] == 0) == matches
    low = matching_columns(CAMERA, column, *seen, 60.0, np.array([[-eye[2] / 20.0, 0.0]]))
    assert (low[0] == 0) == (away_m == 20.0)
    strict = matching_columns(CAMERA, column, *seen, 60.0)
    assert (strict[0] == 0) == (away_m == 20.0)


def test_of_two_things_that_end_at_one_column_the_taller_is_the_pole():
    tall, low = rendered([place(349.3, 20.0)]), rendered([place(350.7, 20.0)], height_m=4.0)
    both = low[0] == PixelClass.POLE
    mask, depth = (np.where(both, b, a) for a, b in zip(tall, low, strict=True))
    column = replace(one_column(20.0), sigma_m=np.array([0.15]))
    found = measure_view(CAMERA, mask, depth, Evidence(level, column, np.empty((0, 3))))
    assert found["method"].tolist() == ["fused", "fused"]
    assert found["reason"].tolist() == ["", "part of another pole"]
    assert found["kept"].tolist() == [True, False]


def test_a_tall_pole_behind_a_column_stays_where_its_foot_is_seen():
    near, far = (
        rendered([place(350.0, 15.0)], height_m=4.0),
        rendered([place(351.3, 25.0)], height_m=12.0),
    )
    pole = near[0] == PixelClass.POLE
    mask, depth = (np.where(pole, a, b) for a, b in zip(near, far, strict=True))
    camera = replace(CAMERA, sigma_lateral_m=0.25)
    found = measure_view(camera, mask, depth, Evidence(level, one_column(15.0), np.empty((0, 3))))
    assert found["reason"].tolist() == ["", ""]
    assert found["depth_m"].tolist() == pytest.approx([15.0, 25.0], rel=0.1)


def test_published_bearing_is_that_of_the_lidar_point_nearest_to_the_foot():
    """However far off, and from where the videolog puts the camera."""
    points = np.array([[*place(350.0, 20.0), 0.0], [*place(350.3, 21.0), 3.0], [500.0, 0.0, 0.0]])
    uv, _ = project(CAMERA.intrinsics, CAMERA.rotation(), CAMERA.position_m, points)
    feet = np.array([uv[0] + 1.0, uv[0] + [0.0, 60.0], uv[1] - 1.0])
    assert nearest_projected(CAMERA, points, feet).tolist() == [0, 0, 1]
    assert nearest_projected(CAMERA, points[2:], feet).tolist() == [-1, -1, -1]
    mask, depth = rendered([place(350.0, 20.0)])
    chosen = Sightings(bearing="lidar")
    row = measure_view(CAMERA, mask, depth, Evidence(level, NONE, points), chosen).iloc[0]
    assert row["method"] == "lidar"
    assert row["bearing_grid_deg"] == pytest.approx(350.0)
    aside = Evidence(level, NONE, points, seen_from_m=(4.0, -3.0))
    row = measure_view(CAMERA, mask, depth, aside, chosen).iloc[0]
    way = points[0, :2] - [4.0, -3.0]
    assert row["bearing_grid_deg"] == pytest.approx(np.degrees(np.arctan2(*way)) % 360)
    bare = measure_view(CAMERA, mask, depth, Evidence(level, NONE, points[2:]), chosen).iloc[0]
    assert (bare["kept"], bare["reason"]) == (False, "no point of the cloud in view")


def road_ahead(rng, count=400):
    """Points of the level road before the camera."""
    return np.array([[*place(a, d), 0.0] for a, d in rng.uniform([345, 8], [365, 48], (count, 2))])


def test_published_distance_is_the_network_s_at_the_foot_alone(rng):
    """By ordinary least squares on the front view's road; without a fit there is none."""
    mask, depth = rendered([place(350.0, 20.0), place(0.0, 40.0)])
    fit = fit_front_depth(CAMERA, depth, road_ahead(rng), 50.0)
    assert (fit.reason, fit.sigma_d) == ("", 0.0)
    column = PoleColumns(place(350.0, 21.0)[None], np.array([9.0]), np.array([0.1]))
    evidence = Evidence(level, column, np.empty((0, 3)))
    chosen = Sightings(distance="published")
    table = measure_view(CAMERA, mask, depth, evidence, chosen, fit)
    assert table["depth_m"].tolist() == pytest.approx([20.0, 40.0], rel=0.05)
    assert set(table["depth_from"]) == {"network"}
    assert table[["depth_lidar_m", "depth_ground_m", "sigma_depth_m"]].isna().all(axis=None)
    bare = measure_view(CAMERA, mask, depth, evidence, chosen)
    assert set(bare["reason"]) == {"distance unknown"}


def test_hidden_feet_have_no_distance_by_the_ground():
    mask, depth = rendered([place(350.0, 20.0)])
    table = measure_view(CAMERA, mask, depth, Evidence(level, NONE, np.empty((0, 3))))
    row = int(table["v_foot"].iloc[0])
    mask[row - 20 : row + 60, :] = PixelClass.VEHICLE
    hidden = measure_view(CAMERA, mask, depth, Evidence(level, NONE, np.empty((0, 3)))).iloc[0]
    assert not hidden["foot_visible"]
    assert np.isnan(hidden["depth_ground_m"])
    assert hidden["depth_network_m"] == pytest.approx(20.0, rel=0.05)


def test_grass_shows_a_foot_and_a_bush_hides_it():
    mask, depth = rendered([place(350.0, 20.0)])
    evidence = Evidence(level, NONE, np.empty((0, 3)))
    u, v = measure_view(CAMERA, mask, depth, evidence)[["u_foot", "v_foot"]].iloc[0].astype(int)
    strip = (slice(v + 1, v + 90), slice(u - 80, u + 80))
    mask[strip] = PixelClass.VEGETATION
    assert measure_view(CAMERA, mask, depth, evidence)["foot_visible"].iloc[0]
    depth[strip] = np.uint16(65000 * (3 / 9.0 + 0.02))
    assert not measure_view(CAMERA, mask, depth, evidence)["foot_visible"].iloc[0]


def test_what_is_dropped_says_why():
    poles = [place(350.0, 20.0), place(0.0, 80.0), place(340.0, 15.0)]
    mask, depth = rendered(poles)
    evidence = Evidence(level, NONE, np.empty((0, 3)))
    reasons = dict(enumerate(measure_view(CAMERA, mask, depth, evidence)["reason"]))
    assert reasons == {0: "", 1: "", 2: "too far"}
    low, low_depth = rendered([place(350.0, 20.0)], height_m=2.0)
    assert measure_view(CAMERA, low, low_depth, evidence)["reason"].tolist() == ["too low"]
    column = PoleColumns(place(350.0, 20.0)[None], np.array([9.0]), np.array([0.1]))
    in_cloud = Evidence(level, column, np.empty((0, 3)))
    assert measure_view(CAMERA, low, low_depth, in_cloud)["reason"].tolist() == [""]
    # less than half of the least height is a delineator before the column
    taller = Sightings(min_height_m=4.5)
    assert measure_view(CAMERA, low, low_depth, in_cloud, taller)["reason"].tolist() == ["too low"]
    rule = Sightings(height_rule="none")
    assert measure_view(CAMERA, low, low_depth, evidence, rule)["reason"].tolist() == [""]
    published = Sightings(height_rule="published")
    whole = measure_view(CAMERA, *rendered([place(350.0, 24.0)], height_m=7.0), evidence, published)
    assert whole["reason"].tolist() == ["too low"]


def test_without_depth_the_ground_is_enough_and_without_both_it_is_said():
    mask, depth = rendered([place(350.0, 20.0)])
    for nothing in (None, np.zeros_like(depth)):
        row = measure_view(CAMERA, mask, nothing, Evidence(level, NONE, np.empty((0, 3)))).iloc[0]
        assert row["depth_from"] == "ground"
        assert row["depth_m"] == pytest.approx(20.0, rel=0.03)

    def unknown(x, y):
        return np.full(np.shape(x), np.nan)

    row = measure_view(CAMERA, mask, depth, Evidence(unknown, NONE, np.empty((0, 3)))).iloc[0]
    assert (row["reason"], bool(row["kept"])) == ("distance unknown", False)


def test_an_empty_view_has_no_rows():
    mask = np.zeros((600, 1000), np.uint8)
    table = measure_view(CAMERA, mask, None, Evidence(level, NONE, np.empty((0, 3))))
    assert len(table) == 0


def signed(bearing_deg, away_m, size_m=0.7, low_m=2.0, camera=CAMERA):
    """Mask of grass with the panel of a sign that faces the camera, and no post."""
    mask = np.full((600, 1000), PixelClass.VEGETATION, np.uint8)
    ends = np.array([[*place(bearing_deg, away_m), low_m + k * size_m] for k in (0, 1)])
    (low, high), depth = project(camera.intrinsics, camera.rotation(), camera.position_m, ends)
    half = 0.5 * size_m * camera.intrinsics.focal_px / depth[0]
    rows = slice(round(float(high[1])), round(float(low[1])))
    mask[rows, round(float(low[0] - half)) : round(float(low[0] + half))] = PixelClass.SIGN
    return mask


SIGNS = Sightings(kinds=["sign"], min_width_px=2.0)


def test_a_panel_tells_its_bearing_and_by_its_size_roughly_its_distance():
    """Where the ray through its lower edge meets the ground says nothing of its distance."""
    depth = np.full((600, 1000), 2000, np.uint16)
    found = measure_view(
        CAMERA, signed(350.0, 20.0), depth, Evidence(level, NONE, np.empty((0, 3))), SIGNS
    )
    (sign,) = found[found["kept"]].to_dict("records")
    assert (sign["kind"], sign["depth_from"]) == ("sign", "size")
    assert abs(float(wrap_deg(sign["bearing_grid_deg"] - 350.0))) < 0.1
    assert sign["depth_m"] == pytest.approx(20.0, rel=0.15)
    assert sign["sigma_depth_m"] == pytest.approx(0.5 * sign["depth_m"])
    assert np.isnan([sign["depth_network_m"], sign["depth_ground_m"]]).all()
    # camera 2.5 m up, lower edge 2 m up: the ray falls 0.5 m in 20 m
    assert sign["lower_edge_rise"] == pytest.approx(-0.5 / 20.0, rel=0.2)
    assert sign["upper_edge_rise"] > sign["lower_edge_rise"]


def test_a_panel_is_too_far_only_by_more_than_its_size_leaves_open():
    """By its size it is known to half: one that seems 64 m away may be within 60 m."""
    evidence = Evidence(level, NONE, np.empty((0, 3)))
    for farthest_m, kept in ((12.0, True), (8.0, False)):
        asked = SIGNS.model_copy(update={"farthest_m": farthest_m})
        (sign,) = measure_view(CAMERA, signed(350.0, 20.0), None, evidence, asked).to_dict(
            "records"
        )
        assert sign["kept"] == kept


def test_the_ray_of_a_lower_edge_above_the_camera_rises():
    evidence = Evidence(level, NONE, np.empty((0, 3)))
    (sign,) = measure_view(CAMERA, signed(350.0, 20.0, low_m=3.0), None, evidence, SIGNS).to_dict(
        "records"
    )
    assert sign["kept"] and sign["lower_edge_rise"] == pytest.approx(0.5 / 20.0, rel=0.2)


@pytest.mark.parametrize(("top_m", "source"), [(2.7, "lidar"), (9.0, "size")])
def test_a_panel_is_on_a_post_that_ends_where_it_does(top_m, source):
    ground, points = np.zeros(1), np.full(1, 9.0)
    post = (
        place(350.0, 20.3)[None], np.array([top_m]), np.array([0.05]), ground, points, np.zeros(1),
    )  # fmt: skip
    evidence = Evidence(level, PoleColumns(*post), np.empty((0, 3)))
    (sign,) = measure_view(CAMERA, signed(350.0, 20.0), None, evidence, SIGNS).to_dict("records")
    assert sign["depth_from"] == source
