"""Beams on targets under the effects that a site simulates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats, Floats32, Ints32
from roadsight.base.kernels import compiled
from roadsight.placement.sensors.light import rise_m
from roadsight.placement.sensors.rays import sensor_from_local
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.detection import column_windows, count_hits, rows_across
from roadsight.placement.sight.kinds import Box, Cylinder, Shape
from roadsight.placement.sight.shapes import beams_on, count_shared_hits


@dataclass(frozen=True)
class Sight:
    """What a sensor's sight of targets is like; the defaults are the plain case.

    Parameters
    ----------
    max_range_m : range from which targets return.
    footprints : whether beams have the sensor's divergence.
    curved : whether beams rise above the level (`rise_m`).
    min_range_m : targets that come nearer than this do not count: part of them is not measured.
    """

    max_range_m: float
    footprints: bool = False
    curved: bool = False
    min_range_m: float = 0.0


def count_beams(
    range_m: Floats32,
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    targets_xyz_m: Floats,
    size_m: tuple[float, float] | Box,
    sight: Sight,
    tilt: Floats | None = None,
) -> Ints32 | Floats:
    """Beams, or shares of beams, that return from each target (n,).

    Parameters
    ----------
    range_m, position_m, yaw_deg, targets_xyz_m : as `count_hits` takes them.
        Feet of boxes are (n, 4), with headings.
    size_m : radius and height of every target, or the box that it is.
    tilt : rotation (3, 3) from the levelled to the mounted sensor, local frame; None: levelled.
    """
    if sight.curved:
        targets_xyz_m = as_met(targets_xyz_m, position_m)
    pose, limit_m = (position_m, yaw_deg), sight.max_range_m
    hits: Ints32 | Floats
    if isinstance(size_m, Box):
        wide = sight.footprints
        hits = beams_on(range_m, sensor, *pose, tilt, targets_xyz_m, size_m, limit_m, wide)[:, 0]
    elif sight.footprints:
        hits = count_shared_hits(range_m, sensor, *pose, tilt, targets_xyz_m, *size_m, limit_m)
    elif tilt is not None:
        shape = Cylinder(*size_m)
        hits = beams_on(range_m, sensor, *pose, tilt, targets_xyz_m, shape, limit_m, False)[:, 0]
        hits = hits.astype(np.int32)
    else:
        hits = count_hits(range_m, sensor, *pose, targets_xyz_m, *size_m, limit_m)
    if sight.min_range_m > 0:
        # Where a target may begin: a cylinder around it holds all of it.
        place = np.asarray(position_m, np.float64)
        if isinstance(size_m, Box):
            radius_m, height_m = np.hypot(size_m.length_m, size_m.width_m) / 2, size_m.height_m
        else:
            radius_m, height_m = size_m
        away = np.hypot(*(targets_xyz_m[:, :2] - place[:2]).T)
        beside = np.maximum(away - radius_m, 0.0)
        above = np.maximum(place[2] - targets_xyz_m[:, 2] - height_m, 0.0)
        below = np.maximum(targets_xyz_m[:, 2] - place[2], 0.0)
        hits[np.hypot(beside, above + below) < sight.min_range_m] = 0
    return hits


def beams_by_height(
    range_m: Floats32,
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    feet_m: Floats,
    shape: Shape,
    sight: Sight,
    bands: int,
    tilt: Floats | None = None,
) -> Floats:
    """The beams of `count_beams` by equal parts of the height, the lowest first, (n, bands).

    Of cylinders and levelled sensors those are counted in closed form, so that a beam that just
    grazes one may count there and not here.
    """
    if sight.curved:
        feet_m = as_met(feet_m, position_m)
    pose = (position_m, yaw_deg, tilt)
    limits = (sight.max_range_m, sight.footprints)
    return beams_on(range_m, sensor, *pose, feet_m, shape, *limits, bands)


def as_met(feet_m: Floats, position_m: ArrayLike) -> Floats:
    """Feet (n, 3 or more) as straight beams meet them where beams are curved: far ones deeper."""
    offset = feet_m[:, :2] - np.asarray(position_m)[:2]
    feet_m = feet_m.copy()
    feet_m[:, 2] -= rise_m(np.hypot(*offset.T))
    return feet_m


# Rows and columns beside a window: who looks between beams needs the next ones (`scene_range_m`),
# of which the lowest two stand for all that is lower.
_BESIDE = 2
# Times its range that a sensor may see bright targets: 80 % to 10 % of the light is 2.8.
_REACH = 4.0


def beams_wanted(
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    feet_m: Floats,
    room_m: tuple[float, float],
    tilt: Floats | None = None,
    curved: bool = False,
) -> Bools:
    """Beams (rows, columns) that may meet a target, and their neighbours; no other is cast.

    Half of a sensor's beams look above the road, and many of the others beside it.

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
