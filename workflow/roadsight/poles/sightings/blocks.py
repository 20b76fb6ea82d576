"""Buildings and headwalls in a cloud whose classes have them: their outlines and heights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints
from roadsight.poles.images.kinds import ObjectKind

CELL_M = 0.5
"""Cells in plan in which returns of a class are joined."""
_JOIN_CELLS = 1.5
"""Cells this near to each other are of one object: those that share a side or a corner."""
_EVERY_M = 1.0
"""Spacing of the places on an outline."""
SIGMA_M = 0.3
"""Standard deviation of an outline, each axis: cells of 0.5 m, of whose outermost half is cut."""


@dataclass(frozen=True)
class BlockCells:
    """Cells that hold returns of a class.

    Parameters
    ----------
    index : (n, 2) numbers of cells, which begin at whole multiples of `CELL_M`, each once.
    top_m, low_m : (n,) highest and lowest return.
    """

    index: Ints
    top_m: Floats
    low_m: Floats


@dataclass(frozen=True)
class Block:
    """An outline: places (n, 2) every metre along it, its highest return and its area."""

    outline_m: Floats
    top_m: float
    area_m2: float


def block_cells(xyz_m: Floats) -> BlockCells:
    """Cells of returns (n, 3) of one class."""
    index, own = np.unique(
        np.floor(xyz_m[:, :2] / CELL_M).astype(np.int64), axis=0, return_inverse=True
    )
    own = own.ravel()
    top, low = np.full(len(index), -np.inf), np.full(len(index), np.inf)
    np.maximum.at(top, own, xyz_m[:, 2])
    np.minimum.at(low, own, xyz_m[:, 2])
    return BlockCells(index.reshape(-1, 2), top, low)


def join_blocks(parts: Sequence[BlockCells], kind: ObjectKind) -> list[Block]:
    """Objects of the cells of all tiles, from west to east.

    Each has the area that its kind may have, and a face: returns as far above each other as the
    least height of its kind.
    """
    index = np.concatenate([np.empty((0, 2), np.int64), *[part.index for part in parts]])
    if not len(index):
        return []
    index, own = np.unique(index, axis=0, return_inverse=True)
    top, low = np.full(len(index), -np.inf), np.full(len(index), np.inf)
    np.maximum.at(top, own.ravel(), np.concatenate([part.top_m for part in parts]))
    np.minimum.at(low, own.ravel(), np.concatenate([part.low_m for part in parts]))
    pairs = cKDTree(index).query_pairs(_JOIN_CELLS, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(index), len(index)))
    _, part = connected_components(graph, directed=False)
    order = np.argsort(part, kind="stable")
    found = []
    for rows in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        shapes = [shape for shape in _outlines(index[rows]) if _within(shape.area, kind.area_m2)]
        if not shapes:
            continue
        middles = shapely.points((index[rows] + 0.5) * CELL_M)
        nearest = np.argmin([shapely.distance(shape, middles) for shape in shapes], axis=0)
        for number, shape in enumerate(shapes):
            own = rows[nearest == number]
            if len(own) and _within(top[own].max() - low[own].min(), kind.height_m):
                places = np.arange(0.0, shape.exterior.length, _EVERY_M)
                xy = shapely.get_coordinates(shapely.line_interpolate_point(shape.exterior, places))
                found.append(Block(xy, float(top[own].max()), float(shape.area)))
    return sorted(found, key=lambda block: (block.outline_m[:, 0].min(), block.outline_m[0, 1]))


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]


def _outlines(index: Ints) -> list[shapely.Polygon]:
    """Outlines of joined cells, single empty ones filled, a quarter of a metre inside.

    A cell at the border is half full on average. What that parts are several objects, such as
    houses that touch at a corner; what it leaves nothing of keeps its hull.
    """
    low = index * CELL_M
    whole = shapely.union_all(shapely.box(*low.T, *(low + CELL_M).T))
    filled = shapely.buffer(whole, CELL_M, join_style="mitre")
    inner = shapely.buffer(filled, -1.5 * CELL_M, join_style="mitre")
    shape = inner if not inner.is_empty else whole.convex_hull
    return list(shapely.get_parts(shape))
