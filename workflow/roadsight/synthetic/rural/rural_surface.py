"""What the ground is at a place: one exact answer for images, cloud and truth."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bytes, Floats
from roadsight.base.kernels import compiled
from roadsight.synthetic.casting.kernel import kernel
from roadsight.synthetic.rural.rural_ground import GRAVEL_DRIVE, SIDE_ROAD, RuralGround
from roadsight.synthetic.rural.rural_materials import Ground

# Plain numbers, as compiled code takes them.
_GRASS = int(Ground.GRASS)
_SHOULDER = int(Ground.SHOULDER)
_ROAD = int(Ground.ROAD)
_SIDE = int(Ground.SIDE_ROAD)
_GRAVEL = int(Ground.GRAVEL_DRIVE)
_DRIVE = int(Ground.PAVED_DRIVE)
_WHITE = int(Ground.WHITE_LINE)
_YELLOW = int(Ground.YELLOW_LINE)
_BRIDGE = int(Ground.BRIDGE)
_SIDE_ROAD_KIND = SIDE_ROAD
_GRAVEL_KIND = GRAVEL_DRIVE
_DASH_M = 3.0
"""Painted part of a dashed middle line: about 10 ft of 40."""
_PERIOD_M = 12.0
"""From dash to dash."""
_DOUBLE_OFFSET_M = 0.11
"""Of either line of a double middle line from the middle."""


class Surface(NamedTuple):
    """Numbers that decide what the ground is.

    Parameters
    ----------
    lane_m, pavement_m, shoulder_m, line_half_m : of the cross-section.
    gully_m, bridge_half_m : station and half length of the bridge.
    branch : (k, 9) kind, side, station, start x, y, direction x, y, half width, radius; then
    branch_length_m : (k,).
    passing : (p, 2) stations between which the middle line is dashed; double elsewhere.
    gap : (g, 3) side, first and last station without an edge line.
    """

    lane_m: float
    pavement_m: float
    shoulder_m: float
    line_half_m: float
    gully_m: float
    bridge_half_m: float
    branch: Floats
    branch_length_m: Floats
    passing: Floats
    gap: Floats


def make_surface(ground: RuralGround, passing_m: ArrayLike) -> Surface:
    """Surface of a site; ``passing_m`` (p, 2) as in `Surface`."""
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
    return Surface(
        section.lane_m,
        section.pavement_m,
        section.shoulder_m,
        section.line_half_m,
        ground.gully_m,
        ground.bridge_half_m,
        np.array(rows, float).reshape(-1, 9),
        np.array([b.length_m for b in ground.branches], float),
        np.array(passing_m, float).reshape(-1, 2),
        np.array(gaps, float).reshape(-1, 3),
    )


@kernel
def line_cover(surface: Surface, s: float, o: float, across: float) -> tuple[float, float]:
    """Share of a strip ``across`` metres wide that is white line, and that is yellow line."""
    white = _strip(abs(o) - (surface.lane_m - surface.line_half_m), surface.line_half_m, across)
    for k in range(len(surface.gap)):
        if o * surface.gap[k, 0] > 0.0 and surface.gap[k, 1] <= s <= surface.gap[k, 2]:
            white = 0.0
    dashed = False
    for k in range(len(surface.passing)):
        dashed = dashed or surface.passing[k, 0] <= s <= surface.passing[k, 1]
    if dashed:
        lit = s - _PERIOD_M * math.floor(s / _PERIOD_M) <= _DASH_M
        yellow = _strip(o, surface.line_half_m, across) if lit else 0.0
    else:
        yellow = _strip(o - _DOUBLE_OFFSET_M, surface.line_half_m, across)
        yellow += _strip(o + _DOUBLE_OFFSET_M, surface.line_half_m, across)
    return white, yellow


@kernel
def _strip(o: float, half: float, across: float) -> float:
    """Share of [o - across/2, o + across/2] within [-half, half]; a point for across = 0."""
    if across <= 0.0:
        return 1.0 if abs(o) <= half else 0.0
    low, high = max(o - 0.5 * across, -half), min(o + 0.5 * across, half)
    return max(high - low, 0.0) / across


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
            if kind == _SIDE_ROAD_KIND:
                return _SIDE
            return _GRAVEL if kind == _GRAVEL_KIND else _DRIVE
    return _SHOULDER if away <= surface.shoulder_m else _GRASS


@compiled(error_model="numpy")
def _kinds(surface: Surface, xy: Floats, road: Floats, lines: bool) -> Bytes:
    kinds = np.empty(len(xy), np.uint8)
    for i in range(len(xy)):
        kind = ground_kind(surface, xy[i, 0], xy[i, 1], road[i, 0], road[i, 1])
        if lines and kind in (_ROAD, _BRIDGE):
            white, yellow = line_cover(surface, road[i, 0], road[i, 1], 0.0)
            kind = _WHITE if white > 0.0 else _YELLOW if yellow > 0.0 else kind
        kinds[i] = kind
    return kinds


def ground_kinds(surface: Surface, xy_m: ArrayLike, road_m: ArrayLike, lines: bool = True) -> Bytes:
    """`Ground` (n,) at plan points (n, 2) with their stations and offsets (n, 2).

    Without ``lines`` it is what lies under the markings.
    """
    xy = np.ascontiguousarray(xy_m, np.float64).reshape(-1, 2)
    return _kinds(surface, xy, np.ascontiguousarray(road_m, np.float64).reshape(-1, 2), lines)
