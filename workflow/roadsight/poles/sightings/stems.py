"""Upright stems in a dense cloud, also short pieces of them: posts in hedges, trunks under crowns.

A scanner on a vehicle looks at most a few degrees upwards: of a lamp post beside the road it sees
two metres, often between a hedge and leaves, and each return may be smeared along its beam. Such a
cloud is cut into level slices (as Pu, Rutzinger, Vosselman and Oude Elberink 2011, ISPRS J.
Photogramm. Remote Sens. 66, S28-S39, do). A slice of a stem holds most of its returns in a small
disc; that of a wall, a hedge or a car does not. Slices above each other are a piece of a stem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Floats32, Ints
from roadsight.poles.sightings.lidar_poles import NO_COLUMN, PoleColumns, stem_axis, thinned

_LAYER_M = 0.3  # height of a slice: lower ones have too few returns, higher ones blur leaning stems
_CELL_M = 0.1  # cells of a slice in plan
# Heights above the ground between which stems are looked for: above grass, and not where a scanner
# on a vehicle, which looks hardly upwards, sees little.
_HEIGHTS_M = (0.6, 6.0)
_CORE_CELLS = 2  # radius of the disc that holds a stem
# Distance of the discs around it, and the range in which its disc must be the fullest.
_WIDE_CELLS = 6
_DIRECTIONS = 8  # discs around it
_DENSE = 0.25  # a disc around it is dense from this share of its own returns on
_MOST_DENSE = 2  # dense discs that a stem may have around it
_WALL = 0.7  # from this share of its own returns on, a single disc around it makes it a wall's
_FEWEST_IN_SLICE = 8  # returns in a slice's disc
_SLICES = 4  # slices of a stem
_SHIFT_M = 0.15  # how far aside the disc of the next slice, and any disc from their middle, may be
_BENT_M = 0.06  # root mean square by which discs may be off a straight axis
_STEEPEST = 0.15  # lean of a stem at most, metres aside per metre up
_NEAR_M = 0.6  # returns within this of the middle give the axis
_SAME_M = 0.8  # a stem this near to a column is the same


def find_stems(
    xyz_m: Floats, above_ground_m: Floats, cls: NDArray, excluded_classes: Sequence[int] = NO_COLUMN
) -> PoleColumns:
    """Stems of at least four slices of 0.3 m, by place; their tops are as far as they were seen.

    In each slice a disc of 0.2 m has at least eight returns, and around it, at 0.6 m, at most two
    of eight directions have a quarter as many: a wall runs on both ways, a smear only one. One
    slice at a time may be missing, where a stem touches something else. Sparse clouds have too few
    returns in a slice, and so no stems.

    Parameters
    ----------
    xyz_m : returns (n, 3), local metres. above_ground_m : (n,), NaN where unknown.
    cls : ASPRS class (n,). excluded_classes : those that no return of a pole has.
    """
    with np.errstate(invalid="ignore"):
        used = ~np.isin(cls, excluded_classes) & (above_ground_m > _HEIGHTS_M[0])
        used &= above_ground_m < _HEIGHTS_M[1]
    points, height = np.asarray(xyz_m, np.float64)[used], np.asarray(above_ground_m)[used]
    order = np.lexsort(points.T)
    points, height = points[order], height[order]
    if not len(points):
        return _columns([])
    layer = np.floor(height / _LAYER_M).astype(np.int64)
    layers, places = _discs(points[:, :2], layer)
    if not len(layers):
        return _columns([])
    # Chains of discs above each other: a step is one slice or two, and the less aside the more
    # slices it takes.
    near = cKDTree(np.column_stack([places / _SHIFT_M, 0.45 * layers]))
    ends = near.query_pairs(1.0, output_type="ndarray").T
    graph = coo_matrix((np.ones(ends.shape[1], bool), ends), shape=(len(layers), len(layers)))
    chain = connected_components(graph, directed=False)[1]
    plan = cKDTree(points[:, :2])
    found = []
    for number in np.flatnonzero(np.bincount(chain) >= _SLICES):
        own = np.flatnonzero(chain == number)
        # What follows above or below may lead away from the stem.
        own = own[np.hypot(*(places[own] - np.median(places[own], axis=0)).T) <= _SHIFT_M]
        if len(np.unique(layers[own])) < _SLICES:
            continue
        # A stem is straight and upright.
        rise = (layers[own] - layers[own].mean()) * _LAYER_M
        middle = places[own].mean(axis=0)
        slope = rise @ (places[own] - middle) / (rise @ rise)
        off = places[own] - middle - rise[:, None] * slope
        if np.hypot(*slope) > _STEEPEST or np.sqrt((off**2).sum(axis=1).mean()) > _BENT_M:
            continue
        low, high = layers[own].min() * _LAYER_M, (layers[own].max() + 1) * _LAYER_M
        rows = np.sort(np.array(plan.query_ball_point(middle, _NEAR_M), np.int64))
        rows = rows[(height[rows] >= low) & (height[rows] < high)]
        xy, sigma, agree = stem_axis(points[rows, :2])
        # A place is no better than half of what its returns are smeared over.
        smear = np.sqrt(((points[rows, :2] - xy) ** 2).sum(axis=1).mean() / 2)
        ground = float(np.median(points[rows, 2] - height[rows]))
        sigma = max(sigma, 0.5 * float(smear))
        found.append((*xy, float(height[rows].max()), sigma, ground, agree))
    return _columns(found)


def _discs(xy: Floats, layer: Ints) -> tuple[Ints, Floats]:
    """Slices (n,) and places (n, 2) of discs that hold most of what is around them."""
    west_south = np.floor(xy.min(axis=0) / _CELL_M).astype(np.int64)
    cell = np.floor(xy / _CELL_M).astype(np.int64) - west_south
    columns, rows = (int(n) + 1 for n in cell.max(axis=0))
    flat = cell[:, 1] * columns + cell[:, 0]
    core, wide = _disc(_CORE_CELLS), _disc(_WIDE_CELLS).astype(np.uint8)
    layers, places = [], []
    for number in np.unique(layer):
        own = flat[layer == number]
        count = np.bincount(own, minlength=rows * columns).reshape(rows, columns)
        image = count.astype(np.float32)
        inner = _summed(image, core)
        peak = (inner >= _FEWEST_IN_SLICE) & (inner >= cv2.dilate(inner, wide))
        row, column = np.nonzero(peak)
        lone = _dense_around(image, inner, row, column) <= _MOST_DENSE
        row, column = row[lone], column[lone]
        layers.append(np.full(len(row), number))
        offset = [_summed(image, core * reach)[row, column] for reach in _reaches(_CORE_CELLS)]
        middle = np.column_stack(offset) / inner[row, column, None]
        places.append((np.column_stack([column, row]) + west_south + 0.5 + middle) * _CELL_M)
    return np.concatenate(layers), np.concatenate(places)


def _dense_around(image: Floats32, inner: Floats32, row: Ints, column: Ints) -> Ints:
    """In how many of eight directions (n,) a disc beside a cell has a quarter of its own returns.

    One that has nearly as many is a wall's: it counts as too many.
    """
    dense = np.zeros(len(row), np.int64)
    most = _MOST_DENSE + 1
    reach = _CORE_CELLS + _WIDE_CELLS
    padded = np.pad(image, reach)
    own = inner[row, column]
    x, y = _reaches(reach)
    for turn in np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS:
        away = np.hypot(x - _WIDE_CELLS * np.cos(turn), y - _WIDE_CELLS * np.sin(turn))
        down, right = np.nonzero(away <= _CORE_CELLS + 0.5)
        beside = padded[row[:, None] + down, column[:, None] + right].sum(axis=1)
        dense += np.where(beside > _WALL * own, most, beside > _DENSE * own)
    return dense


def _disc(cells: int) -> Floats32:
    x, y = _reaches(cells)
    return (x * x + y * y <= cells * cells).astype(np.float32)


def _reaches(cells: int) -> tuple[Floats32, Floats32]:
    """Columns and rows from the middle of a window."""
    y, x = np.mgrid[-cells : cells + 1, -cells : cells + 1].astype(np.float32)
    return x, y


def _summed(image: Floats32, window: Floats32) -> Floats32:
    return np.asarray(cv2.filter2D(image, -1, window, borderType=cv2.BORDER_CONSTANT), np.float32)


def _columns(rows: list[tuple[float, ...]]) -> PoleColumns:
    table = np.array(sorted(rows), np.float64).reshape(-1, 6)
    rest = np.ascontiguousarray(np.column_stack([table[:, 2:], np.ones(len(table))]).T)
    return PoleColumns(table[:, :2].copy(), *rest)


def with_stems(columns: PoleColumns, stems: PoleColumns) -> PoleColumns:
    """Columns and the stems that are not theirs."""
    if not len(columns) or not len(stems):
        return stems if not len(columns) else columns
    gap, _ = cKDTree(columns.xy_m).query(stems.xy_m)
    both = zip(vars(columns).values(), vars(stems).values(), strict=True)
    return PoleColumns(*(np.concatenate([ours, more[gap > _SAME_M]]) for ours, more in both))


# How pole-like columns lean, and the arms near their tops, from their returns.

_LOWEST_M = 1.0  # returns below this may be of grass, shrubs and fences
# Below the top by this much begin arms, lamps, wires, and transformers that hang on the stem.
_HEAD_M = 1.7
# Returns this near to the axis may be the stem's: one of 8 m that leans by 8 degrees is within it
# from end to end.
_BESIDE_AXIS_M = 0.6
# Returns of a stem that tell its lean: of fewer, one of a wire that meets it is not told apart.
_FEWEST = 8
_LEAST_SPAN_M = 2.0  # height between its lowest and highest return, the same
_THIN_M = 0.1  # cells of which each counts as one return
_STARTS = 60  # returns between which lines are tried, spread over all heights
_PAIRS = 400  # pairs of them that are tried, spread over all
# Returns of a stem are this near to its axis: its radius, 13 cm with a spread of 5, and noise of 3
# cm. Wires that meet it and transformers lie farther off for the most part.
_OWN_M = 0.22
_ROUNDS = 5  # rounds of fitting, after which the same returns are a stem's
# Noise of a return about the axis before any is seen, each coordinate: a radius of 13 cm.
_SURFACE_M = 0.09
# Returns that this counts for: few returns of one side lie on a line that is not the axis.
_SURFACE_WORTH = 4.0
_ARM_HEIGHT_M = 1.2  # arms begin this near to the top
_ARM_BEGINS_M = 0.3  # returns nearer to the axis are of the stem and what hangs on it
_ARM_ENDS_M = 2.5  # arms are not longer: brackets of lamps reach 2.5 m, crossarms 1.5 m
_ARM_WIDE_M = 0.15  # half the width of an arm, with the noise of its returns
# An arm has no greater gap: 4 returns a metre leave one this long once in 25 arms of 1 m.
_ARM_GAP_M = 0.8
_WIRE_M = (2.6, 6.0)  # what goes on between these distances is a wire
# Half the width in which a wire is looked for: it sags and need not pass over the axis.
_WIRE_WIDE_M = 0.3
_BESIDE_WIRE_DEG = 20.0  # returns this near to a wire's direction may be its own
_FEWEST_OF_ARM = 3  # returns that make an arm, or a wire
_STEP_DEG = 3.0  # step of the directions in which arms are looked for
_TURNS_RAD = np.radians(np.arange(0.0, 360.0, _STEP_DEG))


@dataclass(frozen=True)
class StemShapes:
    """Shapes of columns, NaN where the returns do not tell.

    Parameters
    ----------
    lean_deg : (n,) from the vertical. lean_azimuth_deg : (n,) to where, clockwise from grid north.
    sigma_lean_deg : (n,) of the lean in either direction; a lean below twice of it is none.
    arm_m : (n,) reach of the longest arm near the top from the axis. arm_sides : (n,) 2 where it
    goes on to the other side (a crossarm), 1 where not (a lamp), 0 where none is seen.
    """

    lean_deg: Floats
    lean_azimuth_deg: Floats
    sigma_lean_deg: Floats
    arm_m: Floats
    arm_sides: Floats


def stem_shapes(
    columns: PoleColumns,
    xyz_m: Floats,
    above_ground_m: Floats,
    cls: NDArray,
    excluded_classes: Sequence[int] = NO_COLUMN,
) -> StemShapes:
    """Shapes of columns from the returns around them.

    Parameters
    ----------
    xyz_m : returns (n, 3), local metres. above_ground_m : (n,), NaN where unknown. cls : ASPRS
    class (n,). excluded_classes : those that no return of a pole has.
    """
    found = np.full((len(columns), 5), np.nan)
    if not len(columns):
        return StemShapes(*found.T)
    with np.errstate(invalid="ignore"):
        used = ~np.isin(cls, excluded_classes) & (above_ground_m > _LOWEST_M)
    points = np.column_stack([xyz_m[used, :2], above_ground_m[used]]).astype(np.float64)
    # Those that may be of stems, arms and wires; one for each small cell, so that a dense cloud
    # takes no longer and counts no more.
    away, _ = cKDTree(columns.xy_m).query(points[:, :2], distance_upper_bound=_WIRE_M[1])
    points = thinned(points[np.isfinite(away)], _THIN_M)
    if len(points):
        tree = cKDTree(points[:, :2])
        for row, (axis, top_m) in enumerate(zip(columns.xy_m, columns.top_m, strict=True)):
            own = tree.query_ball_point(axis, _WIRE_M[1])
            around = points[np.sort(np.array(own, np.int64))] - [*axis, 0.0]
            slope, sigma, middle = _line(around, top_m)
            lean = np.degrees(np.arctan(np.hypot(*slope)))
            azimuth = np.degrees(np.arctan2(*slope)) % 360.0
            if np.isfinite(lean):
                around[:, :2] -= middle + around[:, 2:] * slope
            found[row] = lean, azimuth, np.degrees(sigma), *_arm(around, top_m)
    return StemShapes(*np.ascontiguousarray(found.T))


def _line(points: Floats, top_m: float) -> tuple[Floats, float, Floats]:
    """Slope (2,) of a stem, metres aside per metre up, its sigma, and its place at height 0."""
    unknown = np.full(2, np.nan)
    stem = (np.hypot(*points[:, :2].T) <= _BESIDE_AXIS_M) & (points[:, 2] <= top_m - _HEAD_M)
    xy, height = points[stem, :2], points[stem, 2]
    if len(height) < _FEWEST or np.ptp(height) < _LEAST_SPAN_M:
        return unknown, float("nan"), unknown
    design = np.column_stack([np.ones(len(height)), height])
    line = _start(xy, height)
    for _ in range(_ROUNDS):
        own = np.hypot(*(xy - design @ line).T) <= _OWN_M
        if own.sum() < _FEWEST or np.ptp(height[own]) < _LEAST_SPAN_M:
            return unknown, float("nan"), unknown
        line = np.linalg.lstsq(design[own], xy[own], rcond=None)[0]
    off = np.hypot(*(xy[own] - design[own] @ line).T)
    squares = (off**2).sum() + 2 * _SURFACE_WORTH * _SURFACE_M**2
    noise = np.sqrt(squares / (2 * own.sum() - 4 + 2 * _SURFACE_WORTH))
    spread = np.sqrt(((height[own] - height[own].mean()) ** 2).sum())
    return line[1], float(np.hypot(noise / spread, _without_one(design[own], xy[own]))), line[0]


def _start(xy: Floats, height: Floats) -> Floats:
    """Of the lines through two returns the one of least squares, none counted beyond `_OWN_M`."""
    order = np.argsort(height, kind="stable")
    order = order[np.unique(np.linspace(0, len(order) - 1, _STARTS).astype(np.int64))]
    low, high = np.triu_indices(len(order), 1)
    rise = height[order[high]] - height[order[low]]
    pairs = np.flatnonzero(rise >= 0.5 * _LEAST_SPAN_M)
    pairs = pairs[np.linspace(0, len(pairs) - 1, min(len(pairs), _PAIRS)).astype(np.int64)]
    below, above = order[low[pairs]], order[high[pairs]]
    slope = (xy[above] - xy[below]) / rise[pairs, None]
    start = xy[below] - height[below, None] * slope
    lines = start[:, None] + height[:, None] * slope[:, None]
    cost = np.minimum(((xy - lines) ** 2).sum(axis=2), _OWN_M**2).sum(axis=1)
    best = int(np.argmin(cost))
    return np.stack([start[best], slope[best]])


def _without_one(design: Floats, xy: Floats) -> float:
    """Sigma of a slope by the jackknife: how much hangs on single returns (Efron 1982)."""
    square = np.linalg.inv(design.T @ design)
    gain = design @ square
    residual = xy - gain @ (design.T @ xy)
    shift = gain[:, 1:] * residual / (1.0 - (gain * design).sum(axis=1))[:, None]
    n = len(xy)
    return float(np.sqrt((n - 1) / n * ((shift - shift.mean(axis=0)) ** 2).sum() / 2))


def _arm(points: Floats, top_m: float) -> tuple[float, float]:
    """Reach of the longest arm, NaN where none is seen, and its sides."""
    xy = points[points[:, 2] >= top_m - _ARM_HEIGHT_M, :2]
    way = np.stack([np.sin(_TURNS_RAD), np.cos(_TURNS_RAD)])
    along, across = xy @ way, np.abs(xy @ np.stack([way[1], -way[0]]))
    far = (along >= _WIRE_M[0]) & (along <= _WIRE_M[1]) & (across <= _WIRE_WIDE_M)
    beside = int(_BESIDE_WIRE_DEG / _STEP_DEG)
    wire = far.sum(axis=0) >= _FEWEST_OF_ARM
    wire = np.any([np.roll(wire, turn) for turn in range(-beside, beside + 1)], axis=0)
    inside = (along >= _ARM_BEGINS_M) & (along <= _ARM_ENDS_M) & (across <= _ARM_WIDE_M)
    found = []  # number of returns of an arm before its first gap, and how far they go
    for number, own in enumerate(inside.T):
        arm = np.sort(along[own, number])
        gaps = np.flatnonzero(np.diff(arm, prepend=0.0) > _ARM_GAP_M)
        arm = arm[: gaps[0]] if len(gaps) else arm
        found.append((len(arm), float(arm[-1]) if len(arm) else 0.0))
    count, reach = np.where(wire, 0.0, np.transpose(found))
    half = len(_TURNS_RAD) // 2
    both = count + np.roll(count, half)
    best = int(np.argmax(np.where(count >= np.roll(count, half), both, 0.0)))
    if count[best] < _FEWEST_OF_ARM:
        return float("nan"), 0.0
    other = (best + half) % len(_TURNS_RAD)
    return float(max(reach[best], reach[other])), 2.0 if count[other] >= 2 else 1.0
