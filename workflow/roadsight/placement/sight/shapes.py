"""Shapes of targets and footprints of beams, as kernels take them.

A shape stands on its foot, (3,) relative to the sensor, in the local frame; a box's foot is (4,),
with the heading of its length from local x, counter-clockwise, rad. A kernel knows it by
its `packed` numbers and asks `entered_at` where a ray enters it and `footprint_share` how much of a
wide beam lies on it; a further shape is a further number in `kinds`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Floats, Floats32
from roadsight.base.kernels import compiled, compiled_part
from roadsight.placement.sensors.rays import beam_directions, sensor_from_local
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.detection import chord, column_windows, entry, rows_across
from roadsight.placement.sight.kinds import CYLINDER, Box, Packed, Shape

CLEAN_SHARE = 0.5  # least share of a footprint on a target, so that the range is the target's


def count_shared_hits(
    range_m: Floats32,
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    tilt: Floats | None,
    targets_xyz_m: NDArray[np.floating],
    radius_m: float,
    height_m: float,
    max_range_m: float,
) -> Floats:
    """Sum of the footprints' shares on each target (n,), of the beams that `count_hits` counts.

    A footprint is a rectangle of the sensor's divergence, widened by its aperture, across and
    upright. The silhouette is a rectangle as well: what the beam's own row and column see of the
    cylinder. Under a tilt the cylinder is taken as upright in the sensor's frame, which for a few
    degrees moves its top by centimetres.

    Parameters
    ----------
    tilt : rotation (3, 3) from the levelled to the mounted sensor, local frame, or None.
    max_range_m : range from which targets return.
    """
    position = np.asarray(position_m, np.float64)
    xyz_m = np.asarray(targets_xyz_m, np.float64)
    if tilt is not None:
        xyz_m = (xyz_m - position) @ tilt + position
    feet = sensor_from_local(xyz_m, position, yaw_deg)
    azimuth, elevation = np.radians(sensor.azimuth_deg), np.radians(sensor.elevation_deg)
    across_mrad, upright_mrad = sensor.divergence_mrad or (0.0, 0.0)
    return _count(
        range_m,
        np.column_stack([np.cos(azimuth), np.sin(azimuth)]),
        np.tan(elevation),
        sensor.azimuth_min_deg,
        sensor.azimuth_cell_deg,
        max_range_m,
        np.ascontiguousarray(feet),
        (radius_m, height_m),
        (across_mrad / 1000, upright_mrad / 1000, sensor.aperture_mm / 1000),
    )


@compiled()
def _count(
    depth_m: Floats32,
    heading: Floats,
    slope: Floats,
    start_deg: float,
    cell_deg: float,
    max_range_m: float,
    feet: Floats,
    size_m: tuple[float, float],
    beam: tuple[float, float, float],
) -> Floats:
    """Shares on each target; ``beam`` is divergence across and upright, rad, and aperture, m."""
    shares = np.zeros(len(feet))
    radius_m, height_m = size_m
    secant = np.sqrt(1 + slope * slope)
    for target in range(len(feet)):
        x, y, low = feet[target]
        distance = np.sqrt(x * x + y * y)
        if distance - radius_m >= max_range_m:
            continue
        for first, last in column_windows(x, y, radius_m, start_deg, cell_deg, len(heading)):
            for column in range(first, last + 1):
                cosine, sine = heading[column, 0], heading[column, 1]
                near, far = chord(x, y, cosine, sine, radius_m)
                rectangle = (near, far, low, low + height_m)
                first_row, last_row = rows_across(rectangle, slope)
                for row in range(first_row, last_row):
                    range_m = entry(rectangle, slope[row]) * secant[row]
                    scene_m = depth_m[row, column]
                    if range_m >= max_range_m or (scene_m > 0 and range_m >= scene_m):
                        continue
                    wide_m = beam[2] + beam[0] * range_m
                    share = overlap(x * sine - y * cosine, wide_m, -radius_m, radius_m)
                    # Upright in slopes, of which an angle takes its secant squared.
                    tall = (beam[2] / range_m + beam[1]) * secant[row] ** 2
                    share *= overlap(slope[row], tall, *slopes_into(rectangle))
                    if share >= CLEAN_SHARE:
                        shares[target] += share
    return shares


@compiled_part()
def slopes_into(rectangle: tuple[float, float, float, float]) -> tuple[float, float]:
    """Least and greatest slope of lines from the origin into a rectangle (near, far, low, high)."""
    near, far, low, high = rectangle
    if near <= 0.0:
        return (-np.inf, high / far) if high < 0.0 else (low / far, np.inf)
    return min(low / near, low / far), max(high / near, high / far)


@compiled()
def overlap(middle: float, width: float, low: float, high: float) -> float:
    """Share of an interval about ``middle`` that lies between two limits."""
    if width <= 0.0:
        return 1.0
    inside = min(middle + width / 2, high) - max(middle - width / 2, low)
    return min(max(inside, 0.0) / width, 1.0)


def relative_to(feet_m: Floats, position_m: Floats) -> Floats:
    """Feet (n, 3) or (n, 4) relative to a sensor; headings stay."""
    moved = np.array(feet_m, np.float64)
    moved[:, :3] -= position_m
    return np.ascontiguousarray(moved)


@compiled_part()
def ball_around(shape: Packed) -> tuple[float, float]:
    """Height of the middle of a ball about a shape, and its radius."""
    kind, long_m, wide_m, height_m = shape
    across = long_m * long_m if kind == CYLINDER else (long_m * long_m + wide_m * wide_m) / 4
    return height_m / 2, np.sqrt(across + height_m**2 / 4)


@compiled_part()
def entry_range_m(
    direction: tuple[float, float, float], foot: Floats, radius_m: float, height_m: float
) -> float:
    """Range at which a beam from the origin enters an upright, capped cylinder; 0 if it does not.

    Parameters
    ----------
    direction : unit vector. foot : (3,) middle of the cylinder's lower cap.
    """
    east, north, up = direction
    enter, leave = 0.0, np.inf
    # A level beam crosses neither cap: it runs between them, or above or below the cylinder.
    if abs(up) > 1e-12:
        one, two = foot[2] / up, (foot[2] + height_m) / up
        enter, leave = max(enter, min(one, two)), min(leave, max(one, two))
    elif foot[2] > 0 or foot[2] + height_m < 0:
        return 0.0
    flat = east * east + north * north
    beside = foot[0] * foot[0] + foot[1] * foot[1] - radius_m * radius_m
    if flat < 1e-24:
        return enter if beside <= 0 and enter < leave else 0.0
    along = foot[0] * east + foot[1] * north
    squared = along * along - flat * beside
    if squared < 0:
        return 0.0
    root = np.sqrt(squared)
    enter, leave = max(enter, (along - root) / flat), min(leave, (along + root) / flat)
    return enter if enter < leave else 0.0


@compiled_part()
def entered_at(shape: Packed, foot: Floats, ray: tuple[float, float, float]) -> float:
    """Range at which a ray from the origin along a unit vector enters a shape; 0 if it does not."""
    kind, long_m, wide_m, height_m = shape
    if kind == CYLINDER:
        return entry_range_m(ray, foot, long_m, height_m)
    ahead, left, far_ahead, far_left = _along_box(foot, ray)
    enter, leave = 0.0, np.inf
    for middle, half, part in (
        (far_ahead, long_m / 2, ahead),
        (far_left, wide_m / 2, left),
        (foot[2] + height_m / 2, height_m / 2, ray[2]),
    ):
        if abs(part) < 1e-12:
            if abs(middle) > half:
                return 0.0
            continue
        one, two = (middle - half) / part, (middle + half) / part
        enter, leave = max(enter, min(one, two)), min(leave, max(one, two))
    return enter if enter < leave else 0.0


@compiled_part()
def height_band(
    shape: Packed, foot: Floats, ray: tuple[float, float, float], range_m: float, bands: int
) -> int:
    """Which of so many equal parts of the height, from 0 at the foot, a ray enters at a range."""
    share = (range_m * ray[2] - foot[2]) / shape[3]
    return min(max(int(share * bands), 0), bands - 1)


@compiled_part()
def _along_box(foot: Floats, ray: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """Ray and foot along the length and the width of a box."""
    cosine, sine = np.cos(foot[3]), np.sin(foot[3])
    return (
        cosine * ray[0] + sine * ray[1],
        cosine * ray[1] - sine * ray[0],
        cosine * foot[0] + sine * foot[1],
        cosine * foot[1] - sine * foot[0],
    )


@compiled_part()
def footprint_share(
    shape: Packed,
    foot: Floats,
    ray: tuple[float, float, float],
    range_m: float,
    beam: tuple[float, float, float],
) -> float:
    """Share of a beam's footprint that lies on a shape which its axis enters at a range.

    The footprint is a rectangle, level and upright, and so is the silhouette that the beam's own
    azimuth and elevation see (as in `count_shared_hits`).

    Parameters
    ----------
    beam : divergence across and upright, rad, and aperture, m.
    """
    kind, long_m, wide_m, height_m = shape
    flat = np.sqrt(ray[0] * ray[0] + ray[1] * ray[1])
    if flat < 1e-9:
        return 1.0
    cosine, sine, slope = ray[0] / flat, ray[1] / flat, ray[2] / flat
    if kind == CYLINDER:
        half_m = long_m
        near, far = chord(foot[0], foot[1], cosine, sine, long_m)
    else:
        # Half the width of a box across the beam, and where the beam enters and leaves its plan.
        ahead, left, far_ahead, far_left = _along_box(foot, (cosine, sine, 0.0))
        half_m = (long_m * abs(left) + wide_m * abs(ahead)) / 2
        near, far = _stretch(far_ahead, long_m / 2, ahead, far_left, wide_m / 2, left)
    if far <= 0.0:
        return 0.0
    beside = foot[0] * sine - foot[1] * cosine
    share = overlap(beside, beam[2] + beam[0] * range_m, -half_m, half_m)
    tall = (beam[2] / range_m + beam[1]) * (1 + slope * slope)
    low, high = slopes_into((near, far, foot[2], foot[2] + height_m))
    return share * overlap(slope, tall, low, high)


@compiled_part()
def _stretch(
    ahead_m: float, half_long: float, ahead: float, left_m: float, half_wide: float, left: float
) -> tuple[float, float]:
    """Horizontal distances at which a level ray enters and leaves a rectangle; (0, 0) if not."""
    enter, leave = 0.0, np.inf
    for middle, half, part in ((ahead_m, half_long, ahead), (left_m, half_wide, left)):
        if abs(part) < 1e-12:
            if abs(middle) > half:
                return 0.0, 0.0
            continue
        one, two = (middle - half) / part, (middle + half) / part
        enter, leave = max(enter, min(one, two)), min(leave, max(one, two))
    return (enter, leave) if enter < leave else (0.0, 0.0)


# Of a box that spans more rows or columns, every n-th is looked at and stands for n: near boxes
# would take most of the time, and have far more beams than it takes to see them.
_MOST = 64


def beams_on(
    range_m: Floats32,
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    tilt: Floats | None,
    feet_m: NDArray[np.floating],
    shape: Shape,
    max_range_m: float,
    footprints: bool,
    bands: int = 1,
) -> Floats:
    """Beams, or shares of wide beams, that return from each target by height, (n, bands).

    Every beam that may meet the sphere around a target is intersected with its shape; of boxes
    wider than 64 beams, evenly chosen beams stand for their neighbours.

    Parameters
    ----------
    range_m : depth map of the scene, 0 where nothing returns. tilt : rotation (3, 3) from the
        levelled to the mounted sensor, local frame, or None.
    feet_m : (n, 3) local metres, of boxes (n, 4) with headings, rad. shape : of every target.
    footprints : whether beams have the sensor's divergence.
    bands : equal parts of the height, the lowest first, in which beams enter.
    """
    position = np.asarray(position_m, np.float64)
    feet = relative_to(np.asarray(feet_m, np.float64), position)
    middles = feet[:, :3] + np.array([0.0, 0.0, shape.height_m / 2])
    if tilt is not None:
        middles = middles @ tilt
    across_mrad, upright_mrad = sensor.divergence_mrad or (0.0, 0.0)
    return count_met(
        range_m,
        beam_directions(sensor, yaw_deg, tilt),
        np.radians(sensor.elevation_deg),
        sensor.azimuth_min_deg,
        sensor.azimuth_cell_deg,
        max_range_m,
        feet,
        sensor_from_local(middles + position, position, yaw_deg),
        shape.packed,
        _MOST if isinstance(shape, Box) else max(sensor.shape),
        footprints,
        (across_mrad / 1000, upright_mrad / 1000, sensor.aperture_mm / 1000),
        bands,
    )


@compiled()
def count_met(
    depth_m: Floats32,
    directions: Floats32,
    elevation: Floats,
    start_deg: float,
    cell_deg: float,
    max_range_m: float,
    feet: Floats,
    mounted: Floats,
    shape: Packed,
    most: int,
    wide: bool,
    beam: tuple[float, float, float],
    bands: int,
) -> Floats:
    """Beams, or shares of wide ones, on each target (n, bands), of all that may meet its ball.

    Parameters
    ----------
    directions : (rows, columns, 3) unit vectors, local frame. feet : (n, 3) or (n, 4), from the
        sensor, local frame. mounted : (n, 3) targets' middles in the frame of the sensor.
    most : of a target that spans more rows or columns, every n-th is looked at and stands for n.
    beam : divergence across and upright, rad, and aperture, m; only for ``wide`` ones.
    """
    hits = np.zeros((len(feet), bands))
    _, around = ball_around(shape)
    for target in range(len(feet)):
        x, y, z = mounted[target]
        distance = np.sqrt(x * x + y * y + z * z)
        if distance - around >= max_range_m:
            continue
        first_row, last_row = 0, len(elevation)
        if distance > around:
            middle, half = np.arctan2(z, np.sqrt(x * x + y * y)), np.arcsin(around / distance)
            first_row = np.searchsorted(elevation, middle - half)
            last_row = np.searchsorted(elevation, middle + half, side="right")
        rows = max(1, -(-(last_row - first_row) // most))
        for first, last in column_windows(x, y, around, start_deg, cell_deg, depth_m.shape[1]):
            columns = max(1, -(-(last + 1 - first) // most))
            for row_start in range(first_row, last_row, rows):
                tall = min(rows, last_row - row_start)
                row = row_start + tall // 2
                for column_start in range(first, last + 1, columns):
                    across = min(columns, last + 1 - column_start)
                    column = column_start + across // 2
                    way = directions[row, column]
                    ray = (np.float64(way[0]), np.float64(way[1]), np.float64(way[2]))
                    range_m = entered_at(shape, feet[target], ray)
                    scene_m = depth_m[row, column]
                    if not 0 < range_m < max_range_m or 0 < scene_m <= range_m:
                        continue
                    share = 1.0
                    if wide:
                        share = footprint_share(shape, feet[target], ray, range_m, beam)
                    if share >= CLEAN_SHARE:
                        band = height_band(shape, feet[target], ray, range_m, bands)
                        hits[target, band] += share * tall * across
    return hits
