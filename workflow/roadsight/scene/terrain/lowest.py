"""Lowest height of each coarse cell that other points of the cell support.

Wet and shiny roads mirror: a scanner then sees points metres below them, in whole patches of
cells, which no comparison with neighbouring cells can tell from a pit. In a dense cell they are few
beside the points of the road, and a gap without points lies between.
"""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.base.kernels import compiled
from roadsight.scene.grids import Grid
from roadsight.scene.terrain.cells import flat_cells

_GAP_M = 1.0
"""Height without points that parts mirror images from the road; kerbs and ditches have less."""
_SUPPORT = 0.1
"""Points below a gap that are a smaller share of their cell are no ground; a mirrored road was up
to so much of it on a mobile scan of a junction."""
_LEAST_POINTS = 50
"""Cells with fewer points keep their lowest one: one point is no small share there."""


def lowest_supported(grid: Grid, x: Floats, y: Floats, z: Floats) -> Floats:
    """Lowest supported height per cell (rows, columns); NaN where the cell is empty.

    Parameters
    ----------
    x, y, z : (n,) all points of the cells in question; points without a height do not count.
    """
    cell = flat_cells(grid, x, y)
    return _lowest(cell, z, grid.rows * grid.columns).reshape(grid.shape)


@compiled()
def _lowest(cell: Ints, z: Floats, cells: int) -> Floats:
    """Lowest supported height of each cell, NaN for none."""
    start = np.zeros(cells + 1, np.int64)
    for i in range(len(z)):
        if np.isfinite(z[i]):
            start[cell[i] + 1] += 1
    for c in range(cells):
        start[c + 1] += start[c]
    fill = start[:-1].copy()
    heights = np.empty(start[-1])
    for i in range(len(z)):
        if np.isfinite(z[i]):
            heights[fill[cell[i]]] = z[i]
            fill[cell[i]] += 1
    out = np.full(cells, np.nan)
    for c in range(cells):
        own = heights[start[c] : start[c + 1]]
        n = len(own)
        if n == 0:
            continue
        own.sort()
        out[c] = own[0]
        if n < _LEAST_POINTS:
            continue
        few = int(_SUPPORT * n) + 1
        for k in range(few - 1, 0, -1):
            if own[k] - own[k - 1] > _GAP_M:
                out[c] = own[k]
                break
    return out
