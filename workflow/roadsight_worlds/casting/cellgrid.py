"""Uniform plan grid over a scene: which bodies and which ground each cell holds."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roadsight.base.arrays import Floats, Ints, Ints32
from roadsight.base.kernels import compiled
from roadsight_worlds.casting.alignment import to_plan
from roadsight_worlds.casting.primitives import Bodies, body_extent_m
from roadsight_worlds.casting.terrain import CellBounds, Terrain, cell_bounds

# The grid is so much wider than what it holds, so that nothing lies on its border by rounding.
_PAD_M = 1e-4
# Cells of a grid; a larger scene gets larger cells, so that memory stays bounded.
_MAX_CELLS = 1 << 20
BLOCK = 8  # Cells along the side of a block, which a ray above or below all of it skips at once.


class CellGrid(NamedTuple):
    """Square cells in plan with everything that a ray may meet in them.

    Parameters
    ----------
    x_m, y_m, cell_m : outer corner of cell (0, 0) and cell width.
    rows, columns : cells along y and x.
    low_m, high_m : (rows, columns) heights between which a cell holds anything.
    block_low_m, block_high_m : the same for blocks of 8 by 8 cells.
    ground : bounds of the terrain in each cell.
    first_body : (rows * columns + 1,) where the bodies of each cell start in ``body``.
    body : bodies by cell.
    bottom_m, top_m : heights of the whole scene.
    """

    x_m: float
    y_m: float
    cell_m: float
    rows: int
    columns: int
    low_m: Floats
    high_m: Floats
    block_low_m: Floats
    block_high_m: Floats
    ground: CellBounds
    first_body: Ints
    body: Ints32
    bottom_m: float
    top_m: float


def build_grid(bodies: Bodies, terrain: Terrain, cell_m: float) -> CellGrid:
    """Grid over bodies and terrain; cells grow where a scene would need more than a million.

    Parameters
    ----------
    terrain : ground; one whose end lies before its start is no ground.
    cell_m : wanted cell width.
    """
    extent = body_extent_m(bodies) + _PAD_M
    low, high = bodies.centre_m - extent, bodies.centre_m + extent
    ends = np.concatenate([low[:, :2], high[:, :2]])
    if terrain.end_m >= terrain.start_m:
        stations, step = np.linspace(terrain.start_m, terrain.end_m, 257, retstep=True)
        offsets = np.repeat([terrain.right_m, terrain.left_m], len(stations))
        corners = to_plan(terrain.alignment, np.column_stack([np.tile(stations, 2), offsets]))
        bulge = abs(terrain.alignment.curvature_per_m) * float(step) ** 2  # 8 sagittas
        ends = np.concatenate([ends, corners - bulge, corners + bulge])
    ends = ends if len(ends) else np.zeros((1, 2))  # an empty scene is one empty cell
    corner, width = ends.min(axis=0) - _PAD_M, np.ptp(ends, axis=0) + 2.0 * _PAD_M
    cell_m = max(cell_m, math.sqrt(width[0] * width[1] / _MAX_CELLS))
    columns, rows = (int(n) for n in np.ceil(width / cell_m))
    x = corner[0] + cell_m * (np.arange(columns) + 0.5)
    y = corner[1] + cell_m * (np.arange(rows) + 0.5)
    ground = cell_bounds(terrain, x, y, cell_m)
    limits = np.array([rows, columns])
    start = np.clip(((low[:, 1::-1] - corner[::-1]) // cell_m).astype(np.int64), 0, limits - 1)
    end = np.clip(((high[:, 1::-1] - corner[::-1]) // cell_m).astype(np.int64), 0, limits - 1)
    first, body = _bodies_by_cell(start, end, rows, columns)
    bottom, top = ground.low_m.copy(), ground.high_m.copy()
    _widen(bottom, top, start, end, low[:, 2], high[:, 2])
    return CellGrid(
        float(corner[0]),
        float(corner[1]),
        float(cell_m),
        rows,
        columns,
        bottom,
        top,
        _by_block(bottom, np.minimum, np.inf),
        _by_block(top, np.maximum, -np.inf),
        ground,
        first,
        body,
        float(bottom.min()),
        float(top.max()),
    )


def _by_block(heights_m: Floats, extreme: np.ufunc, nothing: float) -> Floats:
    """Extreme height of each block of cells; blocks at the far borders may be cut."""
    rows, columns = (-(-n // BLOCK) for n in heights_m.shape)
    padded = np.full((rows * BLOCK, columns * BLOCK), nothing)
    padded[: heights_m.shape[0], : heights_m.shape[1]] = heights_m
    return extreme.reduce(padded.reshape(rows, BLOCK, columns, BLOCK), axis=(1, 3))


@compiled(error_model="numpy")
def _bodies_by_cell(start: Ints, end: Ints, rows: int, columns: int) -> tuple[Ints, Ints32]:
    """Bodies of each cell in ascending order, from the cells (row, column) that each covers."""
    first = np.zeros(rows * columns + 1, dtype=np.int64)
    for i in range(len(start)):
        for row in range(start[i, 0], end[i, 0] + 1):
            for column in range(start[i, 1], end[i, 1] + 1):
                first[row * columns + column + 1] += 1
    for cell in range(rows * columns):
        first[cell + 1] += first[cell]
    filled = first[:-1].copy()
    body = np.empty(first[-1], dtype=np.int32)
    for i in range(len(start)):
        for row in range(start[i, 0], end[i, 0] + 1):
            for column in range(start[i, 1], end[i, 1] + 1):
                cell = row * columns + column
                body[filled[cell]] = i
                filled[cell] += 1
    return first, body


@compiled(error_model="numpy")
def _widen(bottom: Floats, top: Floats, start: Ints, end: Ints, low: Floats, high: Floats) -> None:
    """Widen the heights of the cells that bodies cover."""
    for i in range(len(start)):
        for row in range(start[i, 0], end[i, 0] + 1):
            for column in range(start[i, 1], end[i, 1] + 1):
                bottom[row, column] = min(bottom[row, column], low[i])
                top[row, column] = max(top[row, column], high[i])
