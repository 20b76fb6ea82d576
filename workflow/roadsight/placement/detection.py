"""Which targets a sensor sees (paper 1, section 2.5, Fig. 15).

The paper renders a depth map of every target and counts the beams on which the target is nearer
than the scene. Here the same count comes from the target's angular footprint alone: a target is an
upright, solid, capped cylinder, and in the vertical plane of one azimuth it is a rectangle.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from roadsight.placement.rays import sensor_from_local
from roadsight.placement.sensors import Sensor

_FLOATS = NDArray[np.float64]
_INTS = NDArray[np.int32]

MIN_BEAMS = 8
"""A target is seen when more beams than this return from it (paper 1, Table 3)."""


def count_hits(
    range_m: NDArray[np.float32],
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    targets_xyz_m: NDArray[np.floating],
    radius_m: float = 0.25,
    height_m: float = 0.6,
) -> _INTS:
    """Number of beams that return from each target (n,).

    A beam returns from a target if it meets the cylinder within the sensor's range and nearer than
    anything in the scene; equal ranges are the scene's. The pavement needs no tolerance: a cylinder
    stands on it, so a beam that meets both meets the cylinder first, and where the pavement bulges
    above the foot it does hide it. A sensor inside a target sees nothing of it; right above one it
    sees the top.

    Parameters
    ----------
    range_m : depth map of the scene, (rows, columns), 0 where nothing returns.
    position_m : (3,) of the sensor, local metres. yaw_deg : its x axis from local x,
        counter-clockwise.
    targets_xyz_m : (n, 3) feet of the targets, local metres.
    radius_m, height_m : of every target.
    """
    feet = sensor_from_local(targets_xyz_m, position_m, yaw_deg)
    azimuth = np.radians(sensor.azimuth_deg)
    elevation = np.radians(sensor.elevation_deg)
    return _count(
        range_m,
        np.column_stack([np.cos(azimuth), np.sin(azimuth)]),
        np.tan(elevation),
        1 / np.cos(elevation),
        sensor.azimuth_min_deg,
        sensor.azimuth_cell_deg,
        sensor.range_m,
        np.ascontiguousarray(feet),
        radius_m,
        height_m,
    )


@njit(cache=True)
def _count(
    depth_m: NDArray[np.float32],
    heading: _FLOATS,
    slope: _FLOATS,
    secant: _FLOATS,
    start_deg: float,
    cell_deg: float,
    max_range_m: float,
    feet: _FLOATS,
    radius_m: float,
    height_m: float,
) -> _INTS:
    """Beams on each target: ``heading`` (columns, 2), ``slope`` and ``secant`` (rows,)."""
    hits = np.zeros(len(feet), np.int32)
    columns = len(heading)
    for target in range(len(feet)):
        x, y, low = feet[target]
        distance = np.sqrt(x * x + y * y)
        if distance - radius_m >= max_range_m:
            continue
        first, last = _columns_across(x, y, distance, radius_m, start_deg, cell_deg, columns)
        for number in range(first, last):
            column = number % round(360.0 / cell_deg) if number >= columns else number
            if column < columns:
                near, far = _chord(x, y, heading[column, 0], heading[column, 1], radius_m)
                if far > 0.0:
                    hits[target] += _count_column(
                        depth_m[:, column], slope, secant, near, far, low, low + height_m, max_range_m
                    )
    return hits


@njit(cache=True)
def _chord(x: float, y: float, cosine: float, sine: float, radius_m: float) -> tuple[float, float]:
    """Horizontal distances at which an azimuth enters and leaves a circle; (0, 0) if it misses."""
    along, beside = x * cosine + y * sine, x * sine - y * cosine
    half = radius_m * radius_m - beside * beside
    if half < 0.0:
        return 0.0, 0.0
    half = np.sqrt(half)
    return along - half, along + half
