"""Moves of choices into and out of a cover, compiled: greedy, and with weights on hard targets."""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints, Ints32
from roadsight.base.kernels import compiled, compiled_part

_State = namedtuple(
    "_State", "inside member place score ready stamp count weight open spot occupant sizes"
)
"""Search state: ``score`` is the weight gained by adding a choice, or lost by removing it;
``sizes`` holds the numbers of members, of open targets, and of entries read so far."""


@compiled_part()
def _new_state(start, group, weight):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    choices, targets, groups = len(start) - 1, len(weight), 0
    ready, score = np.empty(choices, np.bool_), np.empty(choices, np.int64)
    for choice in range(choices):
        ready[choice], score[choice] = True, start[choice + 1] - start[choice]
        groups = max(groups, group[choice] + 1)
    order, occupant = np.empty(targets, np.int32), np.empty(groups, np.int32)
    for t in range(targets):
        order[t] = t
    for g in range(groups):
        occupant[g] = -1
    sizes = np.zeros(3, np.int64)
    sizes[1] = targets
    return _State(
        np.zeros(choices, np.bool_),
        np.empty(choices, np.int32),
        np.empty(choices, np.int32),
        score,
        ready,
        np.zeros(choices, np.int64),
        np.zeros(targets, np.int32),
        weight,
        order,
        order.copy(),
        occupant,
        sizes,
    )


@compiled_part()
def _copy(source, target):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """One by one: an array set at once compiles for a second and a half, most of it a message."""
    for i in range(len(source)):
        target[i] = source[i]


@compiled_part()
def _add(choice, start, index, tstart, tindex, need, group, state):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    state.inside[choice] = True
    state.member[state.sizes[0]] = choice
    state.place[choice] = state.sizes[0]
    state.sizes[0] += 1
    if group[choice] >= 0:
        state.occupant[group[choice]] = choice
    state.score[choice] = 0
    state.sizes[2] += start[choice + 1] - start[choice]
    for p in range(start[choice], start[choice + 1]):
        t = index[p]
        state.count[t] += 1
        if state.count[t] <= need[t]:
            state.score[choice] += state.weight[t]
        if state.count[t] == need[t]:
            state.sizes[1] -= 1
            last = state.open[state.sizes[1]]
            state.open[state.spot[t]] = last
            state.spot[last] = state.spot[t]
        if need[t] <= state.count[t] <= need[t] + 1:
            state.sizes[2] += tstart[t + 1] - tstart[t]
            for q in range(tstart[t], tstart[t + 1]):
                other = tindex[q]
                if other == choice or state.inside[other] == (state.count[t] == need[t]):
                    continue
                state.score[other] -= state.weight[t]
                state.ready[other] = True


@compiled_part()
def _remove(choice, start, index, tstart, tindex, need, group, state):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    state.inside[choice] = False
    state.sizes[0] -= 1
    last = state.member[state.sizes[0]]
    state.member[state.place[choice]] = last
    state.place[last] = state.place[choice]
    if group[choice] >= 0:
        state.occupant[group[choice]] = -1
    state.score[choice] = 0
    state.sizes[2] += start[choice + 1] - start[choice]
    for p in range(start[choice], start[choice + 1]):
        t = index[p]
        state.count[t] -= 1
        if state.count[t] < need[t]:
            state.score[choice] += state.weight[t]
        if state.count[t] == need[t] - 1:
            state.open[state.sizes[1]] = t
            state.spot[t] = state.sizes[1]
            state.sizes[1] += 1
        if need[t] - 1 <= state.count[t] <= need[t]:
            state.sizes[2] += tstart[t + 1] - tstart[t]
            for q in range(tstart[t], tstart[t + 1]):
                other = tindex[q]
                if other == choice or state.inside[other] == (state.count[t] == need[t] - 1):
                    continue
                state.score[other] += state.weight[t]
                state.ready[other] = True
    state.ready[choice] = False


@compiled_part()
def _better(a, b, cost, state, sign):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Choice a before b: more (sign 1) or less (-1) weight per cost, then the longest at rest."""
    if b < 0:
        return True
    first, second = sign * state.score[a] * cost[b], sign * state.score[b] * cost[a]
    if first != second:
        return first > second
    return (state.stamp[a], a) < (state.stamp[b], b)


@compiled_part()
def _cheapest_loss(tabu, cost, state):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    best = -1
    state.sizes[2] += state.sizes[0]
    for k in range(state.sizes[0]):
        choice = state.member[k]
        if choice != tabu and _better(choice, best, cost, state, -1):
            best = choice
    return best


@compiled()
def fill(
    start: Ints32,
    index: Ints32,
    tstart: Ints32,
    tindex: Ints32,
    cost: Floats,
    need: Ints32,
    group: Ints,
    inside: Bools,
) -> bool:
    """Take choices by weight gained per cost, then drop superfluous ones; False if it got stuck.

    ``start, index`` is the matrix by choice, ``t...`` by target; ``inside`` (m,) takes the result.
    """
    weight = np.empty(len(need), np.int64)
    for t in range(len(need)):
        weight[t] = 1
    state = _new_state(start, group, weight)
    while state.sizes[1] > 0:
        best = -1
        for choice in range(len(cost)):
            if state.inside[choice] or state.score[choice] == 0:
                continue
            if group[choice] >= 0 and state.occupant[group[choice]] >= 0:
                continue
            if _better(choice, best, cost, state, 1):
                best = choice
        if best < 0:
            return False
        _add(best, start, index, tstart, tindex, need, group, state)
    while state.sizes[0] > 0:
        choice = _cheapest_loss(-1, cost, state)
        if state.score[choice] > 0:
            break
        _remove(choice, start, index, tstart, tindex, need, group, state)
    _copy(state.inside, inside)
    return True


@compiled()
def exchange(
    start: Ints32,
    index: Ints32,
    tstart: Ints32,
    tindex: Ints32,
    cost: Floats,
    need: Ints32,
    group: Ints,
    first: Bools,
    goal: float,
    steps: int,
    weight: Ints,
    rng: np.random.Generator,
) -> tuple[Bools, bool, int, int]:
    """Members, whether they cover all at a cost of at most ``goal``, steps used, entries read.

    A step takes out the choices that lose least until the rest is cheap enough, and covers open
    targets, drawn at random, as long as the goal allows; what stays open weighs one more.

    Parameters
    ----------
    start, index : the matrix by choice. tstart, tindex : by target. first : (m,) to begin with.
    weight : (n,) of the targets, changed. steps : at most so many.
    """
    state = _new_state(start, group, weight.copy())
    for choice in range(len(cost)):
        state.score[choice] = 0
        for p in range(start[choice], start[choice + 1]):
            state.score[choice] += weight[index[p]]
    total = 0.0
    for choice in range(len(cost)):
        if first[choice]:
            _add(choice, start, index, tstart, tindex, need, group, state)
            total += cost[choice]
    tabu = -1
    for step in range(1, steps + 1):
        if state.sizes[1] == 0 and total <= goal:
            return state.inside.copy(), True, step, state.sizes[2]
        choice = _cheapest_loss(tabu, cost, state)
        while choice >= 0:
            _remove(choice, start, index, tstart, tindex, need, group, state)
            state.stamp[choice] = step
            total -= cost[choice]
            if total <= goal and state.sizes[1] > 0:
                break
            choice = _cheapest_loss(tabu, cost, state)
        while state.sizes[1] > 0:
            t = state.open[rng.integers(0, state.sizes[1])]
            best = _best_ready(t, tstart, tindex, cost, total, goal, state)
            if best < 0:
                break
            mate = state.occupant[group[best]] if group[best] >= 0 else -1
            if mate >= 0:
                _remove(mate, start, index, tstart, tindex, need, group, state)
                state.stamp[mate] = step
                total -= cost[mate]
            _add(best, start, index, tstart, tindex, need, group, state)
            state.stamp[best] = step
            total += cost[best]
            tabu = best
            if mate >= 0:
                break  # two choices of one group could replace each other for ever
        _weigh_open(tstart, tindex, state)
    _copy(state.weight, weight)
    done = state.sizes[1] == 0 and total <= goal
    return state.inside.copy(), done, steps, state.sizes[2]


@compiled_part()
def _best_ready(t, tstart, tindex, cost, total, goal, state):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Affordable choice over target t that gains most; -1: none."""
    best = -1
    state.sizes[2] += tstart[t + 1] - tstart[t]
    for q in range(tstart[t], tstart[t + 1]):
        choice = tindex[q]
        if not state.ready[choice] or state.inside[choice] or total + cost[choice] > goal:
            continue
        if _better(choice, best, cost, state, 1):
            best = choice
    return best


@compiled_part()
def _weigh_open(tstart, tindex, state):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Open targets weigh one more, for members too: a target may need several."""
    for k in range(state.sizes[1]):
        t = state.open[k]
        state.weight[t] += 1
        state.sizes[2] += tstart[t + 1] - tstart[t]
        for q in range(tstart[t], tstart[t + 1]):
            state.score[tindex[q]] += 1
