"""Good covers quickly: greedy start, then local search with weights on hard targets."""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from roadsight.placement.cover.deadline import Deadline
from roadsight.placement.cover.problem import Instance
from roadsight.placement.cover.reductions import arrays

_CHUNK = 2_000
_NEW_TARGETS, _NEW_SHARE = 50, 1 / 50
_STEP_S, _ENTRY_S = 5e-6, 6e-10  # work of a step, measured: fixed, and by entry of the matrix

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


class LocalSearch:
    """Search for cheaper covers that can go on where it stopped.

    It looks at some targets only; others join once a trial leaves them open.

    Parameters
    ----------
    best : (m,) a cover, or None.
    first : (n,) targets to look at first.

    Attributes
    ----------
    active : (n,) targets that it looks at.
    """

    def __init__(
        self,
        instance: Instance,
        best: NDArray[np.bool_] | None,
        first: NDArray[np.bool_],
        rng: np.random.Generator,
    ) -> None:
        self.instance, self.best, self._rng = instance, best, rng
        self.active = first.copy()
        self._trial = np.zeros(instance.shape[0], bool) if best is None else best
        self._weight = np.ones(instance.shape[1], np.int64)

    @property
    def cost(self) -> float:
        """Cost of the best cover so far, in steps."""
        return np.inf if self.best is None else float(self.instance.cost[self.best].sum())

    def run(self, steps: int, bound: float, deadline: Deadline) -> None:
        """Search for a number of steps, or until the cost is down to a proven ``bound``."""
        everything = np.ones(self.instance.shape[0], bool)
        while steps > 0 and self.instance.round_up(bound) < self.cost:
            part = self.instance.select(everything, self.active)
            grown = False
            while steps > 0 and not grown and self.instance.round_up(bound) < self.cost:
                if deadline.passed():
                    return
                used, grown = self._chunk(part, min(steps, _CHUNK), deadline)
                steps -= used

    def _chunk(self, part: Instance, steps: int, deadline: Deadline) -> tuple[int, bool]:
        """Steps used, and whether more targets became active."""
        weight = self._weight[self.active]
        goal = self.instance.goal(self.cost)
        self._trial, found, used = _search(*arrays(part), part.cost, part.need, part.group,
                                           self._trial, goal, steps, weight, self._rng)  # fmt: skip
        self._weight[self.active] = weight
        deadline.spend(used * (_STEP_S + _ENTRY_S * part.by_choice.nnz))
        if not found:
            return used, False
        before = self.active.sum()
        complete = self.accept(self._trial)
        return used + int(self.active.sum() - before), not complete

    def accept(self, trial: NDArray[np.bool_]) -> bool:
        """Whether a cheap trial covers everything: then it is the best, else targets join."""
        missing = self._missing(trial)
        self._trial = trial.copy()
        if not len(missing):
            self.best = trial.copy()
        self.active[missing] = True
        return not len(missing)

    def _missing(self, trial: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Some of the targets that a trial leaves open, from all over the road."""
        taken = self.instance.by_choice[np.flatnonzero(trial)]
        seen = np.bincount(taken.indices, minlength=taken.shape[1])
        missing = np.flatnonzero(seen < self.instance.need)
        most = max(_NEW_TARGETS, round(_NEW_SHARE * len(seen)))
        if len(missing) <= most:
            return missing
        return missing[np.linspace(0, len(missing) - 1, most).astype(np.int64)]


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
def _search(start, index, tstart, tindex, cost, need, group, first, goal, steps, weight, rng):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Members, whether they cover all at a cost of at most ``goal``, steps used."""
    state = _new_state(start, index, need, group)
    state.weight[:] = weight
    for row in range(len(cost)):
        state.score[row] = 0
        for p in range(start[row], start[row + 1]):
            state.score[row] += weight[index[p]]
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
                break  # two rows of one group could replace each other for ever
        _weigh_open(tstart, tindex, state)
    weight[:] = state.weight
    return state.inside.copy(), state.sizes[1] == 0 and total <= goal, steps


@njit(cache=True)
def _best_ready(t, tstart, tindex, cost, total, goal, state):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Affordable row over target t that gains most; -1: none."""
    best = -1
    for q in range(tstart[t], tstart[t + 1]):
        row = tindex[q]
        if not state.ready[row] or state.inside[row] or total + cost[row] > goal:
            continue
        if _better(row, best, cost, state, 1):
            best = row
    return best


@njit(cache=True)
def _weigh_open(tstart, tindex, state):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Open targets weigh one more, for members too: a target may need several rows."""
    for k in range(state.sizes[1]):
        t = state.open[k]
        state.weight[t] += 1
        for q in range(tstart[t], tstart[t + 1]):
            state.score[tindex[q]] += 1
