"""Which targets a sensor sees (paper 1, section 2.5, Fig. 15).

The paper renders a depth map of every target and counts the beams on which the target is nearer
than the scene. Here the same count comes from the target's angular footprint alone: a target is an
upright, solid, capped cylinder, and in the vertical plane of one azimuth it is a rectangle.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from roadsight.base.arrays import Floats, Floats32, Ints, Ints32
from roadsight.base.kernels import compiled, compiled_part
from roadsight.base.sections.sensing import Targets
from roadsight.placement.sensors.rays import sensor_from_local
from roadsight.placement.sensors.sensors import Sensor

_USUAL = Targets()
MIN_BEAMS = _USUAL.min_beams  # a target is seen when more beams return (paper 1, Table 3)
_TOUCH_M = 1e-9  # a sensor this near to a target's side touches it and counts as inside


def count_hits(
    range_m: Floats32,
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    targets_xyz_m: NDArray[np.floating],
    radius_m: float = _USUAL.radius_m,
    height_m: float = _USUAL.height_m,
    max_range_m: float | None = None,
) -> Ints32:
    """Number of beams that return from each target (n,).

    A beam returns from a target if it meets the cylinder within the sensor's range and nearer than
    anything in the scene; equal ranges are the scene's. The pavement needs no tolerance: a cylinder
    stands on it, so a beam that meets both meets the cylinder first, and where the pavement bulges
    above the foot it does hide it. A sensor inside a target sees nothing of it; right above one it
    sees the top.

    Parameters
    ----------
    range_m : depth map of the scene, (rows, columns), 0 where nothing returns.
    position_m : (3,) of the sensor, local metres. yaw_deg : its x axis from local x,
        counter-clockwise.
    targets_xyz_m : (n, 3) feet of the targets, local metres.
    radius_m, height_m : of every target.
    max_range_m : range from which targets return; the sensor's if not given.
    """
    feet = sensor_from_local(targets_xyz_m, position_m, yaw_deg)
    azimuth = np.radians(sensor.azimuth_deg)
    elevation = np.radians(sensor.elevation_deg)
    return _count(
        range_m,
        np.column_stack([np.cos(azimuth), np.sin(azimuth)]),
        np.tan(elevation),
        1 / np.cos(elevation),
        sensor.azimuth_min_deg,
        sensor.azimuth_cell_deg,
        sensor.range_m if max_range_m is None else max_range_m,
        np.ascontiguousarray(feet),
        radius_m,
        height_m,
    )


@compiled()
def _count(
    depth_m: Floats32,
    heading: Floats,
    slope: Floats,
    secant: Floats,
    start_deg: float,
    cell_deg: float,
    max_range_m: float,
    feet: Floats,
    radius_m: float,
    height_m: float,
) -> Ints32:
    """Beams on each target: ``heading`` (columns, 2), ``slope`` and ``secant`` (rows,)."""
    hits = np.zeros(len(feet), np.int32)
    for target in range(len(feet)):
        x, y, low = feet[target]
        if np.sqrt(x * x + y * y) - radius_m >= max_range_m:
            continue
        for first, last in column_windows(x, y, radius_m, start_deg, cell_deg, len(heading)):
            for column in range(first, last + 1):
                near, far = chord(x, y, heading[column, 0], heading[column, 1], radius_m)
                rectangle = (near, far, low, low + height_m)
                first_row, last_row = rows_across(rectangle, slope)
                for row in range(first_row, last_row):
                    range_m = entry(rectangle, slope[row]) * secant[row]
                    scene_m = depth_m[row, column]
                    if range_m < max_range_m and (scene_m == 0 or range_m < scene_m):
                        hits[target] += 1
    return hits


def target_ranges(
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    foot_m: ArrayLike,
    radius_m: float,
    height_m: float,
) -> tuple[Ints, Ints, Floats]:
    """Row, column and range of each beam that meets a target within the sensor's range.

    They are the depth map of the target alone (paper 1, section 2.5, step iii).

    Parameters
    ----------
    position_m, yaw_deg : as `count_hits`. foot_m : (3,) of the target, local metres.
    """
    range_m = _target_map(
        sensor_from_local(foot_m, position_m, yaw_deg),
        np.radians(sensor.azimuth_deg),
        np.tan(np.radians(sensor.elevation_deg)),
        sensor.azimuth_min_deg,
        sensor.azimuth_cell_deg,
        radius_m,
        height_m,
    )
    rows, columns = np.nonzero((range_m > 0) & (range_m < sensor.range_m))
    return rows, columns, range_m[rows, columns]


@compiled()
def _target_map(
    foot: Floats,
    azimuth: Floats,
    slope: Floats,
    start_deg: float,
    cell_deg: float,
    radius_m: float,
    height_m: float,
) -> Floats:
    """Range of each beam (rows, columns) to a target, 0 where it misses it."""
    range_m = np.zeros((len(slope), len(azimuth)))
    x, y, low = foot
    for first, last in column_windows(x, y, radius_m, start_deg, cell_deg, len(azimuth)):
        for column in range(first, last + 1):
            near, far = chord(x, y, np.cos(azimuth[column]), np.sin(azimuth[column]), radius_m)
            rectangle = (near, far, low, low + height_m)
            first_row, end_row = rows_across(rectangle, slope)
            for row in range(first_row, end_row):
                range_m[row, column] = entry(rectangle, slope[row]) * np.sqrt(1 + slope[row] ** 2)
    return range_m


@compiled_part()
def column_windows(
    x: float, y: float, radius_m: float, start_deg: float, cell_deg: float, columns: int
) -> tuple[tuple[int, int], tuple[int, int]]:
    """First and last column of the two runs of columns whose beams may meet a circle.

    Azimuths repeat after 360 degrees, so the circle appears at two places of the column axis; each
    run is cut to the columns that there are. An empty run ends before it begins.
    """
    distance = np.sqrt(x * x + y * y)
    if distance <= radius_m:
        return (0, columns - 1), (0, -1)
    half_deg = np.degrees(np.arcsin(radius_m / distance))
    left_deg = (np.degrees(np.arctan2(y, x)) - half_deg - start_deg) % 360.0
    return (
        _cut(left_deg, left_deg + 2 * half_deg, cell_deg, columns),
        _cut(left_deg - 360.0, left_deg + 2 * half_deg - 360.0, cell_deg, columns),
    )


@compiled_part()
def _cut(low_deg: float, high_deg: float, cell_deg: float, columns: int) -> tuple[int, int]:
    """Columns whose centres lie between two azimuths, counted from the field of view's limit."""
    # Rounding must not lose a column whose beam just touches the circle; `chord` decides on it.
    first = int(np.ceil(low_deg / cell_deg - 0.5 - 1e-9))
    last = int(np.floor(high_deg / cell_deg - 0.5 + 1e-9))
    return max(first, 0), min(last, columns - 1)


@compiled_part()
def chord(x: float, y: float, cosine: float, sine: float, radius_m: float) -> tuple[float, float]:
    """Horizontal distances at which a beam enters and leaves a circle; (0, 0) if it does not."""
    along, beside = x * cosine + y * sine, x * sine - y * cosine
    squared = radius_m * radius_m - beside * beside
    if squared < 0.0 or along + np.sqrt(squared) <= 0.0:
        return 0.0, 0.0
    half = np.sqrt(squared)
    near = along - half
    return near if near > _TOUCH_M else 0.0, along + half


@compiled_part()
def rows_across(rectangle: tuple[float, float, float, float], slope: Floats) -> tuple[int, int]:
    """Range of rows whose slopes lead from the origin into a rectangle (near, far, low, high)."""
    near, far, low, high = rectangle
    if far <= 0.0 or (near == 0.0 and low <= 0.0 <= high):
        return 0, 0
    if near > 0.0:
        least, greatest = min(low / near, low / far), max(high / near, high / far)
    elif high < 0.0:
        least, greatest = -np.inf, high / far
    else:
        least, greatest = low / far, np.inf
    first, end = np.searchsorted(slope, least), np.searchsorted(slope, greatest, side="right")
    return int(first), int(end)


@compiled_part()
def entry(rectangle: tuple[float, float, float, float], slope: float) -> float:
    """Horizontal distance at which a beam enters a rectangle that it meets."""
    near, _, low, high = rectangle
    if slope * near > high:
        return high / slope
    if slope * near < low:
        return low / slope
    return near


def detection_matrix(
    detections: pd.DataFrame, choices: pd.MultiIndex, targets: pd.Index
) -> sparse.csr_matrix:
    """Boolean matrix, rows = choices (sensor, candidate), columns = targets.

    Parameters
    ----------
    detections : columns sensor, candidate, target; one row per seen target.
    """
    # Names are looked up once per category, not once per detection.
    sensor, candidate, target = (
        detections[name].astype("category").cat for name in ("sensor", "candidate", "target")
    )
    pairs = pd.MultiIndex.from_product([sensor.categories, candidate.categories])
    pair = sensor.codes.to_numpy(np.int64) * len(candidate.categories) + candidate.codes
    rows = choices.get_indexer(pairs)[pair] if len(pair) else np.empty(0, np.int64)
    columns = targets.get_indexer(target.categories)[target.codes]
    known = (rows >= 0) & (columns >= 0)
    ones = np.ones(int(known.sum()), dtype=bool)
    shape = (len(choices), len(targets))
    return sparse.csr_matrix((ones, (rows[known], columns[known])), shape=shape, dtype=bool)


def times_seen(matrix: sparse.csr_matrix, chosen: Ints) -> Ints:
    """How many of the chosen rows see each target (n,)."""
    return np.asarray(matrix[chosen].sum(axis=0, dtype=np.int64)).ravel()


def availability(
    detections: pd.DataFrame, chosen: set[tuple[str, str]], targets: pd.Series
) -> Floats:
    """Share of the time (n,) in which at least one chosen sensor sees each target past traffic.

    Sensors at different places look past different vehicles, so that their shares are taken as
    independent: 1 - prod(1 - p). A target that none of them sees has 0.

    Parameters
    ----------
    detections : columns sensor, candidate, target, availability. chosen : sensor and candidate.
    """
    pairs = pd.MultiIndex.from_frame(detections[["sensor", "candidate"]])
    used = detections[pairs.isin(chosen)]
    never = (1 - used["availability"].astype(np.float64)).groupby(used["target"].astype(str)).prod()
    hidden = never.reindex(targets.astype(str), fill_value=1.0).to_numpy(np.float64)
    return np.asarray(1 - hidden)
