"""Lane markings of one image: centre-lines, without the middle line (paper 2, section 3.2.2).

A marking's centre-line is made of the centroids of its runs of pixels, along rows where it is steep
and along columns where it is flat, so that it is thin and finer than a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Bytes, Floats, Ints
from roadsight.base.sections.poles import EdgeTracing
from roadsight.poles.images.views import scale_of

_MAX_MIDDLE_LINES = 4  # Middle lines that are taken out at most; a double line has two
# Where a middle line lies, as a share of the road's width from the left
_MIDDLE_THIRD = (0.35, 0.65)
_STRETCH_POINTS = 10  # Points that a straight stretch of a curve needs
_LINE_ROUNDS = 12  # Rounds of reweighting for least absolute errors
# Rows with three or more markings that a middle line needs; px of an image 1200 px high
_DENSE_ROWS_PX = 20.0
_WIDEST_PX = 120.0  # Thicker runs are no lines; px of such an image


def centre_lines(marking: Bools, min_marking_px: float) -> Floats:
    """Centre-line points (n, 2) as u, v of all markings that are large enough.

    Parameters
    ----------
    marking : (rows, columns), whether a pixel is painted.
    min_marking_px : smaller ones are dropped, px2 of an image 1200 px high.
    """
    scale = scale_of(marking.shape[0])
    smallest = max(min_marking_px * scale**2, 2.0)
    kept = cv2.findNonZero(without_specks(marking.view(np.uint8), smallest))
    if kept is None:
        return np.empty((0, 2))
    u, v = kept.reshape(-1, 2).T.astype(np.int64)
    widest = max(_WIDEST_PX * scale, 8.0)
    points = _run_centres(u, v, marking.shape, widest)
    return points[np.lexsort((points[:, 0], points[:, 1]))]


def _run_centres(u: Ints, v: Ints, shape: tuple[int, int], widest_px: float) -> Floats:
    """Centroids (n, 2) of the runs of pixels that are shorter than the runs across them.

    A run that touches the frame is cut: its centroid is not the marking's.
    """
    row_run, column_run = _runs(v, u), _runs(u, v)
    row_length, column_length = np.bincount(row_run)[row_run], np.bincount(column_run)[column_run]
    found = []
    for run, length, steep, along, last in (
        (row_run, row_length, row_length <= column_length, u, shape[1] - 1),
        (column_run, column_length, row_length > column_length, v, shape[0] - 1),
    ):
        good = (length <= widest_px) & (along > 0) & (along < last)
        share = np.bincount(run, steep) / np.bincount(run)
        whole = np.bincount(run, ~good) == 0
        chosen = whole & (share > 0.5)
        pixels = np.bincount(run)
        centres = [np.bincount(run, axis)[chosen] / pixels[chosen] for axis in (u, v)]
        found.append(np.column_stack(centres))
    return np.concatenate(found)


def _runs(line: Ints, along: Ints) -> Ints:
    """Number of the run that each pixel belongs to: neighbours on one row or column."""
    order = np.argsort(line * (along.max() + 2) + along, kind="stable")
    starts = np.ones(len(line), bool)
    ordered, place = line[order], along[order]
    starts[1:] = (np.diff(ordered) != 0) | (np.diff(place) != 1)
    number = np.empty(len(line), np.int64)
    number[order] = np.cumsum(starts) - 1
    return number


def without_specks(region: Bytes, smallest_px: float) -> Bytes:
    """Region (rows, columns; 0 or 1) without parts of fewer pixels, holes counted in.

    By outlines, because they are far fewer than pixels.
    """
    outlines, nesting = cv2.findContours(region, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if not len(outlines):
        return region
    outer = [o for o, (*_, parent) in zip(outlines, nesting[0], strict=True) if parent < 0]
    # Pick's theorem: pixels of a part = area of the polygon through their centres + rim / 2 + 1.
    small = [o for o in outer if cv2.contourArea(o) + len(o) / 2 + 1 < smallest_px]
    if not small:
        return region
    kept = region.copy()
    cv2.drawContours(kept, small, -1, 0, cv2.FILLED)
    return kept


def middle_lines(
    points: Floats, road_span: Floats, height_px: int, settings: EdgeTracing
) -> list[Curve]:
    """Axes of the lines between the outermost markings, most of one road one.

    Rows with three or more markings give an axis through those between the outermost two; where
    there are too few such rows, markings in the middle third of the road give it.

    Parameters
    ----------
    points : centre-line points (n, 2). road_span : first and last road column (rows, 2), NaN where
        a row has no road. height_px : of the image.
    """
    scale = scale_of(height_px)
    needed = max(_DENSE_ROWS_PX * scale, 4.0)
    tolerance = max(settings.axis_px * scale, 2.0)
    axes: list[Curve] = []
    while len(axes) < _MAX_MIDDLE_LINES:
        row, u = clusters_by_row(points, max(settings.gap_px * scale, 1.5))
        # The middle one of those between the outermost of each row with three or more.
        rows, start, count = np.unique(row, return_index=True, return_counts=True)
        dense = count >= 3
        middle = start[dense] + count[dense] // 2
        inner = np.column_stack([u[middle], rows[dense].astype(float)])
        if len(np.unique(inner[:, 1])) < needed:
            inner = np.empty((0, 2)) if axes else _central_clusters(row, u, road_span)
        if len(np.unique(inner[:, 1])) < needed:
            break
        axis = fit_curve(inner, tolerance)
        if axis is None:
            break
        axes.append(axis)
        points = points[axis.distance_px(points) > tolerance]
    return axes


def _central_clusters(row: Ints, u: Floats, road_span: Floats) -> Floats:
    """Those (n, 2) in the middle third of the road."""
    if not len(row):
        return np.empty((0, 2))
    left, right = road_span[np.clip(row, 0, len(road_span) - 1)].T
    with np.errstate(invalid="ignore", divide="ignore"):
        place = (u - left) / (right - left)
    central = (place > _MIDDLE_THIRD[0]) & (place < _MIDDLE_THIRD[1])
    return np.column_stack([u[central], row[central].astype(float)])


def clusters_by_row(points: Floats, gap_px: float) -> tuple[Ints, Floats]:
    """Rows with their clusters' centroids, left to right.

    Parameters
    ----------
    points : (n, 2) sorted by row and then by column.

    Returns
    -------
    row (m,) of each cluster and its u (m,), in the same order
    """
    if not len(points):
        return np.empty(0, np.int64), np.empty(0)
    row = np.round(points[:, 1]).astype(np.int64)
    order = np.lexsort((points[:, 0], row))
    row, u = row[order], points[order, 0]
    first = np.ones(len(u), bool)
    first[1:] = (np.diff(row) != 0) | (np.diff(u) > gap_px)
    number = np.cumsum(first) - 1
    return row[first], np.bincount(number, u) / np.bincount(number)


@dataclass(frozen=True)
class Curve:
    """A line down the image, straight between knots and beyond them.

    Parameters
    ----------
    v_px, u_px : knots (k,), rows ascending, at least two.
    """

    v_px: tuple[float, ...]
    u_px: tuple[float, ...]

    def at(self, v_px: NDArray) -> Floats:
        """Column u (n,) at rows v (n,)."""
        knots, u = np.array(self.v_px), np.array(self.u_px)
        v = np.asarray(v_px, np.float64)
        part = np.clip(np.searchsorted(knots, v) - 1, 0, len(knots) - 2)
        slope = np.diff(u) / np.diff(knots)
        return u[part] + slope[part] * (v - knots[part])

    def distance_px(self, points: Floats) -> Floats:
        """Distance across the line of points (n, 2), to first order."""
        step = 0.5 * (self.at(points[:, 1] + 1.0) - self.at(points[:, 1] - 1.0))
        return np.abs(points[:, 0] - self.at(points[:, 1])) / np.hypot(1.0, step)


def fit_curve(points: Floats, tolerance_px: float) -> Curve | None:
    """Robust curve through points (n, 2) as u, v; None if they span fewer than three rows.

    A straight line by least absolute errors in each of up to eight stretches of equally many
    points: rows near the horizon hold most of a bend.
    """
    if len(points) < 3 or np.ptp(points[:, 1]) < 2.0:
        return None
    ordered = points[np.lexsort((points[:, 0], points[:, 1]))]
    stretches = np.array_split(ordered, int(np.clip(len(ordered) // _STRETCH_POINTS, 1, 8)))
    stretches = [part for part in stretches if np.ptp(part[:, 1]) >= 2.0]
    if not stretches:
        return None
    knots: list[tuple[float, float]] = []
    last = len(stretches) - 1
    for i, part in enumerate(stretches):
        level, slope, middle = _straight(part, tolerance_px)
        ends = [part[0, 1]] * (i == 0) + [middle] * (0 < i < last) + [part[-1, 1]] * (i == last)
        knots += [(v, level + slope * (v - middle)) for v in ends]
    rows, columns = zip(*sorted(set(knots)), strict=True)
    return Curve(tuple(map(float, rows)), tuple(map(float, columns)))


def _straight(points: Floats, tolerance_px: float) -> tuple[float, float, float]:
    """Column at the middle row, slope du / dv, and the middle row."""
    u, v = points.T
    middle = float(0.5 * (v[0] + v[-1]))
    basis = np.column_stack([np.ones(len(v)), v - middle])
    weights, solution = np.ones(len(u)), np.zeros(2)
    for _ in range(_LINE_ROUNDS):
        root = np.sqrt(weights)
        solution = np.linalg.lstsq(basis * root[:, None], u * root, rcond=None)[0]
        weights = 1.0 / np.maximum(np.abs(u - basis @ solution), 0.1 * tolerance_px)
    return float(solution[0]), float(solution[1]), middle
