"""Upright stems in a dense cloud, also short pieces of them: posts in hedges, trunks under crowns.

A scanner on a vehicle looks at most a few degrees upwards: of a lamp post beside the road it sees
two metres, often between a hedge and leaves, and each return may be smeared along its beam. Such a
cloud is cut into level slices (as Pu, Rutzinger, Vosselman and Oude Elberink 2011, ISPRS J.
Photogramm. Remote Sens. 66, S28-S39, do). A slice of a stem holds most of its returns in a small
disc; that of a wall, a hedge or a car does not. Slices above each other are a piece of a stem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Floats32, Ints
from roadsight.poles.sightings.lidar_poles import NO_COLUMN, PoleColumns, stem_axis

_LAYER_M = 0.3
"""Height of a slice: lower ones have too few returns, higher ones blur leaning stems."""
_CELL_M = 0.1
"""Cells of a slice in plan."""
_HEIGHTS_M = (0.6, 6.0)
"""Heights above the ground between which stems are looked for: above grass, and not where a scanner
on a vehicle, which looks hardly upwards, sees little."""
_CORE_CELLS = 2
"""Radius of the disc that holds a stem."""
_WIDE_CELLS = 6
"""Distance of the discs around it, and the range in which its disc must be the fullest."""
_DIRECTIONS = 8
"""Discs around it."""
_DENSE = 0.25
"""A disc around it is dense from this share of its own returns on."""
_MOST_DENSE = 2
"""Dense discs that a stem may have around it."""
_WALL = 0.7
"""From this share of its own returns on, a single disc around it makes it a wall's."""
_FEWEST_IN_SLICE = 8
"""Returns in a slice's disc."""
_SLICES = 4
"""Slices of a stem."""
_SHIFT_M = 0.15
"""How far aside the disc of the next slice, and any disc from their middle, may be."""
_BENT_M = 0.06
"""Root mean square by which discs may be off a straight axis."""
_STEEPEST = 0.15
"""Lean of a stem at most, metres aside per metre up."""
_NEAR_M = 0.6
"""Returns within this of the middle give the axis."""
_SAME_M = 0.8
"""A stem this near to a column is the same."""


@dataclass(frozen=True)
class _Discs:
    """Discs of stems: slice (n,), place (n, 2) and returns (n,)."""

    layer: Ints
    xy_m: Floats
    count: Floats


def find_stems(
    xyz_m: Floats,
    above_ground_m: Floats,
    cls: NDArray,
    excluded_classes: Sequence[int] = NO_COLUMN,
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
    return _placed(_discs(points[:, :2], layer), points, height)


def _discs(xy: Floats, layer: Ints) -> _Discs:
    """Places of each slice in which a disc holds most of what is around it."""
    west_south = np.floor(xy.min(axis=0) / _CELL_M).astype(np.int64)
    cell = np.floor(xy / _CELL_M).astype(np.int64) - west_south
    columns, rows = (int(n) + 1 for n in cell.max(axis=0))
    flat = cell[:, 1] * columns + cell[:, 0]
    core, wide = _disc(_CORE_CELLS), _disc(_WIDE_CELLS).astype(np.uint8)
    layers, places, counts = [], [], []
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
        counts.append(inner[row, column])
    return _Discs(np.concatenate(layers), np.concatenate(places), np.concatenate(counts))


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


def _summed(image: Floats32, window: Floats32) -> Floats32:
    return np.asarray(cv2.filter2D(image, -1, window, borderType=cv2.BORDER_CONSTANT), np.float32)


def _reaches(cells: int) -> tuple[Floats32, Floats32]:
    """Columns and rows from the middle of a window."""
    y, x = np.mgrid[-cells : cells + 1, -cells : cells + 1].astype(np.float32)
    return x, y


def _disc(cells: int) -> Floats32:
    x, y = _reaches(cells)
    return (x * x + y * y <= cells * cells).astype(np.float32)


def _groups(pairs: Ints, size: int) -> Ints:
    """Number of the connected part of each node."""
    ones = np.ones(len(pairs), bool)
    graph = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def _placed(discs: _Discs, points: Floats, height: Floats) -> PoleColumns:
    """Chains of discs above each other, each on the axis of its returns."""
    if not len(discs.layer):
        return _columns([])
    # A step of one slice or two, and the less aside the more slices it takes.
    tree = cKDTree(np.column_stack([discs.xy_m / _SHIFT_M, 0.45 * discs.layer]))
    chain = _groups(tree.query_pairs(1.0, output_type="ndarray"), len(discs.layer))
    plan = cKDTree(points[:, :2])
    found = []
    for number in np.flatnonzero(np.bincount(chain) >= _SLICES):
        own = np.flatnonzero(chain == number)
        # What follows above or below may lead away from the stem.
        aside = discs.xy_m[own] - np.median(discs.xy_m[own], axis=0)
        own = own[np.hypot(aside[:, 0], aside[:, 1]) <= _SHIFT_M]
        middle = _middle(discs.xy_m[own], discs.layer[own])
        if middle is None:
            continue
        low, high = discs.layer[own].min() * _LAYER_M, (discs.layer[own].max() + 1) * _LAYER_M
        near = np.sort(np.array(plan.query_ball_point(middle, _NEAR_M), np.int64))
        near = near[(height[near] >= low) & (height[near] < high)]
        found.append(_stem(points[near], height[near]))
    return _columns(found)


def _stem(points: Floats, height: Floats) -> tuple[float, ...]:
    """Row of a column; a place is no better than half of what its returns are smeared over."""
    xy, sigma, agree = stem_axis(points[:, :2])
    smear = np.sqrt(((points[:, :2] - xy) ** 2).sum(axis=1).mean() / 2)
    ground = float(np.median(points[:, 2] - height))
    return (*xy, float(height.max()), max(sigma, 0.5 * float(smear)), ground, agree)


def _middle(xy: Floats, layer: Ints) -> Floats | None:
    """Middle (2,) of a chain that is straight, upright and tall enough, else None."""
    if len(np.unique(layer)) < _SLICES:
        return None
    height = (layer - layer.mean()) * _LAYER_M
    middle = np.asarray(xy.mean(axis=0), np.float64)
    slope = height @ (xy - middle) / (height @ height)
    off = xy - middle - height[:, None] * slope
    if np.hypot(*slope) > _STEEPEST or np.sqrt((off**2).sum(axis=1).mean()) > _BENT_M:
        return None
    return middle


def _columns(rows: list[tuple[float, ...]]) -> PoleColumns:
    table = np.array(sorted(rows), np.float64).reshape(-1, 6)
    rest = np.ascontiguousarray(np.column_stack([table[:, 2:], np.ones(len(table))]).T)
    return PoleColumns(table[:, :2].copy(), *rest)


def with_stems(columns: PoleColumns, stems: PoleColumns) -> PoleColumns:
    """Columns and the stems that are not theirs."""
    if not len(columns) or not len(stems):
        return stems if not len(columns) else columns
    gap, _ = cKDTree(columns.xy_m).query(stems.xy_m)
    new = gap > _SAME_M
    return PoleColumns(
        *(
            np.concatenate([getattr(columns, f.name), getattr(stems, f.name)[new]])
            for f in fields(columns)
        )
    )
