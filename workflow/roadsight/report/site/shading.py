"""A terrain model as shaded relief."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from roadsight.base.arrays import Bools, Bytes, Floats

_SUN_AZIMUTH_DEG = 315.0
"""Light from the north-west, as maps have it: from the south, hills would look like hollows."""
_SUN_ALTITUDE_DEG = 45.0
"""Height of the light above the horizon."""
_EXAGGERATION = 2.0
"""Slopes are drawn this much steeper: roadsides are too flat to show otherwise."""
_NEAR_M = 2.0
"""Filled cells within this of measured ones are shown: gaps between scan lines."""
NO_DATA = 0
"""Byte of cells without a height; shades go from 1 to 255."""


def block_mean(heights_m: NDArray, cell_size_m: float, most_cells: int) -> tuple[Floats, float]:
    """Coarser raster with at most ``most_cells`` along its longer side.

    Parameters
    ----------
    heights_m : (rows, columns), NaN = no data.

    Returns
    -------
    means of blocks (NaN where a block is empty) and their cell size
    """
    rows, columns = heights_m.shape
    factor = -(-max(rows, columns) // most_cells)
    padding = ((0, -rows % factor), (0, -columns % factor))
    padded = np.pad(heights_m.astype(np.float64), padding, constant_values=np.nan)
    blocks = padded.reshape(padded.shape[0] // factor, factor, -1, factor)
    known = np.isfinite(blocks)
    count = known.sum(axis=(1, 3))
    total = np.where(known, blocks, 0.0).sum(axis=(1, 3))
    means = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return means, cell_size_m * factor


def near_measured(heights_m: NDArray, measured: Bools | None, cell_size_m: float) -> NDArray:
    """Heights that are measured or within 2 m of measured ones; NaN elsewhere.

    Wide gaps are filled by long triangles, which say nothing of the ground and look like ridges.

    Parameters
    ----------
    heights_m, measured : (rows, columns); None where a raster does not tell: all stay.
    """
    if measured is None or not measured.any():
        return heights_m
    away_m = distance_transform_edt(~measured, sampling=cell_size_m)
    return np.where(away_m <= _NEAR_M, heights_m, np.nan)


def hillshade(heights_m: NDArray, cell_size_m: float) -> Bytes:
    """Brightness of a surface lit from the north-west, 45 degrees high (Lambert's law).

    Slopes are doubled, because roads are flat. Beside cells without data the slope counts as zero.

    Parameters
    ----------
    heights_m : (rows, columns), first row north, NaN = no data.

    Returns
    -------
    (rows, columns), 1 = dark to 255 = bright, 0 = no data
    """
    known = np.isfinite(heights_m)
    east = _EXAGGERATION * _slope(heights_m, cell_size_m, axis=1)
    north = -_EXAGGERATION * _slope(heights_m, cell_size_m, axis=0)
    azimuth, altitude = np.radians([_SUN_AZIMUTH_DEG, _SUN_ALTITUDE_DEG])
    sun_east, sun_north = np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude)
    facing = np.sin(altitude) - sun_east * east - sun_north * north
    light = np.clip(facing / np.sqrt(1 + east**2 + north**2), 0, 1)
    return np.where(known, 1 + np.rint(254 * light), NO_DATA).astype(np.uint8)


def _slope(heights_m: NDArray, cell_size_m: float, axis: int) -> Floats:
    """Central differences along an axis; 0 where a neighbour is missing."""
    if heights_m.shape[axis] < 3:
        return np.zeros(heights_m.shape)
    slope = np.gradient(heights_m.astype(np.float64), cell_size_m, axis=axis)
    return np.where(np.isfinite(slope), slope, 0.0)
