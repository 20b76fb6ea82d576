"""Heights of the road at places between the pixels of an overhead view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_FLOATS = NDArray[np.float64]
_MASK = NDArray[np.bool_]
_BATCH = 1_000


def surface_heights(
    place: _FLOATS, height_m: NDArray[np.float32], road: _MASK, radius_cells: int = 4
) -> _FLOATS:
    """Height of the road surface at places (n, 2) in rows and columns, NaN without road near.

    A plane through the road pixels around, without those far from their median.
    """
    step = np.arange(-radius_cells, radius_cells + 1)
    rows, columns = (grid.ravel() for grid in np.meshgrid(step, step, indexing="ij"))
    heights = np.empty(len(place))
    for start in range(0, len(place), _BATCH):
        part = place[start : start + _BATCH]
        heights[start : start + len(part)] = _planes(part, rows, columns, height_m, road)
    return heights


def _planes(
    place: _FLOATS, rows: NDArray, columns: NDArray, height_m: NDArray, road: _MASK
) -> _FLOATS:
    """Heights at places of planes through the road pixels at offsets ``rows``, ``columns``."""
    row = np.round(place[:, :1]).astype(int) + rows
    column = np.round(place[:, 1:]).astype(int) + columns
    valid = (row >= 0) & (row < road.shape[0]) & (column >= 0) & (column < road.shape[1])
    row, column = np.where(valid, row, 0), np.where(valid, column, 0)
    z = height_m[row, column].astype(np.float64)
    valid &= road[row, column] & np.isfinite(z)
    middle = medians(z, valid)
    apart = np.where(valid, z - middle[:, None], 0.0)
    weight = (valid & (np.abs(apart) <= 0.3)).astype(np.float64)
    terms = np.stack([np.ones(row.shape), row - place[:, :1], column - place[:, 1:]], axis=-1)
    weighted = (weight[..., None] * terms).transpose(0, 2, 1)
    # As if the slope were known to be some 5 cm a cell, so that few or collinear pixels do.
    square = weighted @ terms + np.diag([1e-9, 0.3, 0.3])
    return middle + np.linalg.solve(square, weighted @ apart[..., None])[:, 0, 0]


def medians(values: _FLOATS, valid: _MASK) -> _FLOATS:
    """Median (n,) of the valid among each row's values (n, k), NaN where none is."""
    rising = np.sort(np.where(valid, values, np.inf), axis=1)
    count = valid.sum(axis=1)
    pair = np.stack([np.maximum(count - 1, 0) // 2, count // 2], axis=1)
    pair = np.minimum(pair, values.shape[1] - 1)
    middle = np.take_along_axis(rising, pair, axis=1).mean(axis=1)
    return np.where(count > 0, middle, np.nan)
