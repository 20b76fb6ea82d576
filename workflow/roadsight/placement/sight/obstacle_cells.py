"""Obstacles by the sensor's angular cells, as published (paper 1, Appendix B, Fig. B.1a).

The points of the scene are partitioned into the cells of a sensor's depth map. Where the depth map
of a target has the range r_t and that of the scene, at the same place, r_s < r_t, the points of the
cell whose ranges lie between the two are obstacles; else the target's point there is not occluded.
Targets are judged one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Floats, Floats32, Ints
from roadsight.placement.sensors.rays import (
    NOT_CAST_M,
    sensor_from_local,
    spherical_from_sensor,
)
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.detection import target_ranges
from roadsight.placement.sight.obstacles import CUBE_M


@dataclass(frozen=True)
class CellPoints:
    """Points by cell, the nearest first in each: the paper's cell matrix.

    Parameters
    ----------
    order : (k,) numbers of points. range_m : (k,) theirs. start : (cells + 1,) where each cell,
        row by row, begins.
    """

    order: Ints
    range_m: Floats
    start: Ints

    def between(self, cell: int, near_m: float, far_m: float) -> Ints:
        """Points of a cell whose ranges lie between two, both included."""
        first, last = self.start[cell : cell + 2]
        own = self.range_m[first:last]
        low = np.searchsorted(own, near_m, side="left")
        return self.order[first + low : first + np.searchsorted(own, far_m, side="right")]


def points_by_cell(
    xyz_m: NDArray[np.floating], sensor: Sensor, position_m: ArrayLike, yaw_deg: float
) -> CellPoints:
    """Points (n, 3) within a sensor's range, local metres, by the cells of its depth map."""
    azimuth, elevation, range_m = spherical_from_sensor(
        sensor_from_local(xyz_m, position_m, yaw_deg)
    )
    row = np.searchsorted(sensor.elevation_edges_deg, elevation, side="right") - 1
    column = ((azimuth - sensor.azimuth_min_deg) % 360.0 / sensor.azimuth_cell_deg).astype(np.int64)
    if sensor.azimuth_max_deg - sensor.azimuth_min_deg == 360.0:
        column %= sensor.columns
    inside = (range_m > 0) & (range_m < sensor.range_m) & (column < sensor.columns)
    found = np.flatnonzero(inside & (row >= 0) & (row < sensor.rows))
    cell = row[found] * sensor.columns + column[found]
    order = np.lexsort((range_m[found], cell))
    counts = np.bincount(cell, minlength=sensor.rows * sensor.columns)
    found = found[order]
    return CellPoints(found, range_m[found], np.concatenate([[0], np.cumsum(counts)]))


def obstacles_of_target(
    cells: CellPoints,
    scene_m: Floats32,
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    foot_m: Floats,
    size_m: tuple[float, float],
    step_m: float = 0.0,
) -> tuple[Ints, float]:
    """Points that hide a target, in increasing order, and the share of its cells that are hidden.

    Parameters
    ----------
    scene_m : (rows, columns), 0 where nothing returns; cells of beams that were not cast hide
        nothing. foot_m : (3,). size_m : radius and height.
    step_m : to which the ranges of ``scene_m`` are rounded.
    """
    row, column, target_m = target_ranges(sensor, position_m, yaw_deg, foot_m, *size_m)
    near_m = scene_m[row, column].astype(np.float64)
    hidden = (near_m > NOT_CAST_M) & (near_m < target_m)
    numbers = row * sensor.columns + column
    parts = [
        cells.between(int(numbers[k]), near_m[k] - step_m, target_m[k])
        for k in np.flatnonzero(hidden)
    ]
    share = float(hidden.mean()) if len(hidden) else 0.0
    return np.unique(np.concatenate([np.empty(0, np.int64), *parts])), share


def cell_lines(
    pairs: pd.DataFrame,
    xyz_m: NDArray[np.floating],
    found: Sequence[tuple[Ints, float]],
) -> pd.DataFrame:
    """Obstacles of sensor-target pairs by cubic metre, in the form of `blocked_sight_lines`.

    Parameters
    ----------
    pairs : columns candidate and target. xyz_m : (n, 3) points of the scene, local metres.
    found : points that hide each pair's target, and the share that they hide.

    Returns
    -------
    one row a pair and cube: candidate, target, blocked_share, obstacle_x, _y, _z (the mean of the
    points).
    """
    counts = [len(points) for points, _ in found]
    chosen = np.concatenate([np.empty(0, np.int64), *(points for points, _ in found)])
    place = np.asarray(xyz_m[chosen], np.float64).reshape(-1, 3)
    lines = pairs[["candidate", "target"]].loc[pairs.index.repeat(counts)].reset_index(drop=True)
    lines["blocked_share"] = np.repeat([share for _, share in found], counts).astype(np.float64)
    cubes = []
    for axis, values in zip("xyz", place.T, strict=True):
        lines[f"obstacle_{axis}"] = values
        cubes.append((lines[f"obstacle_{axis}"] // CUBE_M).rename(axis))
    by = [lines["candidate"], lines["target"], *cubes]
    means = lines.groupby(by, sort=True)[[name for name in lines if name not in pairs]].mean()
    return means.droplevel([2, 3, 4]).reset_index()
