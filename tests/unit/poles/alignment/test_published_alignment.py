from math import inf

import numpy as np
import pytest

from roadsight.geometry.cameras import Intrinsics, cam_from_world, project
from roadsight.poles.alignment import published
from roadsight.poles.alignment.pose import FOCAL, SIZE
from roadsight.poles.alignment.published import (
    FOOT_M,
    Axes,
    Edges,
    alignment_cost,
    bounds_of,
    by_row,
    extents_apart,
    nelder_mead,
    pose_in,
    projected,
    start_of,
    whole_pixels,
    window_of,
)

STUDY_PX = (2356, 1200)
FOCAL_PX = 5000.0


def registered(along=0.3, lateral=-0.2, height=2.2, yaw=0.8, pitch=-1.5, roll=0.4):
    """Unknowns of a registered camera."""
    unknowns = np.zeros(SIZE)
    unknowns[:FOCAL] = along, lateral, height, yaw, pitch, roll
    unknowns[FOCAL] = np.log(FOCAL_PX)
    return unknowns


def slow_cost(edges, parameters, focal_px, window_px):
    """The cost as it is stated, one point and one pixel after the other."""
    rx, ry, rz = np.radians(parameters[3:])
    about_x = np.array([[1, 0, 0], [0, np.cos(rx), -np.sin(rx)], [0, np.sin(rx), np.cos(rx)]])
    about_y = np.array([[np.cos(ry), 0, np.sin(ry)], [0, 1, 0], [-np.sin(ry), 0, np.cos(ry)]])
    about_z = np.array([[np.cos(rz), -np.sin(rz), 0], [np.sin(rz), np.cos(rz), 0], [0, 0, 1]])
    turn = about_z @ about_y @ about_x
    scale = edges.size_px[1] / 1200
    total = 0.0
    for points, pixels in zip(edges.points_ft, edges.pixels, strict=True):
        charges, paired = [], False
        for point in points:
            x, y, z = turn @ point + parameters[:3]
            u = int(edges.size_px[0] / 2 + focal_px * x / -z)
            v = int(edges.size_px[1] / 2 - focal_px * y / -z)
            best, farthest = inf, 0.0
            for column, row in pixels:
                du, dv = abs(u - column), abs(v - row)
                farthest = max(farthest, du, dv)
                if du < window_px[0] * scale and dv < window_px[1] * scale:
                    best = min(best, du**2 + dv**2)
            paired |= best < inf
            charges.append(best / scale**2 if best < inf else farthest / scale)
        total += sum(charges) / len(charges) if paired and len(pixels) else 1e6
    return total


def random_edges(rng, size_px, pixels=60, points=25):
    """Points ahead, some of them outside of the image, and pixels all over it."""
    sides = []
    for sign in (-1, 1):
        far = rng.uniform(40, 800, points)
        sides.append(
            np.column_stack([sign * rng.uniform(5, 90, points), rng.normal(-7, 3, points), -far])
        )
    shown = [by_row(np.floor(rng.uniform(0, size_px, (pixels, 2)))) for _ in sides]
    return Edges(tuple(sides), tuple(shown), size_px)


@pytest.mark.parametrize("size_px", [STUDY_PX, (640, 416), (801, 333)])
@pytest.mark.parametrize("window_px", [(50, 50), (300, 300), (640, 300)])
def test_cost_is_that_of_the_slow_one(rng, size_px, window_px):
    for _ in range(4):
        edges = random_edges(rng, size_px)
        parameters = np.concatenate([rng.normal(0, 3, 3), rng.normal(0, 3, 3)])
        focal_px = FOCAL_PX * size_px[1] / 1200
        fast = alignment_cost(edges, parameters, focal_px, window_px)
        assert fast == pytest.approx(slow_cost(edges, parameters, focal_px, window_px), rel=1e-9)


def one_side(point, pixel):
    """One point straight ahead, one pixel so far off it, on the left; the right side perfect."""
    at = np.array([[0.0, 0.0, -100.0]])
    middle = projected(at, np.zeros(6), FOCAL_PX, STUDY_PX)
    return Edges((at + point, at), (middle + pixel, middle), STUDY_PX)


def test_a_point_without_partner_costs_its_largest_distance_and_not_its_square():
    cost = alignment_cost(one_side(0.0, [30.0, 40.0]), np.zeros(6), FOCAL_PX, (300, 300))
    assert cost == 2500.0
    two = one_side(0.0, [30.0, 40.0])
    far = np.array([[10.0, 0.0, -100.0]])  # 500 px to the right
    two = Edges((np.concatenate([two.points_ft[0], far]), two.points_ft[1]), two.pixels, STUDY_PX)
    assert alignment_cost(two, np.zeros(6), FOCAL_PX, (300, 300)) == (2500.0 + 470.0) / 2


@pytest.mark.parametrize("lacking", ["points", "pixels", "pairs"])
def test_a_side_that_lacks_something_costs_a_million(lacking):
    edges = one_side(0.0, [301.0, 0.0] if lacking == "pairs" else 0.0)
    none = np.empty((0, 3)), np.empty((0, 2))
    points = (none[0] if lacking == "points" else edges.points_ft[0], edges.points_ft[1])
    pixels = (none[1] if lacking == "pixels" else edges.pixels[0], edges.pixels[1])
    edges = Edges(points, pixels, STUDY_PX)
    assert alignment_cost(edges, np.zeros(6), FOCAL_PX, (300, 300)) == 1e6


def test_projection_is_that_of_the_pose(rng):
    """In axes that climb along the line of travel; cut to whole pixels towards zero."""
    axes = Axes.along([500.0, -300.0, 90.0], [3.0, 7.0, 0.8])
    parameters, focal_px = start_of(registered())
    assert focal_px == pytest.approx(FOCAL_PX)
    pose = pose_in(axes, parameters)
    ahead = np.array([3.0, 7.0, 0.8]) / np.linalg.norm([3.0, 7.0, 0.8])
    xyz = axes.origin_m + rng.uniform(20, 150, (40, 1)) * ahead + rng.normal(0, 4, (40, 3))
    rotation = cam_from_world(pose["heading_deg"], pose["pitch_deg"], pose["roll_deg"])
    camera = Intrinsics.centred(*STUDY_PX, FOCAL_PX)
    uv, _ = project(camera, rotation, [pose[a] for a in "xyz"], xyz)
    found = projected(axes.feet(xyz), parameters, FOCAL_PX, STUDY_PX)
    np.testing.assert_array_equal(found, np.trunc(np.round(uv + 0.5, 6)))
    assert whole_pixels([[-0.7, 3.6]]).tolist() == [[0.0, 4.0]]


def test_a_registered_camera_stands_where_it_was_registered():
    """On a level line to the north: lateral is east, along is north."""
    axes = Axes.along([10.0, 20.0, 5.0], [0.0, 8.0, 0.0])
    pose = pose_in(axes, start_of(registered())[0])
    expected = {
        "x": 9.8, "y": 20.3, "z": 7.2, "heading_deg": 0.8, "pitch_deg": -1.5, "roll_deg": 0.4,
    }  # fmt: skip
    assert pose == pytest.approx(expected)
    climbing = Axes.along([10.0, 20.0, 5.0], [0.0, 8.0, 8.0 * np.tan(np.radians(4.0))])
    assert pose_in(climbing, start_of(registered(yaw=0.0, roll=0.0))[0])[
        "pitch_deg"
    ] == pytest.approx(2.5)


def bounds(**changed):
    told = {"number": 12, "cost": 1500.0, "apart_px": (99.0, 99.0)} | changed
    return bounds_of(
        np.arange(6.0), told["number"], told["cost"], told["apart_px"], (1.1 * FOOT_M, 0.11)
    )


BASE = [1.1] * 3 + [0.11] * 3


@pytest.mark.parametrize(
    ("changed", "reach"),
    [
        ({}, BASE),
        ({"number": 11, "cost": 5000.0, "apart_px": (400.0, 400.0)}, BASE),
        ({"cost": 2000.0}, BASE),
        ({"cost": 2001.0}, [1.1] * 3 + [0.2] * 3),
        ({"cost": 2999.0}, [1.1] * 3 + [0.2] * 3),
        ({"cost": 3000.0}, [1.1] * 3 + [0.5] * 3),
    ],
)
def test_bounds_about_the_baseline(changed, reach):
    found = bounds(**changed)
    np.testing.assert_allclose(found.mean(axis=1), np.arange(6.0), atol=1e-9)
    np.testing.assert_allclose(np.diff(found)[:, 0] / 2, reach, atol=1e-9)


@pytest.mark.parametrize(
    ("apart_px", "wide"),
    [
        ((100.0, 50.0), [0]), ((100.0, 95.0), [0, 1, 2, 3, 4, 5]), ((80.0, 100.0), [1, 2, 3, 4, 5]),
        ((-400.0, 100.0), [1, 2, 3, 4, 5]), ((np.nan, np.nan), []),
    ],
)  # fmt: skip
def test_bounds_about_zero_where_the_ends_are_far_apart(apart_px, wide):
    found, about_zero = bounds(apart_px=apart_px), [10, 11, 18, 2, 3, 2]
    for number in range(6):
        expected = [-about_zero[number], about_zero[number]]
        is_wide = found[number].tolist() == expected
        assert is_wide == (number in wide)


def test_windows_grow_with_the_ends():
    assert window_of((300.0, 20.0)) == (300.0, 300.0)
    assert window_of((301.0, 450.0)) == (501.0, 650.0)
    assert window_of((np.nan, -500.0)) == (300.0, 300.0)


def row_of_pixels(left, right, row):
    return np.array([[left, row], [right, row]], float)


def at_pixel(uv):
    """A point 100 ft ahead that is projected onto the middle of whole pixels."""
    middle = (np.array(STUDY_PX) - 1) / 2
    away = (np.asarray(uv, float) - middle) / FOCAL_PX * 100.0
    return np.column_stack([away[:, 0], -away[:, 1], np.full(len(away), -100.0)])


def test_ends_of_edges():
    """Pixels' upper end at row 600, points' at 650; the lowest wide row of both is 1000."""
    seen = (
        row_of_pixels(1000, 1400, 600),
        np.concatenate([row_of_pixels(700, 1500, 1000), row_of_pixels(100, 2000, 1100)]),
    )
    there = (
        at_pixel([[1100, 650], [640, 1000]]),
        at_pixel([[1530, 1000], [300, 1100], [700, 1100], [3000, 1150]]),
    )
    edges = Edges(there, tuple(map(by_row, seen)), STUDY_PX)
    assert extents_apart(edges, np.zeros(6), FOCAL_PX) == (60.0, 50.0)
    narrow = Edges((there[0][:1], at_pixel([[1500, 700]])), edges.pixels, STUDY_PX)
    assert extents_apart(narrow, np.zeros(6), FOCAL_PX) == (1000.0, 50.0)
    out = Edges((at_pixel([[-900, 700]]), np.empty((0, 3))), edges.pixels, STUDY_PX)
    assert np.isnan(extents_apart(out, np.zeros(6), FOCAL_PX)).all()


@pytest.fixture
def road():
    """Edges of a road that bends, and a camera that sees them."""
    far = np.linspace(45, 600, 300)
    bend = (far / 100.0) ** 2
    points = tuple(np.column_stack([bend + side, np.zeros(300), -far]) for side in (-14.0, 12.0))
    parameters, focal_px = start_of(registered())
    shown = []
    for side in points:
        uv = projected(side, parameters, focal_px, STUDY_PX)
        inside = ((uv >= 0) & (uv < STUDY_PX)).all(axis=1)
        shown.append(by_row(uv[inside]))
    return Edges(points, tuple(shown), STUDY_PX), parameters


def test_a_good_baseline_is_kept(road):
    edges, true = road
    found, _ = nelder_mead(edges, true, FOCAL_PX, 20)
    np.testing.assert_array_equal(found, true)


@pytest.mark.parametrize(("number", "off_deg", "reach_deg"), [(3, 0.6, 0.11), (20, 0.6, 0.5)])
def test_a_bad_baseline_is_bettered_within_its_bounds(road, number, off_deg, reach_deg):
    edges, true = road
    start = true + np.array([0, 0, 0, 0, off_deg, 0])
    found, cost = nelder_mead(edges, start, FOCAL_PX, number)
    before = alignment_cost(edges, start, FOCAL_PX, (300, 300))
    assert cost < 0.9 * before
    moved = np.abs(found - start)
    assert (moved[:3] <= 1.1 + 1e-6).all()
    assert moved[3:].max() <= reach_deg + 1e-9
    assert moved[3:].max() > 0.9 * min(reach_deg, 0.11)


def test_nelder_mead_may_turn_a_thousand_times(road, monkeypatch):
    edges, true = road
    told = {}

    def minimize(cost, start, **options):
        told.update(options)
        return type("Result", (), {"x": start, "fun": cost(start)})

    monkeypatch.setattr(published, "minimize", minimize)
    nelder_mead(edges, true + np.array([0, 0, 0, 0, 0.6, 0]), FOCAL_PX, 3)
    assert told["method"] == "Nelder-Mead"
    assert told["options"] == {"maxiter": 1000}
    assert told["bounds"].shape == (6, 2)
