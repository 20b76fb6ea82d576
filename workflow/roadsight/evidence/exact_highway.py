"""What a sensor would see in the generated highway itself, without any cloud between."""

from __future__ import annotations

from typing import Any

import numpy as np

from roadsight.base.arrays import Bools, Floats, Floats32
from roadsight.base.sections.sensing import Targets
from roadsight.geometry.frames import Frame
from roadsight.placement.sensors.poses import Turn, local_from_sensor
from roadsight.placement.sensors.rays import beam_directions
from roadsight.placement.sensors.sensors import AnySensor, Sensor, load_sensor, panorama_name
from roadsight.placement.sight.detection import MIN_BEAMS, count_hits
from roadsight.placement.sight.detectors import Criteria, detector_of
from roadsight.placement.sight.kinds import Cylinder
from roadsight.placement.sight.posed import Panorama
from roadsight.placement.sight.sight import Sight
from roadsight_worlds.casting.alignment import to_plan
from roadsight_worlds.casting.scene import Scene
from roadsight_worlds.casting.terrain import height_at
from roadsight_worlds.highway.highway import Highway


class ExactHighway:
    """The generated highway in the local frame of a site's results.

    Parameters
    ----------
    highway : the generated scene. frame : local frame of the results.
    """

    def __init__(self, highway: Highway, frame: Frame) -> None:
        self._highway = highway
        self._maps: dict[tuple[Sensor, bytes, float], Floats32] = {}
        own = self._highway.frame()
        self._shift_m = own.to_local(frame.to_native(np.zeros((1, 3))))[0]

    def depth_map(self, sensor: Sensor, position_m: Floats, yaw_deg: float) -> Floats32:
        """Exact ranges (rows, columns) at the beams' centres, 0 where nothing is in range.

        Each map is cast once: several metrics look at the same sensors.
        """
        key = sensor, np.asarray(position_m, np.float64).tobytes(), yaw_deg
        if key not in self._maps:
            place_m = position_m + self._shift_m
            self._maps[key] = exact_ranges(self._highway.scene, sensor, place_m, yaw_deg)
        return self._maps[key]

    def sees(self, sensor: Sensor, position_m: Floats, yaw_deg: float, feet_m: Floats) -> Bools:
        """Which targets (n, 3) a sensor sees, by the threshold and size of the default targets."""
        exact_m = self.depth_map(sensor, position_m, yaw_deg)
        return np.asarray(count_hits(exact_m, sensor, position_m, yaw_deg, feet_m) > MIN_BEAMS)

    def road_heights(self, step_m: float) -> tuple[Floats, Floats]:
        """Places (n, 2) on both carriageways, ``step_m`` apart, and their exact heights (n,)."""
        inner, outer = self._highway.section.pavement_m
        across = np.arange(inner + step_m / 2, outer, step_m)
        stations = np.arange(step_m / 2, self._highway.length_m, step_m)
        offsets = np.concatenate([-across, across])
        road = np.stack(np.meshgrid(stations, offsets), axis=-1).reshape(-1, 2)
        plan_m = to_plan(self._highway.alignment, road)
        height_m = height_at(self._highway.terrain, plan_m)
        return plan_m - self._shift_m[:2], height_m - self._shift_m[2]


# Ranges of a sensor's beams in a generated scene itself, and how far a depth map is from them.

WRONG_M = 0.5  # A beam is wrong when its range is off by more than this.


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


# What a sensor in a pose would see in the generated highway itself.

# Cells of the exact panorama that stands for the scene; finer ones cost the square in time.
_STEP_DEG = 0.2
_USUAL = Targets()
# The default target of the placement job.
TARGET = Cylinder(radius_m=_USUAL.radius_m, height_m=_USUAL.height_m)
RCS_M2 = _USUAL.rcs_m2  # Radar cross-section of the default target.


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
