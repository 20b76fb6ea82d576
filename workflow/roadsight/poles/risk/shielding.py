"""Which objects a barrier shields, after the length of need of the Roadside Design Guide.

A vehicle that leaves the road before a barrier may run behind it. The barrier must therefore start
the length of need X ahead of the object (RDG 4th edition, chapter 5; without flare
``X = (LA - L2) / (LA / LR)``), where LA is how far the object reaches, at most the clear zone, L2
the barrier's distance, both from the edge of the travelled way, and LR the runout length (table
5-10). On undivided roads traffic in the other direction asks for the same beyond the object, with
distances from the centreline, if the object lies in its clear zone.

The formula and the terminal's 3.8 m agree with an open calculator that cites the chapter. Of the
runout lengths one cell was found in public text (76 m at 100 km/h and 5,000 to 10,000 vehicles a
day, agrees); the others are from memory: compare them with your copy, or state your own length
(hazard.runout_length_m). Deflections depend on the barrier: 2 to 7 ft by SDDC-TEA's tutorial
(hazard.deflection_m).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bools, Floats
from roadsight.base.doubts import Doubt, listed
from roadsight.base.sections.poles import Hazard
from roadsight.poles.risk.roads import Roads, resampled

_HAZARD = Hazard()
# The first 12.5 ft of a usual end terminal let vehicles through: shielding starts behind them.
TERMINAL_M = 3.81
# A W-beam on strong posts gives way about so far; the range of barriers is 0.6 to 2.1 m. Objects
# nearer behind it are hit through it.
DEFLECTION_M = _HAZARD.deflection_m
_STEP_M = 1.0  # spacing of places along a barrier
_BESIDE_ROAD_M = 15.0  # barriers further from the road's edge are of another road
_ON_IT_M = 0.1  # objects this near a barrier's line are of it: its own ends and posts
# Greatest speed of each row: 60, 80 and 110 km/h stand beside 40, 50 and 70 mph.
_RUNOUT_SPEEDS_KMH = (50.0, 64.4, 80.5, 100.0, 112.7, 130.0)
# Least traffic of each of the table's classes but the first, vehicles a day: "under 1,000", "1,000
# to 5,000", "5,000 to 10,000", "over 10,000". Of the two classes that name 5,000 the longer one is
# taken.
_RUNOUT_AADT = (1000.0, 5000.0, np.nextafter(10_000.0, np.inf))
# Rows by speed, columns by traffic.
_RUNOUT_M = np.array(
    [
        [21.0, 24.0, 27.0, 34.0],
        [30.0, 34.0, 40.0, 49.0],
        [46.0, 49.0, 58.0, 70.0],
        [61.0, 64.0, 76.0, 91.0],
        [76.0, 88.0, 101.0, 110.0],
        [101.0, 116.0, 131.0, 143.0],
    ]
)


@dataclass(frozen=True)
class Barrier:
    """A barrier along a road.

    Parameters
    ----------
    name : of the user's line. road : number of the road. side : -1 left, +1 right of it.
    station_m : (n,) ascending. offset_m : (n,) from the road's edge.
    ends_m : (2, 2) places of the first and the last vertex of the user's line; NaN where this is a
        part of it that was cut before them.
    """

    name: str
    road: int
    side: int
    station_m: Floats
    offset_m: Floats
    ends_m: Floats


def barriers_along(
    lines_m: Sequence[Floats], names: Sequence[str], roads: Roads
) -> tuple[list[Barrier], list[Doubt]]:
    """Barriers by road, side and station, and doubts about lines that cannot be placed.

    Parameters
    ----------
    lines_m : (n, 2) vertices of each line. A line that changes road or side is cut there.
    """
    found: list[Barrier] = []
    lost: list[tuple[str, float]] = []
    bare: list[tuple[str, Bools]] = []
    for line, name in zip(lines_m, names, strict=True):
        places = resampled(line, _STEP_M)
        closed = bool(np.hypot(*(places[0] - places[-1])) < _STEP_M)
        at = roads.locate(places)
        edge = np.full(len(places), np.nan)
        for number, road in enumerate(roads.roads):
            own = at.road == number
            edge[own] = road.bridged_edge_m(at.station_m[own], at.side[own])
        offset = np.abs(at.offset_m) - edge
        near = offset <= _BESIDE_ROAD_M
        unknown = np.isnan(offset) & (np.abs(at.offset_m) <= _BESIDE_ROAD_M)
        if unknown.any():
            bare.append((name, unknown))
        elif not near.any():
            apart = np.where(np.isnan(offset), np.abs(at.offset_m), offset)
            lost.append((name, float(apart.min())))
        key = np.where(near, 2 * at.road + (at.side > 0), -1)
        cuts = np.flatnonzero(np.diff(key)) + 1
        for part in np.split(np.arange(len(places)), cuts):
            if key[part[0]] < 0 or len(part) < 2:
                continue
            rows = part[np.argsort(at.station_m[part], kind="stable")]
            side = 1 if at.offset_m[rows[0]] > 0 else -1
            ends = places[[0, -1]].copy()
            ends[[closed or part[0] > 0, closed or part[-1] < len(places) - 1]] = np.nan
            road_number = int(at.road[rows[0]])
            found.append(Barrier(name, road_number, side, at.station_m[rows], offset[rows], ends))
    return found, _barrier_doubts(lost, bare)


def _barrier_doubts(
    lost: Sequence[tuple[str, float]], bare: Sequence[tuple[str, Bools]]
) -> list[Doubt]:
    """Doubts about barriers that count for nothing.

    Those that are lost are along no road, so far from one (NaN without roads); those that are bare
    have places along which no edge is known.
    """
    found = []
    if lost:
        text = (
            f"barrier {listed([name for name, _ in lost])} lies along no road and counts for"
            " nothing: look at its place and CRS; least distance from a road's edge, m"
        )
        least = min(apart for _, apart in lost)
        measured = round(least, 1) if np.isfinite(least) else None
        found.append(Doubt("barrier_without_road", "doubt", text, measured, _BESIDE_ROAD_M))
    if bare:
        told = listed([f"{name} ({places.mean():.0%})" for name, places in bare])
        text = (
            f"no edge of the road is known along parts of barrier {told}, which count for nothing:"
            " share of these barriers"
        )
        share = float(np.concatenate([places for _, places in bare]).mean())
        found.append(Doubt("barrier_without_edge", "doubt", text, round(share, 3), 0))
    return found


def barrier_ends(barriers: Sequence[Barrier]) -> pd.DataFrame:
    """Ends of barriers as objects: id, kind, x, y (local metres).

    Places at which a line was cut are no ends: the barrier goes on there.
    """
    rows = [
        (f"{barrier.name} {word}", "barrier end", *place)
        for barrier in barriers
        for word, place in zip(("start", "end"), barrier.ends_m, strict=True)
        if np.isfinite(place).all()
    ]
    return pd.DataFrame(rows, columns=["id", "kind", "x", "y"])


@dataclass(frozen=True)
class Demand:
    """What decides how much barrier an object needs.

    Parameters
    ----------
    road, side, station_m, offset_m : of the object; offset from the road's edge.
    clear_zone_m : greatest that the inputs allow. speed_kmh, aadt : greatest likewise.
    half_road_m : from the road's edge to its centreline, NaN if unknown.
    from_low : whether the traffic beside it comes from lower stations.
    divided : whether no opposing traffic can reach it.
    runout_length_m : given instead of the table's; 0: the table's. deflection_m : of the barriers.
    """

    road: int
    side: int
    station_m: float
    offset_m: float
    clear_zone_m: float
    speed_kmh: float
    aadt: float
    half_road_m: float
    from_low: bool = True
    divided: bool = False
    runout_length_m: float = _HAZARD.runout_length_m
    deflection_m: float = DEFLECTION_M


def shielding(demand: Demand, barriers: Sequence[Barrier]) -> tuple[str, float, str]:
    """``none``, ``partial`` or ``full``, offset of the barrier (m, NaN for none), and why.

    Of several barriers before an object the one that shields it best counts.
    """
    order = ("none", "partial", "full")
    found = [("none", float("nan"), "")]
    for barrier in barriers:
        if barrier.road == demand.road and barrier.side == demand.side:
            found.append(_behind(demand, barrier))
    return max(found, key=lambda one: order.index(one[0]))


def _behind(demand: Demand, barrier: Barrier) -> tuple[str, float, str]:
    low, high = float(barrier.station_m[0]), float(barrier.station_m[-1])
    if not low <= demand.station_m <= high:
        return "none", float("nan"), ""
    offset = float(np.interp(demand.station_m, barrier.station_m, barrier.offset_m))
    if offset >= demand.offset_m - _ON_IT_M:
        return "none", float("nan"), ""
    runout = demand.runout_length_m or runout_m(demand.speed_kmh, demand.aadt)
    reach = min(demand.offset_m, demand.clear_zone_m)
    near = length_of_need_m(reach, offset, runout)
    half = demand.half_road_m
    far = 0.0
    lacks = []
    if not demand.divided and np.isnan(half) and demand.offset_m <= demand.clear_zone_m:
        lacks.append("too short perhaps for opposing traffic, for the road's width is unknown")
    elif not demand.divided and demand.offset_m + half <= demand.clear_zone_m:
        far = length_of_need_m(demand.offset_m + half, offset + half, runout)
    before, after = (near, far) if demand.from_low else (far, near)
    for need, there, where in (
        (before, demand.station_m - low - TERMINAL_M, "before"),
        (after, high - demand.station_m - TERMINAL_M, "after"),
    ):
        if need > there + 0.05:
            lacks.append(f"{need - max(there, 0.0):.0f} m short {where} it of {need:.0f} m needed")
    gap = demand.offset_m - offset
    if gap < demand.deflection_m:
        give = demand.deflection_m
        lacks.append(f"{gap:.1f} m behind it, less than the {give:.1f} m it may give way")
    told = f"behind barrier {barrier.name}"
    if lacks:
        return "partial", offset, f"{told}, which is {'; '.join(lacks)}"
    return "full", offset, f"{told} along its length of need"


def runout_m(design_speed_kmh: float, aadt: float) -> float:
    """Runout length, m (RDG table 5-10); speeds between rows take the next higher one."""
    row = int(np.searchsorted(_RUNOUT_SPEEDS_KMH, design_speed_kmh))
    row = min(row, len(_RUNOUT_SPEEDS_KMH) - 1)
    return float(_RUNOUT_M[row, int(np.searchsorted(_RUNOUT_AADT, aadt, side="right"))])


def length_of_need_m(reach_m: float, barrier_m: float, runout: float) -> float:
    """Barrier ahead of an object (RDG chapter 5, without flare); 0 where none is needed.

    Parameters
    ----------
    reach_m : LA, lateral reach of the object. barrier_m : L2, offset of the barrier.
    """
    if reach_m <= 0 or barrier_m >= reach_m:
        return 0.0
    return runout * (1.0 - max(barrier_m, 0.0) / reach_m)
