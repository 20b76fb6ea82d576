"""Surfels as a table (x, y, z, nx, ny, nz, half_m in float32)."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pandas as pd

from roadsight.io.records.tables import read_table, write_table
from roadsight.scene.surfels import Surfels

_CENTRE = ["x", "y", "z"]
_NORMAL = ["nx", "ny", "nz"]


def write_surfels(
    path: str | os.PathLike[str], surfels: Surfels, about: dict[str, Any] | None = None
) -> None:
    """Write surfels with a description."""
    frame = pd.DataFrame(
        np.column_stack([surfels.centre_m, surfels.normal, surfels.half_m]),
        columns=[*_CENTRE, *_NORMAL, "half_m"],
    )
    write_table(path, frame, about)


def read_surfels(path: str | os.PathLike[str]) -> Surfels:
    """Read surfels.

    Raises
    ------
    InputError : the file is missing or damaged.
    """
    frame = read_table(path, [*_CENTRE, *_NORMAL, "half_m"])
    centre_m, normal = frame[_CENTRE].to_numpy(np.float32), frame[_NORMAL].to_numpy(np.float32)
    return Surfels(centre_m, normal, frame["half_m"].to_numpy(np.float32))
