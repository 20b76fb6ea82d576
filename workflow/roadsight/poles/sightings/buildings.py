"""Buildings and headwalls in a cloud whose classes have them: their outlines and heights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Bytes, Floats, Ints
from roadsight.poles.images.kinds import ObjectKind

CELL_M = 0.5  # cells in plan in which returns of a class are joined
# Cells this near to each other are of one object: those that share a side or a corner.
_JOIN_CELLS = 1.5
_EVERY_M = 1.0  # spacing of the places on an outline
# Standard deviation of an outline, each axis: cells of 0.5 m, of whose outermost half is cut.
SIGMA_M = 0.3


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
    cell = np.floor(xyz_m[:, :2] / CELL_M).astype(np.int64)
    index, own = np.unique(cell, axis=0, return_inverse=True)
    own = own.ravel()
    return BlockCells(index.reshape(-1, 2), *_extremes(own, xyz_m[:, 2], xyz_m[:, 2]))


def join_blocks(parts: Sequence[BlockCells], kind: ObjectKind) -> list[Block]:
    """Objects of the cells of all tiles, from west to east.

    Each has the area that its kind may have, and a face: returns as far above each other as the
    least height of its kind.
    """
    index = np.concatenate([np.empty((0, 2), np.int64), *[part.index for part in parts]])
    if not len(index):
        return []
    index, own = np.unique(index, axis=0, return_inverse=True)
    top, low = (np.concatenate([getattr(p, n) for p in parts]) for n in ("top_m", "low_m"))
    top, low = _extremes(own.ravel(), top, low)
    pairs = cKDTree(index).query_pairs(_JOIN_CELLS, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(index), len(index)))
    _, part = connected_components(graph, directed=False)
    order = np.argsort(part, kind="stable")
    found = []
    for rows in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        # Single empty cells are filled, and a quarter of a metre is cut: a cell at the border is
        # half full on average. What that parts are several objects, such as houses that touch at a
        # corner; what it leaves nothing of keeps its hull.
        low_m = index[rows] * CELL_M
        whole = shapely.union_all(shapely.box(*low_m.T, *(low_m + CELL_M).T))
        filled = shapely.buffer(whole, CELL_M, join_style="mitre")
        inner = shapely.buffer(filled, -1.5 * CELL_M, join_style="mitre")
        parted = shapely.get_parts(inner if not inner.is_empty else whole.convex_hull)
        shapes = [shape for shape in parted if _within(shape.area, kind.area_m2)]
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


def _extremes(cell: Ints, top_m: Floats, low_m: Floats) -> tuple[Floats, Floats]:
    """Greatest and least height in each cell, numbered from 0."""
    count = int(cell.max(initial=-1)) + 1
    top, low = np.full(count, -np.inf), np.full(count, np.inf)
    np.maximum.at(top, cell, top_m)
    np.minimum.at(low, cell, low_m)
    return top, low


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]


# Roofs in a cloud whose classes tell no buildings: plane, steady and well above the ground.

_UNTOLD = (0, 1)  # classes of returns that may be of anything
_LOWEST_M = 2.0  # over the ground: the least height of a building
# Edge of the cubes of which one return each is looked at, so that density does not decide.
_CUBE_M = 0.3
_ON_PLANE = 10  # returns that a plane is fitted to
_REACH_M = 1.6  # they are this near: at 2 returns a square metre ten lie within 1.3 m
# Standard deviation from the plane. Share of class 6, hidden, that is found, and of what is found
# that is right, at Delft (15 returns a square metre) and Montpellier (28): 0.75 and 0.99, 0.92 and
# 0.93. With 0.09 m, and cubes of 0.4, a crown whose leaves are a shell is a roof.
_ROUGH_M = 0.06
# Least vertical part of the normal: roofs are up to 60 degrees steep, walls are not roofs.
_UPRIGHT = 0.5
_PLANE_SHARE = 0.5  # of a cell's raised returns that lie on planes
# Half of the 25 cells about one of a roof are of it too; patches of leaves are smaller.
_AROUND_CELLS, _LEAST_AROUND = 2, 12
# A cell and the eight about it.
_BESIDE = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 2)
# Of a building without a class: smaller planes are vehicles, hedges that are cut, crowns.
ROOF_AREA_M2 = (10.0, float("inf"))


def roof_cells(xyz_m: Floats, above_ground_m: Floats, cls: Bytes, own: Bools) -> BlockCells:
    """Cells of raised planes, with the ground as their lowest return.

    Parameters
    ----------
    xyz_m : (n, 3) returns of a tile and of `_REACH_M` around it. above_ground_m : (n,).
    cls : (n,) LAS classes. own : (n,) whether a return is of the tile itself.
    """
    raised = np.isin(cls, _UNTOLD) & (above_ground_m > _LOWEST_M)
    points, own = xyz_m[raised], own[raised]
    index = np.floor(points[own, :2] / CELL_M).astype(np.int64)
    cells, number = np.unique(index, axis=0, return_inverse=True)
    number = number.ravel()
    plane = _on_planes(points)[own]
    most = np.bincount(number, plane, len(cells)) >= _PLANE_SHARE * np.bincount(number)
    top, ground = _extremes(number, points[own, 2], points[own, 2] - above_ground_m[raised][own])
    return BlockCells(cells.reshape(-1, 2)[most], top[most], ground[most])


def steady_roofs(parts: Sequence[BlockCells]) -> list[BlockCells]:
    """Cells of all tiles, as one part: those with enough of a roof about them, gaps filled."""
    index = np.concatenate([np.empty((0, 2), np.int64), *[part.index for part in parts]])
    if not len(index):
        return []
    top, low = (np.concatenate([getattr(p, n) for p in parts]) for n in ("top_m", "low_m"))
    tree = cKDTree(index)
    wider = np.unique((index[:, None] + _BESIDE).reshape(-1, 2), axis=0)
    around = tree.query_ball_point(wider, _AROUND_CELLS, p=np.inf, return_length=True)
    steady = wider[np.asarray(around) >= _LEAST_AROUND]
    nearest = tree.query(steady)[1]
    return [BlockCells(steady, top[nearest], low[nearest])]


def _on_planes(points_m: Floats) -> Bools:
    """Whether each point (n, 3) lies where one return of each cube and its neighbours are a plane.

    A plane that is no wall. All returns of a dense cloud would have neighbours so near that any
    surface, a crown's too, is plane among them.
    """
    _, first, cube = np.unique(
        np.floor(points_m / _CUBE_M), axis=0, return_index=True, return_inverse=True
    )
    thin_m = points_m[first]
    if len(thin_m) < _ON_PLANE:
        return np.zeros(len(points_m), bool)
    apart, rows = cKDTree(thin_m).query(thin_m, _ON_PLANE)
    about = thin_m[rows] - thin_m[rows].mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", about, about) / _ON_PLANE)
    smooth = spread[:, 0] < _ROUGH_M**2
    plane = smooth & (np.abs(axes[:, 2, 0]) > _UPRIGHT) & (apart[:, -1] < _REACH_M)
    return np.asarray(plane[cube.ravel()], np.bool_)
