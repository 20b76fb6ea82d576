"""Which beams of a mounted, spinning LiDAR return from boxes, exactly."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.placement.mounted import count_met
from roadsight.placement.rays import beam_directions, sensor_from_local
from roadsight.placement.sensors import Sensor
from roadsight.placement.shapes import Box, relative_to

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
    return count_met(
        range_m,
        beam_directions(sensor, yaw_deg, tilt),
        np.radians(sensor.elevation_deg),
        sensor.azimuth_min_deg,
        sensor.azimuth_cell_deg,
        max_range_m,
        relative_to(feet_m, position),
        sensor_from_local(middles, position, yaw_deg),
        box.packed,
        _MOST,
        footprints,
        (across_mrad / 1000, upright_mrad / 1000, sensor.aperture_mm / 1000),
    )
