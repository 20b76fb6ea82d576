"""Regular grids in the local frame: rows go north, columns go east, cell (0, 0) is south-west."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats, Ints


@dataclass(frozen=True)
class Grid:
    """Grid whose lines lie on multiples of the cell size, so that tiles of one site agree.

    Parameters
    ----------
    west, south : index of the first column and row, in cells from the local origin.
    columns, rows : number of cells.
    cell_size_m : side of a cell.
    """

    west: int
    south: int
    columns: int
    rows: int
    cell_size_m: float

    @classmethod
    def over(
        cls, x_min: float, y_min: float, x_max: float, y_max: float, cell_size_m: float
    ) -> Grid:
        """Smallest grid that holds the given bounds (local metres)."""
        west, south = int(np.floor(x_min / cell_size_m)), int(np.floor(y_min / cell_size_m))
        east, north = int(np.floor(x_max / cell_size_m)), int(np.floor(y_max / cell_size_m))
        return cls(west, south, east - west + 1, north - south + 1, cell_size_m)

    @classmethod
    def around(cls, x: ArrayLike, y: ArrayLike, cell_size_m: float) -> Grid:
        """Smallest grid that holds the points."""
        x, y = np.asarray(x), np.asarray(y)
        if x.size == 0:
            return cls(0, 0, 0, 0, cell_size_m)
        return cls.over(x.min(), y.min(), x.max(), y.max(), cell_size_m)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns."""
        return self.rows, self.columns

    def indices(self, x: ArrayLike, y: ArrayLike) -> tuple[Ints, Ints]:
        """Column and row of points (n,); points outside the grid get the nearest border cell."""
        column = np.floor(np.asarray(x, np.float64) / self.cell_size_m).astype(np.int64) - self.west
        row = np.floor(np.asarray(y, np.float64) / self.cell_size_m).astype(np.int64) - self.south
        return np.clip(column, 0, self.columns - 1), np.clip(row, 0, self.rows - 1)

    def flat(self, x: ArrayLike, y: ArrayLike) -> Ints:
        """Row-major cell number of points (n,)."""
        column, row = self.indices(x, y)
        return row * self.columns + column

    def centres(self, columns: ArrayLike, rows: ArrayLike) -> tuple[Floats, Floats]:
        """Centre x and y of cells, local metres."""
        x = (np.asarray(columns) + self.west + 0.5) * self.cell_size_m
        y = (np.asarray(rows) + self.south + 0.5) * self.cell_size_m
        return x, y

    @property
    def west_m(self) -> float:
        """x of the western border."""
        return self.west * self.cell_size_m

    @property
    def north_m(self) -> float:
        """y of the northern border."""
        return (self.south + self.rows) * self.cell_size_m


def lowest_per_cell(grid: Grid, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Floats:
    """Lowest value per cell (rows, columns); NaN where the cell is empty."""
    lowest = np.full(grid.rows * grid.columns, np.inf)
    if np.size(x):
        np.minimum.at(lowest, grid.flat(x, y), np.asarray(z, np.float64))
    return np.where(np.isfinite(lowest), lowest, np.nan).reshape(grid.shape)


def fill_gaps(values: Floats) -> Floats:
    """Replace NaN by the nearest known value; an array without any known value stays NaN.

    Ties between equally near cells are broken by the distance transform's fixed scan order.
    """
    gaps = np.isnan(values)
    if not gaps.any() or gaps.all():
        return values
    from scipy import ndimage  # noqa: PLC0415  # slow to load

    nearest = ndimage.distance_transform_edt(gaps, return_distances=False, return_indices=True)
    return values[tuple(nearest)]


def sample_bilinear(grid: Grid, values: Floats, x: ArrayLike, y: ArrayLike) -> Floats:
    """Values (rows, columns) at points (n,), bilinear between cell centres, constant outside."""
    from scipy import ndimage  # noqa: PLC0415  # slow to load

    # Values belong to the centres of cells, half a cell from their corners.
    column = np.asarray(x, np.float64) / grid.cell_size_m - grid.west - 0.5
    row = np.asarray(y, np.float64) / grid.cell_size_m - grid.south - 0.5
    return ndimage.map_coordinates(values, [row, column], order=1, mode="nearest")
