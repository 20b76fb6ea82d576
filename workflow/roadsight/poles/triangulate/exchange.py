"""The set of poles that explains the rays best: greedy first, then improved by exchange."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Ints
from roadsight.poles.triangulate.association import (
    SETTLED,
    Grower,
    Pole,
    in_order,
    take_best,
)
from roadsight.poles.triangulate.rays import Rays

_ROUNDS = 6
"""Rounds of exchange between poles at most; most streets rest after three."""
_BETTER = 1e-6
"""Two sets of poles whose evidence differs by less are equal: sums round more than terms."""


def associate(grower: Grower) -> list[Pole]:
    """Poles that share no ray and together explain the rays best, as far as exchange finds it.

    The best hypothesis is taken first and what it leaves is grown anew; then rays are exchanged
    between poles image by image, poles that are better as one are merged, left-over hypotheses are
    forced in where that pays, and free rays seed new ones, until nothing changes. No step depends
    on the order of the caller's rows.
    """
    free = np.ones(len(grower.rays), bool)
    seeds = grower.seeds()
    poles, others = take_best(grower, seeds, free)
    for _ in range(_ROUNDS):
        before = [pole.key for pole in poles]
        poles = _insert(grower, _merge(grower, _exchange(grower, poles)), others)
        free[:] = True
        for pole in poles:
            free[pole.members] = False
        left = [seed for seed in seeds if free[seed[0]]]
        poles = in_order(poles + take_best(grower, left, free)[0])
        if [pole.key for pole in poles] == before:
            break
    return poles


def _exchange(grower: Grower, poles: list[Pole]) -> list[Pole]:
    """Each image's rays to the poles that they fit best, one to one; poles fitted anew."""
    if not poles:
        return poles
    rays = grower.rays
    tree = cKDTree([[pole.x, pole.y] for pole in poles])
    members: list[list[int]] = [[] for _ in poles]
    for own in _by_image(rays):
        around = sorted(tree.query_ball_point(rays.camera_m[own[0]], grower.model.reach_m))
        if not around:
            continue
        worth = np.maximum(grower.speaking([poles[p] for p in around], own), 0.0)
        for p, k in zip(*linear_sum_assignment(-worth), strict=True):
            if worth[p, k] > 0:
                members[around[p]].append(int(own[k]))
    kept = []
    for pole, rows in zip(poles, members, strict=True):
        if len(rows) < 2:
            continue
        ordered = np.sort(np.array(rows, np.int64))
        again = grower.fit(ordered, pole.x, pole.y, int(ordered[0]))
        if again is not None:
            kept.append(again)
    return in_order(kept)


def _by_image(rays: Rays) -> list[Ints]:
    """Ray numbers of each image."""
    order = np.argsort(rays.image, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(rays.image[order])) + 1)


def _merge(grower: Grower, poles: list[Pole]) -> list[Pole]:
    """Poles after joining those that explain their rays better as one, nearest first."""
    current, fresh = dict(enumerate(poles)), len(poles)
    tried: set[tuple[int, int]] = set()
    free = np.zeros(len(grower.rays), bool)
    joined = True
    while joined and len(current) > 1:
        joined, used = False, set()
        for a, b in _near_pairs(current, grower.model.reach_m / 2):
            if (a, b) in tried or a in used or b in used:
                continue
            tried.add((a, b))
            one = _as_one(grower, current[a], current[b], free)
            if one is not None and one.gain > current[a].gain + current[b].gain + _BETTER:
                used |= {a, b}
                del current[a], current[b]
                current[fresh] = one
                fresh, joined = fresh + 1, True
    return in_order(current.values())


def _near_pairs(poles: dict[int, Pole], reach_m: float) -> list[tuple[int, int]]:
    """Pairs of poles within a distance, nearest first."""
    numbers = np.array(sorted(poles))
    places = np.array([(poles[n].x, poles[n].y) for n in numbers.tolist()])
    pairs = cKDTree(places).query_pairs(reach_m, output_type="ndarray")
    apart = np.hypot(*(places[pairs[:, 0]] - places[pairs[:, 1]]).T)
    first, second = numbers[pairs.min(axis=1)], numbers[pairs.max(axis=1)]
    order = np.lexsort([second, first, np.round(apart, 9)])
    return list(zip(first[order].tolist(), second[order].tolist(), strict=True))


def _as_one(grower: Grower, first: Pole, second: Pole, free: Bools) -> Pole | None:
    """One pole of the rays of two, from the places of both and between.

    Parameters
    ----------
    free : no ray is; the same when it returns.
    """
    free[first.members] = free[second.members] = True
    best = None
    middle = (0.5 * (first.x + second.x), 0.5 * (first.y + second.y))
    for x, y in (middle, (first.x, first.y), (second.x, second.y)):
        one = grower.grow(x, y, first.seed, free)
        if one is not None and (best is None or one.gain > best.gain + SETTLED):
            best = one
    free[first.members] = free[second.members] = False
    return best


def _insert(grower: Grower, poles: list[Pole], others: list[Pole]) -> list[Pole]:
    """Poles after forcing others in, one by one, wherever that explains the rays better.

    Poles that lose rays to the one forced in are grown anew from what they keep and what is free.
    """
    owner = np.full(len(grower.rays), -1)
    current, fresh = dict(enumerate(poles)), len(poles)
    keys = {pole.key for pole in poles}
    for number, pole in current.items():
        owner[pole.members] = number
    free = owner < 0
    for other in others:
        if other.key in keys:
            continue
        numbers = sorted({int(n) for n in owner[other.members] if n >= 0})
        rivals = [current[n] for n in numbers]
        kept = _with_forced(grower, other, rivals, free)
        if sum(pole.gain for pole in kept) > sum(pole.gain for pole in rivals) + _BETTER:
            for n in numbers:
                gone = current.pop(n)
                owner[gone.members] = -1
                keys.discard(gone.key)
            for pole in kept:
                current[fresh] = pole
                owner[pole.members] = fresh
                keys.add(pole.key)
                fresh += 1
        for pole in (*rivals, *kept):
            free[pole.members] = owner[pole.members] < 0
    return in_order(current.values())


def _with_forced(grower: Grower, other: Pole, rivals: list[Pole], free: Bools) -> list[Pole]:
    """A pole that is forced in, and what its rivals become without its rays, best rival first.

    Parameters
    ----------
    free : rays of no pole; when it returns, rays of none of the poles that come back.
    """
    for rival in rivals:
        free[rival.members] = True
    free[other.members] = False
    kept = [other]
    for rival in sorted(rivals, key=lambda pole: (-round(pole.gain, 9), pole.key)):
        again = grower.grow(rival.x, rival.y, rival.seed, free)
        if again is not None:
            kept.append(again)
            free[again.members] = False
    return kept
