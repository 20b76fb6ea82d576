"""Best coverage for a budget."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import highspy
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from roadsight.errors import InputError
from roadsight.placement.cover.deadline import Deadline
from roadsight.placement.cover.problem import CoverProblem, alone_to_none, objective_step
from roadsight.placement.cover.relaxation import quiet_highs
from roadsight.placement.cover.result import OPTIMAL, TIME_LIMIT, Cover, relative_gap

_RELATIVE_GAP = 1e-9


@dataclass(frozen=True)
class _Coverage:
    """Rows that fit the budget, merged targets: (m, n) CSR, weights (n,), costs (m,), groups."""

    by_choice: sparse.csr_matrix
    weight: NDArray[np.float64]
    cost: NDArray[np.float64]
    group: NDArray[np.int64]
    choice: NDArray[np.int64]
    budget: float
    fixed: NDArray[np.bool_]


def maximise_coverage(
    problem: CoverProblem,
    budget: float,
    weights: ArrayLike | None = None,
    time_limit_s: float | None = None,
) -> Cover:
    """Rows within a budget that cover the greatest weight of targets.

    maximise ``sum w_j y_j`` subject to ``y_j <= sum_i a_ij x_i``, ``sum c_i x_i <= budget`` and at
    most one row of a group. ``at_least`` is not used: a target counts once it is covered once.

    Parameters
    ----------
    weights : (targets,) finite, 0 or more; None = 1 each.

    Returns
    -------
    objective is the covered weight, ``bound`` an upper bound of it.

    Raises
    ------
    InputError : the budget or a weight is not usable, or the mandatory rows do not fit.
    """
    start = time.process_time()
    deadline = Deadline(time_limit_s)
    weight = _weights(weights, problem.matrix.shape[1])
    coverage = _prepare(problem, _checked_budget(problem, budget), weight)
    best = _greedy(coverage)
    bound = _simple_bound(coverage, best)
    value = _value(coverage, best)
    nodes = 0
    if bound > _goal(coverage, value) and not deadline.passed():
        found, limit, nodes = _by_milp(coverage, best, deadline)
        best = found if _value(coverage, found) > value else best
        value, bound = _value(coverage, best), min(bound, limit)
    proven = bound <= _goal(coverage, value)
    chosen = np.sort(coverage.choice[best])
    covered = np.asarray(problem.matrix[chosen].sum(axis=0)).ravel() > 0
    objective = math.fsum(weight[covered])
    bound = objective if proven else max(bound, objective)
    counts = dict(zip(("rows", "columns"), problem.matrix.shape, strict=True))
    counts |= dict(zip(("rows_reduced", "columns_reduced"), coverage.by_choice.shape, strict=True))
    return Cover(
        OPTIMAL if proven else TIME_LIMIT,
        chosen.astype(np.int64),
        objective,
        bound,
        relative_gap(objective, bound),
        time.process_time() - start,
        reductions=counts,
        nodes=nodes,
    )


def _weights(weights: ArrayLike | None, targets: int) -> NDArray[np.float64]:
    values = np.ones(targets) if weights is None else np.asarray(weights, np.float64)
    if values.shape != (targets,) or not np.isfinite(values).all() or (values < 0).any():
        raise InputError(
            "is no weight for each target",
            where="weights",
            found=f"shape {values.shape}",
            allowed=f"finite numbers of 0 or more, shape ({targets},)",
        )
    return values


def _checked_budget(problem: CoverProblem, budget: float) -> float:
    if not (np.isfinite(budget) and budget >= 0):
        raise InputError("is not usable", where="budget", found=budget, allowed="0 or more")
    must = problem.mandatory
    groups = problem.groups[must & (problem.groups >= 0)]
    if problem.costs[must].sum() > budget * (1 + 1e-12) or len(groups) > len(np.unique(groups)):
        raise InputError(
            "the mandatory rows do not fit the budget and the groups", where="budget", found=budget
        )
    return budget * (1 + 1e-12)  # a sum of decimal costs may exceed its exact value by rounding


def _prepare(problem: CoverProblem, budget: float, weight: NDArray[np.float64]) -> _Coverage:
    """Affordable rows, and one target for all that the same rows cover."""
    rows = np.flatnonzero(~problem.forbidden & (problem.costs <= budget))
    columns = problem.matrix[rows].tocsc()
    columns.sort_indices()
    keys: dict[bytes, int] = {}
    total: list[float] = []
    first: list[int] = []
    for t in np.flatnonzero((np.diff(columns.indptr) > 0) & (weight > 0)):
        key = columns.indices[columns.indptr[t] : columns.indptr[t + 1]].tobytes()
        if key not in keys:
            keys[key] = len(total)
            total.append(0.0)
            first.append(int(t))
        total[keys[key]] += weight[t]
    matrix = columns[:, first].tocsr()
    matrix.sort_indices()
    return _Coverage(
        matrix,
        np.array(total, np.float64),
        problem.costs[rows],
        alone_to_none(problem.groups[rows]),
        rows,
        budget,
        problem.mandatory[rows],
    )


def _value(coverage: _Coverage, chosen: NDArray[np.bool_]) -> float:
    seen = coverage.by_choice.T @ chosen.astype(np.int32) > 0
    return math.fsum(coverage.weight[seen])


def _goal(coverage: _Coverage, value: float) -> float:
    """Bounds up to this prove ``value``: no better coverage fits below the next step."""
    step = objective_step(coverage.weight) if len(coverage.weight) else 1.0
    return value + step * (1 - 1e-6) if step else value * (1 + 1e-7)


def _greedy(coverage: _Coverage) -> NDArray[np.bool_]:
    """Better of the greedy choices by weight per cost and by weight."""
    rows = coverage.by_choice
    chosen = [
        _fill(rows.indptr, rows.indices, coverage.weight, coverage.cost, coverage.group,
              coverage.budget, coverage.fixed, per_cost)
        for per_cost in (True, False)
    ]  # fmt: skip
    return max(chosen, key=lambda rows: _value(coverage, rows))


@njit(cache=True)
def _fill(start, index, weight, cost, group, budget, fixed, per_cost):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    chosen = fixed.copy()
    seen = np.zeros(len(weight), np.bool_)
    taken = np.zeros(len(group) + 1, np.bool_)
    spent = 0.0
    for row in range(len(cost)):
        if fixed[row]:
            spent += cost[row]
            taken[group[row]] = group[row] >= 0
            for p in range(start[row], start[row + 1]):
                seen[index[p]] = True
    while True:
        best = -1
        most = 0.0
        for row in range(len(cost)):
            if chosen[row] or spent + cost[row] > budget or (group[row] >= 0 and taken[group[row]]):
                continue
            gain = 0.0
            for p in range(start[row], start[row + 1]):
                if not seen[index[p]]:
                    gain += weight[index[p]]
            gain = gain / cost[row] if per_cost else gain
            if gain > most:
                best, most = row, gain
        if best < 0:
            return chosen
        chosen[best] = True
        spent += cost[best]
        if group[best] >= 0:
            taken[group[best]] = True
        for p in range(start[best], start[best + 1]):
            seen[index[p]] = True


def _simple_bound(coverage: _Coverage, chosen: NDArray[np.bool_]) -> float:
    """All weight, or what is covered plus the best gains that the whole budget could buy."""
    seen = coverage.by_choice.T @ chosen.astype(np.int32) > 0
    gain = coverage.by_choice @ np.where(seen, 0.0, coverage.weight)
    order = np.argsort(-gain / coverage.cost, kind="stable")
    spent = np.cumsum(coverage.cost[order])
    part = np.clip((coverage.budget - spent + coverage.cost[order]) / coverage.cost[order], 0, 1)
    bought = math.fsum(coverage.weight[seen]) + float((part * gain[order]).sum())
    return min(math.fsum(coverage.weight), bought)


def _by_milp(
    coverage: _Coverage, start: NDArray[np.bool_], deadline: Deadline
) -> tuple[NDArray[np.bool_], float, int]:
    """Rows, upper bound and nodes of the integer program, begun at ``start``."""
    highs = _model(coverage)
    left = deadline.left_s()
    if math.isfinite(left):
        highs.setOptionValue("time_limit", left)
    step = objective_step(coverage.weight)
    highs.setOptionValue("mip_rel_gap", 0.0 if step else _RELATIVE_GAP)
    highs.setOptionValue("mip_abs_gap", 0.999 * step)
    seen = coverage.by_choice.T @ start.astype(np.int32) > 0
    guess = highspy.HighsSolution()
    guess.col_value = np.concatenate([start, seen]).astype(np.float64)
    highs.setSolution(guess)
    highs.run()
    info = highs.getInfo()
    values = np.array(highs.getSolution().col_value)
    chosen = values[: len(start)] > 0.5 if len(values) else start
    bound = -info.mip_dual_bound if np.isfinite(info.mip_dual_bound) else np.inf
    return chosen, bound, max(int(info.mip_node_count), 0)


def _model(coverage: _Coverage) -> highspy.Highs:
    """Integer program: rows binary, targets continuous, costs negated to minimise."""
    rows, targets = coverage.by_choice.shape
    groups = coverage.group.max(initial=-1) + 1
    members = np.flatnonzero(coverage.group >= 0)
    grouped = sparse.csr_matrix(
        (np.ones(len(members)), (coverage.group[members], members)), shape=(groups, rows)
    )
    constraints = sparse.bmat(
        [
            [coverage.by_choice.T.astype(float), -sparse.identity(targets)],
            [sparse.csr_matrix(coverage.cost), None],
            [grouped, None],
        ],
        format="csr",
    )
    highs = quiet_highs()
    low = np.concatenate([coverage.fixed, np.zeros(targets)]).astype(np.float64)
    highs.addVars(rows + targets, low, np.ones(rows + targets))
    columns = np.arange(rows + targets, dtype=np.int32)
    highs.changeColsCost(len(columns), columns,
                         np.concatenate([np.zeros(rows), -coverage.weight]))  # fmt: skip
    kinds = np.full(rows, highspy.HighsVarType.kInteger)
    highs.changeColsIntegrality(rows, columns[:rows], kinds)
    bottom = np.concatenate([np.zeros(targets), np.full(1 + groups, -np.inf)])
    top = np.concatenate([np.full(targets, np.inf), [coverage.budget], np.ones(groups)])
    highs.addRows(len(top), bottom, top, constraints.nnz, constraints.indptr[:-1],
                  constraints.indices, constraints.data)  # fmt: skip
    return highs
