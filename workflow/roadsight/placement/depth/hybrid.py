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

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Bools, Floats, Floats32, Ints
from roadsight.base.kernels import compiled, compiled_part
from roadsight.base.sections.sensing import Lidar
from roadsight.placement.sensors.sensors import Sensor

_USUAL = Lidar()


class Spherical(NamedTuple):
    """Points around a sensor, in input order: angles in degrees and range in metres, each (n,)."""

    azimuth_deg: Floats
    elevation_deg: Floats
    range_m: Floats


class Bins(NamedTuple):
    """Points sorted into bins of azimuth (all around) and elevation.

    Parameters
    ----------
    start : (rows * columns + 1,) where each bin begins in ``order``; rows are bins of elevation.
    order : (n,) points by bin, in input order inside a bin.
    columns, rows : number of bins. width_deg, height_deg : of a bin. bottom_deg : lowest elevation.
    """

    start: Ints
    order: Ints
    columns: int
    rows: int
    width_deg: float
    height_deg: float
    bottom_deg: float


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


# Bins within the reach of a beam. More of them mean fewer points to look at in more bins; what is
# found stays the same.
_BINS_IN_REACH = 6
_ON_BEAM_M = 1e-9  # nearer points are on the beam: the inverse of their distance means nothing


def bin_points(points: Spherical, reach_deg: float, edges_deg: Floats) -> Bins:
    """Sort points into bins; those farther than the reach from all beams are left out.

    Parameters
    ----------
    reach_deg : greatest angle of neighbours, at most 45. edges_deg : borders of the beams' cells.
    """
    height = reach_deg / _BINS_IN_REACH
    columns = int(360.0 / height)
    bottom = edges_deg[0] - reach_deg
    rows = int(np.ceil((edges_deg[-1] + reach_deg - bottom) / height))
    row = np.floor((points.elevation_deg - bottom) / height).astype(np.int64)
    column = np.floor((points.azimuth_deg + 180.0) / 360.0 * columns).astype(np.int64) % columns
    inside = np.flatnonzero((row >= 0) & (row < rows))
    flat = row[inside] * columns + column[inside]
    counts = np.bincount(flat, minlength=rows * columns)
    start = np.concatenate([[0], np.cumsum(counts)])
    order = inside[np.argsort(flat, kind="stable")]
    return Bins(start, order, columns, rows, 360.0 / columns, height, bottom)


@compiled()
def fill_cells(
    points: Spherical,
    bins: Bins,
    azimuth_deg: Floats,
    elevation_deg: Floats,
    reach_deg: float,
    neighbours: int,
    sparse: Bools,
    depth_m: Floats,
) -> None:
    """Interpolate the range of sparse cells (Steps 5 to 7); without neighbours it stays as it is.

    Parameters
    ----------
    azimuth_deg, elevation_deg : (columns,), (rows,) of the beams.
    sparse : (rows, columns) cells to fill. depth_m : (rows, columns), changed in place.
    """
    nearest = np.empty(neighbours, np.int64)
    gap = np.empty(neighbours)
    for row in range(len(elevation_deg)):
        for column in range(len(azimuth_deg)):
            if sparse[row, column]:
                beam = (azimuth_deg[column], elevation_deg[row])
                found = _find_nearest(points, bins, beam, reach_deg, nearest, gap)
                if found > 0:
                    depth_m[row, column] = _weighted_range(points, nearest[:found], beam)


@compiled_part()
def _find_nearest(
    points: Spherical,
    bins: Bins,
    beam_deg: tuple[float, float],
    reach_deg: float,
    nearest: Ints,
    gap: Floats,
) -> int:
    """Nearest points, nearest first (``gap``: squared angles); returns how many there are.

    Bins are searched in square rings around the beam's own bin until no point outside can be
    nearer.
    """
    own_row = int(np.floor((beam_deg[1] - bins.bottom_deg) / bins.height_deg))
    own_column = int(np.floor((beam_deg[0] + 180.0) / bins.width_deg))
    step_deg = min(bins.width_deg, bins.height_deg)
    found = 0
    # One ring more than the reach, because the beam may lie anywhere in its own bin.
    for ring in range(_BINS_IN_REACH + 2):
        for row in range(max(own_row - ring, 0), min(own_row + ring + 1, bins.rows)):
            stride = 1 if abs(row - own_row) == ring else max(2 * ring, 1)
            for column in range(own_column - ring, own_column + ring + 1, stride):
                found = _scan_bin(
                    points,
                    bins,
                    row,
                    column % bins.columns,
                    beam_deg,
                    reach_deg,
                    nearest,
                    gap,
                    found,
                )
        searched_deg = ring * step_deg
        if searched_deg >= reach_deg:
            break
        if found == len(nearest) and gap[found - 1] < searched_deg * searched_deg:
            break
    return found


@compiled_part()
def _scan_bin(
    points: Spherical,
    bins: Bins,
    row: int,
    column: int,
    beam_deg: tuple[float, float],
    reach_deg: float,
    nearest: Ints,
    gap: Floats,
    found: int,
) -> int:
    """Insert the points of one bin into the sorted list of nearest ones; returns its new length."""
    flat = row * bins.columns + column
    for place in range(bins.start[flat], bins.start[flat + 1]):
        i = bins.order[place]
        along = abs(points.azimuth_deg[i] - beam_deg[0]) % 360.0
        along = min(along, 360.0 - along)
        up = points.elevation_deg[i] - beam_deg[1]
        squared = along * along + up * up
        if squared > reach_deg * reach_deg:
            continue
        slot = found
        while slot > 0 and (
            squared < gap[slot - 1] or (squared == gap[slot - 1] and i < nearest[slot - 1])
        ):
            slot -= 1
        if slot == len(nearest):
            continue
        found = min(found + 1, len(nearest))
        for k in range(found - 1, slot, -1):
            gap[k], nearest[k] = gap[k - 1], nearest[k - 1]
        gap[slot], nearest[slot] = squared, i
    return found


@compiled_part()
def _weighted_range(points: Spherical, nearest: Ints, beam_deg: tuple[float, float]) -> float:
    """Mean range weighted by the inverse distance to the beam (Eqs. 3 and 4)."""
    bx, by, bz = _direction(beam_deg[0], beam_deg[1])
    total, weights = 0.0, 0.0
    on_beam, hits = 0.0, 0
    for i in nearest:
        ux, uy, uz = _direction(points.azimuth_deg[i], points.elevation_deg[i])
        cx, cy, cz = uy * bz - uz * by, uz * bx - ux * bz, ux * by - uy * bx
        distance = points.range_m[i] * np.sqrt(cx * cx + cy * cy + cz * cz)
        if distance <= _ON_BEAM_M:
            on_beam += points.range_m[i]
            hits += 1
        else:
            total += points.range_m[i] / distance
            weights += 1 / distance
    return on_beam / hits if hits else total / weights


@compiled_part()
def _direction(azimuth_deg: float, elevation_deg: float) -> tuple[float, float, float]:
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    horizontal = np.cos(elevation)
    return horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), np.sin(elevation)
