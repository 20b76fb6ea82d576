"""Heights of the road at places between the pixels of an overhead view."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Bools, Floats, Floats32, Ints

_BATCH = 1_000
"""Places worked on together: their windows of pixels stay in the processor's cache."""
_FAR_M = 0.3
"""Road pixels farther from the median around them, up or down, are of something else."""


def surface_heights(
    place: Floats, height_m: Floats32, road: Bools, radius_cells: int = 4
) -> Floats:
    """Height of the road surface at places (n, 2) in rows and columns, NaN without road near.

    A plane through the road pixels around, without those far from their median.
    """
    heights = np.empty(len(place))
    for start in range(0, len(place), _BATCH):
        part = place[start : start + _BATCH]
        heights[start : start + len(part)] = _planes(part, height_m, road, radius_cells)
    return heights


def _planes(place: Floats, height_m: Floats32, road: Bools, radius_cells: int) -> Floats:
    """Heights at places (n, 2) of planes through the road pixels around each."""
    offsets = np.arange(-radius_cells, radius_cells + 1)
    nearest = np.round(place)
    row, column = nearest.astype(np.int64).T[:, :, None] + offsets
    inside_row, inside_column = (
        np.clip(at, 0, size - 1) for at, size in zip((row, column), road.shape, strict=True)
    )
    window = inside_row[:, :, None] * road.shape[1] + inside_column[:, None, :]
    valid = road.take(window)
    valid &= (row == inside_row)[:, :, None] & (column == inside_column)[:, None, :]
    valid, z = valid.reshape(len(place), -1), height_m.take(window).reshape(len(place), -1)
    z = z.astype(np.float64)
    valid &= np.isfinite(z)
    middle = medians(z, valid)
    apart = np.where(valid, z - middle[:, None], 0.0)
    weight = (valid & (np.abs(apart) <= _FAR_M)).astype(np.float64)
    plane = _planes_through(weight, apart, offsets)
    return middle + plane[:, 0] + (plane[:, 1:] * (place - nearest)).sum(axis=1)


def _planes_through(weight: Floats, height: Floats, offsets: Ints) -> Floats:
    """Height in the middle and slopes down and right (n, 3) of planes through windows of pixels.

    Parameters
    ----------
    weight, height : (n, k * k) by pixel, row by row. offsets : (k,) of its rows and columns.
    """
    down, right = (grid.ravel() for grid in np.meshgrid(offsets, offsets, indexing="ij"))
    terms = np.stack([np.ones(len(down)), down, right], axis=1)
    products = (terms[:, :, None] * terms[:, None, :]).reshape(len(terms), 9)
    # As if the slope were known to be some 5 cm a cell, so that few or collinear pixels do. The
    # tiny weight on the height keeps a window without any road pixel solvable; its median is NaN.
    square = (weight @ products).reshape(-1, 3, 3) + np.diag([1e-9, 0.3, 0.3])
    plane = np.linalg.solve(square, ((weight * height) @ terms)[..., None])
    return np.asarray(plane[:, :, 0], np.float64)


def medians(values: Floats, valid: Bools) -> Floats:
    """Median (n,) of the valid among each row's values (n, k), NaN where none is."""
    rising = np.sort(np.where(valid, values, np.inf), axis=1)
    count = valid.sum(axis=1)
    pair = np.stack([np.maximum(count - 1, 0) // 2, count // 2], axis=1)
    pair = np.minimum(pair, values.shape[1] - 1)
    middle = np.take_along_axis(rising, pair, axis=1).mean(axis=1)
    return np.where(count > 0, middle, np.nan)
