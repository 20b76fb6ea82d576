import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.poles.images.image_edges import trace_edges
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.lanes import Curve, centre_lines, fit_curve, without_specks

ROWS = 300
COLUMNS = 500
HORIZON = 100


def straight_road(shift: float = 0.0, side: bool = True, middle: bool = True) -> np.ndarray:
    """Two lanes seen from ahead: the road's half width is the distance below the horizon."""
    mask = np.full((ROWS, COLUMNS), PixelClass.OTHER, np.uint8)
    v, u = np.mgrid[:ROWS, :COLUMNS].astype(float)
    below = np.maximum(v - HORIZON, 0.0)
    across = (u - (COLUMNS - 1) / 2 - shift) / np.maximum(below, 1e-9)
    mask[(np.abs(across) <= 1.0) & (below > 5)] = PixelClass.ROAD
    lines = [(0.0, middle), (-0.8, side), (0.8, side)]
    for place, wanted in lines:
        if wanted:
            mask[(np.abs(across - place) <= 0.03) & (below > 30)] = PixelClass.MARKING
    return mask


def test_markings_keep_their_sides_and_lose_the_middle_line():
    edges = trace_edges(straight_road())
    lane = edges.uv_px[edges.is_lane]
    across = (lane[:, 0] - 249.5) / (lane[:, 1] - HORIZON)
    assert len(lane) > 300
    assert np.abs(np.abs(across) - 0.8).max() < 0.02
    assert (np.sign(across) == edges.side[edges.is_lane]).all()
    assert edges.uv_px.dtype == np.float32
    assert edges.side.dtype == np.int8


def test_centre_lines_are_finer_than_a_pixel():
    lane = trace_edges(straight_road(shift=0.3))
    points = lane.uv_px[lane.is_lane]
    expected = 249.8 + lane.side[lane.is_lane] * 0.8 * (points[:, 1] - HORIZON)
    error = points[:, 0] - expected
    assert np.sqrt(np.mean(error**2)) < 0.45
    assert abs(error.mean()) < 0.1


def test_border_is_kept_outside_the_markings_only():
    edges = trace_edges(straight_road())
    border = edges.uv_px[~edges.is_lane]
    across = np.abs(border[:, 0] - 249.5) / (border[:, 1] - HORIZON)
    steep = border[:, 1] > 135
    assert np.abs(across[steep] - 1.0).max() < 0.06
    gravel = straight_road()
    gravel[200:230, 240:300] = PixelClass.OTHER
    hole = trace_edges(gravel).uv_px[~trace_edges(gravel).is_lane]
    in_hole = (hole[:, 1] > 195) & (hole[:, 1] < 235) & (np.abs(hole[:, 0] - 270) < 40)
    assert not in_hole.any()


def test_a_hole_between_lines_whose_borders_are_out_of_the_image_is_no_border():
    """Markings that are not known to be edge lines still enclose the road."""
    mask = straight_road()[:, 100:400]
    rows = np.arange(330, 370)
    mask[rows[0] : rows[-1], 120:150] = PixelClass.OTHER
    edges = trace_edges(mask)
    border = edges.uv_px[~edges.is_lane]
    near = (np.abs(border[:, 0] - 135) < 20) & (border[:, 1] > 325) & (border[:, 1] < 375)
    assert not near.any()


def four_lanes(worn: bool = False) -> np.ndarray:
    """The same road with lane lines, arrows, and hatching inside its right edge line."""
    mask = straight_road()
    v, u = np.mgrid[:ROWS, :COLUMNS].astype(float)
    below = np.maximum(v - HORIZON, 1e-9)
    across = (u - (COLUMNS - 1) / 2) / below
    depth = 2000.0 / below
    painted = (np.abs(np.abs(across) - 0.4) <= 0.02) & (depth % 12.0 < 4.0)
    for lane in (-0.6, -0.2, 0.2, 0.6):
        painted |= (np.abs(across - lane) <= 0.06) & (np.abs(depth - 20.0) < 2.0)
    painted |= (across > 0.65) & (across < 0.8) & ((depth + 3 * across) % 3.0 < 0.8) & (depth < 30)
    mask[painted & (below > 30)] = PixelClass.MARKING
    if worn:
        mask[(np.abs(across) > 0.7) & (depth % 20.0 < 5.0) & (below > 30)] = PixelClass.ROAD
        mask[np.abs(across) > 1.0] = PixelClass.OTHER
    return mask


@pytest.mark.parametrize("worn", [False, True])
def test_lane_lines_arrows_and_hatching_are_no_edge_lines(worn):
    edges = trace_edges(four_lanes(worn))
    lane = edges.uv_px[edges.is_lane]
    across = np.abs(lane[:, 0] - 249.5) / (lane[:, 1] - HORIZON)
    assert (np.abs(across - 0.8) < 0.03).mean() > 0.75
    assert across.min() > 0.65
    assert min((edges.side[edges.is_lane] == side).sum() for side in (-1, 1)) > 60


def test_a_line_whose_border_is_out_of_the_image_is_not_known_to_be_at_the_edge():
    mask = four_lanes()[:, :300]
    edges = trace_edges(mask)
    right = edges.is_lane & (edges.side > 0)
    rows = edges.uv_px[right, 1]
    assert len(rows) == 0 or rows.max() < HORIZON + 51


def test_without_side_lines_the_middle_of_the_road_is_still_no_edge():
    edges = trace_edges(straight_road(side=False))
    assert not edges.is_lane.any()
    assert (edges.side == np.sign(edges.uv_px[:, 0] - 249.5)).all()


def test_vehicles_and_poles_do_not_make_borders():
    mask = straight_road(side=False, middle=False)
    mask[180:260, 200:300] = PixelClass.VEHICLE
    mask[50:220, 330:334] = PixelClass.POLE
    found = trace_edges(mask).uv_px
    near_car = (np.abs(found[:, 0] - 250) < 60) & (np.abs(found[:, 1] - 220) < 45)
    near_pole = (np.abs(found[:, 0] - 332) < 4) & (found[:, 1] < 205)
    assert not near_car.any()
    assert not near_pole.any()


def test_the_frame_of_the_image_is_no_border():
    mask = np.full((60, 80), PixelClass.ROAD, np.uint8)
    edges = trace_edges(mask)
    assert len(edges.uv_px) == 0
    assert edges.reason == "no edge of the road in sight"


def test_nothing_gives_nothing_and_says_why():
    empty = trace_edges(np.zeros((60, 80), np.uint8))
    assert empty.uv_px.shape == (0, 2)
    assert empty.reason == "no road in the mask"
    speck = np.zeros((60, 80), np.uint8)
    speck[30, 40] = PixelClass.ROAD
    assert trace_edges(speck).reason == "road too small"


def test_small_markings_and_borders_are_dropped():
    mask = straight_road(side=False, middle=False)
    before = trace_edges(mask)
    mask[250, 249] = PixelClass.MARKING
    mask[20:22, 20:22] = PixelClass.ROAD
    after = trace_edges(mask)
    assert np.array_equal(before.uv_px, after.uv_px)


def test_a_kerb_is_border_by_its_centre_line():
    mask = straight_road(side=False, middle=False)
    v, u = np.mgrid[:ROWS, :COLUMNS].astype(float)
    across = (u - 249.5) / np.maximum(v - HORIZON, 1e-9)
    mask[(np.abs(across - 1.02) <= 0.03) & (v > 130)] = PixelClass.KERB
    edges = trace_edges(mask)
    right = edges.uv_px[(edges.side > 0) & (edges.uv_px[:, 1] > 150)]
    assert np.abs((right[:, 0] - 249.5) / (right[:, 1] - HORIZON) - 1.02).max() < 0.02


@settings(max_examples=15, deadline=None)
@given(st.integers(-40, 40))
def test_edges_move_with_the_image(shift):
    still, moved = trace_edges(straight_road()), trace_edges(straight_road(float(shift)))
    lane_a, lane_b = still.uv_px[still.is_lane], moved.uv_px[moved.is_lane]
    inner = lane_a[(lane_a[:, 0] > 60) & (lane_a[:, 0] < 440)]
    there = {(round(float(u - shift), 3), float(v)) for u, v in lane_b}
    share = np.mean([(round(float(u), 3), float(v)) in there for u, v in inner])
    assert share > 0.98


def test_mirrored_roads_have_mirrored_edges():
    mask = straight_road(shift=20.0)
    a, b = trace_edges(mask), trace_edges(np.ascontiguousarray(mask[:, ::-1]))
    left = {(float(u), float(v), int(s)) for (u, v), s in zip(a.uv_px, a.side, strict=True)}
    right = {
        (float(COLUMNS - 1 - u), float(v), -int(s))
        for (u, v), s in zip(b.uv_px, b.side, strict=True)
    }
    assert len(left & right) > 0.97 * len(left)


def test_bends_of_both_ways_lose_their_middle_line():
    mask = np.zeros((ROWS, COLUMNS), np.uint8)
    v, u = np.mgrid[:ROWS, :COLUMNS].astype(float)
    below = np.maximum(v - HORIZON, 1e-9)
    bend = 40 * np.sin((v - HORIZON) / 40)
    across = (u - 249.5 - bend) / below
    mask[(np.abs(across) <= 1.0) & (below > 20)] = PixelClass.ROAD
    for place in (-0.8, 0.0, 0.8):
        mask[(np.abs(across - place) <= 0.03) & (below > 30)] = PixelClass.MARKING
    edges = trace_edges(mask)
    lane = edges.uv_px[edges.is_lane]
    offset = lane[:, 0] - 249.5 - 40 * np.sin((lane[:, 1] - HORIZON) / 40)
    place = offset / (lane[:, 1] - HORIZON)
    assert np.mean(np.abs(place) > 0.7) > 0.97
    assert np.mean(np.sign(place) == edges.side[edges.is_lane]) > 0.99


def slow_centres(marking: np.ndarray, widest: float) -> set[tuple[float, float]]:
    """Every run that is shorter than the runs across it, pixel by pixel."""

    def run(row: int, column: int, down: int, right: int) -> tuple[int, int]:
        first = last = 0
        shape = marking.shape
        while (
            row + (first - 1) * down >= 0
            and column + (first - 1) * right >= 0
            and marking[row + (first - 1) * down, column + (first - 1) * right]
        ):
            first -= 1
        while (
            row + (last + 1) * down < shape[0]
            and column + (last + 1) * right < shape[1]
            and marking[row + (last + 1) * down, column + (last + 1) * right]
        ):
            last += 1
        return first, last

    found = set()
    for row, column in np.argwhere(marking).tolist():
        for down, right in ((0, 1), (1, 0)):
            a, b = run(row, column, down, right)
            cells = [(row + k * down, column + k * right) for k in range(a, b + 1)]
            steep = 0
            for r, c in cells:
                along = np.diff(run(r, c, 0, 1))[0]
                upright = np.diff(run(r, c, 1, 0))[0]
                steep += along <= upright if right else along > upright
            ends = (column + a * right, column + b * right) if right else (row + a, row + b)
            last = marking.shape[1 if right else 0] - 1
            whole = ends[0] > 0 and ends[1] < last and b - a + 1 <= widest
            if 2 * steep > len(cells) and whole:
                found.add((column + right * (a + b) / 2, row + down * (a + b) / 2))
    return found


def test_centre_lines_agree_with_a_slow_search(rng):
    marking = np.zeros((40, 50), bool)
    for _ in range(4):
        row, column = rng.integers(0, 30, 2)
        for step in range(20):
            place = row + rng.integers(0, 2) * step // 2, column + step
            marking[place[0] : place[0] + 3, place[1] : place[1] + 4] = True
    found = centre_lines(marking, 1e-9)
    assert {tuple(p) for p in found.tolist()} == slow_centres(marking, 8.0)


def test_specks_go_and_parts_in_holes_are_seen():
    region = np.zeros((40, 40), np.uint8)
    region[2:38, 2:38] = 1
    region[8:32, 8:32] = 0
    region[18:21, 18:21] = 1
    region[0, 39] = 1
    cleaned = without_specks(region, 10)
    assert not cleaned[18:21, 18:21].any()
    assert cleaned[0, 39] == 0
    assert cleaned[2:38, 2:8].all()
    assert without_specks(region, 9)[19, 19] == 1


def test_curve_passes_by_outliers_and_goes_on_straight():
    v = np.arange(0.0, 100.0)
    u = 10 + 0.5 * v
    u[::7] += 60
    curve = fit_curve(np.column_stack([u, v]), 5.0)
    assert curve is not None
    assert np.abs(curve.at(np.array([-20.0, 50.0, 150.0])) - [0.0, 35.0, 85.0]).max() < 1.5
    assert fit_curve(np.array([[1.0, 2.0], [3.0, 2.0], [5.0, 2.0]]), 5.0) is None
    assert fit_curve(np.empty((0, 2)), 5.0) is None
    line = Curve((0.0, 10.0), (0.0, 10.0))
    assert line.distance_px(np.array([[3.0, 5.0]])) == pytest.approx(np.sqrt(2), abs=0.01)
