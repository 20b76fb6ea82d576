"""Ground, terrain, density and passing traffic."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from roadsight.base.arrays import Numbers
from roadsight.base.sections.scene import GroundFilter
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import read_raster, write_raster
from roadsight.scene.grids import Grid
from roadsight.scene.profile import mean_spacing_m
from roadsight.scene.terrain.registration import Registration
from roadsight.scene.terrain.terrain import TerrainModel
from roadsight.scene.traffic import Columns, is_traffic
from roadsight.scene.whole import ground_of
from roadsight_hardcases.case import Errors, hard_case


def _lowest_in_pillar(xyz: Numbers) -> Numbers:
    """Ground by the published rule."""
    return ground_of(xyz, GroundFilter(method="pillars"))


def _ground(xyz: Numbers) -> Numbers:
    """Ground by the stage's own filter."""
    return ground_of(xyz)


def _street(rng: np.random.Generator, side_m: float = 30.0) -> Numbers:
    x, y = rng.uniform(0, side_m, (2, int(60 * side_m**2)))
    return np.column_stack([x, y, 0.02 * x + rng.normal(0, 0.01, len(x))])


@hard_case("build_dem", bound=0.005, unit="share of the road lost")
def returns_from_below_the_road(rng: np.random.Generator) -> Errors:
    """Multipath puts points metres below the road, and the lowest point is taken for ground."""
    road = _street(rng)
    false = np.column_stack([rng.uniform(0, 30, (240, 2)), rng.uniform(-4, -1, 240)])
    xyz = np.concatenate([road, false])
    return 1 - _lowest_in_pillar(xyz)[: len(road)].mean(), 1 - _ground(xyz)[: len(road)].mean()


@hard_case("build_dem", bound=0.01, unit="share of roofs called ground, and of road lost")
def nothing_below_a_roof(rng: np.random.Generator) -> Errors:
    """Below a parked vehicle there is no ground return, so its roof is the lowest point."""
    road = _street(rng)
    hidden = (np.abs(road[:, 0] - 12) < 2.2) & (np.abs(road[:, 1] - 14) < 0.9)
    roof = np.column_stack([rng.uniform(9.8, 14.2, 900), rng.uniform(13.1, 14.9, 900)])
    roof = np.column_stack([roof, 1.5 + 0.02 * roof[:, 0]])
    xyz = np.concatenate([road[~hidden], roof])
    naive, ours = (np.split(part, [-900]) for part in (_lowest_in_pillar(xyz), _ground(xyz)))
    return naive[1].mean() + 1 - naive[0].mean(), ours[1].mean() + 1 - ours[0].mean()


@hard_case("build_dem", bound=0.01, unit="share of the road lost")
def scan_10_cm_above_another(rng: np.random.Generator) -> Errors:
    """Two scans of a street that do not fit: the upper one lies 0.1 m above the lowest points."""
    xyz = np.concatenate([_street(rng), np.add(_street(rng), [0.0, 0.0, 0.1])])
    return 1 - _lowest_in_pillar(xyz).mean(), 1 - _ground(xyz).mean()


@hard_case("build_dem", bound=0.001, unit="share of points in a wrong cell")
def cells_on_either_side_of_zero(rng: np.random.Generator) -> Errors:
    """Truncation to whole numbers makes the cell at the origin twice as wide."""
    x = rng.uniform(-2, 2, 5000)
    true = np.array([int(value // 0.5) for value in x])
    grid = Grid.around(x, x, 0.5)
    column, _ = grid.indices(x, x)
    naive = (x / 0.5).astype(int)
    return np.mean(naive != true), np.mean(column + grid.west != true)


@hard_case("build_dem", bound=0.02, unit="m")
def heights_beside_unknown_cells(rng: np.random.Generator) -> Errors:
    """Interpolation across cells without data mixes the number for no data into heights."""
    values = 3.0 + 0.01 * np.arange(20.0)[None, :] + np.zeros((20, 1))
    values[:, 8:11] = np.nan
    values[5:7] = np.nan
    frame = Frame((0.0, 0.0, 120.0))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "dem.tif")
        write_raster(path, values, frame, 0.0, 20.0, 1.0)
        raster = read_raster(path, frame)
    x, y = rng.uniform(0.5, 19.5, (2, 2000))
    filled = np.where(np.isnan(values), -9999.0, values)
    naive = ndimage.map_coordinates(filled, [20 - y - 0.5, x - 0.5], order=1, mode="nearest")
    ours, true = raster.sample(x, y), 3.0 + 0.01 * (x - 0.5)
    unknown = ndimage.map_coordinates(
        np.isnan(values).astype(float), [20 - y - 0.5, x - 0.5], order=1, mode="nearest"
    )
    # Where all cells around are known, a height must be given.
    given = (unknown == 0) | np.isfinite(ours)
    return np.abs(naive - true)[given].max(), np.abs(ours - true)[given].max()


@hard_case("build_dem", bound=0.005, unit="m")
def drives_6_cm_apart(rng: np.random.Generator) -> Errors:
    """Of two drives that do not fit, the spread of the ground says neither that nor how far."""
    xyz, apart_m = _street(rng), 0.06
    xyz[rng.random(len(xyz)) < 0.4, 2] += apart_m
    ground = _ground(xyz)
    layer, layers = TerrainModel((0, 0, 30, 30), 0.5), Registration()
    layer.add(xyz[ground])
    layers.add(xyz, ground, np.zeros(len(xyz), np.int64))
    told_m = sum(float(doubt.measured or 0) for doubt in layers.doubts())
    return abs(layer.noise_m() - apart_m), abs(told_m - apart_m)


@hard_case("profile_scene", bound=0.1, unit="share of the spacing")
def spacing_of_repeated_points(rng: np.random.Generator) -> Errors:
    """Overlapping scans repeat points, so that the distance to the nearest other one is zero."""
    x, y = np.meshgrid(0.1 * np.arange(120), 0.1 * np.arange(120))
    xyz = np.repeat(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), 2, axis=0)
    naive = float(np.median(cKDTree(xyz).query(xyz, 2)[0][:, 1]))
    return abs(naive / 0.1 - 1), abs(mean_spacing_m(xyz) / 0.1 - 1)


@hard_case("mark_traffic", bound=0.001, unit="share of a vehicle kept")
def unknown_height_in_a_column(rng: np.random.Generator) -> Errors:
    """One point of unknown height poisons the greatest height of its column."""
    xy = rng.uniform(0, 4, (2000, 2))
    height = rng.uniform(0.4, 1.8, 2000)
    height[::100] = np.nan
    grid = Grid.over(0, 0, 4, 4, 1.0)
    top = np.full(grid.rows * grid.columns, -np.inf)
    cell = grid.flat(*xy.T)
    np.maximum.at(top, cell, height)
    columns = Columns(grid)
    columns.add(xy, height)
    known, on = np.isfinite(height), np.ones(2000, bool)
    naive = on & (height > 0.3) & (top[cell] <= 4.5)
    ours = is_traffic(height, columns.top_m(xy), on, 0.3, 4.5)
    return 1 - naive[known].mean(), 1 - ours[known].mean()
