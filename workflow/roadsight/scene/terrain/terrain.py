"""Ground labels and terrain model of a whole site, tile by tile."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from rasterio.fill import fillnodata
from scipy import ndimage

from roadsight.base.arrays import Bools, Floats, Floats32
from roadsight.base.sections.scene import GroundFilter
from roadsight.scene.grids import Grid
from roadsight.scene.terrain.coarse import CoarseGround, coarse_ground, lowest_supported
from roadsight.scene.terrain.ground import ground_mask, published_ground
from roadsight.scene.terrain.ground_settings import reach_m

Bounds = tuple[float, float, float, float]
# Function of a halo in metres that yields (core bounds, (n, 3) points of core and halo).
Tiles = Callable[[float], Iterator[tuple[Bounds, Floats]]]
_GAP_M = 5.0  # Gaps as wide as a parked lorry or a tree lie inside the scanned area.
_NOISE_POINTS = 10  # Points in a cell that can tell its spread.


def label_ground(
    tiles: Tiles, bounds_m: Bounds, settings: GroundFilter
) -> Iterator[tuple[Floats, Bools]]:
    """Ground labels of each tile.

    Parameters
    ----------
    tiles : the cloud. bounds_m : west, south, east, north of it.

    Yields
    ------
    (n, 3) points of a tile's core and (n,) whether they are ground.
    """
    robust = settings.method == "robust"
    coarse = coarse_of_tiles(tiles, bounds_m, settings) if robust else None
    for core, points in tiles(reach_m(settings)):
        x, y, z = points.T
        if coarse is None:
            mask = published_ground(x, y, z, settings)
        else:
            mask = ground_mask(x, y, z, coarse, settings)
        west, south, east, north = core
        own = (x >= west) & (x < east) & (y >= south) & (y < north)
        yield points[own], mask[own]


def coarse_of_tiles(tiles: Tiles, bounds_m: Bounds, settings: GroundFilter) -> CoarseGround:
    """Coarse ground surface of the whole cloud.

    A tile is read with one cell around it, so that it knows all points of each cell it touches.
    """
    cell = settings.coarse_cell_m
    grid = Grid.over(*bounds_m, cell)
    lowest = np.full(grid.shape, np.nan)
    for (west, south, east, north), points in tiles(cell):
        x, y, z = points.T
        if len(x) == 0:
            continue
        own = (x >= west) & (x < east) & (y >= south) & (y < north)
        part = Grid.around(x, y, cell)
        found = lowest_supported(part, x, y, z)
        column, row = part.indices(x[own], y[own])
        touched = np.zeros(part.shape, bool)
        touched[row, column] = True
        rows, columns = np.nonzero(touched)
        at_row, at_column = rows + part.south - grid.south, columns + part.west - grid.west
        inside = (at_row >= 0) & (at_row < grid.rows) & (at_column >= 0)
        inside &= at_column < grid.columns
        lowest[at_row[inside], at_column[inside]] = found[rows[inside], columns[inside]]
    return coarse_ground(grid, lowest, settings)


class TerrainModel:
    """Mean ground height per cell, gathered tile by tile.

    Parameters
    ----------
    bounds_m : west, south, east, north, local metres. cell_size_m : side of a cell.
    """

    def __init__(self, bounds_m: Bounds, cell_size_m: float) -> None:
        self.grid = Grid.over(*bounds_m, cell_size_m)
        self._total = np.zeros(self.grid.rows * self.grid.columns)
        self._square = np.zeros(len(self._total))
        self._count = np.zeros(len(self._total), np.int64)

    def add(self, ground_m: Floats) -> None:
        """Add ground points (n, 3)."""
        x, y, z = ground_m.T
        cell, cells = self.grid.flat(x, y), len(self._total)
        self._total += np.bincount(cell, z, minlength=cells)
        self._square += np.bincount(cell, z**2, minlength=cells)
        self._count += np.bincount(cell, minlength=cells)

    @property
    def measured(self) -> Bools:
        """Cells (rows, columns) with ground points, south row first; other heights are filled."""
        return (self._count > 0).reshape(self.grid.shape)

    def filled_share(self) -> float:
        """Share of filled cells in the scanned area: measured cells and gaps of 5 m between."""
        reach = int(np.ceil(_GAP_M / 2 / self.grid.cell_size_m))
        known = np.pad(self.measured, reach)
        away = ndimage.distance_transform_cdt(~known, "chessboard") if known.any() else known
        grown = away <= reach
        area = ndimage.distance_transform_cdt(np.pad(grown, 1), "chessboard")[1:-1, 1:-1] > reach
        area |= known
        return 1 - float(known.sum()) / float(area.sum()) if known.any() else 1.0

    def noise_m(self) -> float:
        """Median spread (one sigma) of the ground points of a cell; NaN where none has enough."""
        many = self._count >= _NOISE_POINTS
        if not many.any():
            return float("nan")
        count = self._count[many]
        variance = (self._square[many] - self._total[many] ** 2 / count) / (count - 1)
        return float(np.median(np.sqrt(np.maximum(variance, 0))))

    def heights_m(self, fill_m: float) -> Floats32:
        """Heights (rows, columns), south row first; NaN further than ``fill_m`` from ground.

        Gaps take the inverse-distance mean of the ground around them.
        """
        known = self.measured
        mean = np.divide(self._total, self._count, out=np.zeros_like(self._total), where=known.flat)
        # Filled relative to the mean height, so that single precision keeps the millimetres.
        level = float(mean[known.ravel()].mean()) if known.any() else 0.0
        image = np.where(known, mean.reshape(self.grid.shape) - level, 0.0).astype(np.float32)
        reach = fill_m / self.grid.cell_size_m
        filled = fillnodata(image, mask=known.astype(np.uint8), max_search_distance=reach)
        reached = fillnodata(
            known.astype(np.float32), mask=known.astype(np.uint8), max_search_distance=reach
        )
        return np.where(reached > 0, filled + np.float32(level), np.float32(np.nan))
