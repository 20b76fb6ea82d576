"""Ground as an exact height function along a road, with the bounds that ray casting needs.

``z = z0 + grade * station + profile(offset) + spline(station, offset)``: the profile is piecewise
linear (kerbs and pavement edges stay sharp), the spline is a biquadratic uniform B-spline (bumps,
hills), once continuously differentiable. A B-spline lies between its least and greatest active
coefficient, and its slope between those of the coefficients; so every bound below is rigorous.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats
from roadsight.base.kernels import compiled
from roadsight_worlds.casting.alignment import Alignment, heading_at, road_point, to_road
from roadsight_worlds.casting.kernel import compiled_kernel, kernel

# Bounds are so much wider than computed: far more than rounding, far less than a bump.
_SLACK_M = 1e-6


class Terrain(NamedTuple):
    """Height function in road coordinates; it exists only within its stations and offsets.

    Parameters
    ----------
    alignment : reference line.
    height_m, grade : height of the reference plane at station 0, and its rise over run.
    profile_offset_m, profile_height_m : (k,) break points, k >= 2, offsets increasing; beyond the
        ends the profile is level.
    coefficient_m : (i, j) B-spline coefficients on nodes of station and offset.
    first_station_m, first_offset_m : node (0, 0).
    station_step_m, offset_step_m : node spacing.
    start_m, end_m, right_m, left_m : limits of station and offset.
    object_id : object of the scene that the ground is.
    """

    alignment: Alignment
    height_m: float
    grade: float
    profile_offset_m: Floats
    profile_height_m: Floats
    coefficient_m: Floats
    first_station_m: float
    first_offset_m: float
    station_step_m: float
    offset_step_m: float
    start_m: float
    end_m: float
    right_m: float
    left_m: float
    object_id: int


class CellBounds(NamedTuple):
    """Bounds of the terrain over square cells, (rows, columns) each; empty cells have low > high.

    Over a cell the height lies within [low_m, high_m] and the plan gradient within ``spread`` of
    (slope_x, slope_y).
    """

    low_m: Floats
    high_m: Floats
    slope_x: Floats
    slope_y: Floats
    spread: Floats


@kernel
def _profile(terrain: Terrain, offset: float) -> tuple[float, float]:
    """Height and slope of the profile."""
    x, z = terrain.profile_offset_m, terrain.profile_height_m
    if offset <= x[0]:
        return z[0], 0.0
    if offset >= x[-1]:
        return z[-1], 0.0
    low, high = 0, len(x) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if x[middle] <= offset:
            low = middle
        else:
            high = middle
    slope = (z[high] - z[low]) / (x[high] - x[low])
    return z[low] + slope * (offset - x[low]), slope


@kernel
def _spline(terrain: Terrain, station: float, offset: float) -> tuple[float, float, float]:
    """Value and slopes along station and offset of the B-spline (edge nodes repeat outwards)."""
    u = (station - terrain.first_station_m) / terrain.station_step_m
    v = (offset - terrain.first_offset_m) / terrain.offset_step_m
    i, j = math.floor(u + 0.5), math.floor(v + 0.5)
    f, g = u - i, v - j
    wu = (0.5 * (0.5 - f) ** 2, 0.75 - f * f, 0.5 * (0.5 + f) ** 2)
    wv = (0.5 * (0.5 - g) ** 2, 0.75 - g * g, 0.5 * (0.5 + g) ** 2)
    du, dv = (f - 0.5, -2.0 * f, f + 0.5), (g - 0.5, -2.0 * g, g + 0.5)
    rows, columns = terrain.coefficient_m.shape
    value = along = across = 0.0
    for a in range(3):
        row = min(max(i + a - 1, 0), rows - 1)
        inner = slope = 0.0
        for b in range(3):
            c = terrain.coefficient_m[row, min(max(j + b - 1, 0), columns - 1)]
            inner += wv[b] * c
            slope += dv[b] * c
        value += wu[a] * inner
        along += du[a] * inner
        across += wu[a] * slope
    return value, along / terrain.station_step_m, across / terrain.offset_step_m


@compiled_kernel
def surface_height(terrain: Terrain, x: float, y: float) -> float:
    """Height of the ground at a plan point, also beyond its limits (see `exists`)."""
    station, offset = road_point(terrain.alignment, x, y)
    base = terrain.height_m + terrain.grade * station
    return base + _profile(terrain, offset)[0] + _spline(terrain, station, offset)[0]


@kernel
def surface_gradient(terrain: Terrain, x: float, y: float) -> tuple[float, float]:
    """Plan gradient (dz/dx, dz/dy) of the ground."""
    station, offset = road_point(terrain.alignment, x, y)
    _, along, across = _spline(terrain, station, offset)
    k = terrain.alignment.curvature_per_m
    along = (along + terrain.grade) / (1.0 - k * offset)
    across += _profile(terrain, offset)[1]
    turn_cos, turn_sin = math.cos(k * station), math.sin(k * station)
    ahead, left = turn_cos * along - turn_sin * across, turn_sin * along + turn_cos * across
    cos, sin = terrain.alignment.ahead_x, terrain.alignment.ahead_y
    return cos * ahead - sin * left, sin * ahead + cos * left


@kernel
def exists(terrain: Terrain, x: float, y: float) -> bool:
    """Whether the ground exists at a plan point."""
    station, offset = road_point(terrain.alignment, x, y)
    along = terrain.start_m <= station <= terrain.end_m
    return along and terrain.right_m <= offset <= terrain.left_m


@compiled(error_model="numpy")
def _heights(terrain: Terrain, xy: Floats) -> Floats:
    z = np.empty(len(xy))
    for i in range(len(xy)):
        x, y = xy[i, 0], xy[i, 1]
        z[i] = surface_height(terrain, x, y) if exists(terrain, x, y) else math.nan
    return z


def height_at(terrain: Terrain, xy_m: ArrayLike) -> Floats:
    """Exact ground height (n,) at local plan points (n, 2), metres; NaN where there is none."""
    return _heights(terrain, np.ascontiguousarray(xy_m, dtype=np.float64).reshape(-1, 2))


def cell_bounds(terrain: Terrain, x_m: Floats, y_m: Floats, cell_m: float) -> CellBounds:
    """Bounds over the square cells of width ``cell_m`` centred at columns x and rows y.

    Cells must be small against the radius of the road and against its end-to-end turn.
    """
    xy = np.stack(np.meshgrid(x_m, y_m), axis=-1)
    road = to_road(terrain.alignment, xy).reshape(xy.shape)
    station, offset = road[..., 0], road[..., 1]
    reach = cell_m * math.sqrt(0.5) + _SLACK_M
    k = terrain.alignment.curvature_per_m
    stretch = 1.0 / np.maximum(1.0 - k * offset, 2.0 * abs(k) * reach)  # safe at the arc's centre
    along = reach * stretch / (1.0 - abs(k) * reach * stretch)  # how far station may differ
    profile = _profile_bounds(terrain, offset - reach, offset + reach)
    spline = _spline_bounds(terrain, station, offset, float(along.max()), reach)
    base = terrain.height_m + terrain.grade * station
    rise = abs(terrain.grade) * along
    outside = (station + along < terrain.start_m) | (station - along > terrain.end_m)
    outside |= (offset + reach < terrain.right_m) | (offset - reach > terrain.left_m)
    low = np.where(outside, np.inf, base - rise + profile[0] + spline[0] - _SLACK_M)
    high = np.where(outside, -np.inf, base + rise + profile[1] + spline[1] + _SLACK_M)
    return CellBounds(low, high, *_slope_bounds(terrain, station, stretch, along, profile, spline))


def _profile_bounds(terrain: Terrain, right: Floats, left: Floats) -> tuple[Floats, ...]:
    """Least and greatest height, least and greatest slope of the profile between two offsets."""
    x, z = terrain.profile_offset_m, terrain.profile_height_m
    ends = np.interp(right, x, z), np.interp(left, x, z)
    low, high = np.minimum(*ends), np.maximum(*ends)
    for offset, height in zip(x, z, strict=True):
        inside = (right <= offset) & (offset <= left)
        low, high = (
            np.where(inside, np.minimum(low, height), low),
            np.where(inside, np.maximum(high, height), high),
        )
    least, most = np.full_like(low, np.inf), np.full_like(low, -np.inf)
    slopes = np.concatenate([[0.0], np.diff(z) / np.diff(x), [0.0]])
    limits = np.concatenate([[-np.inf], x, [np.inf]])
    for slope, start, end in zip(slopes, limits[:-1], limits[1:], strict=True):
        touches = (right <= end) & (left >= start)
        least = np.where(touches, np.minimum(least, slope), least)
        most = np.where(touches, np.maximum(most, slope), most)
    return low, high, least, most


def _spline_bounds(
    terrain: Terrain, station: Floats, offset: Floats, along: float, across: float
) -> tuple[Floats, ...]:
    """Bounds of the spline and of its two slopes within ``along`` and ``across`` of points."""
    reach = (
        math.ceil(along / terrain.station_step_m) + 2,
        math.ceil(across / terrain.offset_step_m) + 2,
    )
    nodes = np.pad(terrain.coefficient_m, [(r, r) for r in reach], mode="edge")
    from scipy import ndimage  # noqa: PLC0415  # slow to load

    row = np.rint((station - terrain.first_station_m) / terrain.station_step_m).astype(int)
    column = np.rint((offset - terrain.first_offset_m) / terrain.offset_step_m).astype(int)
    row = np.clip(row + reach[0], 0, nodes.shape[0] - 1)
    column = np.clip(column + reach[1], 0, nodes.shape[1] - 1)
    size = (2 * reach[0] + 1, 2 * reach[1] + 1)
    steps = (terrain.station_step_m, terrain.offset_step_m)
    fields = [nodes] + [
        np.diff(nodes, axis=axis, append=nodes.take([-1], axis=axis)) / step
        for axis, step in enumerate(steps)
    ]
    bounds = []
    for field in fields:
        for extreme in (ndimage.minimum_filter, ndimage.maximum_filter):
            bounds.append(extreme(field, size=size, mode="nearest")[row, column])
    return tuple(bounds)


def _slope_bounds(
    terrain: Terrain,
    station: Floats,
    stretch: Floats,
    along: Floats,
    profile: tuple[Floats, ...],
    spline: tuple[Floats, ...],
) -> tuple[Floats, Floats, Floats]:
    """Middle of the plan gradient and how far the gradient may be from it."""
    k = terrain.alignment.curvature_per_m
    along_low, along_high = spline[2] + terrain.grade, spline[3] + terrain.grade
    across_low, across_high = spline[4] + profile[2], spline[5] + profile[3]
    middle = 0.5 * (along_low + along_high) * stretch, 0.5 * (across_low + across_high)
    steepest = np.maximum(np.abs(along_low), np.abs(along_high))
    spread = np.hypot(0.5 * (along_high - along_low) * stretch, 0.5 * (across_high - across_low))
    # Within a cell the stretch changes, and the road's direction turns under the gradient.
    turn = abs(k) * along
    spread += steepest * stretch * turn * 1.1
    spread += turn * np.hypot(middle[0], middle[1]) + _SLACK_M
    heading = heading_at(terrain.alignment, station)
    cos, sin = np.cos(heading), np.sin(heading)
    return cos * middle[0] - sin * middle[1], sin * middle[0] + cos * middle[1], spread
