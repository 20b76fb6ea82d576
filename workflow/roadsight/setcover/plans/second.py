"""Among the covers of one cost, the one that sees the most targets once more, then twice more.

The covers that share all but r choices with the best one are looked at exhaustively, for r = 1, 2,
3 and so on, and from 1 again after each find. With nothing shared, that is the proof. Where work
runs out before, a Lagrangian bound says how much more there could be at most (`seen_at_most`).

Weights are in any unit of the caller's (the workflow's are 1 for each target), costs in another.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import NamedTuple

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.setcover.common.problem import (
    OPTIMAL,
    WITHIN_GAP,
    Cover,
    Instance,
    is_within,
    relative_gap,
)
from roadsight.setcover.common.relaxation import Node, Relaxation
from roadsight.setcover.plans.deployment import Deployment
from roadsight.setcover.plans.second_kernels import LEVELS, Rules, complete_covers

# Work by entry that the search adds or removes, in seconds: the middle of 6 to 9.5 on the cases of
# `second_kernels`.
_ENTRY_S = 7.5e-9
_ATTEMPT_S = 3e-5  # work of calling the search for some shared choices, in seconds, measured there
_SET_S = 2e-7  # work of sorting a set of choices by what its pairs have in common, measured
_SETUP_S = 1.5e-8  # work of laying out the problem by entry, in seconds, measured there
_SORTED = 20_000  # so many sets of choices are sorted by what they have in common: those find more
_TOLERANCE = 1e-9  # share of a sum by which two are alike
_CHEAPER = 1e-7  # share of its cost that a cheaper cover must save: as far as costs are proven


@dataclass(frozen=True)
class Second:
    """The best of the covers of one cost.

    Parameters
    ----------
    chosen : (k,) its sorted choices.
    value, before : (`LEVELS`,) weight that is seen once more than asked for, and twice more; of
        this cover, and of the one it began with.
    total : weight of all targets that ask for something.
    stretches, stretches_before : how many have a target that is seen once more than asked for.
    bound : most weight that any cover of the cost sees once more than asked for.
    proven : whether none of the cost is better, in the order once more, twice more, stretches.
    """

    chosen: Ints
    value: Floats
    before: Floats
    total: float
    stretches: int
    stretches_before: int
    bound: float
    proven: bool


def second_objective(
    deployment: Deployment, chosen: Ints, limit: WorkLimit, stretch: Ints | None = None
) -> Second:
    """Of the covers that cost no more than one, the one that sees the most more than asked for.

    Groups, mandatory and forbidden choices, cliques and needs are kept to. Nothing is proven about
    the cost: ``chosen`` should be the cheapest. Where a cheaper cover comes up, it is taken, and
    the best of its cost is sought. The answer depends on nothing but the limit of work, which also
    pays for the bound.

    Parameters
    ----------
    deployment : complete, without ``keep``, costs above 0.
    chosen : (k,) sorted choices of a cover that is allowed (not checked).
    stretch : (targets,) number of the stretch of road of each target, -1 for none; None: no road.

    Source: own. The bound is Lagrangian (Fisher 1981); searching all that shares a part with the
    best is local branching (Fischetti and Lodi 2003) with enumeration instead of a program.
    """
    if not (deployment.problem.at_least > 0).any():
        nothing = np.zeros(LEVELS)
        return Second(chosen, nothing, nothing, 0.0, 0, 0, 0.0, proven=True)
    deployment, _, unit = deployment.normalised()
    search = _Search(deployment, chosen, limit, stretch)
    before = search.best.copy()
    bound = search.rules.base + search.most(deployment.problem.mandatory)
    proven = search.run()
    value = search.best[:LEVELS].copy()
    bound = float(value[0]) if proven else max(min(bound, deployment.total), float(value[0]))
    bound, weights = unit * bound, unit * np.asarray(deployment.weights)
    if (weights == np.round(weights)).all():
        bound = math.floor(bound + 1e-6)
    return Second(
        np.flatnonzero(search.cover).astype(np.int64),
        unit * value,
        unit * before[:LEVELS],
        unit * deployment.total,
        int(search.best[2]),
        int(before[2]),
        bound,
        proven,
    )


def chosen_again(
    deployment: Deployment,
    cover: Cover,
    limit: WorkLimit,
    stretch: Ints | None = None,
    gap: float = 0.0,
) -> tuple[Cover, Second]:
    """A cover with the choices of the best of its cost, and what is known of them.

    Its bound stays: it is of the cost. Where the best turns out cheaper than a cover that was not
    proven, objective, gap and status are those of what is chosen. ``seconds_cpu`` counts both.

    Parameters
    ----------
    deployment, limit, stretch : as `second_objective` takes them. cover : of the deployment, with
        choices. gap : share of the objective that was allowed for the proof.
    """
    start = time.process_time()
    found = second_objective(deployment, cover.chosen, limit, stretch)
    seconds = cover.seconds_cpu + time.process_time() - start
    before, after = (math.fsum(deployment.cost[rows]) for rows in (cover.chosen, found.chosen))
    again = replace(cover, chosen=found.chosen, seconds_cpu=seconds)
    if after > before * (1 - _CHEAPER):
        return again, found
    value = deployment.objective(found.chosen)
    proven = cover.bound > deployment.goal(value)
    bound = value if proven else min(cover.bound, value)
    near = WITHIN_GAP if is_within(gap, value, bound) else cover.status
    again = replace(again, objective=value, bound=bound, gap=relative_gap(value, bound))
    return replace(again, status=OPTIMAL if proven else near), found


class _Search:
    """Search in growing neighbourhoods of the best cover.

    Attributes
    ----------
    cover : (choices,) the best so far. rules : what covers are made of.
    best : (4,) its value, as `complete_covers` takes it.
    """

    def __init__(
        self, deployment: Deployment, chosen: Ints, limit: WorkLimit, stretch: Ints | None
    ) -> None:
        problem = deployment.problem
        self._limit = limit
        self._matrix, self._must = problem.matrix, problem.mandatory
        self.cover = np.zeros(len(problem.costs), bool)
        self.cover[chosen] = True
        self._cost = np.asarray(deployment.cost)
        self._least_cost = float(self._cost.min())
        self._money = self._spent(self.cover)
        self.rules = _rules(deployment, self._money, limit, stretch)
        self.best = np.array([-1.0, -1.0, -1.0, 0.0])
        self._complete(self.cover, 0.0)

    def most(self, inside: Bools) -> float:
        """Most that choices add to the bound within the money, with some inside for certain."""
        rules, left = self.rules, self._money - self._cost[inside].sum()
        added = np.interp(left, rules.cost_of_most, rules.most_gain)
        return float(rules.gain[inside].sum() + added)

    def run(self) -> bool:
        """Whether the best is proven; the limit may end it before."""
        apart = 1
        while True:
            free = np.flatnonzero(self.cover & ~self._must)
            if apart < len(free):
                answer: bool | None = False
                cover = self.cover
                for out in self._together(free, apart):
                    if (answer := self._try(out, cover)) is not False:
                        break
            else:
                money = self._money
                answer = self._try(np.empty(0, np.int64), self._must)
                if answer is not None and self._money == money:
                    return True
            if answer is None:
                return False
            apart = 1 if answer else apart + 1

    def _together(self, free: Ints, apart: int) -> Iterable[Ints]:
        """Sets (apart,) of so many choices; those first that see the most targets in common."""
        sets, count = combinations(free.tolist(), apart), math.comb(len(free), apart)
        if apart == 1 or count > _SORTED:
            return (np.array(out, np.int64) for out in sets)
        table = np.fromiter(chain.from_iterable(sets), np.int64, count * apart)
        table = table.reshape(count, apart)
        rows = self._matrix[free].astype(np.int64)
        common, at = (rows @ rows.T).toarray(), np.searchsorted(free, table)
        pairs = list(combinations(range(apart), 2))
        shared = sum(common[at[:, a], at[:, b]] for a, b in pairs)
        self._limit.spend(_SET_S * count * (1 + len(pairs)) + _SETUP_S * rows.nnz)
        return table[np.argsort(-shared, kind="stable")]

    def _try(self, out: Ints, cover: Bools) -> bool | None:
        """Whether a better cover was found that has all choices of one but some; None: out of work.

        Parameters
        ----------
        out : (r,) choices that it need not have. cover : (choices,) of the others.
        """
        if self._limit.passed():
            return None
        inside = cover.copy()
        inside[out] = False
        found, complete = self._complete(inside, self._money - math.fsum(self._cost[inside]))
        return found if complete else None

    def _complete(self, inside: Bools, money: float) -> tuple[bool, bool]:
        """Whether a better cover was found within some money, and whether all were looked at."""
        most = int(min(max(self._limit.left_s() / _ENTRY_S, 1.0), 2.0**62))
        slack = _CHEAPER * self._money
        cover, found, complete, work = complete_covers(
            inside, money, self._least_cost, slack, self.rules, self.best, most
        )
        self._limit.spend(work * _ENTRY_S + _ATTEMPT_S)
        if found:
            self.cover = cover
        if self.best[3] > slack:
            self._money, self.best[3] = self._spent(cover), 0.0
        return found, complete

    def _spent(self, cover: Bools) -> float:
        """Cost of a cover, with room for rounding."""
        return math.fsum(self._cost[cover]) * (1 + _TOLERANCE)


def _rules(deployment: Deployment, money: float, limit: WorkLimit, stretch: Ints | None) -> Rules:
    """What covers are made of, with the bounds that the limit allows, each by a share of it."""
    problem = deployment.problem
    matrix, need = problem.matrix, problem.at_least
    by_target = matrix.tocsc()
    by_target.sort_indices()
    sets = deployment.exclusive.T.tocsr()
    sets.sort_indices()
    weight = np.where(need > 0, deployment.weights, 0.0)
    limit.spend(_SETUP_S * matrix.nnz)
    price, refund = prices(deployment, limit)
    most = seen_at_most(deployment, weight, money, limit)
    road = np.full(len(need), -1, np.int64) if stretch is None else stretch.astype(np.int64)
    order = np.argsort(np.diff(by_target.indptr), kind="stable")
    return Rules(
        matrix.indptr,
        matrix.indices,
        by_target.indptr,
        by_target.indices,
        need,
        weight,
        np.asarray(deployment.cost),
        sets.indptr,
        sets.indices,
        price,
        refund,
        most.gain,
        most.base,
        most.gains,
        most.costs,
        road,
        int(road.max(initial=-1)) + 1,
        order[need[order] > 0],
        ~problem.forbidden,
    )


# Bounds of what a cover costs, and of how much it sees again: both hold wherever the limit of work
# stops them.

_SHARE = 4  # each of the two bounds has one of so many shares of the work that is left
_STEPS = 400  # most steps to the bound: on the sample it is within 0.1 % of what 1,500 steps give
_STEP_ENTRY_S = 1.2e-9  # work of a step by entry, in seconds, measured on the generated highway
_STEP_CHOICE_S = 1e-7  # the same by choice: they are sorted
_REPAIR_S = 2e-8  # work of mending prices by entry of the matrix, in seconds, measured there
_STALLED = 20  # after so many steps without a better bound, steps get shorter
_NEAR = 0.1  # the first step goes for a bound lower by this share: about what it is apart
_SHORTER = 0.7  # factor by which they do
_LEAST_SLOPE = 1e-9  # slope (squared) below which a step leads nowhere


class Most(NamedTuple):
    """A bound of the weight that a cover sees once more than asked for.

    A cover of choices X sees no more than ``base + sum gain_i, i in X``.

    Parameters
    ----------
    gain : (choices,) 0 or more, 0 where forbidden. base : the bound without any choice.
    gains, costs : (choices + 1,) of the choices in the order of gain by cost, summed up from 0.
    """

    gain: Floats
    base: float
    gains: Floats
    costs: Floats


def prices(deployment: Deployment, limit: WorkLimit) -> tuple[Floats, float]:
    """What covering each target once costs at least, and the most that this exceeds costs by.

    For any cover, the prices (targets,) of what it covers, as often as asked, and the excess (0 or
    less) add up to no more than its cost: weak duality. The prices are the duals of the linear
    relaxation. Where work ran out before it was solved, they are the best of three that hold as
    well: the duals of its last step, the same lowered until no choice is worth more than it costs,
    and the least share of cost that a choice asks of a target.
    """
    problem = deployment.problem
    asked = problem.at_least > 0
    cost = np.asarray(deployment.cost)
    by_choice = problem.matrix[:, np.flatnonzero(asked)].tocsr()
    by_choice.sort_indices()
    none = np.full(len(cost), -1, np.int64)
    need = problem.at_least[asked].astype(np.int32)
    instance = Instance(by_choice, cost, need, none, np.arange(len(cost)), False)
    node = Node(~problem.forbidden, problem.mandatory.copy())
    relaxed = Relaxation(instance).solve(node, np.inf, limit.part(_SHARE))
    dual = np.maximum(relaxed.target_dual, 0.0)
    points = [dual]
    free = ~problem.forbidden & ~problem.mandatory
    if not relaxed.complete:
        worth = by_choice @ dual
        dear = free & (worth > cost)
        part = np.where(dear, cost / np.where(dear, worth, 1.0), 1.0)
        share = cost / np.maximum(np.diff(by_choice.indptr), 1)
        least = _least(np.where(free, share, np.inf), instance)
        points += [dual * _least(part, instance), np.where(np.isfinite(least), least, 0.0)]
        limit.spend(_REPAIR_S * by_choice.nnz)
    refunds = [float(np.minimum((cost - by_choice @ one)[free], 0.0).sum()) for one in points]
    sums = [float(one @ need) + refund for one, refund in zip(points, refunds, strict=True)]
    best = int(np.argmax(sums))
    price = np.zeros(len(asked))
    price[asked] = points[best]
    return price, refunds[best]


def _least(value: Floats, instance: Instance) -> Floats:
    """Least value (targets,) of the choices that cover each target."""
    least = np.full(instance.shape[1], np.inf)
    size = np.diff(instance.by_choice.indptr)
    np.minimum.at(least, instance.by_choice.indices, np.repeat(value, size))
    return least


def seen_at_most(deployment: Deployment, weight: Floats, money: float, limit: WorkLimit) -> Most:
    """A Lagrangian bound of the weight that is seen once more than asked, by subgradient steps.

    With u >= 0 (targets,), no choices within the money see more than ``sum(max(w - u, 0)) -
    sum(need u)`` and the gains ``A u`` of the choices: the dearest of them that the money buys.

    Parameters
    ----------
    weight : (targets,) 0 where nothing is asked. money : what all choices may cost.
    """
    problem = deployment.problem
    cost, need = np.asarray(deployment.cost), problem.at_least
    by_choice, allowed = problem.matrix.astype(np.float64), ~problem.forbidden
    by_target = by_choice.T.tocsr()
    step_s = _STEP_ENTRY_S * by_choice.nnz + _STEP_CHOICE_S * len(cost)
    steps = min(_STEPS, limit.part(_SHARE).count_left(step_s))
    u, length, stalled = 0.5 * weight, 1.0, 0
    best, best_u = math.inf, u
    for _ in range(steps):
        limit.spend(step_s)
        gain = np.where(allowed, by_choice @ u, 0.0)
        # What the money buys, the best gain by cost first.
        order = np.argsort(-gain / cost, kind="stable")
        before = np.cumsum(cost[order]) - cost[order]
        share = np.zeros(len(cost))
        share[order] = np.clip((money - before) / cost[order], 0.0, 1.0)
        value = float(share @ gain)
        value += _base(u, need, weight)
        if value < best - 1e-6 * max(1.0, abs(best) if math.isfinite(best) else 1.0):
            best, best_u, stalled = value, u, 0
        else:
            stalled += 1
            if stalled >= _STALLED:
                length, stalled, u = _SHORTER * length, 0, best_u
                continue
        slope = by_target @ share - need - (u < weight)
        slope[((u <= 0) & (slope > 0)) | (need == 0)] = 0.0
        square = float((slope**2).sum())
        if square < _LEAST_SLOPE:
            break
        u = np.maximum(u - length * _NEAR * abs(value) / square * slope, 0.0)
    gain = np.where(allowed, by_choice @ best_u, 0.0)
    order = np.argsort(-gain / cost, kind="stable")
    gains, costs = (np.concatenate([[0.0], np.cumsum(part[order])]) for part in (gain, cost))
    return Most(gain, _base(best_u, need, weight), gains, costs)


def _base(u: Floats, need: Ints, weight: Floats) -> float:
    return float(np.maximum(weight - u, 0.0).sum() - (u * need).sum())
