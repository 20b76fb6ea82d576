"""Vehicles that a scanner caught in passing: smears on the pavement that were never standing.

Clouds joined from many moments keep a vehicle wherever it was seen. As permanent walls along the
lanes such smears would hide most of the road from a roadside sensor.
"""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Bools, Floats
from roadsight.scene.grids import Grid


class Columns:
    """Greatest height above the ground in each column of a grid, gathered part by part.

    Parameters
    ----------
    grid : the columns.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._top_m = np.full(grid.rows * grid.columns, -np.inf)

    def add(self, xy_m: Floats, height_m: Floats) -> None:
        """Take points (n, 2) with their heights above the ground (n,) into account."""
        known = ~np.isnan(height_m)
        cells = self._grid.flat(xy_m[known, 0], xy_m[known, 1])
        np.maximum.at(self._top_m, cells, height_m[known])

    def top_m(self, xy_m: Floats) -> Floats:
        """Greatest height in the columns of the points (n, 2)."""
        return self._top_m[self._grid.flat(xy_m[:, 0], xy_m[:, 1])]


def is_traffic(
    height_m: Floats, top_m: Floats, on_pavement: Bools, lowest_m: float, highest_m: float
) -> Bools:
    """Points on the pavement that stand clear of it in columns that end below vehicle height.

    Masts, trees, gantries and bridges reach higher and stay, down to their feet.

    Parameters
    ----------
    height_m : (n,) above the ground, NaN where the ground is unknown.
    top_m : (n,) greatest height in each point's column.
    on_pavement : (n,) whether the point lies over the pavement, its rim left out.
    lowest_m : what is lower is pavement. highest_m : no vehicle is higher.
    """
    return on_pavement & (height_m > lowest_m) & (top_m <= highest_m)
