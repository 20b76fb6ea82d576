"""Among the covers of one cost, the one that sees the most targets once more, then twice more.

The covers that share all but r choices with the best one are looked at exhaustively, for r = 1, 2,
3 and so on, and from 1 again after each find. With nothing shared, that is the proof. Where work
runs out before, a Lagrangian bound says how much more there could be at most (`second_bounds`).

Weights are in any unit of the caller's (the workflow's are 1 for each target), costs in another.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain, combinations

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.setcover.common.result import OPTIMAL, WITHIN_GAP, Cover, is_within, relative_gap
from roadsight.setcover.plans.deployment import Deployment
from roadsight.setcover.plans.second_bounds import prices, seen_at_most
from roadsight.setcover.plans.second_kernels import LEVELS, Rules, complete_covers

_ENTRY_S = 7.5e-9
"""Work by entry that the search adds or removes, in seconds: the middle of 6 to 9.5 on the cases of
`second_kernels`."""
_ATTEMPT_S = 3e-5
"""Work of calling the search for some shared choices, in seconds, measured there."""
_SET_S = 2e-7
"""Work of putting a set of choices in its place by what each pair of it has in common, measured."""
_SETUP_S = 1.5e-8
"""Work of laying out the problem by entry of its matrix, in seconds, measured there."""
_SORTED = 20_000
"""Up to so many sets of choices are sorted by what they have in common: those find more."""
_TOLERANCE = 1e-9
"""Share of a sum by which two are alike."""
_CHEAPER = 1e-7
"""Share of its cost that a cover must save to be cheaper: as far as costs are proven."""


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
    return Second(
        np.flatnonzero(search.cover).astype(np.int64),
        unit * value,
        unit * before[:LEVELS],
        unit * deployment.total,
        int(search.best[2]),
        int(before[2]),
        _floored(unit * bound, unit * np.asarray(deployment.weights)),
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
                answer = self._neighbourhood(free, apart)
            else:
                money = self._money
                answer = self._try(np.empty(0, np.int64), self._must)
                if answer is not None and self._money == money:
                    return True
            if answer is None:
                return False
            apart = 1 if answer else apart + 1

    def _neighbourhood(self, free: Ints, apart: int) -> bool | None:
        """Whether a better cover was found that shares all but so many; None: out of work."""
        cover = self.cover
        for out in self._together(free, apart):
            answer = self._try(out, cover)
            if answer is not False:
                return answer
        return False

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


def _floored(bound: float, weights: Floats) -> float:
    """The bound in whole steps where all weights are whole."""
    return math.floor(bound + 1e-6) if (weights == np.round(weights)).all() else bound
