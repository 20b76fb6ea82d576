"""Pole-like columns of a voxelised cloud: tall, thin, and with little around them.

They are a second opinion about poles seen in images, never poles by themselves: clean trunks and
lamp posts look alike here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

_FLOATS = NDArray[np.float64]
_CLASSES = (1, 3, 4, 5)
_LOWEST_M = 1.0
_TRUNK_M = 4.5
_LAYER_M = 1.0
_CELL_M = 0.5
_INNER_M = 0.6
_OUTER_M = 2.0
_APART_M = 1.5


@dataclass(frozen=True)
class PoleColumns:
    """Pole-like columns.

    Parameters
    ----------
    xy_m : (n, 2) local metres. top_m : (n,) height of their tops above the ground.
    sigma_m : (n,) of their places.
    """

    xy_m: _FLOATS
    top_m: _FLOATS
    sigma_m: _FLOATS

    def __len__(self) -> int:
        return len(self.xy_m)


def find_pole_columns(
    xyz_m: _FLOATS, above_ground_m: _FLOATS, cls: NDArray, cell_m: float, min_top_m: float = 3.0
) -> PoleColumns:
    """Pole-like columns among voxels, by falling number of layers and then by place.

    A column has points in at least three layers of 1 m, reaches ``min_top_m``, and has few points
    around it: at trunk height (below 4.5 m, under the wires) at most half as many as its own, above
    at most three times as many (wires and arms, but no crown).

    Parameters
    ----------
    xyz_m : centres of voxels (n, 3), local metres. above_ground_m : (n,), NaN where unknown.
    cls : ASPRS class (n,). cell_m : edge of a voxel. min_top_m : lower ones are none.
    """
    with np.errstate(invalid="ignore"):
        high = np.isin(cls, _CLASSES) & (above_ground_m > _LOWEST_M)
    xy, height = xyz_m[high, :2], above_ground_m[high]
    if not len(xy):
        return PoleColumns(np.empty((0, 2)), np.empty(0), np.empty(0))
    centre, layers, top = _tall_cells(xy, height)
    good = (layers >= 3) & (top >= min_top_m)
    centre, layers = centre[good], layers[good]
    # A trunk may lie across two cells: the window must hold it whichever cell's centre is taken.
    tree, trunk = cKDTree(xy), cKDTree(xy[height < _TRUNK_M])
    inner, outer = (_count(tree, centre, r) for r in (_INNER_M, _OUTER_M))
    inner_trunk, outer_trunk = (_count(trunk, centre, r) for r in (_INNER_M, _OUTER_M))
    alone = (outer_trunk - inner_trunk <= 0.5 * inner_trunk + 1) & (outer <= 4 * inner + 2)
    centre, layers, inner = centre[alone], layers[alone], inner[alone]
    order = np.lexsort((centre[:, 1], centre[:, 0], -inner, -layers))
    return _placed(centre[_apart(centre[order], order)], xy, height, tree, cell_m)


def _tall_cells(xy: _FLOATS, height: _FLOATS) -> tuple[_FLOATS, NDArray[np.int64], _FLOATS]:
    """Mean place (n, 2), number of occupied layers and greatest height of each plan cell."""
    cell = np.floor(xy / _CELL_M).astype(np.int64)
    layer = np.floor(height / _LAYER_M).astype(np.int64)
    _, number = np.unique(cell, axis=0, return_inverse=True)
    number = number.ravel()
    cells = int(number.max()) + 1
    weight = np.bincount(number, minlength=cells)
    mean = np.column_stack([np.bincount(number, axis) / weight for axis in xy.T])
    both = np.unique(number * 4096 + np.clip(layer, 0, 4095))
    top = np.zeros(cells)
    np.maximum.at(top, number, height)
    return mean, np.bincount(both // 4096, minlength=cells), top


def _count(tree: cKDTree, places: _FLOATS, radius_m: float) -> NDArray[np.int64]:
    if not len(places) or not tree.n:
        return np.zeros(len(places), np.int64)
    return np.asarray(tree.query_ball_point(places, radius_m, return_length=True), np.int64)


def _apart(ordered: _FLOATS, order: NDArray[np.int64]) -> NDArray[np.int64]:
    """Which to keep, best first, so that no two are nearer than `_APART_M`."""
    if not len(ordered):
        return order
    tree = cKDTree(ordered)
    free = np.ones(len(ordered), bool)
    kept = []
    for i in range(len(ordered)):
        if free[i]:
            kept.append(order[i])
            free[tree.query_ball_point(ordered[i], _APART_M)] = False
    return np.array(kept, np.int64)


def _placed(
    centres: _FLOATS, xy: _FLOATS, height: _FLOATS, tree: cKDTree, cell_m: float
) -> PoleColumns:
    """Place each column at the median of its own points below the arms and wires."""
    places, tops, sigmas = [], [], []
    for centre in centres:
        own = np.array(sorted(tree.query_ball_point(centre, _INNER_M)), np.int64)
        top = float(height[own].max())
        stem = own[height[own] <= max(0.7 * top, _TRUNK_M)]
        stem = stem if len(stem) >= 2 else own
        places.append(np.median(xy[stem], axis=0))
        tops.append(top)
        spread = float(xy[stem].std(axis=0).max()) / np.sqrt(len(stem))
        sigmas.append(max(spread, cell_m / 2))
    return PoleColumns(np.array(places).reshape(-1, 2), np.array(tops), np.array(sigmas))
