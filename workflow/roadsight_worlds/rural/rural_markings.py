"""What is painted on the road: edge and middle lines, and what a road of several lanes has more.

Lanes are parted by dashed lines, arrows stand in them, and some stretches have hatching beside the
edge lines, whose inner border is one more solid line.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from roadsight.base.arrays import Floats
from roadsight_worlds.casting.kernel import kernel
from roadsight_worlds.rendering.rendering_noise import hashed
from roadsight_worlds.rural.rural_ground import LANE_M

_DASH_M = 3.0  # Painted part of a dashed line: about 10 ft of 40.
_PERIOD_M = 12.0  # From dash to dash.
_DOUBLE_OFFSET_M = 0.11  # Of either line of a double middle line from the middle.
_ARROW_EVERY_M = 40.0  # From arrow to arrow in a lane.
_SHAFT_M = 3.6  # Length of an arrow's shaft.
_SHAFT_HALF_M = 0.1  # Half width of an arrow's shaft.
_HEAD_M = 2.4  # Length of an arrow's head.
_HEAD_HALF_M = 0.6  # Half width of an arrow's head where it is widest.
HATCH_M = 0.8  # Width of the hatching.
_STRIPE_EVERY_M = 2.0  # From stripe to stripe of the hatching, along the road.
_STRIPE_HALF_M = 0.25  # Half width of a stripe, along the road.
_PIECE_M = 6.0  # Length of a piece of paint that is worn off whole.


class Markings(NamedTuple):
    """Numbers that decide what is painted.

    Parameters
    ----------
    lanes : each way. edge_m : offset of the edge lines' outer sides. line_half_m : of their width.
    missing : share of the paint that is worn off, in pieces 6 m long.
    passing : (p, 2) stations between which the middle line is dashed; double elsewhere.
    gap : (g, 3) side, first and last station without an edge line.
    hatched : (h, 2) stations between which there is hatching along both edge lines.
    """

    lanes: int
    edge_m: float
    line_half_m: float
    missing: float
    passing: Floats
    gap: Floats
    hatched: Floats


@kernel
def line_cover(paint: Markings, s: float, o: float, across: float) -> tuple[float, float]:
    """Share of a strip ``across`` metres wide that is white paint, and that is yellow paint."""
    white = _strip(abs(o) - (paint.edge_m - paint.line_half_m), paint.line_half_m, across)
    for k in range(len(paint.gap)):
        if o * paint.gap[k, 0] > 0.0 and paint.gap[k, 1] <= s <= paint.gap[k, 2]:
            white = 0.0
    dashed = False
    for k in range(len(paint.passing)):
        dashed = dashed or paint.passing[k, 0] <= s <= paint.passing[k, 1]
    if dashed:
        yellow = _strip(o, paint.line_half_m, across) if _on_dash(s) else 0.0
    else:
        yellow = _strip(o - _DOUBLE_OFFSET_M, paint.line_half_m, across)
        yellow += _strip(o + _DOUBLE_OFFSET_M, paint.line_half_m, across)
    if paint.lanes > 1:
        white = min(white + _of_lanes(paint, s, o, across), 1.0)
    if paint.missing > 0.0:
        row = int(math.floor(2.0 * o / LANE_M + 0.5))
        if hashed(int(math.floor(s / _PIECE_M)), row, 0) < paint.missing:
            return 0.0, 0.0
    return white, yellow


@kernel
def _of_lanes(paint: Markings, s: float, o: float, across: float) -> float:
    """Share of a strip that is lane line, arrow or hatching."""
    away = abs(o)
    cover = 0.0
    if _on_dash(s):
        for k in range(1, paint.lanes):
            cover += _strip(away - LANE_M * k, paint.line_half_m, across)
    lane = min(math.floor(away / LANE_M), paint.lanes - 1.0)
    aside = away - LANE_M * (lane + 0.5)
    # Traffic keeps to the right: right of the middle it runs towards rising stations.
    along = s - _ARROW_EVERY_M * math.floor(s / _ARROW_EVERY_M)
    along = along if o < 0.0 else _SHAFT_M + _HEAD_M - along
    if 0.0 <= along <= _SHAFT_M:
        cover += _strip(aside, _SHAFT_HALF_M, across)
    elif _SHAFT_M < along <= _SHAFT_M + _HEAD_M:
        left = (_SHAFT_M + _HEAD_M - along) / _HEAD_M
        cover += _strip(aside, _HEAD_HALF_M * left, across)
    inner = paint.edge_m - HATCH_M
    for k in range(len(paint.hatched)):
        if paint.hatched[k, 0] <= s <= paint.hatched[k, 1]:
            cover += _strip(away - inner, paint.line_half_m, across)
            if inner <= away <= paint.edge_m:
                slanted = s + away
                slanted -= _STRIPE_EVERY_M * (math.floor(slanted / _STRIPE_EVERY_M) + 0.5)
                cover += _strip(slanted, _STRIPE_HALF_M, min(across, _STRIPE_EVERY_M))
    return cover


@kernel
def _on_dash(s: float) -> bool:
    return s - _PERIOD_M * math.floor(s / _PERIOD_M) <= _DASH_M


@kernel
def _strip(o: float, half: float, across: float) -> float:
    """Share of [o - across/2, o + across/2] within [-half, half]; a point for across = 0."""
    if across <= 0.0:
        return 1.0 if abs(o) <= half else 0.0
    low, high = max(o - 0.5 * across, -half), min(o + 0.5 * across, half)
    return max(high - low, 0.0) / across
