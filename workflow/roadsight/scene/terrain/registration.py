"""Scans, drives and files that lie apart: how far the ground says that they do.

Where points tell their scan (``point_source_id``), heights of scans are compared on the cells of
ground that they share. Without, differences of heights of points beside each other tell: if both
come of one layer, their density falls from zero on, whatever the layer's noise (differences of a
unimodal law, Hodges and Lehmann 1954, doi:10.1214/aoms/1177728669). A second peak is a second
layer, and its place the distance.
"""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.doubts import Doubt
from roadsight.scene.grids import Grid, lowest_per_cell
from roadsight.scene.pavement.scan_levels import robust_plane

_CELL_M = 1.0  # Cells in which scans are compared.
_BLOCK_CELLS = 5  # Side of a block, which has one slope and says one difference of two scans.
_NEAR_M = 0.5  # Points so high above the lowest ground of their cell may be another scan's ground.
_FLAT_M = 0.06  # Spread of a scan's points in a cell of flat ground: noise of 3 cm, and lawn.
_FEWEST_POINTS = 3  # Of a scan in a cell.
_FEWEST_CELLS = 4  # Shared ones in a block.
_FEWEST_BLOCKS = 8  # Whose spread tells how sure their median is.
_NEXT_SCANS = 4  # Scans that each is compared with in a cell, by number: a turn and those after it.
LEAST_APART_M = 0.015  # Scans 2 cm apart change 1.4 % of a sensor's beams.
_SIGMAS = 3.0
_SURE_M = 0.02  # A horizontal shift counts where the slopes of the ground leave it so uncertain.


class Registration:
    """Heights of scans beside each other, gathered tile by tile."""

    def __init__(self) -> None:
        # Lower and higher number of two scans, block, second's height over the first's, slopes.
        self._pairs: list[Floats] = [np.empty((0, 6))]
        self._blocks = 0

    def add(self, xyz_m: Floats, ground: Bools, scan: Ints) -> None:
        """Compare heights in a part of the cloud made of whole cells of 1 m.

        Parameters
        ----------
        xyz_m : (n, 3) points. ground : (n,) labels. scan : (n,) numbers of their scans.
        """
        if not ground.any():
            return
        x, y, z = xyz_m.T
        grid = Grid.around(x, y, _CELL_M)
        cell = grid.flat(x, y)
        lowest = lowest_per_cell(grid, x[ground], y[ground], z[ground]).ravel()
        near = np.flatnonzero(z < lowest[cell] + _NEAR_M)
        cell, ids = cell[near], np.unique(scan)
        row, column = np.divmod(cell, grid.columns)
        centre_x, centre_y = grid.centres(column, row)
        key = cell * len(ids) + np.searchsorted(ids, scan[near])
        count = np.bincount(key, minlength=grid.rows * grid.columns * len(ids))
        kept = np.flatnonzero(count >= _FEWEST_POINTS)
        if len(kept) == 0:
            return
        z = z[near] - lowest[cell]

        def mean(values: Floats) -> Floats:
            return np.bincount(key, values, len(count))[kept] / count[kept]

        height = mean(z)
        variance = mean(z**2) - height**2
        east, north = mean(x[near] - centre_x), mean(y[near] - centre_y)
        cell, owner = kept // len(ids), kept % len(ids)
        height += lowest[cell]
        row, column = np.divmod(cell, grid.columns)
        wide = -(-grid.columns // _BLOCK_CELLS)
        block = row // _BLOCK_CELLS * wide + column // _BLOCK_CELLS
        slope = _slopes(
            np.column_stack([column + east, row + north]) * _CELL_M,
            height,
            block * len(ids) + owner,
            block,
        )[block]
        flat = variance < _FLAT_M**2 + (slope**2).sum(axis=1) * _CELL_M**2 / 12
        height -= east * slope[:, 0] + north * slope[:, 1]
        cell, owner, block, height, slope = (
            column[flat] for column in (cell, owner, block, height, slope)
        )
        for step in range(1, _NEXT_SCANS + 1):
            one = np.flatnonzero(cell[step:] == cell[:-step])
            two = one + step
            table = ids[owner[one]], ids[owner[two]], block[one] + self._blocks
            self._pairs.append(np.column_stack([*table, height[two] - height[one], slope[one]]))
        self._blocks += int(block.max(initial=0)) + 1

    def doubts(self) -> list[Doubt]:
        """A doubt that names the two scans that lie farthest apart; none where scans agree."""
        pairs = np.concatenate(self._pairs)
        blocks, count = _medians(pairs, 3)
        blocks = blocks[count >= _FEWEST_CELLS]
        middle, count = _medians(blocks, 2)
        far = blocks.copy()
        number = np.repeat(np.arange(len(count)), count)
        far[:, 3] = np.abs(blocks[:, 3] - middle[number, 3])
        sigma_m = 1.2533 * 1.4826 * _medians(far, 2)[0][:, 3] / np.sqrt(count)
        sure = (count >= _FEWEST_BLOCKS) & (np.abs(middle[:, 3]) > _SIGMAS * sigma_m)
        sure &= np.abs(middle[:, 3]) > LEAST_APART_M
        if not sure.any():
            return []
        worst = int(np.argmax(np.where(sure, np.abs(middle[:, 3]), 0)))
        low, high = (str(int(name)) for name in middle[worst, :2])
        apart_m, text = float(middle[worst, 3]), ""
        own = blocks[number == worst]
        shift = _horizontal(own)
        if shift is not None:
            apart_m, text = float(shift[0]), f" and {np.hypot(*shift[1:]):.2f} m beside it"
        if apart_m < 0:
            low, high = high, low
        told = (
            f"scan {high} lies above scan {low}{text} (point_source_id), m: sight lines end too"
            " early or pass between; register the scans again, or give the cloud of one"
        )
        return [Doubt("scans_apart", "doubt", told, round(abs(apart_m), 3), LEAST_APART_M)]


def _horizontal(blocks: Floats) -> Floats | None:
    """Shift (3,) up, east and north of one scan on another; None where slopes do not tell it.

    Parameters
    ----------
    blocks : (n, 6), see `Registration`: a shift to the side lowers what rises towards it.
    """
    design = np.column_stack([np.ones(len(blocks)), -blocks[:, 4:]])
    shift = robust_plane(design, blocks[:, 3])
    spread_m = 1.4826 * float(np.median(np.abs(blocks[:, 3] - design @ shift))) + 1e-3
    covariance = spread_m**2 * np.linalg.inv(design.T @ design + 1e-9 * np.eye(3))
    sigma_m = float(np.sqrt(np.linalg.eigvalsh(covariance[1:, 1:])[-1]))
    beside_m = float(np.hypot(*shift[1:]))
    least_m = max(_SIGMAS * sigma_m, LEAST_APART_M)
    return shift if sigma_m < _SURE_M and beside_m > least_m else None


def _slopes(xy_m: Floats, height_m: Floats, group: Ints, block: Ints) -> Floats:
    """Slopes (blocks, 2) east and north that the groups (scans) of each block have in common.

    Parameters
    ----------
    xy_m : (n, 2). height_m : (n,). group, block : (n,) of each place.
    """
    count = np.maximum(np.bincount(group), 1)
    x, y, z = (axis - (np.bincount(group, axis) / count)[group] for axis in (*xy_m.T, height_m))
    xx, yy, xy, xz, yz = (
        np.bincount(block, product) for product in (x * x, y * y, x * y, x * z, y * z)
    )
    area = xx * yy - xy**2
    thin = area <= 1e-3 * (xx + yy) ** 2  # a row of cells tells no slope across it
    area[thin] = np.inf
    return np.column_stack([xz * yy - yz * xy, yz * xx - xz * xy]) / area[:, None]


def _medians(table: Floats, keys: int) -> tuple[Floats, Ints]:
    """Rows of each distinct first ``keys`` columns: the one of median column 3, and their number.

    Parameters
    ----------
    table : (n, 6), see `Registration`.
    """
    table = table[np.lexsort((table[:, 3], *table[:, keys - 1 :: -1].T))]
    new = np.r_[True, (np.diff(table[:, :keys], axis=0) != 0).any(axis=1)][: len(table)]
    first = np.flatnonzero(new)
    count = np.diff(np.append(first, len(table)))
    return table[first + count // 2], count
