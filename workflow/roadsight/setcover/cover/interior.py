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
from roadsight.setcover.common.relaxation import Solution, quiet_highs

_LARGE = 40_000_000
_LEAST_TARGETS, _FIRST_SHARE, _ADDED_SHARE = 500, 1 / 12, 1 / 24
_OPEN, _IDLE, _LEAST_RISE, _TOLERANCE = 1e-3, 1e-6, 2e-3, 1e-5
_PATIENCE = 3
_STEP_S = 3e-7  # work of a step by entry of the linear program, measured


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
    rows = instance.by_choice[:, targets].T.tocsr()
    step_s = _STEP_S * rows.nnz
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
        rows.nnz,
        rows.indptr[:-1].astype(np.int32),
        rows.indices.astype(np.int32),
        np.ones(rows.nnz),
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
    bound = float((dual * instance.need).sum() + np.minimum(reduced, 0.0).sum())
    complete = highs.getModelStatus() == highspy.HighsModelStatus.kOptimal
    return Solution(bound, np.clip(share, 0.0, 1.0), reduced, dual, complete)
