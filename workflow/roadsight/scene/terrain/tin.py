"""Triangulated terrain of ground and road points (paper 2, section 3.2.1, Fig. 4e)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, QhullError

from roadsight.base.arrays import Bools, Floats, Ints, Ints32
from roadsight.base.errors import InputError
from roadsight.geometry.cameras import wrap_deg
from roadsight.geometry.ray_casting import RayScene

# Tenths of a millimetre: whole numbers add up to the same in any order, unlike fractions.
_UNITS_PER_M = 10_000


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
    # Counter-clockwise from their least vertex, in rising order.
    triangles, plan = number[triangles], plan[used]
    a, b, c = (plan[triangles[:, k]] for k in range(3))
    turn = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles = np.where(turn[:, None] < 0, triangles[:, ::-1], triangles)
    start = triangles.argmin(axis=1)
    rows = np.arange(len(triangles))[:, None]
    triangles = triangles[rows, (start[:, None] + np.arange(3)) % 3]
    triangles = triangles[np.lexsort(triangles.T[::-1])].astype(np.int32)
    return Terrain(points_m[used], triangles)


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


# What the terrain hides from a camera, by ray casting (paper 2, section 3.2.4).

# Share of the way to a point at which its ray ends, lest rounding make it meet the point's own
# triangle.
_LAST_SHARE = 0.9999
# Sight lines end this much above the points: they would else meet the ground that these lie on.
TOLERANCE_M = 0.15


class TerrainSight:
    """Terrain that rays can be cast at; the same result every time.

    Parameters
    ----------
    terrain : in the local frame. Without any triangle nothing is hidden.
    """

    def __init__(self, terrain: Terrain) -> None:
        self._scene, self._origin_m = None, np.zeros(3)
        if len(terrain.triangles):
            # Single precision is safe only near the origin.
            self._origin_m = np.round(terrain.vertices.mean(axis=0))
            vertices = terrain.vertices - self._origin_m
            self._scene = RayScene(vertices, terrain.triangles, robust=True)

    def visible(
        self, camera_m: ArrayLike, points_m: ArrayLike, tolerance_m: float = TOLERANCE_M
    ) -> Bools:
        """Whether the straight way from a camera to points is free of terrain.

        The rays end ``tolerance_m`` above the points and a hair before: at a grazing angle a point
        a few centimetres below the triangles would else be hidden by the very ground it lies on.

        Parameters
        ----------
        camera_m : (3,) local metres. points_m : (n, 3) local metres; NaN is never visible.
        """
        points = np.asarray(points_m, np.float64).reshape(-1, 3)
        finite = np.asarray(np.isfinite(points).all(axis=1))
        if self._scene is None or not finite.any():
            return finite
        start = np.asarray(camera_m, np.float64)
        way = points[finite] - (start - np.array([0.0, 0.0, tolerance_m]))
        # An unnormalised ray ends at 1, wherever the point is.
        seen = finite.copy()
        seen[finite] = ~self._scene.occluded(start - self._origin_m, way, _LAST_SHARE)
        return seen


def visible(
    terrain: Terrain | TerrainSight,
    camera_m: ArrayLike,
    points_m: ArrayLike,
    tolerance_m: float = TOLERANCE_M,
) -> Bools:
    """Whether points (n, 3) are seen from a camera (3,); see `TerrainSight.visible`.

    Give a `TerrainSight` where many cameras look at one terrain.
    """
    sight = terrain if isinstance(terrain, TerrainSight) else TerrainSight(terrain)
    return sight.visible(camera_m, points_m, tolerance_m)


# How much of the road ahead the terrain hides, estimated from a height model along sight lines.
#
# Cheap enough to decide whether the triangulated terrain is worth building, at which
# `TerrainSight` casts exact rays.

# Function of x and y (n,), local metres, that gives heights (n,), NaN where unknown.
Height = Callable[[Floats, Floats], Floats]
_HALF_ANGLE_DEG = 45.0  # Road edges this far to either side of the heading are ahead of a camera.
_STEP_M = 2.0  # Steps along the longest sight line; crests that hide a road are longer.
_POINTS = 120  # Edge points looked at from each camera, about: a share needs no more.


def hidden_by_heights(height: Height, eye_m: ArrayLike, points_m: ArrayLike) -> Bools:
    """Whether the ground rises above the straight way from an eye to points.

    Parameters
    ----------
    eye_m : (3,) local metres. points_m : (n, 3); the way ends the same little above them as rays
        at the terrain do. Unknown ground hides nothing.
    """
    points = np.asarray(points_m, np.float64).reshape(-1, 3) + np.array([0.0, 0.0, TOLERANCE_M])
    eye = np.asarray(eye_m, np.float64)
    way = points - eye
    longest_m = float(np.hypot(way[:, 0], way[:, 1]).max(initial=0.0))
    steps = max(int(np.ceil(longest_m / _STEP_M)), 1)
    share = np.arange(1, steps) / steps
    places = eye + share[:, None, None] * way
    ground = height(places[..., 0].ravel(), places[..., 1].ravel()).reshape(places.shape[:2])
    with np.errstate(invalid="ignore"):
        return np.asarray((ground > places[..., 2]).any(axis=0))


def hidden_road_share(
    height: Height, eyes_m: ArrayLike, heading_deg: ArrayLike, edges_m: ArrayLike, reach_m: float
) -> float:
    """Share of the road edge points ahead of cameras that the ground hides.

    Parameters
    ----------
    eyes_m : (k, 3) local metres. heading_deg : (k,) clockwise from grid north.
    edges_m : (n, 3) road edge points. reach_m : farther ones do not count.

    Returns
    -------
    share between 0 and 1; NaN where no camera has a road edge ahead
    """
    edges = np.asarray(edges_m, np.float64).reshape(-1, 3)
    hidden = total = 0
    for eye, heading in zip(np.asarray(eyes_m, float), np.asarray(heading_deg), strict=True):
        east, north = (edges[:, :2] - eye[:2]).T
        turn = wrap_deg(np.degrees(np.arctan2(east, north)) - heading)
        away_m = np.hypot(east, north)
        ahead = np.flatnonzero((away_m <= reach_m) & (away_m > 0) & (abs(turn) <= _HALF_ANGLE_DEG))
        ahead = ahead[:: max(len(ahead) // _POINTS, 1)]  # evenly, up to twice as many
        hidden += int(hidden_by_heights(height, eye, edges[ahead]).sum())
        total += len(ahead)
    return hidden / total if total else float("nan")
