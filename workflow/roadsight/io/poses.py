"""Where candidate sensors stand and face."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from roadsight.errors import InputError
from roadsight.io.tables import read_table

_POSE = ["x", "y", "z", "yaw_deg"]


def read_poses(path: str | os.PathLike[str]) -> dict[str, NDArray[np.float64]]:
    """Pose (4,) of each candidate in the table's order: x, y, z in local metres and yaw in degrees.

    Raises
    ------
    InputError : the table cannot be read, a pose is not finite, or two candidates share a name.
    """
    frame = read_table(path, ["candidate", *_POSE])
    poses = frame[_POSE].to_numpy(np.float64)
    if not np.isfinite(poses).all():
        raise InputError("a candidate's pose is not finite", where=str(path))
    twice = frame["candidate"][frame["candidate"].duplicated()]
    if len(twice):
        raise InputError("two candidates share a name", where=str(path), found=repr(twice.iloc[0]))
    return dict(zip(frame["candidate"].astype(str), poses, strict=True))
