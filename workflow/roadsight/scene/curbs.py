"""Curbs beside a track: where the surface first steps up on either side of the carriageway.

Pavement found by smoothness runs on into forecourts and drives. What bounds a street is a small
step: a curb of 5 to 25 cm, less where it is lowered. The cloud is laid out along the track; on
each side the line of steps that runs on most evenly is followed by dynamic programming. The
lower side of a parked car counts as a step, too: cars stand at the edge of the carriageway, and
what is behind them was not seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints, Ints32

_MARGIN_M = 30.0  # How far curbs are followed straight on beyond both ends of the track.


@dataclass(frozen=True)
class CurbSettings:
    """Settings of the search for curbs.

    Parameters
    ----------
    reach_m : farthest from the track. nearest_m : nearest to it. least_step_m, most_step_m : of
        the surface over 0.3 m. station_m, across_m : cells along and across the track.
    window_m : along the track, over which heights are averaged. shortest_m : shorter pieces are
        dropped. bend_cost : what a step aside by one cell costs, against 1 for a clear curb.
    """

    reach_m: float = 12.0
    nearest_m: float = 1.2
    least_step_m: float = 0.02
    most_step_m: float = 0.30
    station_m: float = 0.5
    across_m: float = 0.1
    window_m: float = 2.0
    shortest_m: float = 3.0
    bend_cost: float = 0.5


@dataclass(frozen=True)
class Curbs:
    """Points of curbs along the track, each side by itself.

    Attributes
    ----------
    xyz_m : (n, 3), at the foot of the step. tangent : (n, 2) direction of the curb in plan.
    polyline : (n,) which piece a point belongs to. step_m : (n,) height of the step.
    """

    xyz_m: Floats
    tangent: Floats
    polyline: Ints32
    step_m: Floats


def find_curbs(xyz_m: Floats, track_xy_m: Floats, settings: CurbSettings | None = None) -> Curbs:
    """Curbs on both sides of a track.

    Parameters
    ----------
    xyz_m : cloud (n, 3), local metres. track_xy_m : (m, 2) in the order of travel.
    """
    settings = settings or CurbSettings()
    line = smooth_line(track_xy_m, settings.station_m, _MARGIN_M)
    empty = Curbs(np.empty((0, 3)), np.empty((0, 2)), np.empty(0, np.int32), np.empty(0))
    if len(line) < 2:
        return empty
    heights = surface(xyz_m, line, settings)
    parts = [empty]
    for side in (-1, 1):
        number = 1 + max((int(p.polyline.max()) for p in parts if len(p.polyline)), default=-1)
        parts.append(_side(heights, line, side, number, settings))
    return Curbs(
        *(np.concatenate([getattr(p, n) for p in parts]) for n in Curbs.__dataclass_fields__)
    )


def smooth_line(track_xy_m: Floats, spacing_m: float, beyond_m: float) -> Floats:
    """Track (k, 2) at even spacing, smoothed over some metres and straight on at both ends."""
    track = np.asarray(track_xy_m, np.float64).reshape(-1, 2)
    moved = np.ones(len(track), bool)
    moved[1:] = np.hypot(*np.diff(track, axis=0).T) > 1e-3
    track = track[moved]
    if len(track) < 2:
        return np.empty((0, 2))
    path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(track, axis=0).T))])
    station = np.arange(0.0, path[-1] + 1e-9, spacing_m)
    line = np.column_stack([np.interp(station, path, axis) for axis in track.T])
    # Over 4 m the jitter of single positions goes, and bends stay.
    line = ndimage.gaussian_filter1d(line, 4.0 / spacing_m, axis=0, mode="nearest")
    away = np.arange(1, round(beyond_m / spacing_m) + 1)[:, None] * spacing_m
    # Straight on means: in the direction of the last 10 m.
    reach = min(len(line) - 1, round(10.0 / spacing_m))
    start, end = line[0] - line[reach], line[-1] - line[-1 - reach]
    before = (line[0] + away * start / np.hypot(*start))[::-1]
    return np.concatenate([before, line, line[-1] + away * end / np.hypot(*end)])


# Points no higher above the lowest one of their cell are of the surface: more than a scanner's
# noise, less than most of what stands on it.
_SHELL_M = 0.10
_FEWEST = 2  # Points in the window along the line that a height needs.


def surface(xyz_m: Floats, line: Floats, settings: CurbSettings) -> Floats:
    """Height (stations, cells) of the lowest surface along a line, NaN where it was not seen.

    Cells run from left to right across the line; each is the mean of the points within 10 cm of
    its lowest one, then the mean along the line over the window.
    """
    stations, cells = len(line), 2 * round(settings.reach_m / settings.across_m)
    tangent = _tangents(line)
    xyz = np.asarray(xyz_m, np.float64)
    gap, nearest = cKDTree(line).query(xyz[:, :2], distance_upper_bound=settings.reach_m + 1.0)
    used = np.isfinite(gap)
    xyz, nearest = xyz[used], nearest[used]
    offset, along = xyz[:, :2] - line[nearest], tangent[nearest]
    right = offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0]
    cell = np.floor((right + settings.reach_m) / settings.across_m).astype(np.int64)
    # Beyond an end of the line everything is nearest to its last point.
    level = np.abs((offset * along).sum(axis=1)) <= settings.station_m
    inside = (cell >= 0) & (cell < cells) & level
    flat, z = nearest[inside] * cells + cell[inside], xyz[inside, 2]
    lowest = np.full(stations * cells, np.inf)
    np.minimum.at(lowest, flat, z)
    low = z <= lowest[flat] + _SHELL_M
    count = np.bincount(flat[low], minlength=stations * cells).reshape(stations, cells)
    total = np.bincount(flat[low], z[low], minlength=stations * cells).reshape(stations, cells)
    window = max(round(settings.window_m / settings.station_m), 1)
    sums = [
        ndimage.uniform_filter1d(part.astype(np.float64), window, axis=0, mode="constant")
        for part in (total, count)
    ]
    # A mean times its window is a whole number but for rounding, so that a half decides.
    enough = sums[1] * window > _FEWEST - 0.5
    return np.where(enough, sums[0] / np.maximum(sums[1], 1e-9), np.nan)


def _tangents(line: Floats) -> Floats:
    step = np.gradient(line, axis=0)
    return np.asarray(step / np.hypot(step[:, 0], step[:, 1])[:, None], np.float64)


def _side(heights: Floats, line: Floats, side: int, first: int, settings: CurbSettings) -> Curbs:
    """Curb of one side; pieces are numbered from ``first``."""
    half = heights.shape[1] // 2
    outwards = heights[:, half:] if side > 0 else heights[:, half - 1 :: -1]
    step, foot = steps(outwards, settings)
    cell = follow(step, settings)
    row = np.arange(len(cell))
    # The sharpest step within two cells of each station's.
    near = np.clip(cell[:, None] + np.arange(-2, 3), 0, step.shape[1] - 1)
    sharpest = near[row, np.take_along_axis(step, near, axis=1).argmax(axis=1)]
    cell = np.where(step[row, sharpest] > 0, sharpest, cell)
    found = step[row, cell] >= settings.least_step_m
    right = side * ((cell + 0.5) * settings.across_m)
    right = ndimage.gaussian_filter1d(right, 1.0 / settings.station_m, mode="nearest")
    tangent = _tangents(line)
    place = line + right[:, None] * np.column_stack([tangent[:, 1], -tangent[:, 0]])
    # Gaps of one metre are closed.
    gap = max(round(1.0 / settings.station_m), 1)
    closed = ndimage.binary_closing(np.pad(found, gap), np.ones(2 * gap + 1, bool))[gap:-gap]
    label, count = ndimage.label(closed)
    length = np.bincount(label, minlength=count + 1) * settings.station_m
    good = length >= settings.shortest_m
    good[0] = False
    order = np.cumsum(good) - 1
    piece, kept = order[label], good[label]
    xyz = np.column_stack([place, foot[row, cell]])[kept]
    direction = _tangents(place)[kept]
    return Curbs(xyz, direction, (piece[kept] + first).astype(np.int32), step[row, cell][kept])


# Cells this near to the track are the road, from whose height it is told what stands up.
_LANE_M = 1.5
# What the slope of the cells before may explain of a rise over 0.3 m; more is itself a step.
_MOST_SLOPE_M = 0.05


def steps(outwards: Floats, settings: CurbSettings) -> tuple[Floats, Floats]:
    """Rise of the surface beyond each cell, and the height of its foot; both (stations, cells).

    The rise is that of the three cells beyond over the three before, less what the slope of the
    cells before lets expect; 0 where it is no curb's, or hidden behind something that stands up.
    """
    reach = 3
    inner, outer = _means(outwards, reach, -1), _means(outwards, reach, 1)
    before = _means(outwards, 2 * reach, -1)
    # The middles of the cells before and of the three nearest of them are 1.5 cells apart, those
    # of the three before and the three beyond 3 cells: hence twice.
    slope = np.where(np.isfinite(before), inner - before, 0.0) * 2.0
    rise = outer - inner - np.clip(slope, -_MOST_SLOPE_M, _MOST_SLOPE_M)
    open_ground = np.fmax.accumulate(np.nan_to_num(outwards, nan=-np.inf), axis=1)
    lane = outwards[:, : max(round(_LANE_M / settings.across_m), 1)]
    road = np.full(len(lane), np.nan)
    known = np.isfinite(lane).any(axis=1)
    road[known] = np.nanmedian(lane[known], axis=1)
    hidden = open_ground > road[:, None] + 2 * settings.most_step_m
    with np.errstate(invalid="ignore"):
        curb = (rise >= settings.least_step_m) & (rise <= settings.most_step_m) & ~hidden
    curb[:, : round(settings.nearest_m / settings.across_m)] = False
    return np.where(curb, rise, 0.0), inner


def _means(values: Floats, reach: int, direction: int) -> Floats:
    """Mean of so many cells before (-1) or from (+1) each cell, NaN where fewer than half."""
    known = np.isfinite(values)
    total, count = np.zeros(values.shape), np.zeros(values.shape)
    for k in range(reach):
        shift = k + 1 if direction < 0 else -k
        moved = np.roll(np.where(known, values, 0.0), shift, axis=1)
        there = np.roll(known, shift, axis=1)
        if shift > 0:
            there[:, :shift] = False
        elif shift < 0:
            there[:, shift:] = False
        total += np.where(there, moved, 0.0)
        count += there
    return np.where(count >= 0.5 * reach, total / np.maximum(count, 1), np.nan)


# What a curb gains by being nearer by one cell, against 1 for a clear curb: over the default reach
# of 120 cells it stays below that.
_NEARER = 0.006
_ASIDE_CELLS = 3  # How far aside a curb may go from one station to the next.


def follow(step_m: Floats, settings: CurbSettings) -> Ints:
    """Cell (stations,) of the curb: the line that gathers most steps with fewest steps aside.

    Of two lines the nearer one is taken where they are alike.
    """
    clear = np.minimum(step_m / (2.0 * settings.least_step_m), 1.0)
    gain = clear - _NEARER * np.arange(step_m.shape[1])
    aside = np.arange(-_ASIDE_CELLS, _ASIDE_CELLS + 1)
    best = np.empty(step_m.shape)
    back = np.zeros(step_m.shape, np.int64)
    best[0] = gain[0]
    cells = step_m.shape[1]
    cost = settings.bend_cost * np.abs(aside)
    for row in range(1, len(step_m)):
        padded = np.pad(best[row - 1], _ASIDE_CELLS, constant_values=-np.inf)
        options = np.stack([padded[k : k + cells] for k in range(len(aside))]) - cost[:, None]
        back[row] = options.argmax(axis=0)
        best[row] = gain[row] + options.max(axis=0)
    cell = np.empty(len(step_m), np.int64)
    cell[-1] = int(best[-1].argmax())
    for row in range(len(step_m) - 1, 0, -1):
        cell[row - 1] = cell[row] + aside[back[row, cell[row]]]
    return cell
