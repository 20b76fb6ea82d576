"""Which beams of a mounted, spinning LiDAR return from targets of any shape, exactly."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from roadsight.placement.detection import column_windows
from roadsight.placement.footprints import CLEAN_SHARE
from roadsight.placement.rays import beam_directions, sensor_from_local
from roadsight.placement.sensors import Sensor
from roadsight.placement.shapes import Cylinder, Packed, ball_around, entered_at, footprint_share

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
    hits = count_met(
        range_m,
        beam_directions(sensor, yaw_deg, tilt),
        np.radians(sensor.elevation_deg),
        sensor.azimuth_min_deg,
        sensor.azimuth_cell_deg,
        max_range_m,
        feet,
        mounted,
        Cylinder(radius_m, height_m).packed,
        max(sensor.shape),
        False,
        (0.0, 0.0, 0.0),
    )
    return hits.astype(np.int32)


@njit(cache=True)
def count_met(
    depth_m: NDArray[np.float32],
    directions: NDArray[np.float32],
    elevation: _FLOATS,
    start_deg: float,
    cell_deg: float,
    max_range_m: float,
    feet: _FLOATS,
    mounted: _FLOATS,
    shape: Packed,
    most: int,
    wide: bool,
    beam: tuple[float, float, float],
) -> _FLOATS:
    """Beams, or shares of wide ones, on each target (n,), of all that may meet the ball about it.

    Parameters
    ----------
    directions : (rows, columns, 3) unit vectors, local frame. feet : (n, 3) or (n, 4), from the
        sensor, local frame. mounted : (n, 3) targets' middles in the frame of the sensor.
    most : of a target that spans more rows or columns, every n-th is looked at and stands for n.
    beam : divergence across and upright, rad, and aperture, m; only for ``wide`` ones.
    """
    hits = np.zeros(len(feet))
    _, around = ball_around(shape)
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
        rows = max(1, -(-(last_row - first_row) // most))
        for first, last in column_windows(x, y, around, start_deg, cell_deg, depth_m.shape[1]):
            columns = max(1, -(-(last + 1 - first) // most))
            for row_start in range(first_row, last_row, rows):
                tall = min(rows, last_row - row_start)
                row = row_start + tall // 2
                for column_start in range(first, last + 1, columns):
                    across = min(columns, last + 1 - column_start)
                    column = column_start + across // 2
                    way = directions[row, column]
                    ray = (np.float64(way[0]), np.float64(way[1]), np.float64(way[2]))
                    range_m = entered_at(shape, feet[target], ray)
                    scene_m = depth_m[row, column]
                    if not 0 < range_m < max_range_m or 0 < scene_m <= range_m:
                        continue
                    share = 1.0
                    if wide:
                        share = footprint_share(shape, feet[target], ray, range_m, beam)
                    if share >= CLEAN_SHARE:
                        hits[target] += share * tall * across
    return hits
