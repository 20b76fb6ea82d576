"""What the chosen sensors of a plan measure of each target by height, from their depth maps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.sensing import Lidar
from roadsight.io.records.depth_maps import DepthMaps
from roadsight.io.records.poses import read_poses, read_tilts
from roadsight.placement.sensors.aimed import Camera, Radar
from roadsight.placement.sensors.poses import Turn, local_from_sensor, split_pose
from roadsight.placement.sensors.sensors import AnySensor, load_sensor, load_sensors
from roadsight.placement.sight.detectors import BandedDetector, Criteria, detector_of
from roadsight.placement.sight.heights import BANDS
from roadsight.placement.sight.kinds import Shape
from roadsight.placement.sight.posed import Panorama
from roadsight.placement.sight.sight import beams_by_height
from roadsight.stages.placement.shared.detection_inputs import SightFiles, sight_of


@dataclass(frozen=True, kw_only=True)
class MeasuringFiles(SightFiles):
    """What tells what the chosen sensors of a plan measure."""

    sensors: Path
    depth: Sequence[Path]
    candidates: Sequence[Path]
    azimuth_stride: Annotated[int, Lidar]


class _Place(NamedTuple):
    """A chosen sensor: its name, its candidate, how it is turned, and whether it has a pose."""

    sensor: str
    candidate: str
    turn: Turn
    posed: bool


def points_by_height(
    given: MeasuringFiles, chosen: pd.DataFrame, feet_m: Floats, shape: Shape
) -> dict[str, Floats]:
    """Points of LiDARs and pixels of cameras on each target, (targets, bands), by unit.

    Parameters
    ----------
    chosen : columns sensor and candidate, whose name says its pose where it has one.

    Raises
    ------
    InputError : a chosen sensor has no depth map.
    """
    sensors = load_sensors(given.sensors)
    pairs = zip(chosen["sensor"], chosen["candidate"].astype(str), strict=True)
    places = [_Place(name, *split_pose(told), "@" in told) for name, told in pairs]
    places = [place for place in places if not isinstance(sensors[place.sensor], Radar)]
    totals: dict[str, Floats] = {}
    found = 0
    for place, panorama, tilt in _views(given, places, sensors):
        sensor = sensors[place.sensor]
        part = _measured(given, place, sensor, panorama, tilt, feet_m, shape)
        unit = "pixels" if isinstance(sensor, Camera) else "points"
        totals[unit] = totals.get(unit, np.zeros(part.shape)) + part
        found += 1
    if found < len(places):
        raise InputError(
            "depth maps of chosen sensors are missing",
            where=", ".join(map(str, given.depth)),
            found=f"{found} of {len(places)}",
            hint="run the workflow again",
        )
    return dict(sorted(totals.items()))


def _views(
    given: MeasuringFiles, places: list[_Place], sensors: dict[str, AnySensor]
) -> Iterator[tuple[_Place, Panorama, Floats | None]]:
    """Each place with its depth map, or its candidate's panorama, and the tilt of its mount."""
    poses = {name: pose for path in given.candidates for name, pose in read_poses(path).items()}
    tilts = read_tilts(given.tilts)
    for path in given.depth:
        maps = DepthMaps(path)
        beams = load_sensor(given.sensors, maps.info.sensor)
        if maps.info.sensor in sensors:
            beams = beams.thinned(given.azimuth_stride)
            here = [p for p in places if not p.posed and p.sensor == maps.info.sensor]
        else:
            here = [p for p in places if p.posed]
        for candidate, depth in maps.only({place.candidate for place in here}):
            *position_m, yaw_deg = poses[candidate]
            panorama = Panorama(depth, beams, np.array(position_m), float(yaw_deg))
            for place in here:
                if place.candidate == candidate:
                    yield place, panorama, tilts.get(candidate)


def _measured(
    given: MeasuringFiles,
    place: _Place,
    sensor: AnySensor,
    view: Panorama,
    tilt: Floats | None,
    feet_m: Floats,
    shape: Shape,
) -> Floats:
    """What one sensor measures of each target by height, as detection counts it."""
    sight = sight_of(given, place.sensor, sensor)
    if not place.posed:
        pose = (view.position_m, view.yaw_deg)
        hits = beams_by_height(view.range_m, view.sensor, *pose, feet_m, shape, sight, BANDS, tilt)
        return np.asarray(given.azimuth_stride * hits)
    detector = detector_of(sensor, Criteria(0, 1.0))
    assert isinstance(detector, BandedDetector)
    rotation = local_from_sensor(view.yaw_deg, place.turn, tilt)
    return detector.by_height(view, rotation, feet_m, shape, sight, BANDS)
