"""Beams that are wider than a line: each counts by the share of its footprint on the target.

A beam that lies half beside its target returns a mixed range, between the target and what is behind
it, so that it counts for nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Floats, Floats32
from roadsight.base.kernels import compiled, compiled_part
from roadsight.placement.sensors.rays import sensor_from_local
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.detection import chord, column_windows, entry, rows_across

CLEAN_SHARE = 0.5  # least share of a footprint on a target, so that the range is the target's


def count_shared_hits(
    range_m: Floats32,
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    tilt: Floats | None,
    targets_xyz_m: NDArray[np.floating],
    radius_m: float,
    height_m: float,
    max_range_m: float,
) -> Floats:
    """Sum of the footprints' shares on each target (n,), of the beams that `count_hits` counts.

    A footprint is a rectangle of the sensor's divergence, widened by its aperture, across and
    upright. The silhouette is a rectangle as well: what the beam's own row and column see of the
    cylinder. Under a tilt the cylinder is taken as upright in the sensor's frame, which for a few
    degrees moves its top by centimetres.

    Parameters
    ----------
    tilt : rotation (3, 3) from the levelled to the mounted sensor, local frame, or None.
    max_range_m : range from which targets return.
    """
    position = np.asarray(position_m, np.float64)
    xyz_m = np.asarray(targets_xyz_m, np.float64)
    if tilt is not None:
        xyz_m = (xyz_m - position) @ tilt + position
    feet = sensor_from_local(xyz_m, position, yaw_deg)
    azimuth, elevation = np.radians(sensor.azimuth_deg), np.radians(sensor.elevation_deg)
    across_mrad, upright_mrad = sensor.divergence_mrad or (0.0, 0.0)
    return _count(
        range_m,
        np.column_stack([np.cos(azimuth), np.sin(azimuth)]),
        np.tan(elevation),
        sensor.azimuth_min_deg,
        sensor.azimuth_cell_deg,
        max_range_m,
        np.ascontiguousarray(feet),
        (radius_m, height_m),
        (across_mrad / 1000, upright_mrad / 1000, sensor.aperture_mm / 1000),
    )


@compiled()
def _count(
    depth_m: Floats32,
    heading: Floats,
    slope: Floats,
    start_deg: float,
    cell_deg: float,
    max_range_m: float,
    feet: Floats,
    size_m: tuple[float, float],
    beam: tuple[float, float, float],
) -> Floats:
    """Shares on each target; ``beam`` is divergence across and upright, rad, and aperture, m."""
    shares = np.zeros(len(feet))
    radius_m, height_m = size_m
    secant = np.sqrt(1 + slope * slope)
    for target in range(len(feet)):
        x, y, low = feet[target]
        distance = np.sqrt(x * x + y * y)
        if distance - radius_m >= max_range_m:
            continue
        for first, last in column_windows(x, y, radius_m, start_deg, cell_deg, len(heading)):
            for column in range(first, last + 1):
                cosine, sine = heading[column, 0], heading[column, 1]
                near, far = chord(x, y, cosine, sine, radius_m)
                rectangle = (near, far, low, low + height_m)
                first_row, last_row = rows_across(rectangle, slope)
                for row in range(first_row, last_row):
                    range_m = entry(rectangle, slope[row]) * secant[row]
                    scene_m = depth_m[row, column]
                    if range_m >= max_range_m or (scene_m > 0 and range_m >= scene_m):
                        continue
                    wide_m = beam[2] + beam[0] * range_m
                    share = overlap(x * sine - y * cosine, wide_m, -radius_m, radius_m)
                    # Upright in slopes, of which an angle takes its secant squared.
                    tall = (beam[2] / range_m + beam[1]) * secant[row] ** 2
                    share *= overlap(slope[row], tall, *slopes_into(rectangle))
                    if share >= CLEAN_SHARE:
                        shares[target] += share
    return shares


@compiled_part()
def slopes_into(rectangle: tuple[float, float, float, float]) -> tuple[float, float]:
    """Least and greatest slope of lines from the origin into a rectangle (near, far, low, high)."""
    near, far, low, high = rectangle
    if near <= 0.0:
        return (-np.inf, high / far) if high < 0.0 else (low / far, np.inf)
    return min(low / near, low / far), max(high / near, high / far)


@compiled()
def overlap(middle: float, width: float, low: float, high: float) -> float:
    """Share of an interval about ``middle`` that lies between two limits."""
    if width <= 0.0:
        return 1.0
    inside = min(middle + width / 2, high) - max(middle - width / 2, low)
    return min(max(inside, 0.0) / width, 1.0)
