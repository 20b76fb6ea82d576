"""Roads that drives follow: one centreline and one measure for both directions.

Drives that run beside each other are drives of one road. Its measure runs along the centreline,
midway between the road's edges, in the direction of the road's longest drive, or of the line that
a road inventory gives. Left and right are as seen in the direction of rising measure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints

# Spacing of centrelines: a tenth of what a line 0.2 m off would turn in a bend of 190 m.
STEP_M = 1.0
# Drives this near each other are on one road; carriageways with a wider median are two roads.
BESIDE_M = 12.0
_BESIDE_DEG = 25.0  # drives of one road differ by no more in direction, either way round
# So much of the shorter drive must run beside the longer one; crossings are less.
_BESIDE_SHARE = 0.5
_REACH_M = 20.0  # edges further from the track are of another road
# A track may lie so far off the road it was driven on: twice the slow error of good GPS and more
# (0.7 m, generated drives).
_OFF_TRACK_M = 2.5
_NARROWEST_M = 3.0  # narrower strips between edges are no road
# Window over which centrelines are smoothed by cubics: bends of 190 m stay within 2 mm.
_SMOOTH_M = 31.0
# Points of one edge lie within this across the road: smoothed contours of 0.3 m cells do.
_EDGE_M = 0.6
# Sections of other width than their neighbours by more are mouths of side roads, unless the
# neighbours scatter more (four deviations).
_WIDTH_OFF_M = 0.3
# Edges are carried over gaps up to this: mouths of side roads are shorter (12 and 13 m, generated
# rural road), with turning lanes too; over longer gaps a road may get wider or narrower.
_GAP_M = 100.0
# Centrelines go on straight so far beyond their ends, for objects ahead of the last image.
_BEYOND_M = 60.0


@dataclass(frozen=True)
class Road:
    """Centreline of a road.

    Parameters
    ----------
    name : of the route. drives : names of the drives along it. measured : where station 0 is and
        which way the measure runs, in words.
    xy_m : (n, 2) every `STEP_M`. station_m : (n,) ascending.
    left_m, right_m : (n,) distance from the centreline to the edge, NaN where none was found.
    noise_m : how much midways between edges, a vertex each, scatter about the centreline; NaN
        without edges.
    travel : 1 where its longest drive went with rising measure, -1 against it.
    """

    name: str
    drives: tuple[str, ...]
    measured: str
    xy_m: Floats
    station_m: Floats
    left_m: Floats
    right_m: Floats
    noise_m: float = float("nan")
    travel: int = 1

    @property
    def start_m(self) -> float:
        """Least station."""
        return float(self.station_m[0])

    @property
    def end_m(self) -> float:
        """Greatest station."""
        return float(self.station_m[-1])

    def place(self, station_m: Floats, offset_m: Floats | float = 0.0) -> Floats:
        """Places (n, 2) at stations and offsets to the right; beyond the ends, straight on."""
        station = np.asarray(station_m, np.float64)
        way = self.direction(station)
        held = np.clip(station, self.start_m, self.end_m)
        middle = np.column_stack([np.interp(held, self.station_m, c) for c in self.xy_m.T])
        offset = np.broadcast_to(np.asarray(offset_m, np.float64), station.shape)
        right = np.column_stack([way[:, 1], -way[:, 0]])
        return middle + (station - held)[:, None] * way + offset[:, None] * right

    def direction(self, station_m: Floats) -> Floats:
        """Unit vectors (n, 2) of rising measure, over 2 m either way."""
        station = np.clip(np.asarray(station_m, np.float64), self.start_m, self.end_m)
        low = np.clip(station - 2.0, self.start_m, self.end_m)
        high = np.clip(station + 2.0, self.start_m, self.end_m)
        ahead = np.column_stack([np.interp(high, self.station_m, c) for c in self.xy_m.T])
        behind = np.column_stack([np.interp(low, self.station_m, c) for c in self.xy_m.T])
        way = ahead - behind
        return way / np.maximum(np.hypot(*way.T), 1e-9)[:, None]

    def edge_m(self, station_m: Floats, side: Ints) -> Floats:
        """Distance (n,) from the centreline to the edge on a side, NaN where unknown."""
        left = np.interp(station_m, self.station_m, self.left_m)
        right = np.interp(station_m, self.station_m, self.right_m)
        return np.where(np.asarray(side) < 0, left, right)

    def bridged_edge_m(self, station_m: Floats, side: Ints) -> Floats:
        """As `edge_m`, carried over gaps of up to 100 m and on for 60 m beyond its ends."""
        station = np.asarray(station_m, np.float64)
        left = _bridged(station, self.station_m, self.left_m)
        right = _bridged(station, self.station_m, self.right_m)
        return np.where(np.asarray(side) < 0, left, right)


class Roads:
    """The roads of a site."""

    def __init__(self, roads: Sequence[Road]) -> None:
        self.roads = tuple(roads)
        starts = [road.xy_m[:-1] for road in self.roads]
        ends = [road.xy_m[1:] for road in self.roads]
        self._start = np.concatenate(starts) if starts else np.empty((0, 2))
        self._end = np.concatenate(ends) if ends else np.empty((0, 2))
        lengths = [len(one) for one in starts]
        self._road = np.repeat(np.arange(len(starts)), lengths).astype(np.int64)
        rows = [np.arange(length, dtype=np.int64) for length in lengths]
        self._row = np.concatenate(rows) if rows else np.empty(0, np.int64)
        self._tree = cKDTree((self._start + self._end) / 2) if len(self._start) else None

    def __len__(self) -> int:
        return len(self.roads)

    def locate(self, xy_m: Floats) -> Located:
        """Road, station and offset of places (n, 2); places beyond an end lie straight on."""
        xy = np.asarray(xy_m, np.float64).reshape(-1, 2)
        n = len(xy)
        if self._tree is None or n == 0:
            nan = np.full(n, np.nan)
            none = np.full((n, 2), np.nan)
            return Located(np.full(n, -1, np.int64), nan, nan.copy(), none, none.copy())
        _, near = self._tree.query(xy, k=min(4, len(self._start)))
        near = np.asarray(near).reshape(n, -1)
        way = (self._end - self._start)[near]
        long = np.hypot(way[..., 0], way[..., 1])
        along = ((xy[:, None] - self._start[near]) * way).sum(axis=2) / long**2
        held = np.clip(along, 0.0, 1.0)
        foot = self._start[near] + held[..., None] * way
        apart = np.hypot(*np.moveaxis(xy[:, None] - foot, 2, 0))
        best = np.argmin(apart, axis=1)
        rows = np.arange(n)
        piece, share = near[rows, best], along[rows, best]
        station, foot, direction = np.empty(n), foot[rows, best], np.empty((n, 2))
        for number, road in enumerate(self.roads):
            own = self._road[piece] == number
            row = self._row[piece[own]]
            last = len(road.station_m) - 2
            first_end, last_end = row == 0, row == last
            part = np.clip(
                share[own],
                np.where(first_end, -_BEYOND_M / STEP_M, 0.0),
                np.where(last_end, 1 + _BEYOND_M / STEP_M, 1.0),
            )
            gap = np.diff(road.station_m)[row]
            station[own] = road.station_m[row] + part * gap
            direction[own] = road.direction(station[own])
            foot[own] = self._start[piece[own]] + part[:, None] * (
                self._end[piece[own]] - self._start[piece[own]]
            )
        right = np.column_stack([direction[:, 1], -direction[:, 0]])
        away = xy - foot
        sign = np.where((away * right).sum(axis=1) < 0, -1.0, 1.0)
        offset = sign * np.hypot(*away.T)
        return Located(self._road[piece], station, offset, foot, direction)


@dataclass(frozen=True)
class Located:
    """Places along roads.

    Parameters
    ----------
    road : (n,) number of the road, -1 for none. station_m : (n,) measure along its centreline.
    offset_m : (n,) from the centreline, positive to the right of rising measure.
    foot_m : (n, 2) nearest place of the centreline. direction : (n, 2) of rising measure there.
    """

    road: Ints
    station_m: Floats
    offset_m: Floats
    foot_m: Floats
    direction: Floats

    @property
    def side(self) -> Ints:
        """-1 left, +1 right, 0 on the centreline or unknown."""
        away = np.nan_to_num(self.offset_m)
        return np.where(np.abs(away) < 1e-6, 0, np.sign(away)).astype(np.int64)


def roads_of(tracks: RouteTracks, edges_m: Floats, names: Sequence[str] | None = None) -> Roads:
    """Roads that drives follow.

    Parameters
    ----------
    edges_m : (n, 2 or more) points of road edges; without any, centrelines are the tracks.
    names : of the routes; those of the tracks if None.
    """
    if len(tracks) == 0:
        return Roads([])
    labels = list(tracks.names if names is None else names)
    lines: dict[int, Floats] = {}
    for route in range(len(labels)):
        own = tracks.route == route
        if own.sum() > 1:
            lines[route] = np.concatenate([tracks.start_m[own], tracks.end_m[own][-1:]])
    road_of = {n: n for n in lines}  # the first of its drives
    for b, a in combinations(lines, 2):
        if beside(lines[a], lines[b]):
            low, high = sorted((road_of[a], road_of[b]))
            road_of = {n: low if first == high else first for n, first in road_of.items()}
    found = []
    for first in sorted(set(road_of.values())):
        group = [n for n in lines if road_of[n] == first]
        longest = min(group, key=lambda n: (-round(_length_m(lines[n])), labels[n]))
        name, drives = labels[longest], tuple(sorted(labels[n] for n in group))
        told = f"from the first image of {name}, in its direction of travel"
        found.append(road_along(lines[longest], edges_m, name, drives, told))
    return Roads(found)


def beside(a_m: Floats, b_m: Floats) -> bool:
    """Whether much of the shorter of two drives runs beside the other."""
    short, long = sorted((resampled(a_m, 5.0), resampled(b_m, 5.0)), key=_length_m)
    apart, row = cKDTree(long).query(short)
    cosine = np.abs((_ways(short) * _ways(long)[row]).sum(axis=1))
    near = (apart <= BESIDE_M) & (cosine >= np.cos(np.radians(_BESIDE_DEG)))
    return bool(near.mean() >= _BESIDE_SHARE)


def _length_m(line: Floats) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def along_m(line_m: Floats) -> Floats:
    """Length (n,) along a line (n, 2) to each vertex."""
    return np.r_[0.0, np.cumsum(np.hypot(*np.diff(line_m, axis=0).T))]


def road_along(
    line_m: Floats,
    edges_m: Floats,
    name: str,
    drives: tuple[str, ...] = (),
    measured: str = "",
    measures_m: tuple[float, float] | None = None,
    paved: shapely.Geometry | None = None,
) -> Road:
    """Road along a line: midway between the edges either side of it, where they are found.

    Parameters
    ----------
    line_m : (n, 2) a drive or a line of an inventory. measures_m : of its first and last vertex;
        0 and its length along the centreline if None. paved : only what has its middle in it is
        road, where the line may lie between carriageways; as a drive does not, if None.
    """
    line = resampled(line_m, STEP_M)
    left = right = np.full(len(line), np.nan)
    noise = float("nan")
    if len(edges_m):
        tree = cKDTree(edges_m[:, :2])
        for _ in range(2):
            line = _smooth(line)
            middle, half = _between(line, edges_m[:, :2], tree, paved)
            if np.isnan(middle).all():
                break
            line = resampled(line + middle[:, None] * _rights(line), STEP_M)
        line = _smooth(line)
        middle, half = _between(line, edges_m[:, :2], tree, paved)
        left, right = half - middle, half + middle
        known = middle[np.isfinite(half)]
        if len(known):
            noise = 1.4826 * float(np.median(np.abs(known - np.median(known))))
    station = along_m(line)
    if measures_m is not None:
        low, high = measures_m
        station = low + station * (high - low) / station[-1]
    return Road(name, drives or (name,), measured, line, station, left, right, noise)


def resampled(line_m: Floats, step_m: float) -> Floats:
    """A line with vertices every ``step_m``, a little less so that they come out even."""
    line = np.asarray(line_m, np.float64)[:, :2]
    moved = np.r_[True, np.hypot(*np.diff(line, axis=0).T) > 1e-6]
    line = line[moved]
    along = along_m(line)
    count = max(int(np.ceil(along[-1] / step_m)), 2)
    at = np.linspace(0.0, along[-1], count + 1)
    return np.column_stack([np.interp(at, along, c) for c in line.T])


def _smooth(line: Floats) -> Floats:
    """Line smoothed by cubics; its ends keep their direction."""
    from scipy.signal import savgol_filter  # noqa: PLC0415  # slow to load

    window = min(int(_SMOOTH_M / STEP_M), (len(line) - 1) // 2 * 2 - 1)
    if window < 5:
        return line
    return np.column_stack([savgol_filter(c, window, 3, mode="interp") for c in line.T])


def _between(
    line: Floats, edges: Floats, tree: cKDTree, paved: shapely.Geometry | None
) -> tuple[Floats, Floats]:
    """Place between the edges (n,), positive right, and half the width (n,), at each vertex.

    Both are NaN where no pair of edges was found; the place is interpolated between such.
    """
    rights, ways, n = _rights(line), _ways(line), len(line)
    pairs: list[Floats] = []
    for number, near in enumerate(tree.query_ball_point(line, _REACH_M)):
        gap = edges[near] - line[number] if near else np.empty((0, 2))
        own = np.abs(gap @ ways[number]) <= 1.0
        offset = np.sort((gap @ rights[number])[own])
        found = _pairs(offset, _OFF_TRACK_M)
        if paved is not None:
            found = _on(paved, line[number], rights[number], found)
            beside = _on(paved, line[number], rights[number], _pairs(offset, 2 * _OFF_TRACK_M))
            # Between two carriageways it may mean either, and would jump from one to the other.
            if len(beside) > 1 and not shapely.contains_xy(paved, *line[number]):
                found = found[:0]
        pairs.append(found)
    widths = [p[np.argmin(np.abs(p.mean(axis=1)))] for p in pairs if len(p)]
    middle, half = np.full(n, np.nan), np.full(n, np.nan)
    if not widths:
        return middle, half
    usual = float(np.median([high - low for low, high in widths]))
    for number, found in enumerate(pairs):
        if len(found):
            misfit = np.abs(found.mean(axis=1)) + np.abs(np.diff(found, axis=1)[:, 0] - usual)
            low, high = found[np.argmin(misfit)]
            middle[number], half[number] = (low + high) / 2, (high - low) / 2
    good = _usual_width(half, middle)
    half[~good] = np.nan
    rows = np.arange(n)
    middle = np.interp(rows, rows[good], middle[good])
    return middle, half


def _on(paved: shapely.Geometry, place: Floats, right: Floats, pairs: Floats) -> Floats:
    """Pairs of edges (k, 2) whose middle is paved."""
    return pairs[shapely.contains_xy(paved, place + pairs.mean(axis=1)[:, None] * right)]


def _pairs(offset: Floats, reach_m: float) -> Floats:
    """Neighbouring edges (k, 2), of sorted offsets, between which or so far beside a track lies."""
    gaps = np.flatnonzero(np.diff(offset) >= _NARROWEST_M)
    found = []
    for g in gaps:
        low, high = offset[g], offset[g + 1]
        if low <= reach_m and high >= -reach_m:
            # The nearest points alone would make the road narrower by their noise.
            left = offset[(offset <= low) & (offset > low - _EDGE_M)]
            right = offset[(offset >= high) & (offset < high + _EDGE_M)]
            found.append((np.median(left), np.median(right)))
    return np.array(found, np.float64).reshape(-1, 2)


def _usual_width(half: Floats, middle: Floats) -> Bools:
    """Whether width and place are those of the neighbours, within 25 m either way."""
    good = np.isfinite(half)
    kept = good.copy()
    for number in np.flatnonzero(good):
        near = slice(max(number - 25, 0), number + 26)
        own = good[near]
        usual = np.median(half[near][own])
        spread = 1.4826 * np.median(np.abs(half[near][own] - usual))
        alike = abs(half[number] - usual) <= max(_WIDTH_OFF_M / 2, 4 * spread)
        kept[number] = alike and abs(middle[number] - np.median(middle[near][own])) <= 1.5
    return kept if kept.any() else good


def _rights(line: Floats) -> Floats:
    way = _ways(line)
    return np.column_stack([way[:, 1], -way[:, 0]])


def _ways(line: Floats) -> Floats:
    way = np.gradient(line, axis=0)
    return way / np.maximum(np.hypot(*way.T), 1e-9)[:, None]


def _bridged(station: Floats, at: Floats, value: Floats) -> Floats:
    """Values at stations, straight between known ones; NaN in gaps and far beyond the ends."""
    known = np.isfinite(value)
    if not known.any():
        return np.full(len(station), np.nan)
    at, value = at[known], value[known]
    after = np.searchsorted(at, station)
    low = np.r_[at[0] - _BEYOND_M, at][after]
    high = np.r_[at, at[-1] + _BEYOND_M][after]
    far = (station < low) | (station > high) | (high - low > _GAP_M)
    return np.where(far, np.nan, np.interp(station, at, value))


class RouteTracks:
    """The routes' camera places as lines.

    Parameters
    ----------
    frames : image rows with route, sequence, x, y (local metres), in any order.

    Attributes
    ----------
    names : of the routes, by number.
    """

    def __init__(self, frames: pd.DataFrame) -> None:
        frames = frames.sort_values(["route", "sequence"], kind="stable")
        xy = frames[["x", "y"]].to_numpy(np.float64)
        route, names = pd.factorize(frames["route"])
        self.names = [str(name) for name in names]
        known = np.isfinite(xy).all(axis=1)
        xy, route = xy[known], route[known]
        self._places = cKDTree(xy)
        first = np.r_[True, np.diff(route) != 0][: len(xy)]
        moved = np.hypot(*np.diff(xy, axis=0, prepend=xy[:1]).T) > 1e-3
        xy, route = xy[moved | first], route[moved | first]
        joined = route[1:] == route[:-1]
        self.start_m, self.end_m = xy[:-1][joined], xy[1:][joined]
        self.route = route[1:][joined]
        self.length_m = np.hypot(*(self.end_m - self.start_m).T)
        total = np.cumsum(self.length_m) - self.length_m
        new = np.r_[True, np.diff(self.route) != 0][: len(total)]
        before = np.maximum.accumulate(np.where(new, np.arange(len(total)), 0))
        self.station_m = total - total[before] if len(total) else total
        lines = np.stack([self.start_m, self.end_m], axis=1)
        self._tree = shapely.STRtree(shapely.linestrings(lines)) if len(lines) else None

    def __len__(self) -> int:
        return len(self.route)

    def locate(self, xy_m: Floats) -> tuple[Ints, Floats, Floats]:
        """Nearest piece of track, station along its route (m) and foot on it (n, 2) of places."""
        if self._tree is None or len(xy_m) == 0:
            none = np.full((len(xy_m), 2), np.nan)
            return np.full(len(xy_m), -1, np.int64), none[:, 0], none
        asked, pieces = self._tree.query_nearest(shapely.points(xy_m), all_matches=True)
        order = np.lexsort([pieces, asked])
        _, first = np.unique(asked[order], return_index=True)
        piece = pieces[order][first].astype(np.int64)
        way = (self.end_m - self.start_m)[piece] / self.length_m[piece, None]
        along = ((xy_m - self.start_m[piece]) * way).sum(axis=1)
        along = np.clip(along, 0.0, self.length_m[piece])
        return piece, self.station_m[piece] + along, self.start_m[piece] + along[:, None] * way

    def away_m(self, xy_m: Floats) -> Floats:
        """How far (n,) places are from a track, or from the only image of a route; inf: none."""
        to_track = np.hypot(*(xy_m - self.locate(xy_m)[2]).T)
        return np.fmin(to_track, self._places.query(xy_m)[0])

    def direction(self, piece: Ints) -> Floats:
        """Unit vectors of travel (n, 2)."""
        return (self.end_m - self.start_m)[piece] / self.length_m[piece, None]

    def place(self, route: int, station_m: Floats) -> Floats:
        """Places (n, 2) at stations of a route, held at its ends."""
        own = self.route == route
        stations = np.r_[self.station_m[own], self.station_m[own][-1:] + self.length_m[own][-1:]]
        xy = np.concatenate([self.start_m[own], self.end_m[own][-1:]])
        return np.column_stack([np.interp(station_m, stations, axis) for axis in xy.T])
