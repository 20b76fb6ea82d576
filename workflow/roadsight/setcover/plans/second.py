"""Among the covers of one cost, the one that sees the most targets once more, then twice more.

The covers that share all but r choices with the best one are looked at exhaustively, for r = 1, 2,
3 and so on, and from 1 again after each find. With nothing shared, that is the proof. Where work
runs out before, a Lagrangian bound says how much more there could be at most (Fisher 1981).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import Instance
from roadsight.setcover.common.relaxation import Node, Relaxation
from roadsight.setcover.plans.deployment import Deployment
from roadsight.setcover.plans.second_kernels import LEVELS, Rules, complete_covers

_ENTRY_S = 8e-9
"""Work by entry of the matrix that the search reads, in seconds, measured."""
_BOUND_STEPS = 400
"""Most steps to the bound: on the sample it is within 0.1 % of what 1,500 steps give."""
_BOUND_SHARE = 4
"""The bound has one of so many shares of the work."""
_BOUND_ENTRY_S = 3e-9
"""Work of a step of the bound by entry of the matrix, in seconds, measured."""
_STALLED = 20
"""After so many steps without a better bound, steps get shorter."""
_NEAR = 0.1
"""The first step goes for a bound lower by this share: about how far bound and covers are apart."""
_SHORTER = 0.7
"""Factor by which they do."""
_SORTED = 20_000
"""Up to so many sets of choices are sorted by what they have in common: those find more."""
_TOLERANCE = 1e-9
"""Share of a sum by which two are alike."""


@dataclass(frozen=True)
class Second:
    """The best of the covers of one cost.

    Parameters
    ----------
    chosen : its sorted choices.
    value, before : (levels,) weight that is seen once more than asked for, and twice more; of
        this cover, and of the one it began with.
    total : weight of all targets that ask for something.
    stretches, stretches_before : with a target that is seen once more than asked for.
    bound : most weight that any cover of the cost sees once more than asked for.
    proven : whether none is better, in the order once more, twice more, stretches.
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
    deployment: Deployment, chosen: Ints, limit: Deadline, stretch: Ints | None = None
) -> Second:
    """Of the covers that cost no more than one, the one that sees the most more than asked for.

    Groups, mandatory and forbidden choices, cliques and needs are kept to. Nothing is proven about
    the cost: ``chosen`` should be the cheapest. The answer depends on nothing but the limit of
    work.

    Parameters
    ----------
    deployment : complete, without ``keep``, costs above 0. chosen : sorted, allowed choices.
    stretch : (targets,) number of the stretch of road of each target, -1 for none; None: no road.
    """
    if not (deployment.problem.at_least > 0).any():
        nothing = np.zeros(LEVELS)
        return Second(chosen, nothing, nothing, 0.0, 0, 0, 0.0, proven=True)
    search = _Search(deployment, chosen, limit, stretch)
    before = search.best.copy()
    bound = search.rules.base + search.most(deployment.problem.mandatory)
    proven = search.run()
    value = search.best[:LEVELS].copy()
    bound = float(value[0]) if proven else max(min(bound, deployment.total), float(value[0]))
    return Second(
        np.flatnonzero(search.cover).astype(np.int64),
        value,
        before[:LEVELS],
        deployment.total,
        int(search.best[2]),
        int(before[2]),
        _floored(bound, np.asarray(deployment.weights)),
        proven,
    )


class _Search:
    """Search in growing neighbourhoods of the best cover."""

    def __init__(
        self, deployment: Deployment, chosen: Ints, limit: Deadline, stretch: Ints | None
    ) -> None:
        problem = deployment.problem
        self._limit = limit
        self._matrix, self._must = problem.matrix, problem.mandatory
        self.cover = np.zeros(len(problem.costs), bool)
        self.cover[chosen] = True
        self._cost = np.asarray(deployment.cost)
        self._money = math.fsum(self._cost[chosen]) * (1 + _TOLERANCE)
        self.rules = _rules(deployment, self._money, self.cover, limit, stretch)
        self.best = self._value()

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
            if apart >= len(free):
                return self._try(np.flatnonzero(self._must)) is not None
            answer = self._neighbourhood(free, apart)
            if answer is None:
                return False
            apart = 1 if answer else apart + 1

    def _neighbourhood(self, free: Ints, apart: int) -> bool | None:
        """Whether a better cover was found that shares all but so many; None: out of work."""
        inside = np.flatnonzero(self.cover)
        for out in self._together(free, apart):
            answer = self._try(np.setdiff1d(inside, out))
            if answer is not False:
                return answer
        return False

    def _together(self, free: Ints, apart: int) -> Iterator[tuple[int, ...]]:
        """So many choices at a time; those first that see the most targets in common."""
        sets = combinations(free.tolist(), apart)
        if apart == 1 or math.comb(len(free), apart) > _SORTED:
            return sets
        rows = self._matrix[free].astype(np.int64)
        common = (rows @ rows.T).toarray()
        number = {int(choice): k for k, choice in enumerate(free)}

        def shared(out: tuple[int, ...]) -> int:
            return -sum(int(common[number[a], number[b]]) for a, b in combinations(out, 2))

        return iter(sorted(sets, key=shared))

    def _try(self, shared: Ints) -> bool | None:
        """Whether a better cover was found that contains some choices; None: out of work."""
        inside = np.zeros(len(self.cover), bool)
        inside[shared] = True
        left = self._money - math.fsum(self._cost[shared])
        if self._limit.passed():
            return None
        clock = min(self._limit.clock_left_s() / _ENTRY_S, 2.0**62)
        most = min(self._limit.count_left(_ENTRY_S), int(clock))
        cover, found, complete, work = complete_covers(
            inside, left, float(self._cost.min()), self.rules, self.best, most
        )
        self._limit.spend(work * _ENTRY_S)
        if found:
            self.cover = cover
        return found if complete else None

    def _value(self) -> Floats:
        best = np.full(3, -1.0)
        complete_covers(self.cover, 0.0, 1.0, self.rules, best, 2**62)
        return best


def _rules(
    deployment: Deployment, money: float, cover: Bools, limit: Deadline, stretch: Ints | None
) -> Rules:
    problem = deployment.problem
    matrix, need = problem.matrix, problem.at_least
    by_target = matrix.tocsc()
    by_target.sort_indices()
    sets = deployment.exclusive.T.tocsr()
    sets.sort_indices()
    weight = np.where(need > 0, deployment.weights, 0.0)
    allowed = ~problem.forbidden
    price, refund = _prices(deployment, limit.part(_BOUND_SHARE))
    share, base, gain = _multipliers(
        matrix, np.asarray(deployment.cost), need, weight, allowed, money, limit
    )
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
        gain,
        base,
        *share,
        road,
        int(road.max(initial=-1)) + 1,
        order[need[order] > 0],
        allowed,
    )


def _prices(deployment: Deployment, limit: Deadline) -> tuple[Floats, float]:
    """What covering each target once costs at least, and the most that this exceeds costs by.

    For any cover, the prices of what it covers, as often as asked, and the (negative) excess add
    up to no more than its cost: weak duality.
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
    solution = Relaxation(instance).solve(node, np.inf, limit)
    price = np.zeros(len(asked))
    if not solution.complete:
        return price, 0.0
    price[asked] = np.maximum(solution.target_dual, 0.0)
    reduced = cost - problem.matrix @ price
    free = ~problem.forbidden & ~problem.mandatory
    return price, float(np.minimum(reduced[free], 0.0).sum())


def _multipliers(
    matrix: sparse.csr_matrix,
    cost: Floats,
    need: Ints,
    weight: Floats,
    allowed: Bools,
    money: float,
    limit: Deadline,
) -> tuple[tuple[Floats, Floats], float, Floats]:
    """A Lagrangian bound of the weight that is seen once more than asked, by subgradient steps.

    With u >= 0 (targets,), no choices within the money see more than ``sum(max(w - u, 0)) -
    sum(need u)`` and the gains ``A u`` of the choices: the dearest of them that the money buys.

    Returns
    -------
    gains and costs in the order of gain by cost, summed up; the bound without choices; gains
    """
    by_target = matrix.T.tocsr()
    steps = min(_BOUND_STEPS, limit.part(_BOUND_SHARE).count_left(_BOUND_ENTRY_S * matrix.nnz))
    u, length, stalled = 0.5 * weight, 1.0, 0
    best, best_u = math.inf, u
    for _ in range(steps):
        gain = np.where(allowed, matrix @ u, 0.0)
        share, value = _bought(gain, cost, money)
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
        if square < _TOLERANCE:
            break
        u = np.maximum(u - length * _NEAR * abs(value) / square * slope, 0.0)
    limit.spend(steps * _BOUND_ENTRY_S * matrix.nnz)
    gain = np.where(allowed, matrix @ best_u, 0.0)
    order = np.argsort(-gain / cost, kind="stable")
    sums = tuple(np.concatenate([[0.0], np.cumsum(part[order])]) for part in (gain, cost))
    return (sums[0], sums[1]), _base(best_u, need, weight), gain


def _base(u: Floats, need: Ints, weight: Floats) -> float:
    return float(np.maximum(weight - u, 0.0).sum() - (u * need).sum())


def _bought(gain: Floats, cost: Floats, money: float) -> tuple[Floats, float]:
    """Share of each choice that is bought, the best gain by cost first, and what they gain."""
    order = np.argsort(-gain / cost, kind="stable")
    before = np.cumsum(cost[order]) - cost[order]
    share = np.zeros(len(cost))
    share[order] = np.clip((money - before) / cost[order], 0.0, 1.0)
    return share, float(share @ gain)


def _floored(bound: float, weights: Floats) -> float:
    """The bound in whole steps where all weights are whole."""
    return math.floor(bound + 1e-6) if (weights == np.round(weights)).all() else bound
