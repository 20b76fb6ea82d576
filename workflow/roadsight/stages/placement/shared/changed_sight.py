"""What a sensor sees that does not stand exactly as planned: rendered anew from the surfels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from roadsight.base.arrays import Bools
from roadsight.base.engines import Engine
from roadsight.base.errors import InputError
from roadsight.base.section import needed
from roadsight.base.sections.sensing import Lidar, Targets, Tolerance
from roadsight.io.records.placement_tables import read_tilts
from roadsight.io.records.scene_tables import read_surfels
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.plans.tolerance import Change, changes
from roadsight.placement.sensors.poses import AS_MOUNTED, Turn, local_from_sensor
from roadsight.placement.sensors.sensors import Sensor, load_sensors
from roadsight.placement.sight.kinds import Box, room_for
from roadsight.placement.sight.sight import beams_wanted, count_beams
from roadsight.stages.placement.shared.detection_inputs import (
    SightFiles,
    read_shaped_targets,
    sight_of,
)


@dataclass(frozen=True, kw_only=True)
class ChangedFiles(SightFiles):
    """How far sensors may be from their plan, and what tells what they see then."""

    tolerance: Tolerance
    engine: Annotated[Engine, Lidar]
    azimuth_stride: Annotated[int, Lidar]
    min_beams: Annotated[int, Targets]
    surfels: Annotated[Path | None, "the scene"] = None
    sensors_file: Path | None = None


class ChangedSight:
    """Sights of sensors in the scene.

    Raises
    ------
    InputError : a file is missing or cannot be read.
    """

    def __init__(self, given: ChangedFiles) -> None:
        self._given = given
        self._sensors = load_sensors(needed(given.sensors_file, "--sensors-file"))
        self._tilts = read_tilts(given.tilts)
        self.targets, self._feet_m, shape = read_shaped_targets(given)
        self._size_m: Any = shape if isinstance(shape, Box) else (shape.radius_m, shape.height_m)
        self._room_m = room_for(shape)
        asked = given.tolerance
        self.changes = changes(asked.move_m, asked.turn_deg, asked.other_height_m)

    @cached_property
    def _lidar(self) -> SurfelLidar:
        """The scene as it is."""
        surfels = read_surfels(needed(self._given.surfels, "--surfels"))
        return SurfelLidar(surfels, engine=self._given.engine)

    def can_change(self, sensor: str) -> bool:
        """Whether a sensor is a spinning LiDAR; others are judged from panoramas."""
        return isinstance(self._sensors[sensor], Sensor)

    def sees(
        self, place: Mapping[str, Any], change: Change | None, lidar: SurfelLidar | None = None
    ) -> Bools:
        """Targets (n,) that a sensor sees from a place: sensor, candidate, x, y, z, yaw_deg.

        Parameters
        ----------
        lidar : another scene.

        Raises
        ------
        InputError : the sensor is no spinning LiDAR.
        """
        whole = self._sensors[place["sensor"]]
        if not isinstance(whole, Sensor):
            raise InputError("tolerance is measured of spinning LiDARs only", found=place["sensor"])
        stride = self._given.azimuth_stride
        sensor = whole.thinned(stride)
        position = np.array([place[axis] for axis in "xyz"], np.float64)
        yaw_deg = float(place["yaw_deg"])
        tilt = self._tilts.get(str(place["candidate"]))
        if change is not None:
            level = local_from_sensor(yaw_deg, AS_MOUNTED)
            position = position + level @ np.array(change.shift_m)
            yaw_deg += change.turn.yaw_deg
            turn = Turn(0.0, change.turn.pitch_deg, change.turn.roll_deg)
            if turn != AS_MOUNTED:
                mounted = local_from_sensor(yaw_deg, AS_MOUNTED)
                tilt = local_from_sensor(yaw_deg, turn, tilt) @ mounted.T
        curved = self._given.curvature == "simulate"
        scene = self._lidar if lidar is None else lidar
        sight = sight_of(self._given, place["sensor"], whole)
        pose = (position, yaw_deg)
        wanted = beams_wanted(sensor, *pose, self._feet_m, self._room_m, tilt, curved)
        depth_m = scene.depth_map(sensor, *pose, tilt, curved, wanted)
        beams = count_beams(depth_m, sensor, *pose, self._feet_m, self._size_m, sight, tilt)
        return np.asarray(stride * beams > self._given.min_beams)

    def keeps(self, place: Mapping[str, Any]) -> Bools:
        """Targets (n,) that a sensor sees under every change."""
        kept = np.ones(len(self.targets), bool)
        for change in self.changes:
            kept &= self.sees(place, change)
        return kept
