"""Triangulated terrain of ground and road points (paper 2, section 3.2.1, Fig. 4e)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, QhullError

from roadsight.base.arrays import Bools, Floats, Ints, Ints32
from roadsight.base.errors import InputError

_UNITS_PER_M = 10_000
"""Tenths of a millimetre: whole numbers add up to the same in any order, unlike fractions."""


@dataclass(frozen=True)
class Terrain:
    """Triangles of the terrain.

    Parameters
    ----------
    vertices : (n, 3) float64 local metres. triangles : (m, 3) int32 rows of ``vertices``.
    """

    vertices: Floats
    triangles: Ints32


@dataclass(frozen=True)
class CellSums:
    """Terrain points summed up by cell, in tenths of a millimetre, so that order does not matter.

    Parameters
    ----------
    cell : (n,) key of the cell, twice its number, one more for its road points; rising.
    sums : (n, 4) sums of x, y, z and number of points.
    """

    cell: Ints
    sums: Ints


def sum_cells(xyz_m: NDArray[np.floating], is_road: Bools, cell_m: float) -> CellSums:
    """Sum up points (n, 3), local metres, in square cells on multiples of ``cell_m``."""
    column, row = np.floor(np.asarray(xyz_m[:, :2], np.float64) / cell_m).astype(np.int64).T
    # Unique while columns stay within 2^29 of the origin, whatever their sign.
    key = (((row << 30) + column) << 1) + is_road
    units = np.round(np.asarray(xyz_m, np.float64) * _UNITS_PER_M).astype(np.int64)
    return _summed(key, np.column_stack([units, np.ones(len(units), np.int64)]))


def add_cells(parts: Sequence[CellSums]) -> CellSums:
    """Sum of several sums, in any order."""
    return _summed(
        *(np.concatenate([getattr(p, name) for p in parts]) for name in ("cell", "sums"))
    )


def cell_means(cells: CellSums) -> Floats:
    """Mean point (n, 3) of each cell, local metres: of its road points where it has any.

    A bridge deck is the surface that hides and carries, whatever ground lies below.
    """
    place = cells.cell >> 1
    # Road points have the greater key of their cell: where there are any, they come last.
    last = np.append(np.diff(place) != 0, True)[: len(place)]
    return cells.sums[last, :3] / cells.sums[last, 3:] / _UNITS_PER_M


def triangulate(points_m: Floats, longest_m: float) -> Terrain:
    """Delaunay triangles of points in plan, without long ones at the outside of the hull.

    Coordinates are taken from the middle of the points: at the size of map coordinates the
    triangulation silently loses most of them.

    Parameters
    ----------
    points_m : (n, 3) local metres, distinct in plan.
    longest_m : triangles with a longer side are dropped where a chain of such reaches the hull;
        those inside (water, a building) stay.

    Raises
    ------
    InputError : fewer than three points, or all on one line.
    """
    plan = points_m[:, :2] - points_m[:, :2].mean(axis=0) if len(points_m) else points_m[:, :2]
    try:
        mesh = Delaunay(plan)
    except (QhullError, ValueError) as error:
        raise InputError(
            "the ground and road points span no surface",
            where="terrain",
            found=f"{len(points_m)} cells with points",
            allowed="three or more that are not on one line",
            hint="lower terrain_cell_m, or check the cloud's ground",
        ) from error
    keep = ~_outside(mesh, plan, longest_m)
    triangles = mesh.simplices[keep]
    used = np.unique(triangles)
    number = np.full(len(points_m), -1, np.int32)
    number[used] = np.arange(len(used), dtype=np.int32)
    return Terrain(points_m[used], _ordered(number[triangles], plan[used]))


def _summed(key: Ints, sums: Ints) -> CellSums:
    order = np.argsort(key, kind="stable")
    key = key[order]
    first = np.flatnonzero(np.append(True, np.diff(key) != 0)[: len(key)])
    if not len(first):
        return CellSums(key, sums)
    return CellSums(key[first], np.add.reduceat(sums[order], first, axis=0))


def _outside(mesh: Delaunay, plan: Floats, longest_m: float) -> Bools:
    """Long triangles that other long triangles join to the hull."""
    corners = plan[mesh.simplices]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    long = sides.max(axis=1) > longest_m
    count = len(long)
    row = np.repeat(np.arange(count), 3)
    beside = mesh.neighbors.ravel()
    joined = (beside >= 0) & long[row] & long[beside]
    graph = coo_matrix((np.ones(joined.sum()), (row[joined], beside[joined])), (count, count))
    _, label = connected_components(graph, directed=False)
    at_hull = long & (mesh.neighbors < 0).any(axis=1)
    return long & np.isin(label, label[at_hull])


def _ordered(triangles: Ints32, plan: Floats) -> Ints32:
    """Triangles counter-clockwise from their least vertex, in rising order."""
    a, b, c = (plan[triangles[:, k]] for k in range(3))
    turn = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles = np.where(turn[:, None] < 0, triangles[:, ::-1], triangles)
    start = triangles.argmin(axis=1)
    rows = np.arange(len(triangles))[:, None]
    triangles = triangles[rows, (start[:, None] + np.arange(3)) % 3]
    return triangles[np.lexsort(triangles.T[::-1])].astype(np.int32)
