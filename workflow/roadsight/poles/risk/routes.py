"""Where roads lie along routes of a linear referencing system (LRS): lines with measures.

A road that drives follow gets the name, the measure and the direction of the route that runs beside
it, so that both directions of a road share one measure, and surveys of different years too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
import shapely
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats
from roadsight.base.doubts import Doubt
from roadsight.base.errors import InputError
from roadsight.poles.risk.roads import BESIDE_M, Road, Roads, along_m, beside, resampled

MeasureUnit = Literal["m", "km", "ft", "usft", "mi", "usmi"]
# Metres in the units of measures, by the ends of column names: from_mi, to_mi.
UNITS_M: dict[str, float] = {
    "m": 1.0,
    "km": 1000.0,
    "ft": 0.3048,
    "usft": 1200 / 3937,
    "mi": 1609.344,
    "usmi": 5280 * 1200 / 3937,
}
# Measures are carried over so often; between, they go with the centreline's length. Nearer ones
# would repeat the corners of a digitised route.
_KNOTS_M = 10.0
_FEWEST = 2  # places with a measure that tell which way it rises
# Segments of one route join within this: digitised ends meet, gaps of a survey are longer.
_JOIN_M = 5.0
# Measures differ from the length of their line by no more than this share: lines drawn along a
# road, its slopes and the projection of a state make 1 or 2 %.
_SCALE = 0.05
_ROUNDED_M = 16.1  # and by this: measures in hundredths of a mile
# Routes that share more than this of the shorter one's way along a road contradict each other.
_SHARED = 0.3
# Routes of which none is nearer than this are of another place, as cloud and track would be.
_ELSEWHERE_M = 100_000.0
# A route that runs beside less of a road than this share is a crossing or a neighbour.
_LEAST_BESIDE = 0.01


@dataclass(frozen=True)
class Route:
    """Line of a route.

    Parameters
    ----------
    name : of the route. xy_m : (n, 2) vertices. measure_m : (n,) at each, rising.
    where : file and feature that state it.
    """

    name: str
    xy_m: Floats
    measure_m: Floats
    where: str = ""


def check_routes(routes: Sequence[Route]) -> None:
    """Refuse measures that fall along their line, and segments digitised against their measures.

    Raises
    ------
    InputError : either of these, told with file and feature.
    """
    for route in routes:
        finite = np.isfinite(route.measure_m)
        rises = (route.measure_m[1:] > route.measure_m[:-1]) & finite[1:] & finite[:-1]
        if not rises.all():
            first = int(np.argmin(rises))
            low, high = route.measure_m[first : first + 2]
            raise InputError(
                f"measures of route {route.name} do not rise along its line",
                where=route.where,
                found=f"{low:g} m, then {high:g} m at vertex {first + 2} of {len(rises) + 1}",
                allowed="measures that rise from vertex to vertex",
                hint="turn the line's vertices round, or exchange its from and to",
            )
    for name in dict.fromkeys(route.name for route in routes):
        own = sorted((r for r in routes if r.name == name), key=lambda r: r.measure_m[0])
        for before, after in pairwise(own):
            ends, starts = before.xy_m[[0, -1]], after.xy_m[[0, -1]]
            apart = np.hypot(*np.moveaxis(ends[:, None] - starts[None], 2, 0))
            if apart[1, 0] > _JOIN_M and apart.min() <= _JOIN_M:
                raise InputError(
                    f"a segment of route {name} is digitised against its measures",
                    where=f"{before.where} and {after.where}",
                    found=f"{apart[1, 0]:.0f} m from the end of one to the start of the next",
                    allowed="lines whose end is the start of the next",
                    hint="turn the vertices of the one that runs the other way",
                )


def with_routes(roads: Roads, routes: Sequence[Route]) -> tuple[Roads, list[Doubt]]:
    """Roads with names and measures of the routes beside them, and doubts about the rest.

    Raises
    ------
    InputError : two routes run along the same stretch of a road; see also `check_routes`.
    """
    check_routes(routes)
    found: list[Road] = []
    told: list[Doubt] = []
    for road in roads.roads:
        shares = _shares(road, routes)
        names = sorted(shares, key=lambda name: (-shares[name].sum(), name))
        if not names:
            lines = shapely.STRtree([shapely.LineString(route.xy_m) for route in routes])
            places = shapely.points(resampled(road.xy_m, _KNOTS_M))
            _, apart = lines.query_nearest(places, return_distance=True, all_matches=False)
            if apart.min() > _ELSEWHERE_M:
                raise InputError(
                    f"no route is anywhere near road {road.name}",
                    where=routes[0].where,
                    found=f"{apart.min() / 1000:.0f} km to the nearest",
                    allowed=f"a line within {_ELSEWHERE_M / 1000:.0f} km",
                    hint="its CRS may be another than the file names, or than roads.routes_crs"
                    " says, for lines of an inventory roads.inventory_crs",
                )
            text = (
                f"no route runs along road {road.name}: its measure stays its own; median distance"
                " to the nearest, m"
            )
            measured = round(float(np.median(apart)), 1)
            told.append(Doubt("road_without_route", "doubt", text, measured, BESIDE_M))
            found.append(road)
            continue
        for other in names[1:]:
            both = shares[names[0]] & shares[other]
            if both.sum() >= _SHARED * shares[other].sum():
                raise InputError(
                    f"two routes run along road {road.name}",
                    where=next(r.where for r in routes if r.name == other),
                    found=f"{names[0]} and {other}",
                    allowed="one route for each road",
                    hint="leave one out of the file; its measures are events of the other",
                )
            text = (
                f"routes {names[0]} and {other} follow each other on road {road.name}: all of it is"
                f" measured along {names[0]}; share of it along {other}"
            )
            share = round(float(shares[other].mean()), 3)
            told.append(Doubt("routes_follow", "doubt", text, share, _LEAST_BESIDE))
        own = [route for route in routes if route.name == names[0]]
        _check_scale(names[0], own)
        at, value = _known_measures(road, own)
        if len(at) < _FEWEST or value[-1] == value[0]:
            text = (
                f"route {names[0]} runs along too little of road {road.name} to tell its direction:"
                " its measure stays its own; places whose measure is known"
            )
            known = len(np.unique(value))
            told.append(Doubt("route_too_short", "doubt", text, known, _FEWEST))
            found.append(road)
        else:
            found.append(_measured(road, names[0], at, value))
    return Roads(found), told


def _check_scale(name: str, routes: Sequence[Route]) -> None:
    """Refuse measures that are in another unit than read, with the unit that would fit."""
    length = sum(float(np.hypot(*np.diff(route.xy_m, axis=0).T).sum()) for route in routes)
    measured = sum(float(route.measure_m[-1] - route.measure_m[0]) for route in routes)
    if abs(measured - length) <= max(_SCALE * length, _ROUNDED_M):
        return
    fits = [
        f"they would fit if what is read as {read} were {unit}: see roads.measure_unit, or name"
        f" the unit in the column"
        for read, one in UNITS_M.items()
        for unit, other in UNITS_M.items()
        if abs(measured * other / one - length) <= _SCALE * length
    ]
    raise InputError(
        f"measures of route {name} do not go with the length of its line",
        where=routes[0].where,
        found=f"{measured:.4g} m of measure along {length:.4g} m",
        allowed=f"measures within {_SCALE:.0%} of the length",
        hint=fits[0] if fits else "check the measures and their unit",
    )


def _shares(road: Road, routes: Sequence[Route]) -> dict[str, Bools]:
    """Which vertices of a road each route runs beside, for routes that do so enough."""
    found: dict[str, Bools] = {}
    tree = cKDTree(road.xy_m)
    for route in routes:
        if not beside(road.xy_m, route.xy_m):
            continue
        near = np.zeros(len(road.xy_m), bool)
        for rows in tree.query_ball_point(resampled(route.xy_m, 2.0), BESIDE_M):
            near[rows] = True
        found[route.name] = found.get(route.name, np.zeros(len(near), bool)) | near
    return {name: near for name, near in found.items() if near.mean() > _LEAST_BESIDE}


def _known_measures(road: Road, routes: Sequence[Route]) -> tuple[Floats, Floats]:
    """Places along a road (k,), m from its first vertex, and the route's measure at each."""
    plan = along_m(road.xy_m)
    knots = np.unique(np.r_[np.arange(0.0, plan[-1], _KNOTS_M), plan[-1]])
    places = np.column_stack([np.interp(knots, plan, axis) for axis in road.xy_m.T])
    measure, gap = _project(places, routes)
    known = np.isfinite(measure) & (gap <= BESIDE_M)
    # Routes end between knots: their own ends tell too.
    ends = np.concatenate([route.xy_m[[0, -1]] for route in routes])
    stated = np.concatenate([route.measure_m[[0, -1]] for route in routes])
    foot = Roads([replace(road, station_m=plan)]).locate(ends)
    met = (np.abs(foot.offset_m) <= BESIDE_M) & (foot.station_m >= 0) & (foot.station_m <= plan[-1])
    at, first = np.unique(np.r_[knots[known], foot.station_m[met]], return_index=True)
    return at, np.r_[measure[known], stated[met]][first]


def _measured(road: Road, name: str, at: Floats, value: Floats) -> Road:
    """The road with the measure of its route, turned round if that rises the other way."""
    plan = along_m(road.xy_m)
    rising = bool(value[-1] >= value[0])
    value = value if rising else -value
    # Feet of corners may repeat: only what rises counts.
    keep = np.r_[True, np.diff(np.maximum.accumulate(value)) > 1e-6]
    at, value = at[keep], value[keep]
    station = np.asarray(np.interp(plan, at, value), np.float64)
    # Beyond the route's ends the measure goes on with the road's length.
    station = np.where(plan < at[0], value[0] + plan - at[0], station)
    station = np.where(plan > at[-1], value[-1] + plan - at[-1], station)
    told = f"measure of route {name}"
    if rising:
        return replace(road, name=name, measured=told, station_m=station)
    return replace(
        road,
        name=name,
        measured=told,
        xy_m=road.xy_m[::-1].copy(),
        station_m=-station[::-1],
        left_m=road.right_m[::-1].copy(),
        right_m=road.left_m[::-1].copy(),
        travel=-road.travel,
    )


def _project(places: Floats, routes: Sequence[Route]) -> tuple[Floats, Floats]:
    """Measure at the foot of places (n,), NaN beyond the ends of lines, and the distance (n,)."""
    measure, gap = np.full(len(places), np.nan), np.full(len(places), np.inf)
    for route in routes:
        start, way = route.xy_m[:-1], np.diff(route.xy_m, axis=0)
        long = np.maximum((way**2).sum(axis=1), 1e-12)
        along = ((places[:, None] - start) * way).sum(axis=2) / long
        held = np.clip(along, 0.0, 1.0)
        apart = np.hypot(*np.moveaxis(places[:, None] - start - held[..., None] * way, 2, 0))
        piece = np.argmin(apart, axis=1)
        rows = np.arange(len(places))
        nearest, share = apart[rows, piece], along[rows, piece]
        low, high = route.measure_m[piece], route.measure_m[piece + 1]
        beyond = ((piece == 0) & (share < 0)) | ((piece == len(start) - 1) & (share > 1))
        better = (nearest < gap) & ~beyond
        measure[better] = (low + held[rows, piece] * (high - low))[better]
        gap[better] = nearest[better]
    return measure, gap
