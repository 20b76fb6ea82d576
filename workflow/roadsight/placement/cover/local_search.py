"""Good covers quickly: greedy start, then local search with weights on hard targets."""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from roadsight.placement.cover.deadline import Deadline
from roadsight.placement.cover.problem import Instance
from roadsight.placement.cover.reductions import arrays

STEPS = 20_000
_CHUNK = 2_000
_NEW_TARGETS = 50

_State = namedtuple(
    "_State", "inside member place score ready stamp count weight open spot occupant sizes"
)
"""Search state: ``score`` is the weight gained by adding a row, or lost by removing it; ``sizes``
holds the numbers of members and of open targets."""


def greedy_cover(instance: Instance) -> NDArray[np.bool_] | None:
    """Rows by weight gained per cost, then without the superfluous ones; None if it got stuck."""
    inside = np.zeros(instance.shape[0], bool)
    done = _greedy(*arrays(instance), instance.cost, instance.need, instance.group, inside)
    return inside if done else None


def improve_cover(
    instance: Instance,
    start: NDArray[np.bool_] | None,
    first: NDArray[np.bool_],
    lower: float,
    rng: np.random.Generator,
    deadline: Deadline,
) -> NDArray[np.bool_] | None:
    """Cheaper cover than ``start`` where the search finds one.

    Parameters
    ----------
    start : (m,) a cover, or None.
    first : (n,) targets to look at first; others join when a trial leaves them open.
    lower : proven bound in steps: a cover at this cost ends the search.
    """
    best, active, left = start, first.copy(), STEPS
    trial = np.zeros(instance.shape[0], bool) if start is None else start
    part = None
    while left > 0 and not deadline.passed():
        cost = np.inf if best is None else instance.cost[best].sum()
        if instance.round_up(lower) >= cost:
            break
        if part is None:
            part = instance.select(np.ones(instance.shape[0], bool), active)
        trial, found, used = _search(*arrays(part), part.cost, part.need, instance.group, trial,
                                     instance.goal(cost), min(left, _CHUNK), rng)  # fmt: skip
        left -= max(used, 1)
        if not found:
            continue
        missing = np.flatnonzero(instance.by_choice.T @ trial.astype(np.int32) < instance.need)
        if len(missing):
            active[missing[:_NEW_TARGETS]] = True
            part, left = None, left - _NEW_TARGETS
        else:
            best = trial.copy()
    return best


@njit(cache=True)
def _new_state(start, index, need, group):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    rows, targets = len(start) - 1, len(need)
    return _State(
        np.zeros(rows, np.bool_),
        np.empty(rows, np.int32),
        np.empty(rows, np.int32),
        (start[1:] - start[:-1]).astype(np.int64),
        np.ones(rows, np.bool_),
        np.zeros(rows, np.int64),
        np.zeros(targets, np.int32),
        np.ones(targets, np.int64),
        np.arange(targets).astype(np.int32),
        np.arange(targets).astype(np.int32),
        np.full(group.max() + 1 if len(group) else 0, -1, np.int32),
        np.array([0, targets], np.int64),
    )


@njit(cache=True)
def _add(row, start, index, tstart, tindex, need, group, state):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    state.inside[row] = True
    state.member[state.sizes[0]] = row
    state.place[row] = state.sizes[0]
    state.sizes[0] += 1
    if group[row] >= 0:
        state.occupant[group[row]] = row
    state.score[row] = 0
    for p in range(start[row], start[row + 1]):
        t = index[p]
        state.count[t] += 1
        if state.count[t] <= need[t]:
            state.score[row] += state.weight[t]
        if state.count[t] == need[t]:
            state.sizes[1] -= 1
            last = state.open[state.sizes[1]]
            state.open[state.spot[t]] = last
            state.spot[last] = state.spot[t]
        if need[t] <= state.count[t] <= need[t] + 1:
            for q in range(tstart[t], tstart[t + 1]):
                other = tindex[q]
                if other == row or state.inside[other] == (state.count[t] == need[t]):
                    continue
                state.score[other] -= state.weight[t]
                state.ready[other] = True


@njit(cache=True)
def _remove(row, start, index, tstart, tindex, need, group, state):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    state.inside[row] = False
    state.sizes[0] -= 1
    last = state.member[state.sizes[0]]
    state.member[state.place[row]] = last
    state.place[last] = state.place[row]
    if group[row] >= 0:
        state.occupant[group[row]] = -1
    state.score[row] = 0
    for p in range(start[row], start[row + 1]):
        t = index[p]
        state.count[t] -= 1
        if state.count[t] < need[t]:
            state.score[row] += state.weight[t]
        if state.count[t] == need[t] - 1:
            state.open[state.sizes[1]] = t
            state.spot[t] = state.sizes[1]
            state.sizes[1] += 1
        if need[t] - 1 <= state.count[t] <= need[t]:
            for q in range(tstart[t], tstart[t + 1]):
                other = tindex[q]
                if other == row or state.inside[other] == (state.count[t] == need[t] - 1):
                    continue
                state.score[other] += state.weight[t]
                state.ready[other] = True
    state.ready[row] = False


@njit(cache=True)
def _better(a, b, cost, state, sign):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Row a before b: more (sign 1) or less (-1) weight per cost, then the longest at rest."""
    if b < 0:
        return True
    first, second = sign * state.score[a] * cost[b], sign * state.score[b] * cost[a]
    if first != second:
        return first > second
    return (state.stamp[a], a) < (state.stamp[b], b)


@njit(cache=True)
def _cheapest_loss(tabu, cost, state):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    best = -1
    for k in range(state.sizes[0]):
        row = state.member[k]
        if row != tabu and _better(row, best, cost, state, -1):
            best = row
    return best


@njit(cache=True)
def _greedy(start, index, tstart, tindex, cost, need, group, inside):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    state = _new_state(start, index, need, group)
    while state.sizes[1] > 0:
        best = -1
        for row in range(len(cost)):
            if state.inside[row] or state.score[row] == 0:
                continue
            if group[row] >= 0 and state.occupant[group[row]] >= 0:
                continue
            if _better(row, best, cost, state, 1):
                best = row
        if best < 0:
            return False
        _add(best, start, index, tstart, tindex, need, group, state)
    while state.sizes[0] > 0:
        row = _cheapest_loss(-1, cost, state)
        if state.score[row] > 0:
            break
        _remove(row, start, index, tstart, tindex, need, group, state)
    inside[:] = state.inside
    return True


@njit(cache=True)
def _search(start, index, tstart, tindex, cost, need, group, first, goal, steps, rng):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Members, whether they cover all at a cost of at most ``goal``, steps used."""
    state = _new_state(start, index, need, group)
    total = 0.0
    for row in range(len(cost)):
        if first[row]:
            _add(row, start, index, tstart, tindex, need, group, state)
            total += cost[row]
    tabu = -1
    for step in range(1, steps + 1):
        if state.sizes[1] == 0 and total <= goal:
            return state.inside.copy(), True, step
        row = _cheapest_loss(tabu, cost, state)
        while row >= 0:
            _remove(row, start, index, tstart, tindex, need, group, state)
            state.stamp[row] = step
            total -= cost[row]
            if total <= goal and state.sizes[1] > 0:
                break
            row = _cheapest_loss(tabu, cost, state)
        if state.sizes[1] == 0:
            continue
        t = state.open[rng.integers(0, state.sizes[1])]
        best = -1
        for q in range(tstart[t], tstart[t + 1]):
            row = tindex[q]
            if state.ready[row] and not state.inside[row] and _better(row, best, cost, state, 1):
                best = row
        if best >= 0 and total + cost[best] <= goal:
            mate = state.occupant[group[best]] if group[best] >= 0 else -1
            if mate >= 0:
                _remove(mate, start, index, tstart, tindex, need, group, state)
                state.stamp[mate] = step
                total -= cost[mate]
            _add(best, start, index, tstart, tindex, need, group, state)
            state.stamp[best] = step
            total += cost[best]
            tabu = best
        for k in range(state.sizes[1]):
            t = state.open[k]
            state.weight[t] += 1
            for q in range(tstart[t], tstart[t + 1]):
                # An open target counts for members too where it needs several rows.
                state.score[tindex[q]] += 1
    return state.inside.copy(), state.sizes[1] == 0 and total <= goal, steps
