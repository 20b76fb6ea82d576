"""Mounts that stand normal to the road instead of upright."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats

_RING_M = 3.0  # radius of the ring whose plane is the road's: a lane to either side of its middle
# How far before the mount the ring's middle is: the ring begins 1 m before the edge, beyond the
# ditch or bank at the mount's foot.
_AHEAD_M = 4.0
_RING_POINTS = 16  # heights around the ring, evenly: the best plane is then their first harmonic


def road_normals(
    xy_m: Floats, yaw_deg: Floats, ground_m: Callable[[Floats, Floats], Floats]
) -> Floats:
    """Unit normals (n, 3) of the road before mounts at places (n, 2), local frame.

    The gradient is that of the plane of best fit through a ring of 3 m about the place 4 m ahead,
    which for evenly spread points is twice their first harmonic over the radius: the road's grade
    and cross-fall, not the ditch or the bank behind the mount. Where the ring leaves the known
    ground the mount stands upright.

    Parameters
    ----------
    yaw_deg : (n,) direction in which the mounts face, counter-clockwise from local x.
    ground_m : heights of the ground at x and y, NaN where unknown.
    """
    yaw = np.radians(yaw_deg)
    ahead = _AHEAD_M * np.column_stack([np.cos(yaw), np.sin(yaw)])
    angle = 2 * np.pi * np.arange(_RING_POINTS) / _RING_POINTS
    spokes = np.column_stack([np.cos(angle), np.sin(angle)])
    ring = (np.asarray(xy_m, np.float64) + ahead)[:, None] + _RING_M * spokes
    height = ground_m(ring[..., 0].ravel(), ring[..., 1].ravel()).reshape(len(xy_m), -1)
    gradient = 2 * height @ spokes / (_RING_POINTS * _RING_M)
    gradient[~np.isfinite(gradient).all(axis=1)] = 0.0
    normal = np.column_stack([-gradient, np.ones(len(gradient))])
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def tilt_rotation(normal: ArrayLike) -> Floats:
    """Smallest rotation (3, 3) that takes the vertical to a unit normal (3,) that points up.

    Rodrigues' formula for the axis z x n: I + [v] + [v]^2 / (1 + cos).
    """
    nx, ny, nz = np.asarray(normal, np.float64)
    cross = np.array([[0.0, 0.0, nx], [0.0, 0.0, ny], [-nx, -ny, 0.0]])
    return np.eye(3) + cross + cross @ cross / (1 + nz)
