"""First hits of rays on flat faces: Intel Embree by its own interface, or through Open3D."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from roadsight.base.arrays import Floats32, Ints32
from roadsight.base.engines import OWN, Engine, open3d
from roadsight.geometry.ray_casting import RayScene


class Rays(Protocol):
    """Faces that rays can be cast at."""

    def first_hits(self, origins_m: Floats32, directions: Floats32, limit_m: float) -> Floats32:
        """Ranges (n,) of the first faces; ``limit_m`` or more where there is none before it.

        Parameters
        ----------
        origins_m : (n, 3), or (3,) for rays from one point, in the faces' frame.
        directions : (n, 3) unit vectors.
        """


def rays_at(corners_m: Floats32, faces: Ints32, engine: Engine = OWN) -> Rays:
    """Flat faces made ready for rays, on one thread.

    Parameters
    ----------
    corners_m : (n, 3), near the origin: Embree works in single precision.
    faces : (m, 4) rows of corners, in turn.

    Raises
    ------
    InputError : the engine open3d cannot be loaded.
    """
    kind = EmbreeRays if engine == "own" else Open3dRays
    return kind(corners_m, faces)


class EmbreeRays:
    """By `RayScene`."""

    def __init__(self, corners_m: Floats32, faces: Ints32) -> None:
        self._scene = RayScene(corners_m, faces)

    def first_hits(self, origins_m: Floats32, directions: Floats32, limit_m: float) -> Floats32:
        """See `Rays`."""
        return self._scene.first_hits(origins_m, directions, limit_m).range_m


class Open3dRays:
    """By Open3D's RaycastingScene, which keeps its own copy of the triangles."""

    def __init__(self, corners_m: Floats32, faces: Ints32) -> None:
        o3d = open3d("lidar.engine")
        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        triangles = faces[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
        self._scene.add_triangles(
            self._tensor.from_numpy(np.ascontiguousarray(corners_m, np.float32)),
            self._tensor.from_numpy(np.ascontiguousarray(triangles, np.uint32)),
        )

    def first_hits(self, origins_m: Floats32, directions: Floats32, limit_m: float) -> Floats32:
        """See `Rays`; ranges beyond the limit are cast too and dropped by the caller."""
        origins = np.broadcast_to(origins_m, directions.shape)
        rays = self._tensor.from_numpy(np.hstack([origins, directions]))
        hits = self._scene.cast_rays(rays, nthreads=1)
        return np.asarray(hits["t_hit"].numpy(), np.float32)
