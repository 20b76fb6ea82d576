"""Which beams of a tilted sensor return from targets, exactly."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from roadsight.placement.detection import column_windows
from roadsight.placement.rays import beam_directions, sensor_from_local
from roadsight.placement.sensors import Sensor

_FLOATS = NDArray[np.float64]


def count_tilted_hits(
    range_m: NDArray[np.float32],
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    tilt: _FLOATS,
    targets_xyz_m: NDArray[np.floating],
    radius_m: float,
    height_m: float,
    max_range_m: float,
) -> NDArray[np.int32]:
    """Number of beams that return from each target (n,), as `count_hits` counts them.

    Every beam that may meet the sphere around a target is intersected with the upright cylinder.

    Parameters
    ----------
    tilt : rotation (3, 3) from the levelled to the mounted sensor, local frame.
    max_range_m : range from which targets return.
    """
    position = np.asarray(position_m, np.float64)
    feet = np.asarray(targets_xyz_m, np.float64) - position
    middles = feet + np.array([0.0, 0.0, height_m / 2])
    mounted = sensor_from_local(middles @ tilt + position, position, yaw_deg)
    return _count(
        range_m,
        beam_directions(sensor, yaw_deg, tilt),
        np.radians(sensor.elevation_deg),
        sensor.azimuth_min_deg,
        sensor.azimuth_cell_deg,
        max_range_m,
        feet,
        mounted,
        radius_m,
        height_m,
    )


@njit(cache=True)
def _count(
    depth_m: NDArray[np.float32],
    directions: NDArray[np.float32],
    elevation: _FLOATS,
    start_deg: float,
    cell_deg: float,
    max_range_m: float,
    feet: _FLOATS,
    mounted: _FLOATS,
    radius_m: float,
    height_m: float,
) -> NDArray[np.int32]:
    """Beams on each target: ``directions`` (rows, columns, 3), ``mounted`` (n, 3) their middles."""
    hits = np.zeros(len(feet), np.int32)
    around = np.sqrt(radius_m**2 + height_m**2 / 4)
    for target in range(len(feet)):
        x, y, z = mounted[target]
        distance = np.sqrt(x * x + y * y + z * z)
        if distance - around >= max_range_m:
            continue
        first_row, last_row = 0, len(elevation)
        if distance > around:
            middle, half = np.arctan2(z, np.sqrt(x * x + y * y)), np.arcsin(around / distance)
            first_row = np.searchsorted(elevation, middle - half)
            last_row = np.searchsorted(elevation, middle + half, side="right")
        windows = column_windows(x, y, around, start_deg, cell_deg, depth_m.shape[1])
        for first, last in windows:
            for row in range(first_row, last_row):
                for column in range(first, last + 1):
                    entry_m = entry_range_m(
                        directions[row, column], feet[target], radius_m, height_m
                    )
                    scene_m = depth_m[row, column]
                    if 0 < entry_m < max_range_m and (scene_m == 0 or entry_m < scene_m):
                        hits[target] += 1
    return hits


@njit(cache=True)
def entry_range_m(
    direction: NDArray[np.float32] | tuple[float, float, float],
    foot: _FLOATS,
    radius_m: float,
    height_m: float,
) -> float:
    """Range at which a beam from the origin enters an upright, capped cylinder; 0 if it does not.

    Parameters
    ----------
    direction : (3,) unit vector. foot : (3,) middle of the cylinder's lower cap.
    """
    east, north, up = float(direction[0]), float(direction[1]), float(direction[2])
    enter, leave = 0.0, np.inf
    if abs(up) > 1e-12:
        one, two = foot[2] / up, (foot[2] + height_m) / up
        enter, leave = max(enter, min(one, two)), min(leave, max(one, two))
    elif foot[2] > 0 or foot[2] + height_m < 0:
        return 0.0
    flat = east * east + north * north
    beside = foot[0] * foot[0] + foot[1] * foot[1] - radius_m * radius_m
    if flat < 1e-24:
        return enter if beside <= 0 and enter < leave else 0.0
    along = foot[0] * east + foot[1] * north
    squared = along * along - flat * beside
    if squared < 0:
        return 0.0
    root = np.sqrt(squared)
    enter, leave = max(enter, (along - root) / flat), min(leave, (along + root) / flat)
    return enter if enter < leave else 0.0
