"""Edges that were digitised metres off: candidates in the lanes are told, and which way to move."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, MultiPolygon, affinity, box

from roadsight.base.sections.placement import Candidates
from roadsight.geometry.areas import depth_inside_m
from roadsight.placement.candidates.candidates import lane_doubts, plan_shift_m, shift_in_words
from roadsight.report.site.cautions import told_cautions

ROAD = MultiPolygon([box(0, -4, 200, 4)])
FEW = settings(max_examples=15, deadline=None)
ANGLES = st.floats(0, 360)
METRES = st.floats(1, 8) | st.floats(-8, -1)


def along(*lines):
    """Places every 4 m along lines (n, 2)."""
    steps = [shapely.line_interpolate_point(line, np.arange(0, line.length, 4)) for line in lines]
    return shapely.get_coordinates(np.concatenate(steps))


def table(xy_m, mount="edge"):
    return pd.DataFrame({"x": xy_m[:, 0], "y": xy_m[:, 1], "edge": "e", "mount": mount})


def edges_of(road):
    """Both long sides of a road that is drawn up one side and down the other."""
    corners = shapely.get_coordinates(road)[:-1]
    return [LineString(half) for half in np.split(corners, 2)]


def told(xy_m, pavement=ROAD, **changed):
    return lane_doubts(table(xy_m), table(xy_m), pavement, Candidates(**changed))


@FEW
@given(angle=ANGLES, across_m=METRES)
def test_a_shift_across_a_straight_road_is_found_back(angle, across_m):
    road = affinity.rotate(shapely.Polygon([(0, 4), (200, 4), (200, -4), (0, -4)]), angle)
    turn = np.radians(angle)
    normal = np.array([-np.sin(turn), np.cos(turn)])
    found = plan_shift_m(along(*edges_of(road)) + across_m * normal, MultiPolygon([road]))
    assert found @ normal == pytest.approx(-across_m, abs=0.3)
    assert np.hypot(*(found + across_m * normal)) < 1.0  # nothing tells a shift along the road


@FEW
@given(angle=ANGLES, shift_m=st.tuples(METRES, METRES))
def test_any_shift_is_found_back_along_a_curve(angle, shift_m):
    turn = np.linspace(0, 1.5, 60)[:, None]
    inner, outer = (r * np.hstack([np.sin(turn), np.cos(turn)]) for r in (100.0, 108.0))
    road = affinity.rotate(shapely.Polygon(np.vstack([inner, outer[::-1]])), angle)
    found = plan_shift_m(along(*edges_of(road)) + shift_m, MultiPolygon([road]))
    np.testing.assert_allclose(found, -np.array(shift_m), atol=0.3)


@pytest.mark.parametrize("off_m", [(9, -9), (9, 0, -9), (11, -11)])
def test_lines_on_a_median_and_lines_that_keep_off_the_road_are_moved_to_the_middle(off_m):
    carriageways = MultiPolygon([box(0, 1, 200, 9), box(0, -9, 200, -1)])
    lines = [LineString([(0, y), (200, y)]) for y in off_m]
    found = plan_shift_m(np.add(along(*lines), (0, 3.5)), carriageways)
    np.testing.assert_allclose(found, (0, -3.5), atol=0.3)


@pytest.mark.parametrize(
    ("inside", "severity", "limit"),
    [
        *((0, None, None), (4, None, None)),
        *((5, "doubt", 0.05), (49, "doubt", 0.05)),
        *((50, "refused", 0.5), (100, "refused", 0.5)),
    ],
)
def test_the_share_in_the_lanes_decides(inside, severity, limit):
    xy_m = np.column_stack([np.linspace(10, 190, 100), np.full(100, 5.0)])
    xy_m[:inside, 1] = 2.0
    found = told(xy_m)
    if severity is None:
        assert found == []
    else:
        (doubt,) = found
        assert (doubt.code, doubt.severity) == ("edges_on_pavement", severity)
        assert (doubt.measured, doubt.limit) == (inside / 100, limit)


@pytest.mark.parametrize("deeper_m", [-2.0, 0.0, 0.9])
def test_edges_on_the_border_or_beside_it_are_right(deeper_m):
    lines = [LineString([(0, y), (200, y)]) for y in (4 - deeper_m, deeper_m - 4)]
    assert told(along(*lines)) == []
    assert told(along(*lines), on_pavement_doubt=0) == []


def test_sensors_on_medians_poles_and_where_there_is_no_pavement_are_right():
    island = MultiPolygon([box(0, -9, 200, 9) - box(5, -2, 195, 2)])
    assert told(along(LineString([(6, 0), (194, 0)])), island) == []
    over = along(LineString([(0, 0), (200, 0)]))
    assert lane_doubts(table(over, "pole"), table(over, "pole"), ROAD, Candidates()) == []
    assert told(over, MultiPolygon()) == []
    assert told(over, on_pavement_m=5) == []  # a user's gantries


def test_the_message_says_which_way_and_reaches_the_report():
    lines = [LineString([(0, y), (200, y)]) for y in (4, -4)]
    xy_m = np.add(along(*lines), (0, 3))
    (doubt,) = told(xy_m, on_pavement_refused=1)
    (warning,), notes = told_cautions([doubt.to_dict()])
    assert notes == [] and "3.0 m to the south (dx +0.0, dy -3.0 m)" in warning
    assert "0% still inside" in warning and "in the lanes: 49\u202f% (limit 5\u202f%)" in warning
    square = MultiPolygon([box(-90, -90, 290, 90)])
    assert "no shift of all edges by up to 15 m" in told(xy_m, square)[0].message


@pytest.mark.parametrize(
    ("shift_m", "words"),
    [
        ((1.0, 1.0), "1.4 m to the north-east (dx +1.0, dy +1.0 m)"),
        ((-0.01, -2.0), "2.0 m to the south (dx +0.0, dy -2.0 m)"),
        ((-3.0, 0.0), "3.0 m to the west (dx -3.0, dy +0.0 m)"),
        ((-2.0, 2.1), "2.9 m to the north-west (dx -2.0, dy +2.1 m)"),
    ],
)
def test_shifts_in_words(shift_m, words):
    assert shift_in_words(np.array(shift_m)) == words


def test_depths_are_signed_as_point_by_point(rng):
    area = MultiPolygon([box(0, 0, 9, 9) - box(3, 3, 5, 5), box(12, 0, 14, 3)])
    xy_m = rng.uniform(-2, 16, (200, 2))
    slowly = [
        area.boundary.distance(place) * (1 if area.contains(place) else -1)
        for place in shapely.points(xy_m)
    ]
    np.testing.assert_allclose(depth_inside_m(area, xy_m), slowly, atol=1e-12)
    assert (depth_inside_m(MultiPolygon(), xy_m) == -np.inf).all()
