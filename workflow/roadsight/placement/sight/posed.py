"""What a sensor in any pose sees of targets, from one panorama of the scene at its position.

A panorama is the depth map of a levelled sensor that looks everywhere. A beam of a turned sensor
meets a target exactly; the scene's range along it is looked up in the panorama, between whose beams
one over the range is interpolated, which for a plane is linear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roadsight.base.arrays import Floats, Floats32
from roadsight.base.kernels import compiled, compiled_part
from roadsight.placement.sensors.rays import PINHOLE, SPHERICAL, Raster
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.kinds import Packed
from roadsight.placement.sight.shapes import (
    CLEAN_SHARE,
    ball_around,
    entered_at,
    footprint_share,
    height_band,
    relative_to,
)

_Ray = tuple[float, float, float]
# Neighbouring ranges of a greater ratio are of two surfaces
# (`docs/decisions/042-poses-from-one-panorama.md`).
_ONE_SURFACE = 1.25
# Angle from the axis, rad, from which on a window takes all cells: the stretch of the equidistant
# projection, theta over its sine, grows without end towards 180 degrees.
_WIDEST = np.radians(170.0)
# Angle from the axis, rad, at which a pinhole's window ends: its tangent must stay finite.
_UPRIGHT = np.radians(89.9)


@dataclass(frozen=True)
class Panorama:
    """Ranges all around a position.

    Parameters
    ----------
    range_m : (rows, columns), 0 where nothing returns. sensor : its beams.
    position_m : (3,) local metres. yaw_deg : of its x axis from local x, counter-clockwise.
    """

    range_m: Floats32
    sensor: Sensor
    position_m: Floats
    yaw_deg: float


def weigh_by_height(
    panorama: Panorama,
    raster: Raster,
    rotation: Floats,
    feet_m: Floats,
    shape: Packed,
    max_range_m: float,
    beam: tuple[float, float, float] | None,
    bands: int,
) -> Floats:
    """Weight of the raster's cells that meet each target (n, 1 + bands).

    First comes that of all cells, then that of those which see it, by the equal part of the height
    at which they enter, the lowest first.

    Parameters
    ----------
    rotation : (3, 3) whose columns are the sensor's axes in the local frame.
    feet_m : (n, 3) local metres, of boxes (n, 4) with headings. shape : of every target.
    max_range_m : cells see no farther.
    beam : divergence across and upright, rad, and aperture, m: cells then count by the share of
        their footprint on the target if that is `CLEAN_SHARE` or more; None: lines.
    """
    return _weigh(
        panorama.range_m,
        np.tan(np.radians(panorama.sensor.elevation_deg)),
        np.radians(panorama.yaw_deg + panorama.sensor.azimuth_min_deg),
        raster.projection,
        raster.u,
        raster.v,
        raster.weight,
        raster.most,
        np.ascontiguousarray(rotation, np.float64),
        relative_to(feet_m, panorama.position_m),
        shape,
        max_range_m,
        beam is not None,
        beam or (0.0, 0.0, 0.0),
        bands,
    )


@compiled()
def _weigh(
    scene_m: Floats32,
    slopes: Floats,
    start: float,
    projection: int,
    u: Floats,
    v: Floats,
    weight: Floats,
    most: int,
    rotation: Floats,
    feet: Floats,
    shape: Packed,
    max_range_m: float,
    wide: bool,
    beam: tuple[float, float, float],
    bands: int,
) -> Floats:
    """Weights (n, 1 + bands): met, and seen by height."""
    found = np.zeros((len(feet), 1 + bands))
    middle_m, around_m = ball_around(shape)
    for target in range(len(feet)):
        foot = feet[target]
        x, y, z = foot[0], foot[1], foot[2] + middle_m
        if np.sqrt(x * x + y * y + z * z) - around_m >= max_range_m:
            continue
        ahead = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
        left = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
        up = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
        u_low, u_high, v_low, v_high = _window(projection, ahead, left, up, around_m)
        first_row = int(np.searchsorted(v, v_low))
        end_row = int(np.searchsorted(v, v_high, side="right"))
        turns = 1 if projection == SPHERICAL else 0
        for turn in range(-turns, turns + 1):
            first = int(np.searchsorted(u, u_low + 360.0 * turn))
            end = int(np.searchsorted(u, u_high + 360.0 * turn, side="right"))
            row_step = max(1, -(-(end_row - first_row) // most))
            step = max(1, -(-(end - first) // most))
            for row_start in range(first_row, end_row, row_step):
                rows = min(row_step, end_row - row_start)
                row = row_start + rows // 2
                for start_column in range(first, end, step):
                    columns = min(step, end - start_column)
                    column = start_column + columns // 2
                    cell = float(rows * columns)
                    if weight.size > 0:
                        cell *= weight[row, column]
                    ray = _turned(rotation, _direction(projection, u[column], v[row]))
                    range_m = entered_at(shape, foot, ray)
                    if cell == 0.0 or not 0.0 < range_m < max_range_m:
                        continue
                    if wide:
                        share = footprint_share(shape, foot, ray, range_m, beam)
                        cell *= share if share >= CLEAN_SHARE else 0.0
                    found[target, 0] += cell
                    behind_m = scene_range_m(scene_m, slopes, start, ray)
                    if behind_m == 0.0 or range_m < behind_m:
                        found[target, 1 + height_band(shape, foot, ray, range_m, bands)] += cell
    return found


@compiled_part()
def _window(
    projection: int, ahead: float, left: float, up: float, around_m: float
) -> tuple[float, float, float, float]:
    """Limits of u and of v between which a ball in the sensor frame lies; too wide is allowed."""
    flat = np.sqrt(ahead * ahead + left * left)
    distance = np.sqrt(flat * flat + up * up)
    if distance <= around_m:
        # Half the turn of azimuths, of which one copy is taken: all of them once.
        return -180.0, 180.0 - 1e-9, -np.inf, np.inf
    half = np.arcsin(around_m / distance)
    if projection == SPHERICAL:
        low, high = -180.0, 180.0 - 1e-9
        if flat > around_m:
            middle, side = (
                np.degrees(np.arctan2(left, ahead)),
                np.degrees(np.arcsin(around_m / flat)),
            )
            low, high = middle - side, middle + side
        elevation = np.arctan2(up, flat)
        return low, high, np.degrees(elevation - half), np.degrees(elevation + half)
    if projection == PINHOLE:
        u_low, u_high = _tangents(ahead, left, around_m)
        v_low, v_high = _tangents(ahead, up, around_m)
        return u_low, u_high, v_low, v_high
    beside = np.sqrt(left * left + up * up)
    from_axis = np.arctan2(beside, ahead)
    if from_axis + half >= _WIDEST:
        return -np.inf, np.inf, -np.inf, np.inf
    # Across the ray from the axis, this projection stretches angles by theta over its sine.
    farthest = from_axis + half
    extent = np.degrees(half * farthest / np.sin(farthest))
    share = np.degrees(from_axis) / beside if beside > 0 else 0.0
    return (share * left - extent, share * left + extent, share * up - extent, share * up + extent)


@compiled_part()
def _tangents(ahead: float, beside: float, around_m: float) -> tuple[float, float]:
    """Slopes of the lines from the origin that touch a circle, cut to what lies ahead."""
    distance = np.sqrt(ahead * ahead + beside * beside)
    if distance <= around_m:
        return -np.inf, np.inf
    middle, half = np.arctan2(beside, ahead), np.arcsin(around_m / distance)
    low, high = max(middle - half, -_UPRIGHT), min(middle + half, _UPRIGHT)
    if low >= high:
        return 0.0, -1.0
    return np.tan(low), np.tan(high)


@compiled_part()
def _direction(projection: int, u: float, v: float) -> _Ray:
    """Unit vector in the sensor frame."""
    if projection == SPHERICAL:
        azimuth, elevation = np.radians(u), np.radians(v)
        flat = np.cos(elevation)
        return flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)
    if projection == PINHOLE:
        length = np.sqrt(1 + u * u + v * v)
        return 1 / length, u / length, v / length
    angle_deg = np.sqrt(u * u + v * v)
    angle = np.radians(angle_deg)
    share = np.sin(angle) / angle_deg if angle_deg > 0 else 0.0
    return np.cos(angle), share * u, share * v


@compiled_part()
def _turned(rotation: Floats, ray: _Ray) -> _Ray:
    return (
        rotation[0, 0] * ray[0] + rotation[0, 1] * ray[1] + rotation[0, 2] * ray[2],
        rotation[1, 0] * ray[0] + rotation[1, 1] * ray[1] + rotation[1, 2] * ray[2],
        rotation[2, 0] * ray[0] + rotation[2, 1] * ray[1] + rotation[2, 2] * ray[2],
    )


@compiled()
def scene_range_m(scene_m: Floats32, slopes: Floats, start: float, ray: _Ray) -> float:
    """Range of the scene along a unit vector of the local frame; 0 where nothing is in range.

    Parameters
    ----------
    scene_m : (rows, columns) of the panorama. slopes : (rows,) of its rows, increasing.
    start : azimuth of its first column's right border in the local frame, rad.
    """
    rows, columns = scene_m.shape
    flat = np.sqrt(ray[0] * ray[0] + ray[1] * ray[1])
    slope = ray[2] / flat if flat > 1e-12 else np.inf * np.sign(ray[2])
    if slope > slopes[rows - 1]:
        return 0.0
    upper = min(max(np.searchsorted(slopes, slope), 1), rows - 1)
    # Between rows elevations are nearly even, and so are their slopes.
    gap = slopes[upper] - slopes[upper - 1]
    rise = min(max((slope - slopes[upper - 1]) / gap, 0.0), 1.0)
    place = ((np.arctan2(ray[1], ray[0]) - start) / (2 * np.pi) % 1.0) * columns - 0.5
    left = int(np.floor(place))
    across = place - left
    first, second = left % columns, (left + 1) % columns
    low, high = np.inf, 0.0
    for row in (upper - 1, upper):
        for column in (first, second):
            range_m = float(scene_m[row, column])
            low, high = min(low, range_m), max(high, range_m)
    if low == 0.0 or high > _ONE_SURFACE * low:
        return float(scene_m[upper if rise > 0.5 else upper - 1, second if across > 0.5 else first])
    below = (1 - across) / scene_m[upper - 1, first] + across / scene_m[upper - 1, second]
    above = (1 - across) / scene_m[upper, first] + across / scene_m[upper, second]
    return 1 / ((1 - rise) * below + rise * above)
