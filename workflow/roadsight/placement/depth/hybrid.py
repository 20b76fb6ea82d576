"""Depth maps from the points themselves (paper 1, section 2.4, Algorithm 1).

A cell of at least ``min_cell_points`` points returns their least range (Step 4). Every other cell
takes the points nearest to its centre in azimuth and elevation (Step 5) and measures each one's
distance d to the beam (Eqs. 3 and 4). The text at hand lost Steps 6 and 7, a "spatial
interpolation". Two things are guessed here. The cell returns the mean range of these points,
weighted by 1 / d. Points farther from the beam than ``reach_cells`` cells take no part: some such
limit there must be, since refined maps have elements of 0 (Fig. 12), and without one the whole sky
would return the nearest treetop.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Floats, Floats32, Ints
from roadsight.base.kernels import compiled
from roadsight.base.sections.sensing import Lidar
from roadsight.placement.depth.angular_neighbours import Spherical, bin_points, fill_cells
from roadsight.placement.sensors.sensors import Sensor

_USUAL = Lidar()


def preliminary_depth(
    xyz_m: NDArray[np.floating], sensor: Sensor, position_m: ArrayLike, yaw_deg: float
) -> Floats32:
    """Least range per cell, 0 where a cell is empty (Steps 1 to 4); shape (rows, columns).

    Parameters
    ----------
    xyz_m : (n, 3) points, local metres; those that are not finite are left out.
    position_m : (3,) of the sensor, local metres.
    yaw_deg : sensor x from local x, counter-clockwise.
    """
    least, counts = least_ranges(points_in_range(xyz_m, sensor, position_m, yaw_deg), sensor)
    return np.where(counts > 0, least, 0.0).astype(np.float32)


def hybrid_depth(
    xyz_m: NDArray[np.floating],
    sensor: Sensor,
    position_m: ArrayLike,
    yaw_deg: float,
    *,
    min_cell_points: int = _USUAL.min_cell_points,
    neighbours: int = _USUAL.neighbours,
    reach_cells: float = _USUAL.reach_cells,
) -> Floats32:
    """Algorithm 1: range of every beam, 0 where nothing is near it; shape (rows, columns).

    Equally near neighbours are taken in input order. Fewer than ``neighbours`` points within reach
    are used as they are; a point on the beam itself alone decides the range.

    Parameters
    ----------
    xyz_m, position_m, yaw_deg : as `preliminary_depth`.
    min_cell_points : N, cells with fewer points are filled. neighbours : K2.
    reach_cells : farthest neighbours, in longest sides of a cell.
    """
    points = points_in_range(xyz_m, sensor, position_m, yaw_deg)
    least, counts = least_ranges(points, sensor)
    sparse = counts < min_cell_points
    depth = np.where(sparse, 0.0, least)
    if len(points.range_m):
        reach = reach_deg(sensor, reach_cells)
        bins = bin_points(points, reach, sensor.elevation_edges_deg)
        beams = (sensor.azimuth_deg, sensor.elevation_deg)
        fill_cells(points, bins, *beams, reach, neighbours, sparse, depth)
    return depth.astype(np.float32)


def reach_deg(sensor: Sensor, reach_cells: float = _USUAL.reach_cells) -> float:
    """Greatest angle between a beam and the points that may fill its cell."""
    tallest = float(np.diff(sensor.elevation_edges_deg).max())
    return min(reach_cells * max(sensor.azimuth_cell_deg, tallest), 45.0)


def points_in_range(
    xyz_m: NDArray[np.floating], sensor: Sensor, position_m: ArrayLike, yaw_deg: float
) -> Spherical:
    """Spherical coordinates (Eqs. 1 and 2) of the points nearer than the sensor's range.

    A point at the sensor's very centre has no direction and is left out.
    """
    position = np.asarray(position_m, np.float64)
    return Spherical(*_spherical(xyz_m, position, np.radians(yaw_deg), sensor.range_m))


def least_ranges(points: Spherical, sensor: Sensor) -> tuple[Floats, Ints]:
    """Least range (infinite if none) and number of points of each cell, both (rows, columns)."""
    least, counts = np.full(sensor.shape, np.inf), np.zeros(sensor.shape, np.int64)
    edges, start = sensor.elevation_edges_deg, sensor.azimuth_min_deg
    span = sensor.azimuth_max_deg - start
    _least(points, edges, start, span, least, counts)
    return least, counts


@compiled()
def _spherical(
    xyz_m: NDArray[np.floating], position_m: Floats, yaw: float, max_range_m: float
) -> tuple[Floats, Floats, Floats]:
    azimuth, elevation, distance = (
        np.empty(len(xyz_m)),
        np.empty(len(xyz_m)),
        np.empty(len(xyz_m)),
    )
    cosine, sine = np.cos(yaw), np.sin(yaw)
    n = 0
    for i in range(len(xyz_m)):
        dx, dy = xyz_m[i, 0] - position_m[0], xyz_m[i, 1] - position_m[1]
        z = xyz_m[i, 2] - position_m[2]
        range_m = np.sqrt(dx * dx + dy * dy + z * z)
        if 0 < range_m < max_range_m:
            x, y = cosine * dx + sine * dy, cosine * dy - sine * dx
            azimuth[n] = np.degrees(np.arctan2(y, x))
            elevation[n] = np.degrees(np.arctan2(z, np.sqrt(x * x + y * y)))
            distance[n] = range_m
            n += 1
    return azimuth[:n].copy(), elevation[:n].copy(), distance[:n].copy()


@compiled()
def _least(
    points: Spherical,
    edges_deg: Floats,
    start_deg: float,
    span_deg: float,
    least: Floats,
    counts: Ints,
) -> None:
    rows, columns = least.shape
    per_column = span_deg / columns
    for i in range(len(points.range_m)):
        row = np.searchsorted(edges_deg, points.elevation_deg[i], side="right") - 1
        column = int(((points.azimuth_deg[i] - start_deg) % 360.0) / per_column)
        if column >= columns and span_deg == 360.0:
            column = 0
        if 0 <= row < rows and column < columns:
            counts[row, column] += 1
            least[row, column] = min(least[row, column], points.range_m[i])
