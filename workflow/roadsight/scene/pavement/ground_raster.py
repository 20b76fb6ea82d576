"""Ground as a raster: mean height per cell, and a plane at the smallest scale with support.

Planes are weighted least squares under a Gaussian window, by normalised convolution (Knutsson and
Westin 1993, doi:10.1109/CVPR.1993.341081), so that empty cells say nothing and the scale is local:
fine where points are dense, coarse only where they are sparse or noisy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from roadsight.base.arrays import Bools, Floats
from roadsight.scene.grids import Grid

_MOST = 8.0
"""Points of one cell that count: more share the same scan's error."""
_RIDGE = 0.02
"""Of the window's variance: keeps a plane along a single scan line finite."""


@dataclass(frozen=True)
class CellMeans:
    """Means of the points of each cell (rows, columns); height and intensity 0 where empty.

    Parameters
    ----------
    count : points. height_m, intensity : means. variance_m2 : of height.
    across, up : mean position within the cell, in cells from its centre.
    """

    grid: Grid
    count: Floats
    height_m: Floats
    variance_m2: Floats
    intensity: Floats
    across: Floats
    up: Floats

    @property
    def weight(self) -> Floats:
        """Weight of each cell's mean."""
        return np.minimum(self.count, _MOST)


@dataclass(frozen=True)
class LocalPlanes:
    """Plane at each cell (rows, columns).

    Parameters
    ----------
    known : whether there is one. height_m : at the cell's centre. east, north : rise over run.
    residual_m : root mean square of the cells' means about it. error_m : standard error of the
    height. scale_m : standard deviation of the window.
    """

    known: Bools
    height_m: Floats
    east: Floats
    north: Floats
    residual_m: Floats
    error_m: Floats
    scale_m: Floats


def cell_means(xyz_m: Floats, intensity: Floats, cell_m: float) -> CellMeans:
    """Means per cell of ground points (n, 3) and their intensity (n,)."""
    grid = Grid.around(xyz_m[:, 0], xyz_m[:, 1], cell_m)
    cell, size = grid.flat(xyz_m[:, 0], xyz_m[:, 1]), grid.rows * grid.columns
    count = np.bincount(cell, minlength=size).astype(np.float64)
    many = np.maximum(count, 1.0)
    level = float(xyz_m[:, 2].mean()) if len(xyz_m) else 0.0

    def mean(values: Floats) -> Floats:
        return np.bincount(cell, values, minlength=size) / many

    height = mean(xyz_m[:, 2] - level) + level * (count > 0)
    column, row = (xyz_m[:, axis] / cell_m % 1.0 - 0.5 for axis in (0, 1))
    parts = (
        count,
        height,
        mean((xyz_m[:, 2] - height[cell]) ** 2),
        mean(intensity),
        mean(column),
        mean(row),
    )
    return CellMeans(grid, *(part.reshape(grid.shape) for part in parts))


def smooth(values: Floats, sigma_cells: float) -> Floats:
    """Gaussian mean that takes everything outside as 0."""
    return ndimage.gaussian_filter(values, sigma_cells, mode="constant", truncate=2.5)


def window_planes(
    weight: Floats, height_m: Floats, across: Floats, up: Floats, sigma_cells: float
) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """Weighted plane under a Gaussian window at each cell.

    Parameters
    ----------
    weight, height_m, across, up : (rows, columns) of `CellMeans`.

    Returns
    -------
    height at the centre in metres, rise per cell along columns and rows, root mean square
    residual, sum of weights under the window, distance of their mean from the centre in cells.
    """
    rows, columns = weight.shape
    row, column = np.mgrid[:rows, :columns].astype(np.float64)
    column -= columns / 2
    row -= rows / 2
    x, y = column + across, row + up
    total = np.maximum(smooth(weight, sigma_cells), 1e-12)

    def mean(values: Floats) -> Floats:
        return smooth(weight * values, sigma_cells) / total

    level = float((weight * height_m).sum() / max(weight.sum(), 1e-12))
    z = np.where(weight > 0, height_m - level, 0.0)
    mx, my, mz = mean(x), mean(y), mean(z)
    ridge = _RIDGE * sigma_cells**2
    xx, yy = mean(x * x) - mx**2 + ridge, mean(y * y) - my**2 + ridge
    xy, xz, yz = mean(x * y) - mx * my, mean(x * z) - mx * mz, mean(y * z) - my * mz
    determinant = xx * yy - xy**2
    east, north = (xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant
    left = np.maximum(mean(z * z) - mz**2 - east * xz - north * yz, 0.0)
    height = mz + east * (column - mx) + north * (row - my) + level
    off = np.hypot(mx - column, my - row)
    return height, east, north, np.sqrt(left), total * 2 * np.pi * sigma_cells**2, off


def _narrowest_spread(occupied: Floats, sigma_cells: float) -> tuple[Floats, Floats]:
    """Occupied cells under each window, and their variance along the narrowest direction."""
    rows, columns = occupied.shape
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    x, y = x - columns / 2, y - rows / 2
    total = np.maximum(smooth(occupied, sigma_cells), 1e-12)

    def mean(values: Floats) -> Floats:
        return smooth(occupied * values, sigma_cells) / total

    mx, my = mean(x), mean(y)
    xx, yy, xy = mean(x * x) - mx**2, mean(y * y) - my**2, mean(x * y) - mx * my
    narrow = (xx + yy) / 2 - np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
    return total * 2 * np.pi * sigma_cells**2, narrow


def local_planes(
    cells: CellMeans, scales_cells: tuple[float, ...], error_m: float, fewest: float = 6.0
) -> LocalPlanes:
    """Plane of each cell at the smallest scale that carries it.

    A scale carries a plane where its window holds ``fewest`` occupied cells that spread by half
    the window's width in every direction around its middle. Where that plane's height is less
    certain than ``error_m`` a larger scale is taken, if it carries.
    """
    cell_m, weight = cells.grid.cell_size_m, cells.weight
    occupied = (weight > 0).astype(np.float64)
    chosen: list[Floats] = []
    known = np.zeros(weight.shape, dtype=bool)
    fine = known.copy()
    for scale in scales_cells:
        height, east, north, residual, total, off = window_planes(
            weight, cells.height_m, cells.across, cells.up, scale
        )
        number, narrow = _narrowest_spread(occupied, scale)
        carries = (number >= fewest) & (narrow >= (0.5 * scale) ** 2) & (off < scale)
        error = residual / np.sqrt(np.maximum(total, 1.0))
        width = np.full(weight.shape, scale * cell_m)
        values = [height, east / cell_m, north / cell_m, residual, error, width]
        take = carries & ~fine
        chosen = [
            np.where(take, new, old) for new, old in zip(values, chosen or values, strict=True)
        ]
        known |= carries
        fine |= carries & (error <= error_m)
    return LocalPlanes(known, *chosen)
