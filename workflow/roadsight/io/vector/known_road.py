"""What a user knows of where a road is: places on it, and where a vehicle drove."""

from __future__ import annotations

import os

import numpy as np
import shapely

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.vector.vectors import read_lines


def read_seeds(text: str | None, frame: Frame, where: str) -> Floats | None:
    """Places on the road (k, 2), local metres, of ``x,y;x,y`` in the cloud's coordinates.

    None without any. ``where`` names what gave them.

    Raises
    ------
    InputError : one is no pair of numbers, or not finite; its number is told.
    """
    given = [place for place in (text or "").split(";") if place.strip()]
    pairs = []
    for number, place in enumerate(given, 1):
        try:
            x, y = (float(value) for value in place.split(","))
        except ValueError:
            x = y = np.nan
        if not np.isfinite([x, y]).all():
            raise InputError(
                f"seed {number} of {len(given)} is no place",
                where=where,
                found=place.strip(),
                allowed="x,y;x,y, finite numbers in the cloud's coordinates",
            )
        pairs.append((x, y))
    return frame.to_local(np.array(pairs)) if pairs else None


def read_track(
    path: str | os.PathLike[str] | None, frame: Frame, crs: str | None = None
) -> Floats | None:
    """Where a vehicle drove (k, 2), local metres: the longest line of a file; None without one.

    ``crs`` is that of a file that names none.

    Raises
    ------
    InputError : the file cannot be read, or holds no line.
    """
    if not path:
        return None
    lines = read_lines(path, frame, crs).geometry
    return shapely.get_coordinates(max(lines, key=lambda line: line.length))
