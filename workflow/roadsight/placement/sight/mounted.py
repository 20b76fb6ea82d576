"""Which beams of a mounted, spinning LiDAR return from targets of any shape, exactly."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Floats, Floats32, Ints32
from roadsight.base.kernels import compiled
from roadsight.placement.sensors.rays import beam_directions, sensor_from_local
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.detection import column_windows
from roadsight.placement.sight.footprints import CLEAN_SHARE
from roadsight.placement.sight.kinds import Box, Cylinder, Packed, Shape
from roadsight.placement.sight.shapes import (
    ball_around,
    entered_at,
    footprint_share,
    height_band,
    relative_to,
)

_MOST = 64
"""Of a box that spans more rows or columns, every n-th is looked at and stands for n: near boxes
would take most of the time, and have far more beams than it takes to see them."""


def count_tilted_hits(
    range_m: Floats32,
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    tilt: Floats,
    targets_xyz_m: NDArray[np.floating],
    radius_m: float,
    height_m: float,
    max_range_m: float,
) -> Ints32:
    """Number of beams that return from each target (n,), as `count_hits` counts them.

    Every beam that may meet the sphere around a target is intersected with the upright cylinder.

    Parameters
    ----------
    tilt : rotation (3, 3) from the levelled to the mounted sensor, local frame.
    max_range_m : range from which targets return.
    """
    pose = (position_m, yaw_deg, tilt)
    shape = Cylinder(radius_m, height_m)
    hits = beams_on(range_m, sensor, *pose, targets_xyz_m, shape, max_range_m, False)
    return hits[:, 0].astype(np.int32)


def beams_on(
    range_m: Floats32,
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    tilt: Floats | None,
    feet_m: NDArray[np.floating],
    shape: Shape,
    max_range_m: float,
    footprints: bool,
    bands: int = 1,
) -> Floats:
    """Beams, or shares of wide beams, that return from each target by height, (n, bands).

    Every beam that may meet the sphere around a target is intersected with its shape; of boxes
    wider than 64 beams, evenly chosen beams stand for their neighbours.

    Parameters
    ----------
    range_m : depth map of the scene, 0 where nothing returns. tilt : rotation (3, 3) from the
        levelled to the mounted sensor, local frame, or None.
    feet_m : (n, 3) local metres, of boxes (n, 4) with headings, rad. shape : of every target.
    footprints : whether beams have the sensor's divergence.
    bands : equal parts of the height, the lowest first, in which beams enter.
    """
    position = np.asarray(position_m, np.float64)
    feet = relative_to(np.asarray(feet_m, np.float64), position)
    middles = feet[:, :3] + np.array([0.0, 0.0, shape.height_m / 2])
    if tilt is not None:
        middles = middles @ tilt
    across_mrad, upright_mrad = sensor.divergence_mrad or (0.0, 0.0)
    return count_met(
        range_m,
        beam_directions(sensor, yaw_deg, tilt),
        np.radians(sensor.elevation_deg),
        sensor.azimuth_min_deg,
        sensor.azimuth_cell_deg,
        max_range_m,
        feet,
        sensor_from_local(middles + position, position, yaw_deg),
        shape.packed,
        _MOST if isinstance(shape, Box) else max(sensor.shape),
        footprints,
        (across_mrad / 1000, upright_mrad / 1000, sensor.aperture_mm / 1000),
        bands,
    )


@compiled()
def count_met(
    depth_m: Floats32,
    directions: Floats32,
    elevation: Floats,
    start_deg: float,
    cell_deg: float,
    max_range_m: float,
    feet: Floats,
    mounted: Floats,
    shape: Packed,
    most: int,
    wide: bool,
    beam: tuple[float, float, float],
    bands: int,
) -> Floats:
    """Beams, or shares of wide ones, on each target (n, bands), of all that may meet its ball.

    Parameters
    ----------
    directions : (rows, columns, 3) unit vectors, local frame. feet : (n, 3) or (n, 4), from the
        sensor, local frame. mounted : (n, 3) targets' middles in the frame of the sensor.
    most : of a target that spans more rows or columns, every n-th is looked at and stands for n.
    beam : divergence across and upright, rad, and aperture, m; only for ``wide`` ones.
    """
    hits = np.zeros((len(feet), bands))
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
                        band = height_band(shape, feet[target], ray, range_m, bands)
                        hits[target, band] += share * tall * across
    return hits
