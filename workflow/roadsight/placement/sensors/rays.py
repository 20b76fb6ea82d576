"""Between the local frame, the sensor frame and its angles (paper 1, section 2.4, Eqs. 1 and 2).

Yaw is the angle of the sensor's x axis from local x, counter-clockwise; z stays vertical.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Bools, Floats, Floats32
from roadsight.placement.sensors.light import rise_m
from roadsight.placement.sensors.sensors import Camera, Radar, Rosette, Sensor

# Range in a depth map of a beam that was not cast, a millimetre and a number of any precision. It
# hides all that is behind it, so that a target which would need the beam is not taken for seen.
NOT_CAST_M = 2.0**-10


def sensor_from_local(xyz_m: ArrayLike, position_m: ArrayLike, yaw_deg: float) -> Floats:
    """Eq. 1: local points (..., 3) in the frame of a sensor at ``position_m`` (3,), metres."""
    offset = np.asarray(xyz_m, np.float64) - np.asarray(position_m, np.float64)
    return offset @ _local_from_sensor(yaw_deg)


def local_from_sensor(xyz_m: ArrayLike, position_m: ArrayLike, yaw_deg: float) -> Floats:
    """Inverse of `sensor_from_local`."""
    turned = np.asarray(xyz_m, np.float64) @ _local_from_sensor(yaw_deg).T
    return turned + np.asarray(position_m, np.float64)


def _local_from_sensor(yaw_deg: float) -> Floats:
    """Rotation whose columns are the sensor's axes in the local frame."""
    cosine, sine = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def spherical_from_sensor(xyz_m: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Eq. 2: azimuth in [-180, 180] and elevation in degrees, and range, of points (..., 3).

    Elevation is taken by the two-argument arctangent, which keeps its precision near the zenith;
    the sensor's own centre has range 0 and both angles 0.
    """
    x, y, z = np.moveaxis(np.asarray(xyz_m, np.float64), -1, 0)
    horizontal = np.hypot(x, y)
    azimuth, elevation = np.arctan2(y, x), np.arctan2(z, horizontal)
    return np.degrees(azimuth), np.degrees(elevation), np.hypot(horizontal, z)


def sensor_from_spherical(
    azimuth_deg: ArrayLike, elevation_deg: ArrayLike, range_m: ArrayLike
) -> Floats:
    """Eq. 3: points (..., 3) in the sensor frame from angles and range, broadcast together."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    horizontal = range_m * np.cos(elevation)
    parts = (
        horizontal * np.cos(azimuth),
        horizontal * np.sin(azimuth),
        range_m * np.sin(elevation),
    )
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def beam_directions(
    sensor: Sensor, yaw_deg: float, tilt: Floats | None = None, wanted: Bools | None = None
) -> Floats32:
    """Unit vectors of a sensor's beams in the local frame; shape (rows, columns, 3).

    Parameters
    ----------
    tilt : rotation (3, 3) from the levelled to the mounted sensor, local frame; None: levelled.
    wanted : (rows, columns), beams of which alone the directions (n, 3) are returned, row by row.
    """
    azimuth = np.radians(sensor.azimuth_deg + yaw_deg)
    elevation = np.radians(sensor.elevation_deg)
    row, column = np.ogrid[: sensor.rows, : sensor.columns] if wanted is None else wanted.nonzero()
    shape = sensor.shape if wanted is None else row.shape
    level, directions = np.cos(elevation)[row], np.empty((*shape, 3), np.float32)
    np.multiply(level, np.cos(azimuth)[column], out=directions[..., 0], casting="same_kind")
    np.multiply(level, np.sin(azimuth)[column], out=directions[..., 1], casting="same_kind")
    directions[..., 2] = np.sin(elevation)[row]
    return directions if tilt is None else directions @ tilt.T.astype(np.float32)


def returns_xyz_m(
    range_m: Floats32,
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    tilt: Floats | None = None,
) -> Floats:
    """Points (n, 3) that a depth map stands for, local metres, row by row (paper 1, Fig. 9).

    Parameters
    ----------
    range_m : (rows, columns), 0 where nothing returns. tilt : as `beam_directions` takes it.
    """
    rows, columns = np.nonzero(range_m)
    azimuth, elevation = sensor.azimuth_deg[columns], sensor.elevation_deg[rows]
    in_sensor = sensor_from_spherical(azimuth, elevation, range_m[rows, columns])
    xyz_m = local_from_sensor(in_sensor, position_m, yaw_deg)
    if tilt is None:
        return xyz_m
    return (xyz_m - np.asarray(position_m)) @ tilt.T + np.asarray(position_m)


def as_seen_from(
    xyz_m: NDArray[np.floating], position_m: ArrayLike, tilt: Floats | None, curved: bool
) -> NDArray[np.floating]:
    """Points (n, 3) moved so that a levelled sensor with straight beams sees them as this one does.

    Parameters
    ----------
    tilt : as `beam_directions` takes it. curved : beams rise above the level (`rise_m`).
    """
    if tilt is None and not curved:
        return xyz_m
    offset = xyz_m - np.asarray(position_m, np.float64)
    if curved:
        offset[:, 2] -= rise_m(np.hypot(offset[:, 0], offset[:, 1]))
    if tilt is not None:
        offset = offset @ tilt
    return offset + np.asarray(position_m, np.float64)


# Numbers of the projections, by which kernels know them; see `Raster`.
SPHERICAL, PINHOLE, EQUIDISTANT = 0, 1, 2
_ROSETTE_CELL_DEG = 0.1  # cells in which a rosette's expected points are gathered
# Parts of a cell, either way, over which the density is averaged: it is not even at the rim and at
# the axis.
_ROSETTE_PARTS = 4
_RADAR_CELL_DEG = 0.02  # cells tell which part of a target is met: far finer than the resolution
_MOST_FINE = 24  # pixels of a camera and cells of a rosette looked at along either axis of a target
_MOST_RADAR = 16  # the same for radars, of which only the part of a target that is met counts
_ALL = 1 << 30  # more than any sensor has: every beam of a spinning LiDAR is looked at


@dataclass(frozen=True)
class Raster:
    """A grid of directions.

    Parameters
    ----------
    projection : what u and v are. SPHERICAL: azimuth and elevation, degrees. PINHOLE: y / x and
        z / x. EQUIDISTANT: angle from the x axis, degrees, towards y and towards z.
    u, v : (columns,) and (rows,), increasing, of the cells' middles.
    weight : (rows, columns) what a cell counts for, or (0, 0) where each counts for 1.
    most : along either axis at most so many cells of a target are looked at; where it spans more,
        every n-th stands for its neighbours.
    """

    projection: int
    u: Floats
    v: Floats
    weight: Floats
    most: int


def spinning_raster(sensor: Sensor) -> Raster:
    """Beams of a spinning LiDAR, all of them."""
    return Raster(SPHERICAL, sensor.azimuth_deg, sensor.elevation_deg, np.zeros((0, 0)), _ALL)


def camera_raster(camera: Camera) -> Raster:
    """Middles of a camera's pixels; of near targets, whose pixels abound, some of them."""
    u, v = (
        np.asarray((np.arange(count) + 0.5 - count / 2) / camera.focal_px, np.float64)
        for count in (camera.columns_px, camera.rows_px)
    )
    return Raster(PINHOLE, u, v, np.zeros((0, 0)), _MOST_FINE)


def radar_raster(radar: Radar) -> Raster:
    """Fine directions at which the part of a target is judged that a radar's beam meets."""
    reach = min(radar.zones[-1].half_angle_deg, 180.0)
    u = _cells(-reach, reach, _RADAR_CELL_DEG)
    v = _cells(radar.elevation_min_deg, radar.elevation_max_deg, _RADAR_CELL_DEG)
    return Raster(SPHERICAL, u, v, np.zeros((0, 0)), _MOST_RADAR)


@lru_cache(maxsize=8)
def rosette_raster(rosette: Rosette) -> Raster:
    """Expected points of one frame in each cell of 0.1 degrees, whatever the phase of the prisms.

    The prisms' speeds have no common measure, so that over the phases both angles are independent
    and even. The angle between the arrows, each a quarter a of the field long, is then even on 0 to
    180 degrees, and the distance from the axis is below r with probability
    1 - arccos(r^2 / (2 a^2) - 1) / pi. The density is infinite at the rim and at the axis, but not
    its mean over rings as wide as a part of a cell.
    """
    across, upright = rosette.half_view_deg
    cell, arrow = _ROSETTE_CELL_DEG, rosette.field_deg / 4
    width = cell / _ROSETTE_PARTS
    u = cell * (np.arange(2 * int(np.ceil(across / cell))) + 0.5 - np.ceil(across / cell))
    v = cell * (np.arange(2 * int(np.ceil(upright / cell))) + 0.5 - np.ceil(upright / cell))
    parts = (np.arange(_ROSETTE_PARTS) + 0.5) / _ROSETTE_PARTS - 0.5
    weight = np.zeros((len(v), len(u)))
    for offset_deg in rosette.laser_offsets_deg:
        for du in parts:
            for dv in parts:
                radius = np.hypot(u + cell * du, (v + cell * dv - offset_deg)[:, None])
                # Mean share of points per square degree of the ring of that width.
                inner, outer = np.maximum(radius - width / 2, 0), radius + width / 2
                share = _within(outer, arrow) - _within(inner, arrow)
                weight += share / (np.pi * (outer**2 - inner**2))
    return Raster(EQUIDISTANT, u, v, weight * (rosette.points / weight.sum()), _MOST_FINE)


def _within(radius_deg: Floats, arrow_deg: float) -> Floats:
    """Probability that the sum of two arrows of a length in even directions is so short."""
    cosine = np.clip(radius_deg**2 / (2 * arrow_deg**2) - 1, -1, 1)
    return np.asarray(1 - np.arccos(cosine) / np.pi)


def _cells(low: float, high: float, step: float) -> Floats:
    """Middles of cells of about a width that fill an interval."""
    count = max(round((high - low) / step), 1)
    return low + (np.arange(count) + 0.5) * (high - low) / count
