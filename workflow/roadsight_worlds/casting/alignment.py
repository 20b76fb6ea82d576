"""Road coordinates on a circular arc, exact both ways.

``station_m`` runs along the reference line, ``offset_m`` is positive to the left of it. The
curvature is positive where the line turns left; zero makes it straight.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats
from roadsight.base.kernels import compiled
from roadsight_worlds.casting.kernel import compiled_kernel, kernel


class Alignment(NamedTuple):
    """Reference line of a road in plan.

    Parameters
    ----------
    x_m, y_m : local position of station 0.
    ahead_x, ahead_y : unit vector of the direction at station 0.
    curvature_per_m : 1 / radius, positive to the left.
    """

    x_m: float
    y_m: float
    ahead_x: float
    ahead_y: float
    curvature_per_m: float


@kernel
def road_point(alignment: Alignment, x: float, y: float) -> tuple[float, float]:
    """Station and offset of one plan point."""
    cos, sin = alignment.ahead_x, alignment.ahead_y
    east, north = x - alignment.x_m, y - alignment.y_m
    ahead, left = cos * east + sin * north, cos * north - sin * east
    k = alignment.curvature_per_m
    if k == 0.0:
        return ahead, left
    u, v = k * ahead, 1.0 - k * left  # from the arc's centre, in radii
    offset = (2.0 * left - k * (ahead * ahead + left * left)) / (1.0 + math.sqrt(u * u + v * v))
    return math.atan2(u, v) / k, offset


@compiled_kernel
def plan_point(alignment: Alignment, station: float, offset: float) -> tuple[float, float]:
    """Plan point of one station and offset."""
    k = alignment.curvature_per_m
    turn = k * station
    if k == 0.0:
        ahead, left = station, offset
    else:
        ahead = math.sin(turn) * (1.0 / k - offset)
        left = 2.0 * math.sin(0.5 * turn) ** 2 / k + offset * math.cos(turn)
    cos, sin = alignment.ahead_x, alignment.ahead_y
    return alignment.x_m + cos * ahead - sin * left, alignment.y_m + sin * ahead + cos * left


@compiled(error_model="numpy")
def _road_points(alignment: Alignment, xy: Floats) -> Floats:
    road = np.empty_like(xy)
    for i in range(len(xy)):
        road[i, 0], road[i, 1] = road_point(alignment, xy[i, 0], xy[i, 1])
    return road


@compiled(error_model="numpy")
def _plan_points(alignment: Alignment, road: Floats) -> Floats:
    xy = np.empty_like(road)
    for i in range(len(road)):
        xy[i, 0], xy[i, 1] = plan_point(alignment, road[i, 0], road[i, 1])
    return xy


def to_road(alignment: Alignment, xy_m: ArrayLike) -> Floats:
    """Station and offset (n, 2) of local plan points (n, 2), metres."""
    return _road_points(alignment, np.ascontiguousarray(xy_m, dtype=np.float64).reshape(-1, 2))


def to_plan(alignment: Alignment, road_m: ArrayLike) -> Floats:
    """Local plan points (n, 2) of stations and offsets (n, 2), metres."""
    return _plan_points(alignment, np.ascontiguousarray(road_m, dtype=np.float64).reshape(-1, 2))


def heading_at(alignment: Alignment, station_m: ArrayLike) -> Floats:
    """Direction of travel at stations, radians anticlockwise from x."""
    start = math.atan2(alignment.ahead_y, alignment.ahead_x)
    return start + alignment.curvature_per_m * np.asarray(station_m, dtype=float)
