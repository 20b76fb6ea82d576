"""Where candidate sensors stand and face."""

from __future__ import annotations

import os
from collections.abc import Iterable

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.io.records.tables import read_table
from roadsight.placement.candidates.tilt import tilt_rotation

_POSE = ["x", "y", "z", "yaw_deg"]
_NORMAL = ["normal_x", "normal_y", "normal_z"]


FOR_SENSORS = "for_sensors"
"""Column of denser candidates: names of the sensors whose gaps they are for, blanks between."""


def read_poses(path: str | os.PathLike[str], sensor: str | None = None) -> dict[str, Floats]:
    """Pose (4,) of each candidate in the table's order: x, y, z in local metres and yaw in degrees.

    Parameters
    ----------
    sensor : only candidates that are for this sensor; None: all.

    Raises
    ------
    InputError : the table cannot be read, a pose is not finite, or two candidates share a name.
    """
    frame = read_table(path)
    if sensor is not None and FOR_SENSORS in frame:
        meant = [sensor in str(names).split() for names in frame[FOR_SENSORS]]
        frame = frame[np.array(meant, bool)]
    if missing := {"candidate", *_POSE} - set(frame):
        frame = read_table(path, sorted(missing))  # says what it lacks
    poses = frame[_POSE].to_numpy(np.float64)
    if not np.isfinite(poses).all():
        raise InputError("a candidate's pose is not finite", where=str(path))
    twice = frame["candidate"][frame["candidate"].duplicated()]
    if len(twice):
        raise InputError("two candidates share a name", where=str(path), found=repr(twice.iloc[0]))
    return dict(zip(frame["candidate"].astype(str), poses, strict=True))


def read_tilts(paths: Iterable[str | os.PathLike[str]]) -> dict[str, Floats]:
    """Rotation (3, 3) from the levelled to the mounted sensor of each candidate that is tilted.

    Without any file every mount is levelled, and the result empty.

    Raises
    ------
    InputError : a table cannot be read.
    """
    tilts: dict[str, Floats] = {}
    for path in paths:
        frame = read_table(path, ["candidate", *_NORMAL])
        normals = frame[_NORMAL].to_numpy(np.float64)
        tilts |= dict(zip(frame["candidate"].astype(str), map(tilt_rotation, normals), strict=True))
    return tilts
