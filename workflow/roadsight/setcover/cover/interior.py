"""Bound of a large instance by interior points.

The simplex method walks from vertex to vertex, the longer the more targets a road has. A bound
asks for good duals only, which an interior point method finds in some twenty steps. Targets enter
where the last shares leave them open, and leave without a dual. Groups are left out: without them
a cover is at most cheaper.
"""

from __future__ import annotations

import highspy
import numpy as np

from roadsight.base.arrays import Ints
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import Instance
from roadsight.setcover.common.relaxation import ROUNDING, Solution, quiet_highs

_LARGE = 40_000_000
"""Choices x targets above which interior points are used: the published sizes have up to 17
million. 1 km of road took 16 s with them and 42 s with the simplex method; 250 m took that 0.9 s.
"""
_LEAST_TARGETS = 500
"""The two shares below stand for so many targets at least."""
_FIRST_SHARE = 1 / 12
"""Share of all targets to begin with: drawn at random, they are spread over the road."""
_ADDED_SHARE = 1 / 24
"""Share of all targets that join at once at most."""
_OPEN = 1e-3
"""Targets that lack more than this are open. Interior points stop near the optimum, not at it."""
_IDLE = 1e-6
"""Targets whose dual is no more than this leave."""
_LEAST_RISE = 2e-3
"""Share by which a round must raise the bound to count as progress."""
_TOLERANCE = 1e-5
"""Accuracy that the solver is asked for. Any duals give a bound, and the last digits cost steps."""
_PATIENCE = 3
"""Rounds without progress that end it."""
_STEP_S = 3e-7
"""Work of a step by entry of the linear program, in seconds, measured."""


def is_large(instance: Instance) -> bool:
    """Whether interior points are faster than the simplex method: from some 500 m of road on."""
    choices, targets = instance.shape
    return choices * targets > _LARGE


def interior_bound(instance: Instance, rng: np.random.Generator, deadline: Deadline) -> Solution:
    """Relaxation with the best bound that was found, as far as it rises and time allows."""
    choices, targets = instance.shape
    inside = np.zeros(targets, bool)
    inside[rng.permutation(targets)[: _some(targets, _FIRST_SHARE)]] = True
    best = Solution(0.0, np.zeros(choices), instance.cost, np.zeros(targets), False)
    rounds_alike = 0
    while True:
        found = _solve(instance, np.flatnonzero(inside), deadline)
        rises = found.bound > (1 + _LEAST_RISE) * best.bound
        best = max(best, found, key=lambda one: one.bound)
        missing = np.where(inside, 0.0, instance.need - instance.by_choice.T @ found.x)
        entering = np.argsort(-missing, kind="stable")[: _some(targets, _ADDED_SHARE)]
        entering = entering[missing[entering] > _OPEN]
        rounds_alike = 0 if rises else rounds_alike + 1
        if deadline.passed() or rounds_alike == _PATIENCE or not len(entering):
            return best
        inside &= found.target_dual > _IDLE
        inside[entering] = True


def _some(targets: int, share: float) -> int:
    return max(_LEAST_TARGETS, round(share * targets))


def _solve(instance: Instance, targets: Ints, deadline: Deadline) -> Solution:
    """Relaxation on some targets."""
    choices = instance.shape[0]
    by_target = instance.by_choice[:, targets].T.tocsr()
    step_s = _STEP_S * by_target.nnz
    highs = quiet_highs(
        solver="ipm",
        run_crossover="off",
        presolve="off",
        ipm_optimality_tolerance=_TOLERANCE,
        ipm_iteration_limit=deadline.count_left(step_s),
    )
    if np.isfinite(deadline.clock_left_s()):
        highs.setOptionValue("time_limit", max(deadline.clock_left_s(), 1e-3))
    highs.addVars(choices, np.zeros(choices), np.ones(choices))
    highs.changeColsCost(choices, np.arange(choices, dtype=np.int32), instance.cost)
    need = instance.need[targets].astype(np.float64)
    highs.addRows(
        len(targets),
        need,
        np.full(len(targets), highspy.kHighsInf),
        by_target.nnz,
        by_target.indptr[:-1].astype(np.int32),
        by_target.indices.astype(np.int32),
        np.ones(by_target.nnz),
    )
    highs.run()
    deadline.spend(step_s * max(highs.getInfo().ipm_iteration_count, 0))
    return _read(highs, instance, targets)


def _read(highs: highspy.Highs, instance: Instance, targets: Ints) -> Solution:
    """Shares and duals, all 0 where the method was stopped before it had any."""
    raw = highs.getSolution()
    share, row_dual = np.array(raw.col_value), np.array(raw.row_dual)
    whole = len(share) == instance.shape[0] and len(row_dual) == len(targets)
    if not (whole and np.isfinite(share).all() and np.isfinite(row_dual).all()):
        share, row_dual = np.zeros(instance.shape[0]), np.zeros(len(targets))
    dual = np.zeros(instance.shape[1])
    dual[targets] = np.maximum(row_dual, 0.0)
    reduced = instance.cost - instance.by_choice @ dual
    worth, refunds = float(dual @ instance.need), float(np.minimum(reduced, 0.0).sum())
    bound = worth + refunds - ROUNDING * (worth - refunds)
    complete = highs.getModelStatus() == highspy.HighsModelStatus.kOptimal
    return Solution(bound, np.clip(share, 0.0, 1.0), reduced, dual, complete)
