"""Towns from the air with their surveyed paved area: Delft, and a street of Amsterdam.

The survey covers some of the streets. Found pavement is judged within 5 m of surveyed area, where
the cloud has points and neither a building nor water lies.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyogrio
import shapely
from rasterio import features
from rasterio.transform import Affine
from scipy import ndimage

from roadsight.base.arrays import Bools, Bytes, Floats
from roadsight.io.cloud.clouds import read_laz
from roadsight.scene.grids import Grid

REACH_M = 5.0  # What lies farther from surveyed area is unknown.
_CELL_M = 0.25
_BUILDING = 6
_WATER = 9
_GROUND = 2
_CLOSING_CELLS = 3  # Gaps between the points of an airborne cloud of 15 points a square metre.
_BORDER_M = 2.0  # Edges this near to the cloud's border are those of the cloud.


@dataclass(frozen=True)
class Survey:
    """Cloud and surveyed area in one local metre frame.

    Parameters
    ----------
    xyz_m : (n, 3). intensity, classification : (n,). paved : surveyed area.
    grid : cells on which areas are compared. known : (rows, columns) cells that are judged.
    """

    xyz_m: Floats
    intensity: Floats
    classification: Bytes
    paved: shapely.Geometry
    grid: Grid
    known: Bools

    @property
    def judged(self) -> shapely.Geometry:
        """Box in which edges are compared."""
        low, high = self.xyz_m[:, :2].min(axis=0), self.xyz_m[:, :2].max(axis=0)
        return shapely.box(*(low + _BORDER_M), *(high - _BORDER_M))

    def cells_of(self, area: shapely.Geometry) -> Bools:
        """Cells (rows, columns) whose centre lies in an area."""
        cell = self.grid.cell_size_m
        place = Affine(cell, 0, self.grid.west * cell, 0, cell, self.grid.south * cell)
        found = features.rasterize([(area, 1)], out_shape=self.grid.shape, transform=place)
        return found.astype(bool)

    def area_of(self, points_m: Floats) -> Bools:
        """Cells (rows, columns) that points (n, 3) cover, gaps between them closed."""
        count = np.zeros(self.grid.rows * self.grid.columns, np.int64)
        np.add.at(count, self.grid.flat(points_m[:, 0], points_m[:, 1]), 1)
        padded = np.pad(count.reshape(self.grid.shape) > 0, _CLOSING_CELLS)
        closed = ndimage.binary_closing(padded, iterations=_CLOSING_CELLS)
        return closed[_CLOSING_CELLS:-_CLOSING_CELLS, _CLOSING_CELLS:-_CLOSING_CELLS]

    def outline_of(self, points_m: Floats) -> shapely.Geometry:
        """The same as an area."""
        cell = self.grid.cell_size_m
        covered = self.area_of(points_m)
        place = Affine(cell, 0, self.grid.west * cell, 0, cell, self.grid.south * cell)
        shapes = features.shapes(covered.astype(np.uint8), mask=covered, transform=place)
        return shapely.union_all([shapely.geometry.shape(found) for found, _ in shapes])


def read_survey(files: Sequence[Path]) -> Survey:
    """Read the cloud and the surveyed polygons of roads and bridges, all in EPSG:28992.

    Parameters
    ----------
    files : one .laz, and layers: .sqlite, or .csv with a column `polygon` of vertices as JSON.
    """
    cloud = read_laz(next(path for path in files if path.suffix == ".laz"))
    origin = np.append(np.floor(cloud.xyz[:, :2].min(axis=0)), 0.0)
    xyz_m = cloud.xyz - origin
    layers = []
    for path in files:
        if path.suffix == ".csv":
            rings = pd.read_csv(path)["polygon"].map(json.loads)
            drawn = np.array([shapely.Polygon(ring) for ring in rings], object)
            layers.append(shapely.make_valid(drawn))
        elif path.suffix != ".laz":
            layers.append(pyogrio.read_dataframe(path).geometry.to_numpy())
    paved = shapely.union_all(np.concatenate(layers))
    paved = shapely.transform(shapely.force_2d(paved), lambda xy: xy - origin[:2])
    grid = Grid.around(xyz_m[:, 0], xyz_m[:, 1], _CELL_M)
    classes = np.asarray(cloud.dims["classification"], np.uint8)
    survey = Survey(
        xyz_m,
        np.asarray(cloud.dims["intensity"], np.float64),
        classes,
        paved,
        grid,
        np.zeros(grid.shape, bool),
    )
    near = survey.cells_of(paved.buffer(REACH_M))
    covered = survey.area_of(xyz_m)
    building = survey.area_of(xyz_m[classes == _BUILDING])
    open_ground = survey.area_of(xyz_m[classes == _GROUND])
    water = survey.area_of(xyz_m[classes == _WATER])
    known = near & covered & ~(building & ~open_ground) & ~water
    return Survey(xyz_m, survey.intensity, classes, paved, grid, known)
