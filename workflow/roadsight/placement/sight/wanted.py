"""Which beams of a spinning LiDAR can meet a target at all; only those need a depth.

Half of a sensor's beams look above the road, and many of the others beside it. Detection reads the
scene along beams that meet a target and along no other, so that those alone are cast.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats
from roadsight.base.kernels import compiled
from roadsight.placement.sensors.rays import sensor_from_local
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.detection import column_windows, rows_across
from roadsight.placement.sight.sight import as_met

_BESIDE = 2
"""Rows and columns beside a window: who looks between beams needs the next ones (`scene_range_m`),
of which the lowest two stand for all that is lower."""
_REACH = 4.0
"""Times its range that a sensor may see bright targets: 80 % to 10 % of the light is 2.8."""


def beams_wanted(
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    feet_m: Floats,
    room_m: tuple[float, float],
    tilt: Floats | None = None,
    curved: bool = False,
) -> Bools:
    """Beams (rows, columns) that may meet a target, and their neighbours.

    Parameters
    ----------
    position_m : (3,) local metres. yaw_deg : sensor x from local x, counter-clockwise.
    feet_m : (n, 3 or more) local metres. room_m : radius and height about each (`room_for`).
    tilt : as `beam_directions` takes it. curved : beams rise above the level (`rise_m`).
    """
    position = np.asarray(position_m, np.float64)
    xyz_m = (as_met(feet_m, position) if curved else feet_m)[:, :3]
    radius_m, height_m = room_m
    leaning = 0.0
    if tilt is not None:
        xyz_m = (xyz_m - position) @ tilt + position
        leaning = float(np.hypot(tilt[2, 0], tilt[2, 1]))
    wanted = np.zeros(sensor.shape, np.bool_)
    _mark(
        wanted,
        np.tan(np.radians(sensor.elevation_deg)),
        sensor.azimuth_min_deg,
        sensor.azimuth_cell_deg,
        np.ascontiguousarray(sensor_from_local(xyz_m, position, yaw_deg)),
        radius_m + leaning * height_m,
        (-leaning * radius_m, height_m + leaning * radius_m),
        _REACH * sensor.range_m,
    )
    return wanted


@compiled()
def _mark(
    wanted: Bools,
    slope: Floats,
    start_deg: float,
    cell_deg: float,
    feet: Floats,
    radius_m: float,
    span_m: tuple[float, float],
    reach_m: float,
) -> None:
    """Mark the windows of upright cylinders; ``span_m`` from the foot, (lowest, highest)."""
    rows, columns = wanted.shape
    for target in range(len(feet)):
        x, y, z = feet[target]
        distance = np.sqrt(x * x + y * y)
        if distance - radius_m >= reach_m:
            continue
        near, far = max(distance - radius_m, 0.0), distance + radius_m
        low, high = z + span_m[0], z + span_m[1]
        first_row, end_row = rows_across((near, far, low, high), slope)
        if near == 0.0 and low <= 0.0 <= high:
            first_row, end_row = 0, rows  # inside of it: whichever it meets
        first_row, end_row = max(first_row - _BESIDE, 0), min(end_row + _BESIDE, rows)
        for first, last in column_windows(x, y, radius_m, start_deg, cell_deg, columns):
            # A target between two columns meets neither, but who looks between them needs both.
            beside = _BESIDE if last >= first - 1 else 0
            for turned in range(first - beside, last + beside + 1):
                column = turned % columns
                for row in range(first_row, end_row):
                    wanted[row, column] = True
