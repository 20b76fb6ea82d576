"""What the terrain hides from a camera, by ray casting (paper 2, section 3.2.4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools
from roadsight.geometry.cameras import wrap_deg
from roadsight.geometry.ray_casting import RayScene
from roadsight.scene.terrain.sight_lines import TOLERANCE_M
from roadsight.scene.terrain.tin import Terrain

_LAST_SHARE = 0.9999
"""Share of the way to a point at which its ray ends, lest rounding make it meet the point's own
triangle."""


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


def hidden_share(
    sight: TerrainSight,
    cameras_m: ArrayLike,
    heading_deg: ArrayLike,
    edges_m: ArrayLike,
    reach_m: float = 120.0,
    half_angle_deg: float = 45.0,
) -> float:
    """Share of the road edge points ahead of the cameras that the terrain hides.

    Parameters
    ----------
    cameras_m : (k, 3) local metres. heading_deg : (k,) clockwise from grid north.
    edges_m : (n, 3) road edge points. reach_m : farther ones do not count.
    half_angle_deg : only points within this of the heading count.

    Returns
    -------
    share between 0 and 1; 0 where no camera has a road edge ahead.
    """
    edges = np.asarray(edges_m, np.float64).reshape(-1, 3)
    hidden = total = 0
    for camera, heading in zip(np.asarray(cameras_m), np.asarray(heading_deg), strict=True):
        east, north = (edges[:, :2] - camera[:2]).T
        turn = wrap_deg(np.degrees(np.arctan2(east, north)) - heading)
        gap_m = np.hypot(east, north)
        ahead = (gap_m <= reach_m) & (gap_m > 0) & (np.abs(turn) <= half_angle_deg)
        seen = sight.visible(camera, edges[ahead])
        hidden, total = hidden + int((~seen).sum()), total + len(seen)
    return hidden / total if total else 0.0
