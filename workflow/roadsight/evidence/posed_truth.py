"""What a sensor in a pose would see in the generated highway itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from roadsight.base.arrays import Bools, Floats
from roadsight.base.sections.sensing import Targets
from roadsight.evidence.exact_highway import ExactHighway
from roadsight.placement.sensors.poses import Turn, local_from_sensor
from roadsight.placement.sensors.sensors import AnySensor, load_sensor, panorama_name
from roadsight.placement.sight.detection import MIN_BEAMS
from roadsight.placement.sight.detectors import Criteria, detector_of
from roadsight.placement.sight.kinds import Cylinder
from roadsight.placement.sight.posed import Panorama
from roadsight.placement.sight.sight import Sight

_STEP_DEG = 0.2
"""Cells of the exact panorama that stands for the scene; finer ones cost the square in time."""
_USUAL = Targets()
TARGET = Cylinder(radius_m=_USUAL.radius_m, height_m=_USUAL.height_m)
"""The default target of the placement job."""
RCS_M2 = _USUAL.rcs_m2
"""Radar cross-section of the default target."""


def sees_in_pose(
    scene: ExactHighway, sensor: AnySensor, place: dict[str, Any], feet_m: Floats
) -> Bools:
    """Which targets (n, 3) a chosen sensor sees, by the default targets, from exact ranges.

    The detector is the one that made the plan: exact ranges judge the depth, not the detectors.

    Parameters
    ----------
    place : entry of solution.json with x, y, z, yaw_deg, pitch_deg and roll_deg.
    """
    position_m = np.array([place[axis] for axis in "xyz"], np.float64)
    beams = load_sensor("", panorama_name(_STEP_DEG, sensor.range_m))
    panorama = Panorama(scene.depth_map(beams, position_m, 0.0), beams, position_m, 0.0)
    turn = Turn(0.0, place["pitch_deg"], place["roll_deg"])
    rotation = local_from_sensor(place["yaw_deg"], turn)
    detector = detector_of(sensor, Criteria(MIN_BEAMS, RCS_M2))
    measured = detector.measure(panorama, rotation, feet_m, TARGET, Sight(sensor.range_m))
    return detector.sees(measured)
