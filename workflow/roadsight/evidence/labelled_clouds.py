"""Labelled clouds: surveyed towns from the air, and street scans thinned as their figures ask.

The towns are Delft and a street of Amsterdam, whose survey covers some of the streets. Found
pavement is judged within 5 m of surveyed area, where the cloud has points and neither a building
nor water lies.
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

from roadsight.base.arrays import Bools, Bytes, Floats, Ints
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


ROAD = (40, 60)  # SemanticKITTI labels of the carriageway: road, lane marking.
GROUND = (40, 44, 48, 49, 60, 72)  # Road, parking, sidewalk, other ground, lane marking, terrain.
UNLABELLED = (0, 1)
OUTLIER = 1
FIRST_MOVING = 250  # Labels above this are of moving things.
NEAREST_M = 2.5  # Nearer points are of the vehicle itself.


@dataclass(frozen=True)
class Street:
    """Points of all frames in one local metre frame.

    Parameters
    ----------
    xyz_m : (n, 3). label, scan : (n,). intensity : (n,).
    scanner_m : (frames, 3) where each scan was taken. world_from_scanner : (frames, 3, 3).
    """

    xyz_m: Floats
    label: Ints
    scan: Ints
    intensity: Floats
    scanner_m: Floats
    world_from_scanner: Floats

    def select(self, keep: Bools | Ints) -> Street:
        """The same street with some of its points."""
        return Street(
            self.xyz_m[keep],
            self.label[keep],
            self.scan[keep],
            self.intensity[keep],
            self.scanner_m,
            self.world_from_scanner,
        )

    @property
    def still(self) -> Bools:
        """Points that are neither outliers nor of moving things."""
        return (self.label != OUTLIER) & (self.label <= FIRST_MOVING)

    @property
    def range_m(self) -> Floats:
        """Horizontal distance of each point from its scanner."""
        offset = self.xyz_m[:, :2] - self.scanner_m[self.scan, :2]
        return np.hypot(offset[:, 0], offset[:, 1])


def read_street(folder: Path) -> Street:
    """Read a street scan."""
    cloud = read_laz(folder / "frames.laz")
    poses = pd.read_csv(folder / "poses.csv")
    names = [f"world_from_sensor_r{i}{j}" for i in range(3) for j in range(3)]
    rotation = poses[names].to_numpy(np.float64)
    return Street(
        cloud.xyz,
        np.load(folder / "labels.npz")["label"].astype(np.int64),
        np.asarray(cloud.dims["point_source_id"], np.int64),
        np.asarray(cloud.dims["intensity"], np.float64),
        poses[["x_m", "y_m", "z_m"]].to_numpy(np.float64),
        rotation.reshape(-1, 3, 3),
    )


def first_per_cell(xyz_m: Floats, cell_m: float) -> Ints:
    """Numbers of the first point of each cubic cell, in their order."""
    cell = np.floor(xyz_m / cell_m).astype(np.int64)
    cell -= cell.min(axis=0)
    size = cell.max(axis=0) + 1
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    return np.sort(np.unique(key, return_index=True)[1])


def ground_points(street: Street, cell_m: float = 0.04, farthest_m: float = 45.0) -> Street:
    """Points on which ground and pavement are judged: still, 2.5 to 45 m, one a 4 cm cell."""
    reach = street.range_m
    near = street.select(street.still & (reach >= NEAREST_M) & (reach <= farthest_m))
    return near.select(first_per_cell(near.xyz_m, cell_m))


def f1(found: Bools, truth: Bools) -> float:
    """Harmonic mean of precision and recall; 1 where there is nothing to find and nothing found."""
    both = int((found & truth).sum())
    total = int(found.sum()) + int(truth.sum())
    return 2 * both / total if total else 1.0
