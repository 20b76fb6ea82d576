"""Road edges of one image: lane markings, and the road's border beside them (paper 2, 3.2.2)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Bytes, Floats, Floats32
from roadsight.base.kernels import compiled, compiled_part
from roadsight.base.sections.poles import EdgeTracing
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.lanes import (
    Curve,
    centre_lines,
    clusters_by_row,
    fit_curve,
    middle_lines,
    scale_of,
    without_specks,
)

LANE = "lane"  # Kind of a point on a painted line
BORDER = "border"  # Kind of a point on the road's border
# Window of the blur that takes the steps out of a mask's border; odd, so that nothing shifts
_BLUR_PX = 5
_MARGIN = 0.15  # Share of the road's width by which the dividing line stays away from its borders
_ROWS_OF_A_LINE = 12  # Rows with two markings that a line half-way between them needs
# How much farther from the border than usual a point of an edge line lies at most
_EDGE_SPREAD = 1.5
# The same in pixels, beside that: of the mask's border and of the line's centre
_EDGE_SLACK_PX = 2.0


def _table(*classes: PixelClass) -> Bytes:
    table = np.zeros(256, np.uint8)
    table[list(classes)] = 1
    return table


# What a road's border encloses.
_ROAD = _table(PixelClass.ROAD, PixelClass.MARKING, PixelClass.KERB)
# Against these the road's border is not traced: they stand in front of it, or it drops out of
# sight; a kerb is an edge by its own centre-line.
_OCCLUDERS = _table(
    PixelClass.VEHICLE,
    PixelClass.POLE,
    PixelClass.SIGN,
    PixelClass.GUARDRAIL,
    PixelClass.TREE,
    PixelClass.WIRE,
    PixelClass.SKY,
    PixelClass.KERB,
)


@dataclass(frozen=True)
class TracedEdges:
    """Edges of one image.

    Parameters
    ----------
    uv_px : (n, 2) float32. side : (n,) int8, -1 left, +1 right. is_lane : (n,) whether a point is
    on a marking, else on the road's border. reason : why there is nothing, or "".
    """

    uv_px: Floats32
    side: NDArray[np.int8]
    is_lane: Bools
    reason: str = ""


def trace_edges(mask: Bytes, settings: EdgeTracing | None = None) -> TracedEdges:
    """Edges of the road in a mask of project classes (rows, columns).

    Lane markings without the middle line, as centre-lines; and the border of the road outside the
    region between the outermost markings, where nothing stands in front of it. A kerb's
    centre-line is border.
    """
    settings = settings or EdgeTracing()
    # The road without specks and without small holes, 0 or 1.
    smallest = max((settings.min_border_px * scale_of(len(mask))) ** 2, 4.0)
    road = np.asarray(cv2.LUT(mask, _ROAD), np.uint8)
    road = 1 - without_specks(1 - without_specks(road, smallest), smallest)
    span = _road_span(road)
    markings = centre_lines(mask == PixelClass.MARKING, settings.min_marking_px)
    axes = middle_lines(markings, span, mask.shape[0], settings)
    tolerance = max(settings.axis_px * scale_of(mask.shape[0]), 2.0)
    lanes = markings
    for axis in axes:
        lanes = lanes[axis.distance_px(lanes) > tolerance]
    dividing = _dividing_line(axes, lanes, road, tolerance)
    border = np.concatenate(
        [
            _borders(mask, road, settings),
            centre_lines(mask == PixelClass.KERB, settings.min_marking_px),
        ]
    )
    border = border[~_between(border, lanes, mask.shape[0])]
    lanes = lanes[_along_border(lanes, span, dividing, mask.shape[1])]
    if settings.borders == "nearest":
        reach = max(settings.gap_px * scale_of(mask.shape[0]), 2.0)
        border = border[on_nearest_border(border, mask, road, dividing, reach)]
    points = np.concatenate([lanes, border])
    row = np.clip(np.round(points[:, 1]), 0, len(mask) - 1).astype(np.int64)
    side = np.where(points[:, 0] < dividing[row], -1, 1).astype(np.int8)
    is_lane = np.arange(len(points)) < len(lanes)
    reason = ""
    if not len(points):
        reason = "no edge of the road in sight" if road.any() else "road too small"
        if not cv2.LUT(mask, _ROAD).any():
            reason = "no road in the mask"
    return TracedEdges(points.astype(np.float32), side, is_lane, reason)


@compiled()
def _road_span(road: Bytes) -> Floats:
    """First and last road column of each row (rows, 2), NaN without road."""
    rows, columns = road.shape
    span = np.full((rows, 2), np.nan)
    for row in range(rows):
        left = 0
        while left < columns and not road[row, left]:
            left += 1
        if left == columns:
            continue
        right = columns - 1
        while not road[row, right]:
            right -= 1
        span[row, 0], span[row, 1] = left, right
    return span


def _borders(mask: Bytes, road: Bytes, settings: EdgeTracing) -> Floats:
    """Border points (n, 2), finer than a pixel, of parts that are long enough."""
    rows = np.flatnonzero(road.any(axis=1))
    if not len(rows):
        return np.empty((0, 2))
    # The smoothing of the edge reaches this far beyond the road's own rows.
    top, end = max(int(rows[0]) - _BLUR_PX, 0), min(int(rows[-1]) + _BLUR_PX + 1, len(road))
    part = np.ascontiguousarray(road[top:end])
    soft = cv2.GaussianBlur(
        part * np.uint8(254), (_BLUR_PX, _BLUR_PX), 0, borderType=cv2.BORDER_REPLICATE
    )
    hidden = cv2.dilate(cv2.LUT(mask[top:end], _OCCLUDERS), np.ones((_BLUR_PX, _BLUR_PX), np.uint8))
    points = _crossings(soft, 127.0)
    column, row = np.round(points).astype(np.int64).T
    points = points[hidden[row, column] == 0]
    if len(points):
        # Pieces are drawn coarsely, so that small gaps do not part them.
        scale = scale_of(len(part))
        cell = max(round(3 * scale), 2)
        drawn = np.zeros((part.shape[0] // cell + 1, part.shape[1] // cell + 1), np.uint8)
        column, row = (np.floor(points).astype(np.int64) // cell).T
        drawn[row, column] = 1
        _, labels = cv2.connectedComponents(drawn, connectivity=8, ltype=cv2.CV_32S)
        own = labels[row, column]
        points = points[np.bincount(own)[own] >= max(settings.min_border_px * scale, 6.0)]
    return np.add(points, (0.0, float(top)))


def _crossings(soft: NDArray, level: float) -> Floats:
    """Where the smoothed road (rows, columns) crosses ``level``, along rows or columns.

    Each crossing is taken along the axis that cuts the border more squarely.
    """
    # Pixels that differ from a neighbour below or to the right.
    inside = soft > level
    change = np.zeros(soft.shape, bool)
    change[:, :-1] |= inside[:, :-1] != inside[:, 1:]
    change[:-1] |= inside[:-1] != inside[1:]
    row, column = np.nonzero(change)
    values = soft.astype(np.int16)
    last_row, last_column = soft.shape[0] - 1, soft.shape[1] - 1
    inner = (row > 0) & (row < last_row) & (column > 0) & (column < last_column)
    row, column = row[inner], column[inner]
    here = values[row, column]
    along_u = np.abs(values[row, column + 1] - values[row, column - 1])
    along_v = np.abs(values[row + 1, column] - values[row - 1, column])
    found = []
    for step_u, step_v, chosen in ((1, 0, along_u >= along_v), (0, 1, along_u < along_v)):
        there = values[row + step_v, column + step_u]
        crosses = chosen & ((here > level) != (there > level))
        share = (level - here[crosses]) / (there[crosses] - here[crosses])
        found.append(
            np.column_stack([column[crosses] + step_u * share, row[crosses] + step_v * share])
        )
    points = np.concatenate(found)
    return points[np.lexsort((points[:, 0], points[:, 1]))]


def _between(points: Floats, lanes: Floats, height_px: int) -> Bools:
    """Whether points (n, 2) lie in the region that the outermost markings enclose.

    Gaps of dashed lines are bridged by straight lines between the rows that have them.
    """
    row, u = clusters_by_row(lanes, 1.5)
    rows, start, count = np.unique(row, return_index=True, return_counts=True)
    two = count >= 2
    if np.count_nonzero(two) < 2 or not len(points):
        return np.zeros(len(points), bool)
    rows, left, right = rows[two], u[start[two]], u[start[two] + count[two] - 1]
    v = points[:, 1]
    inside_rows = (v >= rows[0] - 0.5) & (v <= min(rows[-1] + 0.5, height_px))
    low, high = np.interp(v, rows, left), np.interp(v, rows, right)
    return inside_rows & (points[:, 0] >= low) & (points[:, 0] <= high)


def _along_border(points: Floats, span: Floats, dividing: Floats, columns: int) -> Bools:
    """Whether markings (n, 2) are edge lines and not lane lines, arrows or hatching.

    An edge line keeps its place between the road's borders, as a share of the road's width along a
    row; it is that of the outermost marking of most rows. What lies further inside is none, nor is
    what has its border out of the image.
    """
    row = np.clip(np.round(points[:, 1]), 0, len(span) - 1).astype(np.int64)
    right = (points[:, 0] >= dividing[row]).astype(np.int64)
    left_px, right_px = span[row].T
    border = np.where(right > 0, right_px, left_px)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.abs(points[:, 0] - border) / (right_px - left_px)
        slack = _EDGE_SLACK_PX / (right_px - left_px)
    share[~np.isfinite(share) | (border < 1.0) | (border > columns - 2.0)] = np.inf
    kept = np.zeros(len(points), bool)
    for side in (0, 1):
        own = np.flatnonzero((right == side) & np.isfinite(share))
        own = own[np.lexsort((share[own], row[own]))]
        rows, first = np.unique(row[own], return_index=True)
        if len(rows) < _ROWS_OF_A_LINE:
            continue
        usual = float(np.median(share[own[first]]))
        kept[own] = share[own] < _EDGE_SPREAD * usual + slack[own]
    return kept


def _dividing_line(axes: list[Curve], lanes: Floats, road: Bytes, tolerance_px: float) -> Floats:
    """Column (rows,) of each row between the left and the right side of the road.

    The middle line if there is one, else half-way between the outermost markings; beyond their
    rows, or without both, the road ahead of the camera.
    """
    hints = np.full(len(road), np.nan)
    axis = axes[len(axes) // 2] if axes else None
    if axis is None:
        row, u = clusters_by_row(lanes, 1.5)
        rows, start, count = np.unique(row, return_index=True, return_counts=True)
        two = count >= 2
        half = 0.5 * (u[start[two]] + u[start[two] + count[two] - 1])
        if len(half) >= _ROWS_OF_A_LINE:
            axis = fit_curve(np.column_stack([half, rows[two].astype(float)]), tolerance_px)
    if axis is not None:
        rows = np.arange(max(round(axis.v_px[0]), 0), min(round(axis.v_px[-1]) + 1, len(road)))
        hints[rows] = axis.at(rows)
    return _road_ahead(road, hints)


@compiled()
def _road_ahead(road: Bytes, hints: Floats) -> Floats:
    """Column (rows,) that goes straight up from the middle, and follows the road where it bends.

    The camera drives on the road, so that its own vertical plane divides the road's sides; the line
    is moved only as far as needed to stay well inside the road that it came from.

    Parameters
    ----------
    hints : (rows,) where the line is known to run, NaN elsewhere.
    """
    columns = road.shape[1]
    here = 0.5 * (columns - 1)
    width = columns
    line = np.empty(road.shape[0])
    for row in range(road.shape[0] - 1, -1, -1):
        if np.isfinite(hints[row]):
            here = min(max(hints[row], 0.0), columns - 1.0)
        at = _nearest_road(road[row], int(round(here)), width)
        if at >= 0:
            left, right = at, at
            while left > 0 and road[row, left - 1]:
                left -= 1
            while right < columns - 1 and road[row, right + 1]:
                right += 1
            width = right - left + 1
            if not np.isfinite(hints[row]):
                margin = _MARGIN * (right - left)
                here = min(max(here, left + margin), right - margin)
        line[row] = here
    return line


@compiled_part()
def _nearest_road(line: Bytes, start: int, reach: int) -> int:
    """Nearest road column to ``start`` within ``reach``, the left one of two; -1 if none."""
    for step in range(reach + 1):
        if start - step >= 0 and line[start - step]:
            return start - step
        if start + step < len(line) and line[start + step]:
            return start + step
    return -1


# Road borders that bound the carriageway itself: the first on either side of the camera's path.
# Where forecourts and drives are paved like the street, the road of a mask runs on into them and
# its far border says nothing about the street. A kerb ends the road even where paving goes on,
# and what lies behind a parked car is not looked for.

# 1 for the classes over which the road runs on.
_OPEN = _table(PixelClass.ROAD, PixelClass.MARKING)
_KERB = int(PixelClass.KERB)  # As a plain number, for comparisons with masks


def on_nearest_border(
    points: Floats, mask: Bytes, road: Bytes, dividing: Floats, reach_px: float
) -> Bools:
    """Whether border points lie on the first border of their row and side.

    Parameters
    ----------
    points : (n, 2) u, v. mask : project classes (rows, columns). road : the cleaned road, 0 or 1.
    dividing : (rows,) column between left and right. reach_px : how far beside the border.
    """
    # Small holes that cleaning closed do not end the road, kerbs do.
    open_road = np.where(mask == _KERB, 0, np.maximum(road, _OPEN[mask])).astype(np.uint8)
    ends = _first_ends(open_road, (mask == _KERB).astype(np.uint8), dividing)
    row = np.clip(np.round(points[:, 1]), 0, len(mask) - 1).astype(np.int64)
    left = points[:, 0] < dividing[row]
    low = np.where(left, ends[row, 0], ends[row, 2]) - reach_px
    high = np.where(left, ends[row, 1], ends[row, 3]) + reach_px
    return (points[:, 0] >= low) & (points[:, 0] <= high)


@compiled()
def _first_ends(road: Bytes, kerb: Bytes, dividing: Floats) -> Floats:
    """Columns (rows, 4) between which the left and the right border lie; NaN without road."""
    rows, columns = road.shape
    ends = np.full((rows, 4), np.nan)
    for row in range(rows):
        middle = int(min(max(round(dividing[row]), 0), columns - 1))
        for side in range(2):
            step = 2 * side - 1
            at = middle
            if not road[row, at]:
                continue
            while 0 <= at < columns and road[row, at]:
                at += step
            beyond = at
            while 0 <= beyond < columns and kerb[row, beyond]:
                beyond += step
            ends[row, 2 * side] = min(at, beyond)
            ends[row, 2 * side + 1] = max(at, beyond)
    return ends
