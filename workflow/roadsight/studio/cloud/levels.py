"""Levels of detail of a cloud's tiles: each adds points between those of the coarser ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Bytes, Floats, Floats32

CELLS_M = (1.6, 0.8, 0.4, 0.2, 0.1)
"""Edges of the cells of each level; the last level has all other points."""
LEVELS = len(CELLS_M) + 1
RECORD = np.dtype(
    [
        ("xyz", "<u2", 3),
        ("height_cm", "<i2"),
        ("intensity", "u1"),
        ("cls", "u1"),
        ("ground", "u1"),
        ("free", "u1"),
    ]
)
"""A point as the browser gets it: position by its tile's box, height above ground."""
_STEPS = 65535
"""Steps of a coordinate within a tile's box: what 16 bits hold."""
_HIGHEST_CM = 32767
"""Heights above ground are centimetres in 16 bits with a sign."""


def level_of_points(xyz_m: Floats32) -> Bytes:
    """Level (n,) at which each point first appears.

    A level takes the first point, in the order given, of each cubic cell in which no coarser level
    has taken one for itself.

    Parameters
    ----------
    xyz_m : (n, 3), all coordinates within a few kilometres.
    """
    level = np.full(len(xyz_m), LEVELS - 1, np.uint8)
    rest = np.arange(len(xyz_m))
    for number, cell_m in enumerate(CELLS_M):
        if not len(rest):
            break
        cell = np.floor(xyz_m[rest] / cell_m).astype(np.int64)
        cell -= cell.min(axis=0)
        rows, columns, _ = (cell.max(axis=0) + 1).tolist()
        key = cell[:, 0] + rows * (cell[:, 1] + columns * cell[:, 2])
        first = np.unique(key, return_index=True)[1]
        level[rest[first]] = number
        rest = np.delete(rest, first)
    return level


def pack_points(
    xyz_m: Floats32,
    low_m: Floats,
    high_m: Floats,
    height_m: Floats,
    intensity: Bytes,
    classes: Bytes,
    ground: Bools,
) -> NDArray[np.void]:
    """Points (n,) of `RECORD`.

    Parameters
    ----------
    low_m, high_m : (3,) corners of the tile's box; positions are steps of 1/65535 of it.
    height_m : (n,) above ground; NaN counts as 0.
    """
    extent = np.maximum(high_m - low_m, 1e-6)
    packed = np.zeros(len(xyz_m), RECORD)
    share = np.clip((xyz_m.astype(np.float64) - low_m) / extent, 0.0, 1.0)
    packed["xyz"] = np.rint(share * _STEPS)
    highest_m = _HIGHEST_CM / 100.0
    height = np.clip(np.nan_to_num(height_m), -highest_m, highest_m)
    packed["height_cm"] = np.rint(100.0 * height)
    packed["intensity"], packed["cls"], packed["ground"] = intensity, classes, ground
    return packed


def scaled_intensity(intensity: NDArray[np.uint16], brightest: float) -> Bytes:
    """Intensity (n,) as bytes, so that a cloud's bright points are 255.

    Parameters
    ----------
    brightest : value that becomes 255; larger ones, too.
    """
    scaled = intensity.astype(np.float64) * (255.0 / max(brightest, 1.0))
    return np.rint(np.minimum(scaled, 255.0)).astype(np.uint8)
