"""What stands between a sensor and the targets that it does not see (paper 1, Appendix B).

Each sight line is cast on its own, so the answer does not depend on the sensor's resolution; where
it ends is the obstacle. The paper's way goes by the cells of the depth map (`CellPoints`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from pandas.core.groupby import DataFrameGroupBy
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Floats32, Ints
from roadsight.base.errors import InputError
from roadsight.placement.sensors.rays import NOT_CAST_M, sensor_from_local, spherical_from_sensor
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.detection import target_ranges

# Names of the objects at places (n, 3), empty where there is none.
ObjectsAt = Callable[[Floats], NDArray[np.object_]]
# Ranges (n,) of rays from one origin (3,) along unit directions (n, 3); 0 or infinity for none.
Cast = Callable[[Floats, Floats], Floats]
# Heights on a target, as shares of its own, to which sight lines are cast.
_LEVELS = (0.25, 0.5, 0.75, 1.0)
_NEAR_M = 0.4  # a hit this near to the target is the pavement or the target's own surroundings
CUBE_M = 1.0  # edge of the cubes in which obstacles are gathered
NEAREST = 8  # candidates at which an uncovered target is judged
# What is told of the sight lines of a pair.
_COLUMNS = ["blocked_share", "obstacle_x", "obstacle_y", "obstacle_z"]


def blocked_sight_lines(pairs: pd.DataFrame, target_height_m: float, cast: Cast) -> pd.DataFrame:
    """Sight lines of sensor-target pairs and where they are blocked.

    Parameters
    ----------
    pairs : columns candidate, sensor_x, sensor_y, sensor_z and x, y, z (foot of the target), local
        metres.
    target_height_m : height of a target. cast : the scene.

    Returns
    -------
    index of ``pairs`` with blocked_share (0 to 1 over the lines to the target) and obstacle_x, _y,
    _z (on the lowest blocked line, NaN where none is).
    """
    parts = [
        _lines_of_sensor(group, target_height_m, cast)
        for _, group in pairs.groupby("candidate", sort=True)
    ]
    if not parts:
        return pd.DataFrame(columns=_COLUMNS, index=pairs.index, dtype=np.float64)
    return pd.concat(parts).reindex(pairs.index)


def _lines_of_sensor(pairs: pd.DataFrame, target_height_m: float, cast: Cast) -> pd.DataFrame:
    sensor = pairs[["sensor_x", "sensor_y", "sensor_z"]].to_numpy(np.float64)[0]
    blocked = np.zeros((len(pairs), len(_LEVELS)), dtype=bool)
    hits = np.full((len(pairs), 3), np.nan)
    # From the top down, so that the hit of the lowest blocked line is what stays.
    for column, level in reversed(list(enumerate(_LEVELS))):
        way = pairs[["x", "y", "z"]].to_numpy(np.float64) - sensor
        way[:, 2] += level * target_height_m
        length = np.linalg.norm(way, axis=1)
        way[length == 0, 2] = 1.0  # any direction will do: nothing is nearer than the sensor itself
        direction = way / np.linalg.norm(way, axis=1, keepdims=True)
        reach = np.asarray(cast(sensor, direction), np.float64)
        hit = (reach > 0) & (reach < length - _NEAR_M)
        hits[hit] = sensor + reach[hit, None] * direction[hit]
        blocked[:, column] = hit
    table = np.column_stack([blocked.mean(axis=1), hits])
    return pd.DataFrame(table, columns=_COLUMNS, index=pairs.index)


def group_obstacles(lines: pd.DataFrame) -> pd.DataFrame:
    """Obstacles by cubic metre: where they are and how much they hide.

    Parameters
    ----------
    lines : columns target, candidate and those of `blocked_sight_lines`.

    Returns
    -------
    x, y, z (mean of the hits), sight_lines, targets (distinct), sensors (distinct), names of both;
    the greatest first, ties by place.
    """
    lines = lines[lines["blocked_share"] > 0]
    keys = [(lines[f"obstacle_{axis}"] // CUBE_M).rename(axis) for axis in "xyz"]
    groups = lines.groupby(keys, sort=True)
    table = _hidden_by(groups)
    table["target"], table["candidate"] = groups["target"].first(), groups["candidate"].first()
    return table.sort_values("targets", ascending=False, kind="stable").reset_index(drop=True)


def _hidden_by(groups: DataFrameGroupBy) -> pd.DataFrame:
    """What hits of each group hide: their mean place, sight lines, distinct targets and sensors."""
    return pd.DataFrame(
        {
            "x": groups["obstacle_x"].mean(),
            "y": groups["obstacle_y"].mean(),
            "z": groups["obstacle_z"].mean(),
            "sight_lines": groups.size(),
            "targets": groups["target"].nunique(),
            "sensors": groups["candidate"].nunique(),
        }
    )


OBJECT_NEAR_M = 0.6  # a hit is of an object with a surfel so near: half a cube and a surfel's size


def object_finder(members: pd.DataFrame) -> ObjectsAt:
    """Function that tells the object at each place, empty where none is near.

    Parameters
    ----------
    members : surfels of objects, columns x, y, z (local metres) and object.
    """
    if members.empty:
        return lambda places_m: np.full(len(places_m), "", object)
    centres_m = members[["x", "y", "z"]].to_numpy(np.float64)
    tree = cKDTree(centres_m, balanced_tree=False, compact_nodes=False)

    def objects_at(places_m: Floats) -> NDArray[np.object_]:
        distance_m, near = tree.query(places_m, distance_upper_bound=OBJECT_NEAR_M)
        known = np.isfinite(distance_m)
        names = np.full(len(places_m), "", object)
        names[known] = members["object"].iloc[near[known]].astype(str)
        return names

    return objects_at


def by_object(lines: pd.DataFrame, objects_at: ObjectsAt) -> pd.DataFrame:
    """Obstacles gathered to objects: what each object hides.

    Parameters
    ----------
    lines : as `group_obstacles` takes them. objects_at : as `object_finder` gives it.

    Returns
    -------
    object, x, y, z (mean of the hits), sight_lines, targets and sensors (distinct); the greatest
    first.
    """
    hits = lines[lines["blocked_share"] > 0]
    place = [f"obstacle_{axis}" for axis in "xyz"]
    hits = hits.assign(object=objects_at(hits[place].to_numpy(np.float64)))
    hits = hits[hits["object"] != ""]
    if hits.empty:
        names = ["object", "x", "y", "z", "sight_lines", "targets", "sensors"]
        return pd.DataFrame(columns=names)
    table = _hidden_by(hits.groupby("object", sort=True)).reset_index()
    return table.sort_values("targets", ascending=False, kind="stable").reset_index(drop=True)


def pairs_in_range(sensors: pd.DataFrame, targets: pd.DataFrame, range_m: Floats) -> pd.DataFrame:
    """All sensor-target pairs no further apart than the sensor's range.

    Parameters
    ----------
    sensors : columns candidate, x, y, z. targets : columns target, x, y, z. range_m : per sensor.

    Returns
    -------
    columns candidate, sensor_x, sensor_y, sensor_z, target, x, y, z, distance_m.
    """
    place = sensors[["x", "y", "z"]].to_numpy(np.float64)
    foot = targets[["x", "y", "z"]].to_numpy(np.float64)
    distance = np.linalg.norm(place[:, None] - foot[None], axis=2)
    row, column = np.nonzero(distance <= np.asarray(range_m)[:, None])
    pairs = pd.DataFrame(foot[column], columns=["x", "y", "z"])
    pairs[["sensor_x", "sensor_y", "sensor_z"]] = place[row]
    pairs["candidate"] = sensors["candidate"].to_numpy()[row]
    pairs["target"] = targets["target"].to_numpy()[column]
    pairs["distance_m"] = distance[row, column]
    return pairs


def explain_gaps(
    targets: pd.DataFrame,
    candidates: pd.DataFrame,
    range_m: float,
    target_height_m: float,
    cast: Cast,
) -> pd.DataFrame:
    """Why no candidate sees a target, judged at its nearest candidates.

    Parameters
    ----------
    targets : columns target, x, y, z. candidates : columns candidate, x, y, z.
    range_m : longest range of the plan's sensors. cast : the scene.

    Returns
    -------
    a row per target: target, x, y, z, reason ("out of range", "hidden" where most sight lines are
    blocked, else "too few beams"), nearest_m, blocked_share, and the obstacle_x, _y, _z and
    candidate of the nearest candidate that is most blocked.

    Raises
    ------
    InputError : there is no candidate.
    """
    if candidates.empty:
        raise InputError("no candidate at which to judge the uncovered targets")
    place = candidates[["x", "y", "z"]].to_numpy(np.float64)
    foot = targets[["x", "y", "z"]].to_numpy(np.float64)
    count = min(NEAREST, len(candidates))
    distance, near = cKDTree(place).query(foot, k=count)
    distance, near = distance.reshape(-1, count), near.reshape(-1, count)
    pairs = targets[["target", "x", "y", "z"]].loc[targets.index.repeat(count)]
    pairs = pairs.reset_index(drop=True)
    pairs[["sensor_x", "sensor_y", "sensor_z"]] = place[near.ravel()]
    pairs["candidate"] = candidates["candidate"].to_numpy()[near.ravel()]
    lines = pairs.join(blocked_sight_lines(pairs, target_height_m, cast))
    share = lines["blocked_share"].to_numpy().reshape(-1, count)
    worst = np.arange(len(targets)) * count + share.argmax(axis=1)
    gaps = lines.iloc[worst].reset_index(drop=True)
    gaps["blocked_share"], gaps["nearest_m"] = share.mean(axis=1), distance[:, 0]
    gaps["reason"] = np.select(
        [gaps["nearest_m"] > range_m, gaps["blocked_share"] > 0.5],
        ["out of range", "hidden"],
        "too few beams",
    )
    return gaps


# Obstacles by the sensor's angular cells, as published (paper 1, Appendix B, Fig. B.1a): where the
# depth map of a target has the range r_t and that of the scene r_s < r_t, the points of the cell
# whose ranges lie between the two are obstacles. Targets are judged one by one.


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
    pairs: pd.DataFrame, xyz_m: NDArray[np.floating], found: Sequence[tuple[Ints, float]]
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
