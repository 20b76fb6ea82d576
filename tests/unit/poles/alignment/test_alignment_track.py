import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.base.errors import InputError
from roadsight.poles.alignment.drive import Roadway, roadway_at
from roadsight.poles.alignment.roadside import RoadEdges, edges_ahead
from roadsight.poles.alignment.track import extended_track, sides_of_track, track_headings_deg

TRACK = np.array([[0.0, 0.0], [0.0, 50.0], [30.0, 90.0], [80.0, 100.0]])


def turned(points, angle_rad, shift=(0.0, 0.0)):
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return points @ np.array([[c, s], [-s, c]]) + shift


def straight_edges(length_m=200.0, half_m=4.0, grade=0.0, bank=0.0):
    y = np.arange(-20.0, length_m, 0.3)
    sides = [
        np.column_stack([np.full(len(y), x), y, grade * y + bank * x]) for x in (-half_m, half_m)
    ]
    return np.concatenate(sides)


def test_sides_of_a_straight_track():
    points = [[-3.0, 20.0], [3.0, 20.0], [0.0, 20.0], [5.0, -10.0]]
    assert sides_of_track(points, TRACK[:2]).tolist() == [-1, 1, 0, 0]


def test_sides_at_a_sharp_corner_and_without_a_track():
    hairpin = np.array([[0.0, 0.0], [0.0, 50.0], [1.0, 0.0]])
    assert sides_of_track([[-1.0, 60.0], [0.5, 20.0], [3.0, 20.0]], hairpin).tolist() == [-1, 1, -1]
    assert sides_of_track([[1.0, 1.0]], np.zeros((3, 2))).tolist() == [0]
    assert len(sides_of_track(np.empty((0, 2)), TRACK)) == 0


@given(
    st.lists(st.tuples(st.floats(-40, 120), st.floats(5, 120)), min_size=1, max_size=20),
    st.floats(0, 6.28),
    st.floats(-5e6, 5e6),
)
def test_sides_do_not_depend_on_the_frame_and_mirror(points, angle, shift):
    points = np.array(points)
    sides = sides_of_track(points, TRACK)
    moved = sides_of_track(
        turned(points, angle, (shift, -shift)), turned(TRACK, angle, (shift, -shift))
    )
    flip = np.array([-1.0, 1.0])
    clear = np.abs(sides_of_track(points + 1e-3, TRACK) - sides_of_track(points - 1e-3, TRACK)) == 0
    assert (moved == sides)[clear & (sides != 0)].all()
    assert (sides_of_track(points * flip, TRACK * flip) == -sides).all()


def test_headings_on_a_circle_are_its_tangents():
    angle = np.radians(np.arange(300.0, 420.0, 3.0))
    track = 150.0 * np.column_stack([-np.cos(angle), np.sin(angle)])
    heading = track_headings_deg(track, np.zeros(len(track)))
    gap = (heading - np.degrees(angle) + 180) % 360 - 180
    assert np.abs(gap[2:-2]).max() < 0.1 and np.abs(gap).max() < 1.0


def test_heading_of_a_vehicle_that_stands_is_the_fallback():
    assert track_headings_deg(np.zeros((3, 2)), [7.0, 8.0, 9.0]).tolist() == [7.0, 8.0, 9.0]
    assert track_headings_deg(np.zeros((1, 2)), [7.0]).tolist() == [7.0]


def test_extended_track():
    assert extended_track(TRACK[:2], 10.0).tolist() == [[0, -10], [0, 0], [0, 50], [0, 60]]


def test_roadway_of_a_tilted_road():
    edges = RoadEdges.from_points(straight_edges(grade=0.05, bank=-0.03))
    road = roadway_at(edges, [1.0, 60.0, 3.0], 3.0, 0.0)
    assert abs((road.heading_deg + 180) % 360 - 180) < 0.1
    assert road.grade == pytest.approx(0.05, abs=0.004)
    assert road.bank == pytest.approx(-0.03, abs=0.004)
    assert abs(road.bend) < 1e-4
    alone = roadway_at(edges, [500.0, 60.0, 3.0], 3.0, 0.02)
    assert alone == Roadway(3.0, 0.02, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("change", [1.5e-4, -1.5e-4])
def test_roadway_where_bend_and_grade_change(change):
    """Heading change s^2 / 2 at station s, and the grade likewise: no lag behind either."""
    station = np.arange(-80.0, 80.0, 0.1)
    heading, grade_change = 0.5 * change * station**2, 3e-5
    middle = np.cumsum(np.column_stack([np.sin(heading), np.cos(heading)]) * 0.1, axis=0)
    middle -= middle[800]
    right = np.column_stack([np.cos(heading), -np.sin(heading)])
    z = grade_change * station**3 / 6
    sides = [np.column_stack([middle + half * right, z])[::3] for half in (-4.0, 4.0)]
    edges = RoadEdges.from_points(np.concatenate(sides))
    for at in (800, 1000):
        place = [*middle[at], z[at]]
        road = roadway_at(edges, place, np.degrees(heading[at]) + 3.0, 0.0)
        gap = road.heading_deg - np.degrees(heading[at])
        assert abs((gap + 180) % 360 - 180) < 0.1
        assert road.bend == pytest.approx(change * station[at], abs=5e-4)
        assert road.grade == pytest.approx(0.5 * grade_change * station[at] ** 2, abs=0.001)


def test_raster_steps_are_smoothed_away():
    angle = np.radians(30.0)
    true = straight_edges(80.0)
    true[:, :2] = turned(true[:, :2], angle)
    cells = np.unique(np.floor(true / 0.3), axis=0) * 0.3 + 0.15
    edges = RoadEdges.from_points(cells)
    across = turned(edges.xyz_m[:, :2], -angle)[:, 0]
    raw = turned(cells[:, :2], -angle)[:, 0]
    assert np.std(np.abs(across)) < 0.5 * np.std(np.abs(raw))
    far = RoadEdges.from_points(cells + np.array([5e6, 5e6, 0]))
    np.testing.assert_allclose(far.xyz_m - [5e6, 5e6, 0], edges.xyz_m, atol=1e-4)


def test_edges_ahead_are_thinned_on_both_sides():
    edges = RoadEdges.from_points(straight_edges())
    near = edges_ahead(edges, [0.0, 0.0, 0.0], 0.0, TRACK[:2] * [1, 4], points=200)
    assert 150 < len(near.half_m) <= 202
    assert (near.xyz_m[: near.left, 0] < 0).all() and (near.xyz_m[near.left :, 0] > 0).all()
    assert (near.inward[: near.left, 0] > 0.9).all() and (near.inward[near.left :, 0] < -0.9).all()
    assert (near.xyz_m[:, 1] > 0).all()


def test_no_edges_and_bad_edges():
    empty = RoadEdges.from_points(np.empty((0, 3)))
    assert len(edges_ahead(empty, [0, 0, 0], 0.0, TRACK).half_m) == 0
    assert roadway_at(empty, [0, 0, 0], 5.0, 0.0) == Roadway(5.0, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(InputError, match="not finite"):
        RoadEdges.from_points([[0.0, np.nan, 0.0]])
