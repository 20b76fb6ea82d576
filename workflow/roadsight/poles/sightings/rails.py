"""Guardrails in a cloud: narrow lines at the height of a bumper, with nothing above or beside them.

Rails are told from hedges, which have returns beside the line, from walls, fences and parked
vehicles, which have returns above it, and from chance by their length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.poles.images.kinds import KINDS
from roadsight.poles.sightings.lidar_poles import NO_COLUMN

_ABOVE_M = 1.0
"""Height over a rail in which a wall, a fence or a vehicle has returns."""
_DECK = 17
"""ASPRS class of bridge decks, over which the ground is a valley's."""
_DECK_M = 1.5
"""Rails stand no further from the deck of their bridge."""
_THIN_M = 0.1
"""Cells in plan that count as one return each, however dense the cloud."""
REACH_M = 4.0
"""Stretch of rail to either side of a return that shows its direction."""
_BIN_M = 1.0
"""Pieces of it that should each have a return: W-beams have 2.5 returns a metre at 24 pulses/m2."""
_FILLED = 6
"""Of the eight pieces, so many must, or all four on one side, where the rail ends."""
_DIRECTIONS = 48
"""Directions tried over half a turn."""
_HALF_WIDTH_M = 0.15
"""Returns of a rail are this near to its line: it is 0.1 m thick and curves, on a radius of 60 m by
0.13 m over the reach."""
_BESIDE_M = (0.3, 1.0)
"""Distances beside the line where a hedge goes on and a rail does not."""
_MOST_BESIDE = 0.7
"""Returns there, as a share of those on the line."""
_MOST_ABOVE = 0.3
"""Returns above, likewise."""
_LINK_M = 4.0
"""Returns of one rail follow each other within this: chance leaves gaps, and so do vehicles."""
_TURN_COS = float(np.cos(np.radians(15.0)))
"""Their directions differ by no more than 15 degrees."""
_ASIDE_M = 0.3
"""A next return is no further beside the direction."""
_SHORTEST_M = 8.0
"""Shorter lines are no rails: a parked car is 5 m long, a usual rail 7.6 m plus its ends."""
_EVERY_M = 1.0
"""Spacing of the places of a line."""


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
    points, above = _thinned(ground[low]), _thinned(ground[over])
    if not len(points):
        return RailReturns(np.empty((0, 3)), np.empty((0, 2)))
    around = _near(points, points)
    higher = _near(points, above)
    turn = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
    ways = np.column_stack([np.cos(turn), np.sin(turn)])
    best = _directions(points, above, *around, *higher, ways)
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


def _thinned(points: Floats) -> Floats:
    """Mean of the points in each cell, in order of place."""
    if not len(points):
        return points
    cell = np.floor(points[:, :2] / _THIN_M).astype(np.int64)
    _, number, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    sums = [np.bincount(number.ravel(), points[:, k]) for k in range(3)]
    return np.asarray(np.column_stack(sums) / count[:, None], np.float64)


def _near(points: Floats, others: Floats) -> tuple[Ints, Ints]:
    """Others within reach of each point: where each one's begin, and their numbers."""
    if not len(others):
        return np.zeros(len(points) + 1, np.int64), np.empty(0, np.int64)
    lists = cKDTree(others[:, :2]).query_ball_point(points[:, :2], REACH_M, return_sorted=True)
    start = np.cumsum([0, *(len(one) for one in lists)], dtype=np.int64)
    return start, np.array([k for one in lists for k in one], np.int64)


@njit(cache=True)
def _directions(
    points: Floats,
    above: Floats,
    start: Ints,
    around: Ints,
    start_above: Ints,
    higher: Ints,
    ways: Floats,
) -> Ints:
    """Of each point the direction in which it is a rail's, -1 where in none."""
    best = np.full(len(points), -1, np.int64)
    side = int(REACH_M / _BIN_M)
    for i in range(len(points)):
        most = 0.0
        for k in range(len(ways)):
            filled = np.zeros(2 * side, np.bool_)
            on, beside, over, off = 0.0, 0.0, 0.0, 0.0
            for j in around[start[i] : start[i + 1]]:
                x, y = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
                along = x * ways[k, 0] + y * ways[k, 1]
                across = abs(x * ways[k, 1] - y * ways[k, 0])
                if across <= _HALF_WIDTH_M:
                    on += 1.0
                    off += across
                    filled[min(int((along + REACH_M) / _BIN_M), 2 * side - 1)] = True
                elif _BESIDE_M[0] <= across <= _BESIDE_M[1]:
                    beside += 1.0
            count, before, after = 0, 0, 0
            for m in range(2 * side):
                count += filled[m]
                before += filled[m] and m < side
                after += filled[m] and m >= side
            if count < _FILLED and before < side and after < side:
                continue
            if beside > _MOST_BESIDE * on:
                continue
            for j in higher[start_above[i] : start_above[i + 1]]:
                x, y = above[j, 0] - points[i, 0], above[j, 1] - points[i, 1]
                over += abs(x * ways[k, 1] - y * ways[k, 0]) <= _BESIDE_M[0]
            if over > _MOST_ABOVE * on:
                continue
            score = on - off / _HALF_WIDTH_M
            if score > most:
                most, best[i] = score, k
    return best


def join_rails(returns: RailReturns) -> list[Floats]:
    """Lines (n, 3) of places every metre, with the ground's height, from west to east.

    Each runs along the longest of the shortest ways between its returns.
    """
    if len(returns.xyz_m) < 2:
        return []
    pairs, length = _links(returns)
    size = len(returns.xyz_m)
    ends = pairs[:, 0], pairs[:, 1]
    graph = coo_matrix((length, ends), shape=(size, size)).tocsr()
    _, part = connected_components(graph, directed=False)
    lines = []
    for number in range(part.max() + 1):
        own = np.flatnonzero(part == number)
        if len(own) < _SHORTEST_M / _LINK_M:
            continue
        line = _smoothed(returns.xyz_m[own[_longest_way(graph[own][:, own])]])
        if line is not None:
            lines.append(line if line[0, 0] <= line[-1, 0] else line[::-1].copy())
    return sorted(lines, key=lambda line: (line[0, 0], line[0, 1]))


def _links(returns: RailReturns) -> tuple[Ints, Floats]:
    """Pairs (m, 2) of returns that follow each other on a rail, and their distances."""
    pairs = cKDTree(returns.xyz_m[:, :2]).query_pairs(_LINK_M, output_type="ndarray")
    step = returns.xyz_m[pairs[:, 1], :2] - returns.xyz_m[pairs[:, 0], :2]
    ways = [returns.direction[pairs[:, k]] for k in (0, 1)]
    good: Bools = np.abs((ways[0] * ways[1]).sum(axis=1)) >= _TURN_COS
    for way in ways:
        good &= np.abs(step[:, 0] * way[:, 1] - step[:, 1] * way[:, 0]) <= _ASIDE_M
    length = np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-3)
    return pairs[good].astype(np.int64), length[good]


def _longest_way(graph: csr_matrix) -> Ints:
    """Nodes of the way between the two that are farthest from each other."""
    away = dijkstra(graph, directed=False, indices=0)
    first = int(np.argmax(away))
    away, before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)
    way = [int(np.argmax(away))]
    while way[-1] != first:
        way.append(int(before[way[-1]]))
    return np.array(way, np.int64)


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
