"""Slope of the ground and what covers it, from occupied cells of 1 m."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats, Ints

_BLOCK_M = 8.0
"""Edge of the blocks whose slope is measured: about two lanes wide."""
_LEAST_CELLS = 24
"""Known cells of the 64 of a block; fewer may lie in a strip, across which the slope is a guess."""
_ROUGHEST_M = 0.15
"""Root mean square distance of smooth ground from its plane; more is a wall, a hedge or forest."""


def slopes_deg(
    x_m: NDArray[np.floating], y_m: NDArray[np.floating], z_m: NDArray[np.floating]
) -> Floats:
    """Slope (k,) of the plane through each block of 8 m of smooth ground, degrees.

    A block counts where 24 of its cells are known and they lie within 0.15 m of their plane, root
    mean square: roads, verges and embankments, but no walls, hedges or forest.

    Parameters
    ----------
    x_m, y_m, z_m : (n,) places and lowest heights of cells.
    """
    if len(x_m) == 0:
        return np.empty(0)
    block = np.floor(np.column_stack([x_m, y_m]) / _BLOCK_M).astype(np.int64)
    _, of, count = np.unique(block, axis=0, return_inverse=True, return_counts=True)
    of = of.reshape(-1)

    def mean(values: NDArray[np.floating]) -> Floats:
        return np.bincount(of, values) / count

    dx, dy, dz = (axis - mean(axis)[of] for axis in (x_m, y_m, z_m))
    xx, yy, xy = mean(dx * dx), mean(dy * dy), mean(dx * dy)
    xz, yz, zz = mean(dx * dz), mean(dy * dz), mean(dz * dz)
    area = xx * yy - xy * xy
    # Cells on one line have no area, and their plane no slope across it.
    flat = (count >= _LEAST_CELLS) & (area > 1e-6 * (xx + yy) ** 2)
    xx, yy, xy, xz, yz, zz, area = (v[flat] for v in (xx, yy, xy, xz, yz, zz, area))
    east, north = (xz * yy - yz * xy) / area, (yz * xx - xz * xy) / area
    smooth = zz - east * xz - north * yz <= _ROUGHEST_M**2
    return np.degrees(np.arctan(np.hypot(east, north)[smooth]))


def cover_core(column: Ints, row: Ints, covered: Bools) -> int:
    """Number of covered cells whose eight neighbours are covered too: no wire and no gantry.

    Parameters
    ----------
    column, row : (n,) place of each cell. covered : (n,) whether something spans it.
    """
    column, row = column[covered], row[covered]
    if len(column) == 0:
        return 0
    wide = np.int64(column.max() - column.min() + 3)
    key = (row - row.min() + 1) * wide + column - column.min() + 1
    core = np.ones(len(key), bool)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            core &= np.isin(key + down * wide + right, key)
    return int(core.sum())
