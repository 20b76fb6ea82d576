"""Guardrails in a cloud: narrow lines at the height of a bumper, with nothing above or beside them.

Rails are told from hedges, which have returns beside the line, from walls, fences and parked
vehicles, which have returns above it, and from chance by their length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.kernels import compiled, compiled_part
from roadsight.poles.images.kinds import KINDS
from roadsight.poles.sightings.lidar_poles import NO_COLUMN, thinned

_ABOVE_M = 1.0  # height over a rail in which a wall, a fence or a vehicle has returns
_DECK = 17  # ASPRS class of bridge decks, over which the ground is a valley's
_DECK_M = 1.5  # rails stand no further from the deck of their bridge
_THIN_M = 0.1  # cells in plan that count as one return each, however dense the cloud
REACH_M = 4.0  # stretch of rail to either side of a return that shows its direction
# Pieces of it that should each have a return: W-beams have 2.5 returns a metre at 24 pulses/m2.
_BIN_M = 1.0
_FILLED = 6  # of the eight pieces, so many must, or all four on one side, where the rail ends
_DIRECTIONS = 48  # directions tried over half a turn
# Returns of a rail are this near to its line: it is 0.1 m thick and curves, on a radius of 60 m by
# 0.13 m over the reach.
_HALF_WIDTH_M = 0.15
_BESIDE_M = (0.3, 1.0)  # distances beside the line where a hedge goes on and a rail does not
_MOST_BESIDE = 0.7  # returns there, as a share of those on the line
_MOST_ABOVE = 0.3  # returns above, likewise
# Cells of a square about the reach: no return has more neighbours.
_MOST_IN_REACH = int(2 * REACH_M / _THIN_M + 3) ** 2
# Cells that a rail and what may be beside it have within 1 m: 20 along it, of them 7 across up to
# 0.3 m either way, and 0.7 times the 4 on the line beside that. These are 196 of the disc's 314;
# what fills more, as grass does from 100 returns/m2 on, is an area, and its directions are not
# tried.
_MOST_BY_A_RAIL = round(
    2
    * _BESIDE_M[1]
    / _THIN_M
    * (2 * _BESIDE_M[0] / _THIN_M + 1 + _MOST_BESIDE * (2 * _HALF_WIDTH_M / _THIN_M + 1))
)
# Returns of one rail follow each other within this: chance leaves gaps, and so do vehicles.
_LINK_M = 4.0
_TURN_COS = float(np.cos(np.radians(15.0)))  # their directions differ by no more than 15 degrees
_ASIDE_M = 0.3  # a next return is no further beside the direction
# Shorter lines are no rails: a parked car is 5 m long, a usual rail 7.6 m plus its ends.
_SHORTEST_M = 8.0
_EVERY_M = 1.0  # spacing of the places of a line


@dataclass(frozen=True)
class RailReturns:
    """Returns of rails: place (n, 3) with the ground's height, and direction (n, 2)."""

    xyz_m: Floats
    direction: Floats


def find_rail_returns(xyz_m: Floats, above_ground_m: Floats, cls: NDArray) -> RailReturns:
    """Returns, thinned, whose neighbours lie on a line as those of a rail do.

    Parameters
    ----------
    xyz_m : returns (n, 3), local metres. above_ground_m : (n,), NaN where unknown.
    cls : ASPRS class (n,).
    """
    least_m, most_m = KINDS["guardrail"].height_m
    above_ground_m = _over_decks(xyz_m, above_ground_m, cls)
    with np.errstate(invalid="ignore"):
        solid = ~np.isin(cls, NO_COLUMN) & (above_ground_m > least_m)
        low = solid & (above_ground_m <= most_m)
        over = solid & (above_ground_m > most_m) & (above_ground_m <= most_m + _ABOVE_M)
    xyz = np.asarray(xyz_m, np.float64)
    ground = np.column_stack([xyz[:, :2], xyz[:, 2] - above_ground_m])
    # Column by column of cells from the west, each northwards.
    points, above = (thinned(ground[rows], _THIN_M, axes=2) for rows in (low, over))
    if not len(points):
        return RailReturns(np.empty((0, 3)), np.empty((0, 2)))
    turn = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
    ways = np.column_stack([np.cos(turn), np.sin(turn)])
    best = _directions(points, _columns(points), above, _columns(above), ways)
    found = best >= 0
    return RailReturns(points[found], ways[best[found]])


def _over_decks(xyz_m: Floats, above_ground_m: Floats, cls: NDArray) -> Floats:
    """Heights above the ground, or above the bridge deck beside a return if that is higher."""
    deck = np.asarray(cls) == _DECK
    above = np.array(above_ground_m, np.float64)
    if not deck.any():
        return above
    tree = cKDTree(xyz_m[deck, :2])
    away, nearest = tree.query(xyz_m[:, :2], distance_upper_bound=_DECK_M)
    beside = np.isfinite(away) & ~deck
    over = xyz_m[beside, 2] - xyz_m[deck][nearest[beside], 2]
    # What is below the deck is not on it.
    above[beside] = np.where(over > -_DECK_M, np.fmin(over, above[beside]), above[beside])
    return above


def _columns(thinned: Floats) -> Ints:
    """Number of the first column of cells, and where the points of each column begin, (m + 2,)."""
    column = np.floor(thinned[:, 0] / _THIN_M).astype(np.int64)
    if not len(column):
        return np.zeros(2, np.int64)
    # A mean may be rounded into the next column; the order of the points stays.
    column = np.maximum.accumulate(column)
    bounds = np.arange(column[0], column[-1] + 2)
    return np.concatenate([column[:1], np.searchsorted(column, bounds)])


@compiled()
def _directions(
    points: Floats, columns: Ints, above: Floats, columns_above: Ints, ways: Floats
) -> Ints:
    """Of each point the direction in which it is a rail's, -1 where in none."""
    best = np.full(len(points), -1, np.int64)
    near, higher = np.empty((2, _MOST_IN_REACH)), np.empty((2, _MOST_IN_REACH))
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        if _gather(x, y, _BESIDE_M[1], points, columns, near) > _MOST_BY_A_RAIL:
            continue
        size = _gather(x, y, REACH_M, points, columns, near)
        over = -1
        most = 0.0
        for k in range(len(ways)):
            on, beside = _counts(near[0, :size], near[1, :size], ways[k, 0], ways[k, 1])
            if beside > _MOST_BESIDE * on or not _goes_on(near[:, :size], ways[k]):
                continue
            if over < 0:
                over = _gather(x, y, REACH_M, above, columns_above, higher)
            if _within(higher[:, :over], ways[k], _BESIDE_M[0])[0] > _MOST_ABOVE * on:
                continue
            score = on - _within(near[:, :size], ways[k], _HALF_WIDTH_M)[1] / _HALF_WIDTH_M
            if score > most:
                most, best[i] = score, k
    return best


@compiled_part()
def _gather(x: float, y: float, reach_m: float, points: Floats, columns: Ints, near: Floats) -> int:
    """Write the offsets (2, n) of the points within reach of a place, in their order; n of them."""
    first = max(int(np.floor((x - reach_m) / _THIN_M)) - 1 - columns[0], 0)
    last = min(int(np.floor((x + reach_m) / _THIN_M)) + 1 - columns[0], len(columns) - 3)
    count = 0
    for c in range(first, last + 1):
        low, end = columns[c + 1], columns[c + 2]
        high = end
        while low < high:
            middle = (low + high) // 2
            if points[middle, 1] < y - reach_m:
                low = middle + 1
            else:
                high = middle
        for j in range(low, end):
            if points[j, 1] > y + reach_m:
                break
            dx, dy = points[j, 0] - x, points[j, 1] - y
            if dx * dx + dy * dy <= reach_m * reach_m:
                near[0, count], near[1, count] = dx, dy
                count += 1
    return count


@compiled_part()
def _counts(x: Floats, y: Floats, along_x: float, along_y: float) -> tuple[int, int]:
    """Points on a line through the origin, and beside it; flat arrays, which compile to vectors."""
    on, beside = 0, 0
    for j in range(len(x)):
        across = abs(x[j] * along_y - y[j] * along_x)
        on += across <= _HALF_WIDTH_M
        beside += (across >= _BESIDE_M[0]) & (across <= _BESIDE_M[1])
    return on, beside


@compiled_part()
def _within(near: Floats, way: Floats, across_m: float) -> tuple[int, float]:
    """Number of points so near to a line through the origin, and the sum of their distances."""
    count, off = 0, 0.0
    for j in range(near.shape[1]):
        across = abs(near[0, j] * way[1] - near[1, j] * way[0])
        if across <= across_m:
            count += 1
            off += across
    return count, off


@compiled_part()
def _goes_on(near: Floats, way: Floats) -> bool:
    """Whether points on the line fill most of its pieces, or all on one side."""
    side = int(REACH_M / _BIN_M)
    filled = np.zeros(2 * side, np.bool_)
    for j in range(near.shape[1]):
        if abs(near[0, j] * way[1] - near[1, j] * way[0]) <= _HALF_WIDTH_M:
            along = near[0, j] * way[0] + near[1, j] * way[1]
            filled[min(int((along + REACH_M) / _BIN_M), 2 * side - 1)] = True
    before, after = filled[:side].sum(), filled[side:].sum()
    return before + after >= _FILLED or max(before, after) == side


def join_rails(returns: RailReturns) -> list[Floats]:
    """Lines (n, 3) of places every metre, with the ground's height, from west to east.

    Each runs along the longest of the shortest ways between its returns.
    """
    if len(returns.xyz_m) < 2:
        return []
    # Pairs of returns that follow each other on a rail.
    pairs = cKDTree(returns.xyz_m[:, :2]).query_pairs(_LINK_M, output_type="ndarray")
    step = returns.xyz_m[pairs[:, 1], :2] - returns.xyz_m[pairs[:, 0], :2]
    ways = [returns.direction[pairs[:, k]] for k in (0, 1)]
    good: Bools = np.abs((ways[0] * ways[1]).sum(axis=1)) >= _TURN_COS
    for way in ways:
        good &= np.abs(step[:, 0] * way[:, 1] - step[:, 1] * way[:, 0]) <= _ASIDE_M
    length = np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-3)[good]
    size = len(returns.xyz_m)
    ends = pairs[good, 0], pairs[good, 1]
    graph = coo_matrix((length, ends), shape=(size, size)).tocsr()
    _, part = connected_components(graph, directed=False)
    lines = []
    for number in range(part.max() + 1):
        own = np.flatnonzero(part == number)
        if len(own) < _SHORTEST_M / _LINK_M:
            continue
        # The way between the two that are farthest from each other.
        joined = graph[own][:, own]
        first = int(np.argmax(dijkstra(joined, directed=False, indices=0)))
        away, before = dijkstra(joined, directed=False, indices=first, return_predecessors=True)
        nodes = [int(np.argmax(away))]
        while nodes[-1] != first:
            nodes.append(int(before[nodes[-1]]))
        line = _smoothed(returns.xyz_m[own[nodes]])
        if line is not None:
            lines.append(line if line[0, 0] <= line[-1, 0] else line[::-1].copy())
    return sorted(lines, key=lambda line: (line[0, 0], line[0, 1]))


def _smoothed(places: Floats) -> Floats | None:
    """The line every metre, each place a mean over two; None if it is too short."""
    station = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places[:, :2], axis=0).T))])
    if station[-1] < _SHORTEST_M:
        return None
    fine = np.linspace(0.0, station[-1], int(np.ceil(station[-1] / (0.2 * _EVERY_M))) + 1)
    dense = np.column_stack([np.interp(fine, station, places[:, k]) for k in range(3)])
    at = np.linspace(0.0, station[-1], max(int(round(station[-1] / _EVERY_M)), 1) + 1)
    near = np.abs(fine - at[:, None])
    # Towards an end the mean is over less on both sides, so that the line is not cut short.
    half = np.minimum(_EVERY_M, np.minimum(at, station[-1] - at))[:, None]
    weight = (near <= half + 1e-9).astype(np.float64)
    return np.asarray(weight @ dense / weight.sum(axis=1, keepdims=True), np.float64)
