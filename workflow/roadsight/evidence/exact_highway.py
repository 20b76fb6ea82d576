"""What a sensor would see in the generated highway itself, without any cloud between."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Bools, Floats, Floats32
from roadsight.evidence.exact_ranges import exact_ranges
from roadsight.geometry.frames import Frame
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.detection import MIN_BEAMS, count_hits
from roadsight.synthetic.casting.alignment import to_plan
from roadsight.synthetic.casting.terrain import height_at
from roadsight.synthetic.highway.highway import Highway


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
