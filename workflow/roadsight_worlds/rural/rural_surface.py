"""What the ground is at a place: one exact answer for images, cloud and truth."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bytes, Floats
from roadsight.base.kernels import compiled
from roadsight_worlds.casting.kernel import kernel
from roadsight_worlds.rural.rural_ground import GRAVEL_DRIVE, SIDE_ROAD, RuralGround
from roadsight_worlds.rural.rural_markings import Markings, line_cover
from roadsight_worlds.rural.rural_materials import Ground

# Plain numbers, as compiled code takes them.
_GRASS, _SHOULDER, _ROAD, _SIDE, _GRAVEL, _DRIVE, _WHITE, _YELLOW, _BRIDGE = map(int, Ground)


class Surface(NamedTuple):
    """Numbers that decide what the ground is.

    Parameters
    ----------
    pavement_m, shoulder_m : of the cross-section.
    gully_m, bridge_half_m : station and half length of the bridge.
    branch : (k, 9) kind, side, station, start x, y, direction x, y, half width, radius; then
    branch_length_m : (k,).
    paint : what is painted on it.
    """

    pavement_m: float
    shoulder_m: float
    gully_m: float
    bridge_half_m: float
    branch: Floats
    branch_length_m: Floats
    paint: Markings


def make_surface(
    ground: RuralGround, passing_m: ArrayLike, hatched_m: ArrayLike, missing: float
) -> Surface:
    """Surface of a site; ``passing_m`` (p, 2) and the others as in `Markings`."""
    rows = [
        (b.kind, b.side, b.station_m, *b.start_m, *b.ahead, b.half_m, b.radius_m)
        for b in ground.branches
    ]
    gaps = [
        (b.side, b.station_m - b.half_m - b.radius_m, b.station_m + b.half_m + b.radius_m)
        for b in ground.branches
        if b.kind == SIDE_ROAD
    ]
    section = ground.section
    paint = Markings(
        section.lanes,
        section.lane_m,
        section.line_half_m,
        missing,
        np.array(passing_m, float).reshape(-1, 2),
        np.array(gaps, float).reshape(-1, 3),
        np.array(hatched_m, float).reshape(-1, 2),
    )
    return Surface(
        section.pavement_m,
        section.shoulder_m,
        ground.gully_m,
        ground.bridge_half_m,
        np.array(rows, float).reshape(-1, 9),
        np.array([b.length_m for b in ground.branches], float),
        paint,
    )


@kernel
def branch_at(surface: Surface, k: int, x: float, y: float) -> tuple[float, float]:
    """Distance along branch ``k`` from the pavement's edge, and to the left of its middle."""
    b = surface.branch
    east, north = x - b[k, 3], y - b[k, 4]
    return east * b[k, 5] + north * b[k, 6], north * b[k, 5] - east * b[k, 6]


@kernel
def _branch_width(surface: Surface, k: int, along: float) -> float:
    """Half width of branch ``k`` with its rounded corners."""
    radius = surface.branch[k, 8]
    into = radius - min(max(along, 0.0), radius)
    return surface.branch[k, 7] + radius - math.sqrt(radius * radius - into * into)


@kernel
def ground_kind(surface: Surface, x: float, y: float, s: float, o: float) -> int:
    """`Ground` without its lines at a place given by plan point, station and offset."""
    away = abs(o)
    on_bridge = abs(s - surface.gully_m) <= surface.bridge_half_m
    if away <= surface.pavement_m:
        return _BRIDGE if on_bridge else _ROAD
    if on_bridge and away <= surface.shoulder_m + 0.15:
        return _BRIDGE
    for k in range(len(surface.branch)):
        if o * surface.branch[k, 1] <= 0.0:
            continue
        along, across = branch_at(surface, k, x, y)
        ends = surface.branch_length_m[k]
        if -1.5 <= along <= ends and abs(across) <= _branch_width(surface, k, along):
            kind = surface.branch[k, 0]
            if kind == SIDE_ROAD:
                return _SIDE
            return _GRAVEL if kind == GRAVEL_DRIVE else _DRIVE
    return _SHOULDER if away <= surface.shoulder_m else _GRASS


@compiled(error_model="numpy")
def _kinds(surface: Surface, xy: Floats, road: Floats, lines: bool) -> Bytes:
    kinds = np.empty(len(xy), np.uint8)
    for i in range(len(xy)):
        kind = ground_kind(surface, xy[i, 0], xy[i, 1], road[i, 0], road[i, 1])
        if lines and kind in (_ROAD, _BRIDGE):
            white, yellow = line_cover(surface.paint, road[i, 0], road[i, 1], 0.0)
            kind = _WHITE if white > 0.0 else _YELLOW if yellow > 0.0 else kind
        kinds[i] = kind
    return kinds


def ground_kinds(surface: Surface, xy_m: ArrayLike, road_m: ArrayLike, lines: bool = True) -> Bytes:
    """`Ground` (n,) at plan points (n, 2) with their stations and offsets (n, 2).

    Without ``lines`` it is what lies under the markings.
    """
    xy = np.ascontiguousarray(xy_m, np.float64).reshape(-1, 2)
    return _kinds(surface, xy, np.ascontiguousarray(road_m, np.float64).reshape(-1, 2), lines)
