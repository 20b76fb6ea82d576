"""What a plan's sensors share, and how much data they make."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from shapely import LineString, line_locate_point
from shapely import points as shapely_points

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.placement.sensors.aimed import Camera, Rosette
from roadsight.placement.sensors.sensors import AnySensor, Sensor


def stations_m(edges: Sequence[LineString], xy_m: Floats) -> Floats:
    """Place (n,) of each point along the longest edge."""
    longest = max(edges, key=lambda edge: edge.length)
    return np.asarray(line_locate_point(longest, shapely_points(xy_m)))


def handover(times_seen: Ints) -> dict[str, Any]:
    """How many sensors see each target (n,): share of two and more, mean, and targets by number."""
    count = max(len(times_seen), 1)
    return {
        "share_seen_by_two": float((times_seen >= 2).sum() / count),
        "mean_sensors": float(times_seen.sum() / count),
        "targets_by_sensors": np.bincount(times_seen, minlength=2).tolist(),
    }


def overlaps(
    seen: Bools, target_station_m: Floats, sensor_station_m: Floats, cell_m: float
) -> list[dict[str, Any]]:
    """Length of road on which each sensor and the next one along it see the same targets.

    Parameters
    ----------
    seen : (sensors, targets). target_station_m, sensor_station_m : places along the road.
    cell_m : the road is counted in stretches of so much.

    Returns
    -------
    sensor and next (numbers from 0), targets (that both see) and length_m, along the road
    """
    order = np.argsort(sensor_station_m, kind="stable")
    stretch = np.floor(target_station_m / cell_m).astype(np.int64)
    found = []
    for one, two in pairwise(order):
        both = seen[one] & seen[two]
        length = float(len(np.unique(stretch[both])) * cell_m)
        found.append(
            {"sensor": int(one), "next": int(two), "targets": int(both.sum()), "length_m": length}
        )
    return found


def data_rates(sensor: AnySensor, frames_hz: float) -> dict[str, float]:
    """Points (LiDAR) or pixels (camera) that a sensor measures in a second; nothing for radars.

    Parameters
    ----------
    frames_hz : turns of spinning LiDARs that state none, and frames of cameras, in a second.
    """
    if isinstance(sensor, Sensor):
        turns_hz = frames_per_s(sensor, frames_hz)
        return {"points_per_s": sensor.rows * sensor.columns * turns_hz}
    if isinstance(sensor, Rosette):
        return {"points_per_s": sensor.points_per_s}
    if isinstance(sensor, Camera):
        return {"pixels_per_s": sensor.columns_px * sensor.rows_px * frames_hz}
    return {}


def frames_per_s(sensor: AnySensor, frames_hz: float) -> float:
    """How many simulated scans a sensor makes in a second; 0 where they are no points."""
    if isinstance(sensor, Rosette):
        return 1 / sensor.frame_s
    if isinstance(sensor, Sensor):
        return frames_hz if sensor.rotation_hz is None else sensor.rotation_hz
    return 0.0
