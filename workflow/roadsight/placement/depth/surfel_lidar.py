"""Depth maps by casting one ray per beam at surfels with Embree.

A surfel stops every beam that meets it. That is right for surfaces, and wrong for what beams pass
in part: twigs, meshes, layers that registration has spread. Where a cloud was scanned from about
the place of the sensor, its samples tell the share of beams that passed, and vote (`View`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats, Floats32, Ints32
from roadsight.base.engines import OWN, Engine, open3d
from roadsight.base.sections.sensing import Lidar
from roadsight.geometry.ray_casting import RayScene
from roadsight.placement.depth.votes import View, VoteSettings, seen_from_here
from roadsight.placement.sensors.light import rise_m
from roadsight.placement.sensors.rays import NOT_CAST_M, beam_directions
from roadsight.placement.sensors.sensors import Sensor
from roadsight.scene.samples import Samples, build_samples
from roadsight.scene.surfels import Surfels, build_surfels
from roadsight.scene.voxel_planes import coarsen, sum_moments

# Corners of a rectangle about its middle, in half edges, in turn.
_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
# Edge of the finest voxels: finer ones gain nothing on a cloud of 3.7 million points a 250 m
# (docs/decisions/011-surfels.md).
SURFEL_M = Lidar().surfel_size_m
_FARTHEST_M = 1e6  # limit of rays without any: rays need a finite one, and no site is so large


class SurfelLidar:
    """Surfels that rays can be cast at; single-threaded, the same result every time.

    Parameters
    ----------
    surfels : in the local frame. Without any surfel nothing ever returns.
    samples : of the same cloud; they correct the first surfels where they can tell. None: surfels
        alone.
    votes : how samples vote.
    engine : who casts the rays.

    Raises
    ------
    InputError : the engine open3d cannot be loaded.
    """

    def __init__(
        self,
        surfels: Surfels,
        samples: Samples | None = None,
        votes: VoteSettings | None = None,
        engine: Engine = OWN,
    ) -> None:
        self._samples = samples
        self._votes = votes or VoteSettings()
        self._origin_m = np.zeros(3)
        self._scene: EmbreeRays | Open3dRays | None = None
        if len(surfels):
            # Embree works in single precision, which is good for millimetres near its origin only.
            self._origin_m = np.round(surfels.centre_m.mean(axis=0, dtype=np.float64))
            corners_m = _corners(surfels, self._origin_m)
            faces = np.arange(4 * len(surfels), dtype=np.int32).reshape(-1, 4)
            kind = EmbreeRays if engine == OWN else Open3dRays
            self._scene = kind(corners_m.reshape(-1, 3), faces)

    def cast(
        self, origins_m: ArrayLike, directions: ArrayLike, max_range_m: float = np.inf
    ) -> Floats32:
        """Ranges (n,) at which rays return, infinite where nothing stops them.

        Parameters
        ----------
        origins_m : (n, 3), or (3,) for rays from one point, local metres.
        directions : (n, 3) unit vectors, local frame.
        max_range_m : surfels at this range or farther do not count.
        """
        directions = np.ascontiguousarray(directions, np.float32).reshape(-1, 3)
        limit_m = min(max_range_m, _FARTHEST_M)
        if self._scene is None or len(directions) == 0:
            return np.full(len(directions), np.inf, np.float32)
        origins = (np.asarray(origins_m, np.float64) - self._origin_m).astype(np.float32)
        range_m = self._scene.first_hits(origins, directions, limit_m)
        range_m[range_m >= np.float32(limit_m)] = np.inf
        if self._samples is None:
            return range_m
        places, member = np.unique(
            np.asarray(origins_m, np.float64).reshape(-1, 3), axis=0, return_inverse=True
        )
        for number, place_m in enumerate(places):
            if not seen_from_here(self._samples, place_m, limit_m, self._votes):
                continue
            view = View(self._samples, place_m, limit_m, self._votes)
            rays = slice(None) if len(places) == 1 else np.flatnonzero(member.ravel() == number)
            range_m[rays] = view.ranges(directions[rays], range_m[rays])
        range_m[range_m >= limit_m] = np.inf
        return range_m

    def depth_map(
        self,
        sensor: Sensor,
        position_m: ArrayLike,
        yaw_deg: float,
        tilt: Floats | None = None,
        curved: bool = False,
        wanted: Bools | None = None,
    ) -> Floats32:
        """Range of every beam's first return, metres, 0 for none; shape (rows, columns).

        Parameters
        ----------
        position_m : (3,) local metres. yaw_deg : sensor x from local x, counter-clockwise.
        tilt : as `beam_directions` takes it. curved : beams rise above the level (`rise_m`).
        wanted : (rows, columns), beams to cast; the others are `NOT_CAST_M`. None: all.
        """
        if wanted is None:
            wanted = np.ones(sensor.shape, bool)
        directions = beam_directions(sensor, yaw_deg, tilt, wanted)
        range_m = self.cast(position_m, directions, sensor.range_m)
        if curved:
            range_m = self.cast(position_m, risen(directions, range_m), sensor.range_m)
        range_m[np.isinf(range_m)] = 0.0
        depth_m = np.full(sensor.shape, NOT_CAST_M, np.float32)
        depth_m[wanted] = range_m
        return depth_m


def lidar_of_points(
    xyz_m: Floats, surfel_size_m: float = SURFEL_M, engine: Engine = OWN
) -> SurfelLidar:
    """Surfels of a cloud that is in memory, and samples that vote where it was scanned from here.

    Parameters
    ----------
    xyz_m : (n, 3) local metres. surfel_size_m : edge of the finest voxels; samples have half of it.
    engine : who casts the rays.
    """
    fine = sum_moments(xyz_m, surfel_size_m / 2)
    return SurfelLidar(build_surfels(coarsen(fine)), build_samples(fine), engine=engine)


def risen(directions: Floats32, range_m: Floats32) -> Floats32:
    """Straight lines (n, 3) to where curved beams are at a range.

    A beam climbs by `rise_m`, so little that the range to which it is straightened hardly matters.

    Parameters
    ----------
    directions : (n, 3) unit vectors at the sensor. range_m : (n,), infinite for no return.
    """
    known = np.where(np.isinf(range_m), 0.0, range_m).astype(np.float64)
    at = directions * known[:, None]
    at[:, 2] += rise_m(np.hypot(at[:, 0], at[:, 1]))
    length = np.linalg.norm(at, axis=1, keepdims=True)
    straight = np.divide(at, length, out=directions.astype(np.float64), where=length > 0)
    return straight.astype(np.float32)


def _corners(surfels: Surfels, origin_m: Floats) -> Floats32:
    """Corners (n, 4, 3) of each surfel: its plane over its rectangle."""
    n = len(surfels)
    rows, axis = np.arange(n), np.abs(surfels.normal).argmax(axis=1)
    u, v = (axis + 1) % 3, (axis + 2) % 3
    across = surfels.normal[rows, axis]
    slope_u, slope_v = -surfels.normal[rows, u] / across, -surfels.normal[rows, v] / across
    corners = np.empty((n, 4, 3), np.float32)
    centre, (half_u, half_v) = surfels.centre_m - origin_m, surfels.half_m.T
    for number, (du, dv) in enumerate(_CORNERS):
        corners[:, number] = centre
        corners[rows, number, u] += du * half_u
        corners[rows, number, v] += dv * half_v
        corners[rows, number, axis] += du * slope_u * half_u + dv * slope_v * half_v
    return corners


class EmbreeRays:
    """First hits of rays on flat faces, on one thread.

    Parameters
    ----------
    corners_m : (n, 3), near the origin: Embree works in single precision.
    faces : (m, 4) rows of corners, in turn.
    """

    def __init__(self, corners_m: Floats32, faces: Ints32) -> None:
        self._scene = RayScene(corners_m, faces)

    def first_hits(self, origins_m: Floats32, directions: Floats32, limit_m: float) -> Floats32:
        """Ranges (n,) of the first faces; ``limit_m`` or more where there is none before it.

        Parameters
        ----------
        origins_m : (n, 3), or (3,) for rays from one point, in the faces' frame.
        directions : (n, 3) unit vectors.
        """
        return self._scene.first_hits(origins_m, directions, limit_m).range_m


class Open3dRays:
    """The same by Open3D's RaycastingScene, which keeps its own copy of the triangles."""

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
        """As of `EmbreeRays`; ranges beyond the limit are cast too and dropped by the caller."""
        origins = np.broadcast_to(origins_m, directions.shape)
        rays = self._tensor.from_numpy(np.hstack([origins, directions]))
        hits = self._scene.cast_rays(rays, nthreads=1)
        return np.asarray(hits["t_hit"].numpy(), np.float32)
