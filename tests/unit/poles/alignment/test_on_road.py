import numpy as np
import pandas as pd
import pytest

from roadsight.base.errors import InputError
from roadsight.poles.alignment.drive import on_road, places_of
from roadsight.poles.alignment.roadside import RoadEdges, edges_ahead
from roadsight.poles.alignment.track import extended_track

STEP_M = 8.0


def line(x, first=-80.0, last=300.0):
    """Edge along y."""
    y = np.arange(first, last, 0.3)
    return np.column_stack([np.full(len(y), x), y, np.zeros(len(y))])


ROAD = [line(-4.0), line(4.0)]
LEFT_UNSEEN = [line(-3.5, last=50.0), line(-3.5, first=140.0)]


def edges_of(lines):
    return RoadEdges.from_points(np.concatenate(lines))


def track_of(x):
    return np.column_stack([x, STEP_M * np.arange(len(x))])


def moved_x(x, lines, heading_deg=0.0):
    track = track_of(x)
    moved = on_road(track, np.full(len(x), heading_deg), edges_of(lines))
    np.testing.assert_allclose(moved[:, 1], track[:, 1], atol=1e-9)
    return moved[:, 0]


def drifting(aside_m):
    """On the road, 10 places beside it, and back."""
    return np.concatenate([np.zeros(5), np.full(10, aside_m), np.zeros(5)])


@pytest.mark.parametrize("aside_m", [-9.0, -6.5, -4.6, 4.7, 7.0, 9.0])
def test_a_track_beside_its_road_is_moved_into_it(aside_m):
    """Else both edges of the road lie on one side of the vehicle."""
    # Half a road, or more, is another road: a drift comes and goes more slowly.
    x = np.interp(np.arange(20), [3, 7, 12, 16], [0.0, aside_m, aside_m, 0.0])
    moved = moved_x(x, ROAD)
    np.testing.assert_allclose(moved, np.clip(x, -2.0, 2.0), atol=0.02)
    found = edges_ahead(edges_of(ROAD), [x[9], 72.0, 0.0], 0.0, extended_track(track_of(moved), 60))
    assert (found.xyz_m[: found.left, 0] < 0).all() and (found.xyz_m[found.left :, 0] > 0).all()
    assert found.half_width_m == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize("aside_m", [-4.4, -4.3, -3.0, 0.0, 1.7, 4.3])
def test_a_track_on_its_road_or_hardly_beside_it_stays(aside_m):
    x = np.interp(np.arange(20), [3, 7, 12, 16], [0.0, aside_m, aside_m, 0.0])
    np.testing.assert_array_equal(moved_x(x, ROAD), x)


@pytest.mark.parametrize(
    "x, lines",
    [
        (np.full(20, 16.8), [line(0.0), line(18.0), line(20.8), line(23.0)]),
        (np.append(np.full(19, 16.8), 9.0), [line(0.0), line(18.0), line(20.8), line(23.0)]),
        (np.full(30, 1.7), [*LEFT_UNSEEN, line(3.5), line(6.0), line(8.6)]),
        (np.full(30, 1.7), [*LEFT_UNSEEN, line(3.0), line(5.6), line(8.2)]),
        (np.full(30, 1.7), [*LEFT_UNSEEN, line(3.5), line(7.0), line(14.0)]),
        (np.full(30, 1.7), [*LEFT_UNSEEN, line(3.5), line(5.0), line(12.0)]),
    ],
    ids=["path", "path and the width", "cycle path", "parking", "service road", "close by"],
)
def test_a_road_whose_other_edge_is_unseen_keeps_its_track(x, lines):
    """What lies beyond the near edge is as wide as no road, or another road."""
    np.testing.assert_array_equal(moved_x(x, lines), x)


def test_a_gap_must_be_as_wide_as_the_road():
    """Where the drift begins, the far edge is hidden behind a line in the road, 4 m from it."""
    x = drifting(4.0) + 1.0
    lines = [line(-4.0, last=35.0), line(-4.0, first=125.0), line(0.5, 35.0, 125.0), line(4.0)]
    np.testing.assert_array_equal(moved_x(x, lines), x)


def test_a_few_points_are_no_line():
    """One point beside a track, and in its road, moves nothing and keeps nothing from moving."""
    points = np.array([[10.0, 50.0, 0.0], [6.7, 80.0, 0.0], [1.5, 64.0, 0.0]])
    few = [line(7.4, 80.0, 81.9)]
    x = np.full(20, 1.0)
    left = [line(-4.0, last=45.0), line(-4.0, first=100.0)]
    np.testing.assert_array_equal(moved_x(x, [*left, line(4.0), line(12.0, 80.0, 81.9)]), x)
    x = np.concatenate([np.full(4, 3.0), np.full(16, 5.0)])
    np.testing.assert_allclose(moved_x(x, [*ROAD, points, *few]), 2.0, atol=0.05)


def test_lines_near_to_each_other_have_no_road_between_them():
    """A path of 2.4 m beside the road is none, though it is nearer to places of the track."""
    x = np.interp(np.arange(20), [3, 7, 12, 16], [0.0, 7.0, 7.0, 0.0])
    moved = moved_x(x, [*ROAD, line(6.4)])
    np.testing.assert_allclose(moved, np.clip(x, -2.0, 2.0), atol=0.5)


def test_edges_far_aside_tell_no_road():
    """16 m aside they do not: those places follow the last that tell it, 15 m aside."""
    x = np.interp(np.arange(40), [0, 15, 25], [0.0, 14.0, 14.0])
    moved = moved_x(x, [line(-2.0), line(2.0)])
    np.testing.assert_allclose(moved[:15], np.clip(x[:15], -1.0, 1.0), atol=0.02)
    np.testing.assert_allclose(moved[15:] - x[15:], moved[14] - x[14], atol=1e-9)


def test_edges_far_behind_tell_no_road():
    """The first place beside the road is 12 m past the end of the edges."""
    x = np.where(np.arange(20) < 14, 2.0, 5.0)
    np.testing.assert_array_equal(moved_x(x, [line(-4.0, last=100.0), line(4.0, last=100.0)]), x)


@pytest.mark.parametrize("turn_deg, moves", [(20.0, True), (30.0, False)])
def test_edges_at_an_angle_to_the_track_tell_no_road(turn_deg, moves):
    """Here headings are turned, and so is what lies across them."""
    track = track_of(np.interp(np.arange(20), [3, 7, 12, 16], [0.0, 6.0, 6.0, 0.0]))
    moved = on_road(track, np.full(20, turn_deg), edges_of(ROAD))
    assert (np.abs(moved - track).max() > 1.0) == moves


def test_a_side_road_moves_no_track():
    """It leaves to the right at a right angle, behind an edge with a mouth of 10 m."""
    mouth = [line(4.0, last=75.0), line(4.0, first=85.0)]
    side = [line(x)[:, [1, 0, 2]] for x in (75.0, 85.0)]
    side = [part[part[:, 0] > 5.0] for part in side]
    x = np.full(20, 2.0)
    left = [line(-4.0, last=60.0), line(-4.0, first=100.0)]
    np.testing.assert_array_equal(moved_x(x, [*left, *mouth, *side]), x)


@pytest.mark.parametrize("lines", [[line(-4.0)], [line(-4.0, first=150.0, last=160.0)], []])
def test_no_road_moves_no_track(lines):
    x = np.linspace(-9.0, 9.0, 10)
    np.testing.assert_array_equal(moved_x(x, [np.empty((0, 3)), *lines]), x)


def test_two_widths_that_do_not_agree_tell_none():
    """4 and 12 m: their median is neither."""
    lines = [line(-2.0, last=4.0), line(2.0, last=4.0), line(-6.0, first=4.0), line(6.0, first=4.0)]
    np.testing.assert_array_equal(moved_x(np.zeros(2), lines), np.zeros(2))


def test_a_moved_track_has_no_steps():
    """Positions to and fro about the limit, places that see no edge, and a last one far out."""
    x = np.concatenate([[0.0, 1.5, 3.0], np.tile([4.35, 4.6], 8), [5.0]])
    hidden = [line(side, *part) for side in (-4.0, 4.0) for part in ((-80.0, 70.0), (90.0, 300.0))]
    for lines in (ROAD, hidden):
        moved = track_of(moved_x(x, lines))
        np.testing.assert_allclose(moved[2:, 0], 2.0, atol=0.3)
        end = np.diff(extended_track(moved, 60.0)[-2:], axis=0)[0]
        assert abs(np.degrees(np.arctan2(*end))) < 3.0


def test_places_start_where_they_were_recorded_on_a_moved_track():
    x = np.interp(np.arange(20), [3, 7, 12, 16], [0.0, 6.0, 6.0, 0.0])
    frames = frames_at(x)
    places = places_of(frames, edges_of(ROAD))
    for place, (east, north) in zip(places, track_of(x), strict=True):
        assert (place.start.x_m, place.start.y_m) == (east, north)
        assert np.abs(place.track_m[:, 0]).max() < 2.5
    assert places[-1].station_m == pytest.approx(np.hypot(*np.diff(track_of(x), axis=0).T).sum())


def test_a_position_that_is_not_finite_is_named():
    with pytest.raises(InputError, match=r"image_3.*not finite"):
        places_of(frames_at(np.where(np.arange(8) == 3, np.nan, 0.0)), edges_of(ROAD))


def frames_at(x):
    rows = {"route": "r1", "z_road": 0.0, "heading_deg": 0.0, "width_px": 2000, "height_px": 1200}
    rows |= {"sequence": np.arange(len(x)), "x": x, "y": STEP_M * np.arange(len(x))}
    return pd.DataFrame({"image": [f"image_{k}" for k in range(len(x))], **rows})
