"""Which beams of a mounted, spinning LiDAR return from boxes, exactly."""

from __future__ import annotations

from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats, Floats32
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.kinds import Box
from roadsight.placement.sight.mounted import beams_on


def count_box_hits(
    range_m: Floats32,
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    tilt: Floats | None,
    feet_m: Floats,
    box: Box,
    max_range_m: float,
    footprints: bool,
) -> Floats:
    """Beams, or shares of wide beams, that return from each box (n,); see `beams_on`.

    Parameters
    ----------
    feet_m : (n, 4) x, y, z, local metres, and heading of the length from local x, rad.
    """
    pose = (position_m, yaw_deg, tilt)
    return beams_on(range_m, sensor, *pose, feet_m, box, max_range_m, footprints)[:, 0]
