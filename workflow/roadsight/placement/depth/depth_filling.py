"""Linear interpolation in depth maps (paper 1, Fig. 12, the second way of deployment)."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Bools, Floats32
from roadsight.base.kernels import compiled


def fill_linearly(depth_m: Floats32, wanted: Bools, *, wraps: bool = True) -> Floats32:
    """Ranges of the wanted cells, 0 elsewhere; shape (rows, columns).

    Known ranges stay. Others are interpolated between the nearest known cells of their row and of
    their column, and the two are weighed by how near the nearest one is. Where only one side has a
    known cell, its range is taken; without any the cell stays without return.

    Parameters
    ----------
    depth_m : (rows, columns), 0 where nothing is known. wanted : cells that have a return.
    wraps : whether the last column is beside the first one.
    """
    across = _along_rows(np.ascontiguousarray(depth_m), wraps)
    upright = _along_rows(np.ascontiguousarray(depth_m.T), False)
    total = across[1] + upright[1].T
    mixed = across[0] * across[1] + (upright[0] * upright[1]).T
    filled = np.divide(mixed, total, out=np.zeros_like(depth_m), where=total > 0)
    return np.where(wanted, np.where(depth_m > 0, depth_m, filled), 0.0).astype(np.float32)


def _along_rows(depth_m: Floats32, wraps: bool) -> tuple[Floats32, Floats32]:
    """Ranges interpolated along rows, and 1 / cells to the nearest known one, 0 if none."""
    before_m, before = _last_known(depth_m, wraps)
    mirrored = np.ascontiguousarray(depth_m[:, ::-1])
    after_m, after = (part[:, ::-1] for part in _last_known(mirrored, wraps))
    share = np.where(before > 0, np.where(after > 0, before / np.maximum(before + after, 1), 0), 1)
    value = (1 - share) * before_m + share * after_m
    nearest = np.minimum(np.where(before > 0, before, np.inf), np.where(after > 0, after, np.inf))
    return value.astype(np.float32), (1 / nearest).astype(np.float32)


@compiled()
def _last_known(depth_m: Floats32, wraps: bool) -> tuple[Floats32, Floats32]:
    """Of each cell the last known range before it in its row, and how many cells back, 0: none."""
    rows, columns = depth_m.shape
    range_m, gap = np.zeros((rows, columns), np.float32), np.zeros((rows, columns), np.float32)
    for row in range(rows):
        known_m, cells = np.float32(0.0), 0
        for step in range(2 * columns if wraps else columns):
            column = step % columns
            if known_m > 0:
                range_m[row, column], gap[row, column] = known_m, cells
            if depth_m[row, column] > 0:
                known_m, cells = depth_m[row, column], 0
            cells += 1
    return range_m, gap
