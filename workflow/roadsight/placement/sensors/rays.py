"""Between the local frame, the sensor frame and its angles (paper 1, section 2.4, Eqs. 1 and 2).

Yaw is the angle of the sensor's x axis from local x, counter-clockwise; z stays vertical.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Bools, Floats, Floats32
from roadsight.placement.sensors.earth import rise_m
from roadsight.placement.sensors.sensors import Sensor

NOT_CAST_M = 2.0**-10
"""Range in a depth map of a beam that was not cast, a millimetre and a number of any precision. It
hides all that is behind it, so that a target which would need the beam is not taken for seen."""


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
