"""Existing poles of a user that may carry sensors, and zones that may not."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.records.sighting_tables import read_text_table
from roadsight.io.vector.point_tables import read_points
from roadsight.io.vector.vector_sources import load_local

_HEIGHT = "height_m"
_HIGHEST_M = 100.0
"""A mount that is said to be higher is taken for a mistake of unit or column."""


def read_mounts(path: str | os.PathLike[str], frame: Frame) -> pd.DataFrame:
    """Poles: name (unique), x, y (local metres), top_m (metres; NaN where height_m is not given).

    Parameters
    ----------
    path : CSV (lat, lon or native x, y) or any vector file; further id or name, height_m.

    Raises
    ------
    InputError : as `read_points`, or two share a name, or a height is impossible.
    """
    points = read_points(path, frame)
    names = points["id"].str.strip()
    if (repeated := names[names.duplicated()]).size:
        raise InputError("two poles share a name", where=str(path), found=repeated.iloc[0])
    is_table = Path(path).suffix.lower() == ".csv"
    source = read_text_table(path) if is_table else load_local(Path(path), frame)
    given = source[_HEIGHT] if _HEIGHT in source else pd.Series(np.nan, index=source.index)
    top = pd.to_numeric(given, errors="coerce").to_numpy(np.float64)
    blank = given.isna().to_numpy() | (given.astype(str).str.strip() == "").to_numpy()
    wrong = ~blank & ~((top > 0) & (top <= _HIGHEST_M))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            "has an impossible height",
            where=f"{path}: {names.iloc[row]}",
            found=given.iloc[row],
            allowed=f"above 0 and at most {_HIGHEST_M:g} m, or empty",
        )
    return pd.DataFrame({"name": names, "x": points["x"], "y": points["y"], "top_m": top})
