"""Scans that say different things of one surface: other epochs, or registration that failed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.base.doubts import Doubt

_CELL_M = 0.5
"""Cells in which scans are compared: several points of each, and little rise of the road within."""
_FEWEST_POINTS = 3
"""Points of a scan in a cell whose mean height counts."""
_FEWEST_CELLS = 100
"""Cells, 25 m2, that a scan must share with others before it is compared."""
_LEAST_APART_M = 0.1
"""Scans differ by over 5 cm on 2 to 16 % of the pavement of five streets, where a turn tilted them,
and by over this on up to 2 %. Thinner layers of asphalt are not told from registration."""
_SPREADS = 4.0
"""Means of three points differ by so many spreads of one point by chance once in 10^6 cells."""
_MOST_CHANGED = 0.05
"""Share of cells on which scans differ: parked cars that left, and edges of kerbs."""


@dataclass
class ScanHeights:
    """Heights of scans on the cells that they share, gathered tile by tile.

    Parameters
    ----------
    scan, off_m : of each scan in each shared cell: its number, its mean height above the middle of
        the scans there. cell : number of the cell. spread_m : of the points of one scan in a cell.
    """

    scan: list[Ints] = field(default_factory=list)
    off_m: list[Floats] = field(default_factory=list)
    cell: list[Ints] = field(default_factory=list)
    spread_m: list[Floats] = field(default_factory=list)
    cells: int = 0

    def add(self, xyz_m: Floats, scan: Ints) -> None:
        """Compare scans on a surface.

        Parameters
        ----------
        xyz_m : (n, 3) points of whole cells of the surface. scan : (n,) their scans.
        """
        if len(xyz_m) == 0:
            return
        place = np.floor(xyz_m[:, :2] / _CELL_M).astype(np.int64)
        keys = np.column_stack([place, scan])
        order = np.lexsort(keys.T)
        keys, height_m = keys[order], xyz_m[order, 2]
        first = np.flatnonzero(np.r_[True, (np.diff(keys, axis=0) != 0).any(axis=1)])
        count = np.diff(np.append(first, len(keys)))
        mean = np.add.reduceat(height_m, first) / count
        square = np.add.reduceat((height_m - np.repeat(mean, count)) ** 2, first) / count
        enough = count >= _FEWEST_POINTS
        _, cell = np.unique(keys[first][enough, :2], axis=0, return_inverse=True)
        cell, mean = cell.ravel(), mean[enough]
        shared = np.bincount(cell)[cell] > 1
        cell, mean, owner = cell[shared], mean[shared], keys[first][enough][shared, 2]
        self.off_m.append(mean - _middles(cell, mean))
        self.scan.append(owner)
        self.cell.append(cell + self.cells)
        self.spread_m.append(np.sqrt(square[enough][shared]))
        self.cells += int(cell.max()) + 1 if len(cell) else 0


def _middles(cell: Ints, height_m: Floats) -> Floats:
    """Median height of each one's cell (n,)."""
    if len(cell) == 0:
        return height_m
    order = np.lexsort((height_m, cell))
    _, first, count = np.unique(cell[order], return_index=True, return_counts=True)
    ranked = height_m[order]
    middle = (ranked[first + (count - 1) // 2] + ranked[first + count // 2]) / 2
    return np.asarray(middle[np.unique(cell, return_inverse=True)[1]], np.float64)


def epoch_doubts(heights: ScanHeights) -> list[Doubt]:
    """Doubts about a pavement whose scans differ by more than their noise; none where they agree.

    A scan that lies off as a whole is said by its offset, and what is left by the share of cells.
    """
    if not heights.off_m or sum(map(len, heights.off_m)) == 0:
        return []
    scan, off_m = np.concatenate(heights.scan), np.concatenate(heights.off_m)
    cell, spread_m = np.concatenate(heights.cell), np.concatenate(heights.spread_m)
    apart_m = max(_LEAST_APART_M, _SPREADS * float(np.median(spread_m)))
    ids, number, count = np.unique(scan, return_inverse=True, return_counts=True)
    middle = _by_scan(number, off_m)
    middle[count < _FEWEST_CELLS] = 0.0
    found = []
    if np.ptp(middle) > apart_m:
        high, low = ids[np.argmax(middle)], ids[np.argmin(middle)]
        text = (
            f"scan {high} lies above scan {low} on the pavement (point_source_id), m: other epochs"
            " or registration; give the cloud of one epoch"
        )
        gap_m = round(float(np.ptp(middle)), 3)
        found.append(Doubt("pavement_scans_apart", "doubt", text, gap_m, round(apart_m, 3)))
    left = off_m - middle[number]
    order = np.argsort(cell, kind="stable")
    _, first = np.unique(cell[order], return_index=True)
    highest = np.maximum.reduceat(left[order], first)
    lowest = np.minimum.reduceat(left[order], first)
    changed = float((highest - lowest > apart_m).mean())
    if len(first) >= _FEWEST_CELLS and changed > _MOST_CHANGED:
        text = (
            f"share of the pavement on which scans differ by over {100 * apart_m:.0f} cm in height:"
            " other epochs? give the cloud of one"
        )
        found.append(Doubt("pavement_epochs", "doubt", text, round(changed, 3), _MOST_CHANGED))
    return found


def _by_scan(number: Ints, off_m: Floats) -> Floats:
    """Median of each scan's departures."""
    order = np.lexsort((off_m, number))
    _, first, count = np.unique(number[order], return_index=True, return_counts=True)
    return np.asarray(off_m[order][first + count // 2], np.float64)
