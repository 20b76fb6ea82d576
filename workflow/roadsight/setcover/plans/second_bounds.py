"""Bounds for the search among covers of one cost: what a cover costs, and how much it sees again.

Both hold wherever the limit of work stops them. Costs are in one unit, weights in another.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.setcover.common.problem import Instance
from roadsight.setcover.common.relaxation import Node, Relaxation
from roadsight.setcover.plans.deployment import Deployment

_SHARE = 4
"""Each of the two bounds has one of so many shares of the work that is left."""
_STEPS = 400
"""Most steps to the bound: on the sample it is within 0.1 % of what 1,500 steps give."""
_STEP_ENTRY_S = 1.2e-9
"""Work of a step by entry of the matrix, in seconds, measured on the generated highway."""
_STEP_CHOICE_S = 1e-7
"""The same by choice: they are sorted."""
_REPAIR_S = 2e-8
"""Work of mending prices by entry of the matrix, in seconds, measured there."""
_STALLED = 20
"""After so many steps without a better bound, steps get shorter."""
_NEAR = 0.1
"""The first step goes for a bound lower by this share: about how far bound and covers are apart."""
_SHORTER = 0.7
"""Factor by which they do."""
_TOLERANCE = 1e-9
"""Slope (squared) below which a step leads nowhere."""


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
        points += [_lowered(dual, instance, free), _shares(instance, free)]
        limit.spend(_REPAIR_S * by_choice.nnz)
    refunds = [float(np.minimum((cost - by_choice @ one)[free], 0.0).sum()) for one in points]
    worth = [float(one @ need) + refund for one, refund in zip(points, refunds, strict=True)]
    best = int(np.argmax(worth))
    price = np.zeros(len(asked))
    price[asked] = points[best]
    return price, refunds[best]


def _lowered(dual: Floats, instance: Instance, free: Bools) -> Floats:
    """Prices of which no free choice has more than it costs."""
    worth = instance.by_choice @ dual
    dear = free & (worth > instance.cost)
    part = np.where(dear, instance.cost / np.where(dear, worth, 1.0), 1.0)
    return dual * _least(part, instance)


def _shares(instance: Instance, free: Bools) -> Floats:
    """The least share of cost that a free choice asks of each of its targets; 0 without any."""
    share = instance.cost / np.maximum(np.diff(instance.by_choice.indptr), 1)
    least = _least(np.where(free, share, np.inf), instance)
    return np.where(np.isfinite(least), least, 0.0)


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
    gain = np.where(allowed, by_choice @ best_u, 0.0)
    order = np.argsort(-gain / cost, kind="stable")
    gains, costs = (np.concatenate([[0.0], np.cumsum(part[order])]) for part in (gain, cost))
    return Most(gain, _base(best_u, need, weight), gains, costs)


def _base(u: Floats, need: Ints, weight: Floats) -> float:
    return float(np.maximum(weight - u, 0.0).sum() - (u * need).sum())


def _bought(gain: Floats, cost: Floats, money: float) -> tuple[Floats, float]:
    """Share of each choice that is bought, the best gain by cost first, and what they gain."""
    order = np.argsort(-gain / cost, kind="stable")
    before = np.cumsum(cost[order]) - cost[order]
    share = np.zeros(len(cost))
    share[order] = np.clip((money - before) / cost[order], 0.0, 1.0)
    return share, float(share @ gain)
