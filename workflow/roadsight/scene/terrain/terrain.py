"""Ground labels and terrain model of a whole site, tile by tile."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from rasterio.fill import fillnodata

from roadsight.base.arrays import Bools, Floats, Floats32
from roadsight.scene.grids import Grid, lowest_per_cell
from roadsight.scene.terrain.ground import GroundSettings, coarse_at, coarse_ground, ground_mask

Bounds = tuple[float, float, float, float]
Tiles = Callable[[float], Iterator[tuple[Bounds, Floats]]]
"""Function of a halo in metres that yields (core bounds, (n, 3) points of core and halo)."""

_HALO_PILLARS = 8
"""Pillars around a tile whose points are read with it: more than the filter over pillars looks to
either side, because gaps are filled from beyond them."""


def label_ground(
    tiles: Tiles, bounds_m: Bounds, settings: GroundSettings
) -> Iterator[tuple[Floats, Bools]]:
    """Ground labels of each tile.

    Parameters
    ----------
    tiles : the cloud. bounds_m : west, south, east, north of it.

    Yields
    ------
    (n, 3) points of a tile's core and (n,) whether they are ground.
    """
    grid = Grid.over(*bounds_m, settings.coarse_cell_m)
    lowest = np.full(grid.shape, np.nan)
    for _, points in tiles(0.0):
        np.fmin(lowest, lowest_per_cell(grid, *points.T), out=lowest)
    surface, slope = coarse_ground(lowest, settings)
    for core, points in tiles(_HALO_PILLARS * settings.pillar_width_m):
        x, y, z = points.T
        mask = ground_mask(x, y, z, *coarse_at(grid, surface, slope, x, y), settings)
        west, south, east, north = core
        own = (x >= west) & (x < east) & (y >= south) & (y < north)
        yield points[own], mask[own]


class TerrainModel:
    """Mean ground height per cell, gathered tile by tile.

    Parameters
    ----------
    bounds_m : west, south, east, north, local metres. cell_size_m : side of a cell.
    """

    def __init__(self, bounds_m: Bounds, cell_size_m: float) -> None:
        self.grid = Grid.over(*bounds_m, cell_size_m)
        self._total = np.zeros(self.grid.rows * self.grid.columns)
        self._count = np.zeros(len(self._total), np.int64)

    def add(self, ground_m: Floats) -> None:
        """Add ground points (n, 3)."""
        cell = self.grid.flat(ground_m[:, 0], ground_m[:, 1])
        self._total += np.bincount(cell, ground_m[:, 2], minlength=len(self._total))
        self._count += np.bincount(cell, minlength=len(self._total))

    def heights_m(self, fill_m: float) -> Floats32:
        """Heights (rows, columns), south row first; NaN further than ``fill_m`` from ground.

        Gaps take the inverse-distance mean of the ground around them.
        """
        known = (self._count > 0).reshape(self.grid.shape)
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
