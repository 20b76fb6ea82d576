"""Good covers quickly: greedy start, then local search with weights on hard targets."""

from __future__ import annotations

import math
from collections import namedtuple

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints, Ints32
from roadsight.base.kernels import compiled, compiled_part
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import Instance
from roadsight.setcover.common.reductions import arrays

FIRST_STEPS = 2_000  # steps of a search where the bound leaves one choice to spare at most
_SPARE_STEPS = 4_000  # steps more for each further choice that the bound leaves
MOST_SPARE = 50  # choices that the bound leaves beyond this make a search no longer
_CHUNK = 2_000  # steps between two looks at the limit
_NEW_TARGETS = 50  # most open targets that join at once, unless the share below is more
# Most open targets that join at once, as a share of all: the fewer join, the more trials a long
# road takes before all that matter are in.
_NEW_SHARE = 1 / 50
_STEP_S = 1e-6  # fixed work of a step, in seconds, measured
_ENTRY_S = 1.2e-9  # work by entry of the matrix that a step reads, in seconds, measured


def greedy_cover(instance: Instance) -> Bools | None:
    """Choices by weight gained per cost, without the superfluous ones; None if it got stuck."""
    inside = np.zeros(instance.shape[0], bool)
    done = fill(*arrays(instance), instance.cost, instance.need, instance.group, inside)
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
        self, instance: Instance, best: Bools | None, first: Bools, rng: np.random.Generator
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
        while steps > 0:
            steps = self.improve(steps, bound, deadline)

    def improve(
        self, steps: int, bound: float, deadline: Deadline, scope: Bools | None = None
    ) -> int:
        """Search for a cheaper cover; steps left once there is one, 0 where none is sought.

        ``scope`` (m,): choices that may be taken, the best cover's among them; None: all.
        """
        before = self.cost
        choices = np.ones(self.instance.shape[0], bool) if scope is None else scope
        self._trial = self._trial & choices
        while steps > 0 and self.instance.round_up(bound) < before:
            part = self.instance.select(choices, self.active)
            grown = False
            while steps > 0 and not grown:
                if deadline.passed():
                    return 0
                used, grown = self._chunk(part, choices, min(steps, _CHUNK), deadline)
                steps -= used
                if self.cost < before:
                    return steps
        return 0

    def _chunk(
        self, part: Instance, choices: Bools, steps: int, deadline: Deadline
    ) -> tuple[int, bool]:
        """Steps used (a target that joins counts as one), and whether targets joined."""
        weight = self._weight[self.active]
        goal = self.instance.goal(self.cost)
        members, found, used, entries = exchange(
            *arrays(part),
            part.cost,
            part.need,
            part.group,
            self._trial[choices],
            goal,
            steps,
            weight,
            self._rng,
        )
        self._trial = np.zeros(len(choices), bool)
        self._trial[choices] = members
        self._weight[self.active] = weight
        deadline.spend(used * _STEP_S + entries * _ENTRY_S)
        if not found:
            return used, False
        before = self.active.sum()
        complete = self.accept(self._trial)
        return used + int(self.active.sum() - before), not complete

    def accept(self, trial: Bools) -> bool:
        """Whether a cheap trial covers everything: then it is the best, else targets join."""
        taken = self.instance.by_choice[np.flatnonzero(trial)]
        seen = np.bincount(taken.indices, minlength=taken.shape[1])
        missing = np.flatnonzero(seen < self.instance.need)
        most = max(_NEW_TARGETS, round(_NEW_SHARE * len(seen)))
        if len(missing) > most:  # some, from all over the road
            missing = missing[np.linspace(0, len(missing) - 1, most).astype(np.int64)]
        self._trial = trial.copy()
        # Costs that the search has added up along its way are rounded: they are added anew.
        if not len(missing) and float(self.instance.cost[trial].sum()) < self.cost:
            self.best = trial.copy()
        self.active[missing] = True
        return not len(missing)


def search_while_it_pays(
    local: LocalSearch,
    bound: float,
    deadline: Deadline,
    apart: float = 0.0,
    most_spare: int = MOST_SPARE,
) -> None:
    """Search the longer, the more choices the bound leaves, and again after each find.

    Parameters
    ----------
    apart : it pays while a cheaper cover may cost more than so many mean costs above the bound.
    most_spare : so many of the choices that the bound leaves make it longer at most.
    """
    instance = local.instance
    enough = instance.round_up(bound)
    while instance.goal(local.cost) - bound > apart * instance.cost.mean():
        spare = 1.0
        if local.best is not None:
            spare = local.best.sum() * (local.cost - enough) / local.cost
        before = local.cost
        more = int(np.clip(spare, 1, most_spare)) - 1
        local.improve(FIRST_STEPS + _SPARE_STEPS * more, enough, deadline)
        if not local.cost < before:
            return


# Moves of choices into and out of a cover, compiled: greedy, and with weights on hard targets.

# Search state: ``score`` is the weight gained by adding a choice, or lost by removing it; ``sizes``
# holds the numbers of members, of open targets, and of entries read so far.
_State = namedtuple(
    "_State", "inside member place score ready stamp count weight open spot occupant sizes"
)


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


# Local search that shares the time with the proof.
#
# A proof that takes long leaves time in which a better cover may be found, and a better cover
# makes the proof shorter. The search is `exchange`, row weighting local search (Gao, Weise and Li
# 2015), mostly among the choices that are cheap by the relaxation's reduced costs: the core
# problem of Caprara, Fischetti and Toth (1999).

# Choices by target that are cheap. On a railway's crews (63,009 choices) the search got to 174 in 3
# to 9 CPU s of 15 with 10 in two of three runs, to 175 with 5, 20 and 40, to 177 with all.
CHEAP_CHOICES = 10
# Bursts among cheap choices before one among all: where no cover below the best consists of cheap
# choices, only the latter finds one.
_CHEAP_BURSTS = 3
_BURST_S = 0.25  # work of a burst: looking for targets and choices anew takes a hundredth of it
_BURST_STEPS = 20_000  # steps between two looks at the work
_HEAD_S = 2.0  # work of the proof before it shares: ten corridors are proven about then
# So many mean costs between cover and bound, the search goes ahead of the proof: cuts close less in
# seconds, and each cut is chosen for the cover known.
_AHEAD_SPARE = 3.0
_AHEAD_SHARE = 0.25  # share of the time left that it may take ahead of the proof
_AHEAD_S = 0.3  # work ahead of the proof without a find that ends it, more after late finds
_BESIDE_S = 10.0  # the same beside the proof
_PATIENCE = 4.0  # it goes on for so many times the work that its last find took, too


class LongSearch:
    """Local search beside a proof, as long as it pays.

    Parameters
    ----------
    local : the search; it keeps the best cover.
    reduced_cost : (m,) of the relaxation, in steps, as far as it was solved.
    deadline : that of the proof.
    """

    def __init__(self, local: LocalSearch, reduced_cost: Floats, deadline: Deadline) -> None:
        self._local = local
        self._cheap = cheap_choices(local.instance, reduced_cost)
        self._begun_s = deadline.spent_s()
        self._used_s = self._found_s = 0.0
        self._bursts = 0

    def ahead(self, bound: float, deadline: Deadline) -> None:
        """Search before a proof whose bound is far from the cover."""
        instance, local = self._local.instance, self._local
        most_s = self._used_s + _AHEAD_SHARE * deadline.left_s()
        spare = _AHEAD_SPARE * instance.cost.mean()
        while local.cost - instance.round_up(bound) >= spare:
            due_s = min(most_s, _AHEAD_S + _PATIENCE * self._found_s)
            if deadline.passed() or self._used_s >= due_s:
                break
            self._burst(due_s, bound, deadline)

    def to_the_end(self, bound: float, deadline: Deadline) -> None:
        """Search until the limit, where no proof will come; without one, as long as it pays."""
        instance, local = self._local.instance, self._local
        endless = math.isinf(deadline.left_s())
        while bound <= instance.goal(local.cost) and not deadline.passed():
            if endless and self._used_s >= _BESIDE_S + _PATIENCE * self._found_s:
                break
            self._burst(self._used_s + _BURST_S, bound, deadline)

    def catch_up(self, bound: float, deadline: Deadline) -> None:
        """Search until it has worked as long as the proof, or does not pay any more."""
        instance, local = self._local.instance, self._local
        proof_s = deadline.spent_s() - self._begun_s - self._used_s
        while bound <= instance.goal(local.cost) and not deadline.passed():
            due_s = min(proof_s - _HEAD_S, _BESIDE_S + _PATIENCE * self._found_s)
            if due_s - self._used_s < _BURST_S:
                break
            self._burst(due_s, bound, deadline)

    def _burst(self, due_s: float, bound: float, deadline: Deadline) -> None:
        """Search for a while among one set of choices."""
        self._bursts += 1
        local, scope = self._local, None
        if self._bursts % (_CHEAP_BURSTS + 1):
            scope = self._cheap if local.best is None else self._cheap | local.best
        before, cost = deadline.spent_s(), local.cost
        end_s = before + min(_BURST_S, due_s - self._used_s)
        while deadline.spent_s() < end_s and local.cost == cost and not deadline.passed():
            local.improve(_BURST_STEPS, bound, deadline, scope)
        self._used_s += deadline.spent_s() - before
        if local.cost < cost:
            self._found_s = self._used_s


def cheap_choices(instance: Instance, reduced_cost: Floats) -> Bools:
    """Choices (m,) that are among the `CHEAP_CHOICES` of least reduced cost of any target.

    Of equal ones all are: where costs and targets are alike, that is every choice.
    """
    by_target = instance.by_target
    cheap = np.zeros(instance.shape[0], bool)
    for first, last in zip(by_target.indptr[:-1], by_target.indptr[1:], strict=True):
        choices = by_target.indices[first:last]
        value = reduced_cost[choices]
        if len(value) > CHEAP_CHOICES:
            limit = np.partition(value, CHEAP_CHOICES - 1)[CHEAP_CHOICES - 1]
            choices = choices[value <= limit + 1e-9]
        cheap[choices] = True
    return cheap
