"""Which beams of a mounted, spinning LiDAR return from boxes, exactly."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from roadsight.placement.detection import column_windows
from roadsight.placement.footprints import CLEAN_SHARE
from roadsight.placement.rays import beam_directions, sensor_from_local
from roadsight.placement.sensors import Sensor
from roadsight.placement.shapes import (
    Box,
    Packed,
    ball_around,
    entered_at,
    footprint_share,
    relative_to,
)

_FLOATS = NDArray[np.float64]

# Of a box that spans more rows or columns, every n-th is looked at and stands for n.
_MOST = 64


def count_box_hits(
    range_m: NDArray[np.float32],
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    tilt: _FLOATS | None,
    feet_m: _FLOATS,
    box: Box,
    max_range_m: float,
    footprints: bool,
) -> _FLOATS:
    """Beams, or shares of wide beams, that return from each box (n,).

    Every beam that may meet the sphere around a box is intersected with it; of boxes wider than 64
    beams, evenly chosen beams stand for their neighbours.

    Parameters
    ----------
    range_m : depth map of the scene, 0 where nothing returns. tilt : rotation (3, 3) from the
        levelled to the mounted sensor, local frame, or None.
    feet_m : (n, 4) x, y, z, local metres, and heading of the length from local x, rad.
    footprints : whether beams have the sensor's divergence.
    """
    position = np.asarray(position_m, np.float64)
    middles = feet_m[:, :3] + np.array([0.0, 0.0, box.height_m / 2])
    if tilt is not None:
        middles = (middles - position) @ tilt + position
    across_mrad, upright_mrad = sensor.divergence_mrad or (0.0, 0.0)
    return _count(
        range_m,
        beam_directions(sensor, yaw_deg, tilt),
        np.radians(sensor.elevation_deg),
        sensor.azimuth_min_deg,
        sensor.azimuth_cell_deg,
        max_range_m,
        relative_to(feet_m, position),
        sensor_from_local(middles, position, yaw_deg),
        box.packed,
        footprints,
        (across_mrad / 1000, upright_mrad / 1000, sensor.aperture_mm / 1000),
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
    shape: Packed,
    wide: bool,
    beam: tuple[float, float, float],
) -> _FLOATS:
    """Beams on each box: ``directions`` (rows, columns, 3), ``mounted`` (n, 3) their middles."""
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
        rows = max(1, -(-(last_row - first_row) // _MOST))
        for first, last in column_windows(x, y, around, start_deg, cell_deg, depth_m.shape[1]):
            columns = max(1, -(-(last + 1 - first) // _MOST))
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
