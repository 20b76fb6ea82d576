"""Ranges of a sensor's beams in a generated scene itself, and how far a depth map is from them."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Floats, Floats32
from roadsight.placement.sensors.rays import beam_directions
from roadsight.placement.sensors.sensors import Sensor
from roadsight.synthetic.casting.scene import Scene

WRONG_M = 0.5
"""A beam is wrong when its range is off by more than this."""


def exact_ranges(scene: Scene, sensor: Sensor, position_m: Floats, yaw_deg: float) -> Floats32:
    """Exact ranges (rows, columns) at the beams' centres, 0 where nothing is in range, m.

    Parameters
    ----------
    position_m : (3,) in the scene's frame. yaw_deg : azimuth that the sensor faces.
    """
    directions = beam_directions(sensor, yaw_deg).reshape(-1, 3).astype(np.float64)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    origins = np.broadcast_to(position_m, directions.shape)
    range_m, _, _ = scene.cast(origins, directions, sensor.range_m)
    found = np.where(np.isfinite(range_m), range_m, 0.0)
    return found.astype(np.float32).reshape(sensor.shape)


def share_wrong(range_m: Floats32, exact_m: Floats32) -> float:
    """Share of a depth map's beams whose range is off by more than `WRONG_M`.

    A beam that returns where nothing is, or does not where something is, is wrong as well.
    """
    wrong = np.abs(range_m - exact_m) > WRONG_M
    return float((wrong | ((range_m == 0) != (exact_m == 0))).mean())
