"""Poses of sensors: how they are turned at a candidate, and which of the turns are worth keeping.

One convention for all kinds and for mounts that lean, normal to the road: a
sensor looks along its x axis, y points to its left, z up. From the candidate's facing direction (x
to the road's normal) it is turned by **yaw** to the left, then by **pitch** upwards, then by
**roll** with its right side up; pitch and roll are those of `roadsight.geometry.cameras`. A leaning
mount is turned with all of it last. So, from right to left,

    local_from_sensor = tilt  Rz(facing + yaw)  Ry(-pitch)  Rx(-roll)
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats, Ints

_NUMBER = r"[+-](?:\d+(?:\.\d+)?)"
_NAME = re.compile(rf"(.*)@y({_NUMBER})p({_NUMBER})r({_NUMBER})")


class Turn(NamedTuple):
    """Yaw to the left, pitch upwards, roll with the right side up, degrees."""

    yaw_deg: float
    pitch_deg: float
    roll_deg: float


AS_MOUNTED = Turn(0.0, 0.0, 0.0)  # no turn at all


def turns_of(
    yaw_deg: Sequence[float], pitch_deg: Sequence[float], roll_deg: Sequence[float]
) -> list[Turn]:
    """All combinations, without repeats, the least turned first: ties between poses go to it.

    Angles are rounded to a thousandth of a degree, as names of poses state them.
    """
    # Adding zero turns -0.0 into 0.0: the two are equal and would have different names.
    turns = {
        Turn(*(round(float(angle), 3) + 0.0 for angle in angles))
        for angles in product(yaw_deg, pitch_deg, roll_deg)
    }
    return sorted(turns, key=lambda turn: (sum(map(abs, turn)), turn))


def local_from_sensor(facing_deg: float, turn: Turn, tilt: Floats | None = None) -> Floats:
    """Rotation (3, 3) whose columns are the sensor's axes in the local frame.

    Parameters
    ----------
    facing_deg : direction in which the candidate faces, counter-clockwise from local x.
    tilt : rotation (3, 3) from the levelled to the leaning mount, local frame; None: levelled.
    """
    yaw, pitch, roll = np.radians([facing_deg + turn.yaw_deg, turn.pitch_deg, turn.roll_deg])
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    about_y = np.array(
        [[np.cos(pitch), 0, -np.sin(pitch)], [0, 1, 0], [np.sin(pitch), 0, np.cos(pitch)]]
    )
    about_x = np.array(
        [[1, 0, 0], [0, np.cos(roll), np.sin(roll)], [0, -np.sin(roll), np.cos(roll)]]
    )
    rotation = about_z @ about_y @ about_x
    return np.asarray(rotation if tilt is None else tilt @ rotation)


def pose_name(candidate: str, turn: Turn) -> str:
    """Name of a candidate in a pose."""
    yaw, pitch, roll = (f"{angle:+.3f}".rstrip("0").rstrip(".") for angle in turn)
    return f"{candidate}@y{yaw}p{pitch}r{roll}"


def split_pose(name: str) -> tuple[str, Turn]:
    """Candidate and turn of a name; a name without a pose is a candidate as mounted."""
    matched = _NAME.fullmatch(name)
    if matched is None:
        return name, AS_MOUNTED
    return matched[1], Turn(*(float(matched[number]) for number in (2, 3, 4)))


def not_dominated(seen: Bools) -> Ints:
    """Rows worth keeping of what the poses (m, n) at one position see of the targets.

    A pose is dropped when it sees nothing, the same as an earlier one, or part of what another
    sees. As poses at a position cost the same and exclude each other, no cover gets dearer by it.
    """
    bits = np.packbits(seen, axis=1)
    keep = np.asarray(seen.any(axis=1))
    for row in np.flatnonzero(keep):
        within = ~(bits[row] & ~bits).any(axis=1) & keep
        same = within & ~(bits & ~bits[row]).any(axis=1)
        better = within & ~same
        keep[row] = not (better.any() or same[:row].any())
    return np.flatnonzero(keep)


# Mounts that stand normal to the road instead of upright.

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
