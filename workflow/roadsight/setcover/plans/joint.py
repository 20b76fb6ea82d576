"""Covers in which several choices together must give each target enough.

Minimise ``sum c_i x_i`` subject to ``sum_i min(g_ij, d_j) x_i >= d_j`` for each target j, at most
one choice of a group, x binary. With g = -log(1 - p) and d = -log(1 - level) independent choices
see a target with probability ``level``. What is not a sum, such as choices that are not
independent, enters as cuts, found by an oracle at each answer: one choice of a set must be taken.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import highspy
import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.errors import InputError
from roadsight.setcover.common.problem import (
    INFEASIBLE,
    OPTIMAL,
    TIME_LIMIT,
    WITHIN_GAP,
    Cover,
    is_within,
    objective_step,
    power_of_two,
    relative_gap,
)
from roadsight.setcover.common.relaxation import quiet_highs

# Sets of choices of which an answer needs one more; none where the sorted choices will do.
Oracle = Callable[[Ints], list[Ints]]
_FIRST = 250  # targets to begin with, those that have the least to spare
_ADDED = 80  # most targets that join after a round, those that lack most

TOLERANCE = 1e-7  # share of a need that may be missing
# Tolerance of the solver. Sums that it lets pass must pass here as well, or it would be asked the
# same again.
_SOLVED_TO = TOLERANCE / 100
_NODES_PER_S = 40  # nodes of a solver's tree in a second of the limit, about
_NODES_OF_ROUND = 10  # nodes that a round costs at least: its set-up and its root take time
# The clock stops at so many limits, and only what has gone wrong: answers must not depend on how
# busy a machine is.
_CLOCK_FACTOR = 20


def solve_joint(
    problem: JointProblem, limit_s: float = 300.0, gap: float = 0.0, oracle: Oracle | None = None
) -> Cover:
    """Cheapest choices, proven, or the best ones found within the limit.

    Rounds around HiGHS: only violated targets and cuts are constraints, so that its dual
    bound is one of the whole problem at any time. Answers are mended greedily into ones that are
    allowed. The limit counts nodes of the solver's trees, about as many as it does in so much time;
    the clock stops a solve only at twenty times the limit.

    Parameters
    ----------
    oracle : finds what sums do not say; without it the sums are all.
    """
    return _Joint(problem, limit_s, gap, oracle or (lambda chosen: [])).run()


class _Joint:
    """State of `solve_joint`."""

    def __init__(self, problem: JointProblem, limit_s: float, gap: float, oracle: Oracle) -> None:
        step = objective_step(problem.costs)
        self.whole, self.unit = step > 0, step or power_of_two(float(problem.costs.max(initial=1)))
        scaled = problem.costs / self.unit
        costs = np.round(scaled) if self.whole else scaled
        self.problem = problem = replace(problem, costs=costs)
        self.gap, self.oracle = gap, oracle
        self.by_target = problem.gain.tocsc()
        self.start = time.process_time()
        self.end = time.perf_counter() + _CLOCK_FACTOR * limit_s
        self.nodes_left = max(int(limit_s * _NODES_PER_S), 1)
        self.nodes = 0
        slack = np.asarray(problem.gain.sum(axis=0)).ravel() / problem.need
        self.active = np.zeros(len(problem.need), bool)
        self.active[np.argsort(slack, kind="stable")[:_FIRST]] = True
        self.cuts: list[Ints] = []
        self.best: Ints | None = None
        self.bound = 0.0

    def run(self) -> Cover:
        """Rounds of solving and separating."""
        if not self.problem.reachable().all():
            return self._result(INFEASIBLE)
        self._offer(np.empty(0, np.int64))
        while True:
            chosen, bound, status = self._solve()
            if status == highspy.HighsModelStatus.kInfeasible:
                return self._result(INFEASIBLE if self.best is None else OPTIMAL)
            if self.whole and math.isfinite(bound):
                bound = math.ceil(bound - 1e-6)
            self.bound = max(self.bound, min(bound, self._cost(self.best)))
            if chosen is not None:
                # What the answer breaks is added.
                short = self.problem.need * (1 - TOLERANCE) - self.problem.given(chosen)
                worst = np.argsort(-short / self.problem.need, kind="stable")
                worst = worst[(short[worst] > 0) & ~self.active[worst]][:_ADDED]
                self.active[worst] = True
                found = [] if len(worst) else self.oracle(chosen)
                self.cuts += found
                violated = bool(len(worst) or found)
                self._offer(chosen)
            best = self._cost(self.best)
            room = 1e-6 * (1.0 if self.whole else best)
            if math.isfinite(best) and self.bound >= best - room:
                return self._result(OPTIMAL)
            if is_within(self.gap, best, self.bound):
                return self._result(WITHIN_GAP)
            late = self.nodes_left <= 0 or time.perf_counter() > self.end
            if late or chosen is None or not violated:
                return self._result(TIME_LIMIT)

    def _solve(self) -> tuple[Ints | None, float, highspy.HighsModelStatus]:
        """Answer, bound and status of the constraints of the moment."""
        highs = self._model()
        left_s = max(self.end - time.perf_counter(), 1.0)
        highs.setOptionValue("time_limit", left_s)
        highs.setOptionValue("mip_max_nodes", int(self.nodes_left))
        # A proof to less than one step of whole costs is one to the end.
        highs.setOptionValue("mip_abs_gap", 1 - 1e-6 if self.whole else 1e-6)
        highs.setOptionValue("mip_rel_gap", self.gap / 2)
        highs.run()
        info = highs.getInfo()
        spent = max(int(info.mip_node_count), 1)
        self.nodes_left -= max(spent, _NODES_OF_ROUND)
        self.nodes += spent
        status = highs.getModelStatus()
        solution = np.array(highs.getSolution().col_value)
        found = len(solution) > 0 and info.primal_solution_status == 2
        chosen = np.flatnonzero(solution > 0.5).astype(np.int64) if found else None
        return chosen, float(info.mip_dual_bound), status

    def _model(self) -> highspy.Highs:
        problem, choices = self.problem, len(self.problem.costs)
        highs = quiet_highs(
            mip_feasibility_tolerance=_SOLVED_TO, primal_feasibility_tolerance=_SOLVED_TO
        )
        highs.addVars(choices, np.zeros(choices), np.ones(choices))
        number = np.arange(choices, dtype=np.int32)
        highs.changeColsCost(choices, number, problem.costs)
        kinds = np.full(choices, highspy.HighsVarType.kInteger)
        highs.changeColsIntegrality(choices, number, kinds)
        for target in np.flatnonzero(self.active):
            part = slice(self.by_target.indptr[target], self.by_target.indptr[target + 1])
            index, value = self.by_target.indices[part], self.by_target.data[part]
            share = value / problem.need[target]
            highs.addRow(1.0, highspy.kHighsInf, len(index), index.astype(np.int32), share)
            least = least_number(share, problem.groups[index])
            if least > 1:
                times = np.where(share >= 1 - TOLERANCE, float(least), 1.0)
                highs.addRow(
                    float(least), highspy.kHighsInf, len(index), index.astype(np.int32), times
                )
        for cut in self.cuts:
            highs.addRow(1.0, highspy.kHighsInf, len(cut), cut.astype(np.int32), np.ones(len(cut)))
        order = np.argsort(problem.groups, kind="stable")
        starts = np.flatnonzero(np.diff(problem.groups[order], prepend=-1))
        for members in np.split(order, starts[1:]):
            if len(members) > 1:
                one = np.ones(len(members))
                highs.addRow(-highspy.kHighsInf, 1.0, len(one), members.astype(np.int32), one)
        if self.best is not None:
            start = highspy.HighsSolution()
            start.col_value = np.isin(np.arange(choices), self.best).astype(np.float64)
            highs.setSolution(start)
        return highs

    def _offer(self, chosen: Ints) -> None:
        """Mend choices into an answer that is allowed, and keep it if it is the best."""
        mended = self._mended(chosen)
        if mended is not None and self._cost(mended) < self._cost(self.best):
            self.best = mended

    def _mended(self, chosen: Ints) -> Ints | None:
        """Choices with the most for their cost added till nothing lacks, then needless ones out."""
        problem = self.problem
        taken = [int(choice) for choice in chosen]
        given = problem.given(chosen)
        while True:
            lack = np.maximum(problem.need * (1 - TOLERANCE) - given, 0.0)
            short = np.flatnonzero(lack > 0)
            if len(short):  # what each choice adds
                part = problem.gain[:, short].copy()
                part.data = np.minimum(part.data, lack[short][part.indices])
                helps = np.asarray(part @ (1 / problem.need[short])).ravel()
            else:
                found = self.oracle(np.sort(np.array(taken, np.int64)))
                if not found:
                    break
                self.cuts += found
                counts = np.bincount(np.concatenate(found), minlength=len(problem.costs))
                helps = counts.astype(np.float64)
            helps = helps / problem.costs
            helps[np.isin(problem.groups, problem.groups[taken])] = 0.0
            choice = int(np.argmax(helps))
            if helps[choice] <= 0:
                return None
            taken.append(choice)
            given = problem.given(np.array(taken, np.int64))
        for choice in sorted(taken, key=lambda one: (-problem.costs[one], one)):
            fewer = np.array(sorted(set(taken) - {choice}), np.int64)
            lacks = problem.need * (1 - TOLERANCE) - problem.given(fewer)
            if lacks.max(initial=-1.0) <= 0 and not self.oracle(fewer):
                taken = fewer.tolist()
        return np.array(sorted(taken), np.int64)

    def _cost(self, taken: Ints | None) -> float:
        return math.inf if taken is None else math.fsum(self.problem.costs[taken])

    def _result(self, status: str) -> Cover:
        best = self._cost(self.best)
        if status == INFEASIBLE:
            self.best, best, self.bound = None, math.inf, math.inf
        bound = best if status == OPTIMAL else min(self.bound, best)
        return Cover(
            status,
            np.empty(0, np.int64) if self.best is None else self.best,
            best * self.unit,
            bound * self.unit,
            relative_gap(best, bound),
            time.process_time() - self.start,
            reductions={
                "rows": self.problem.gain.shape[0],
                "columns": self.problem.gain.shape[1],
                "columns_used": int(self.active.sum()),
                "cuts": len(self.cuts),
            },
            nodes=self.nodes,
        )


@dataclass(frozen=True)
class JointProblem:
    """Choices, what they give, and what targets need.

    Parameters
    ----------
    gain : (choices, targets) sparse, 0 or more; entries above the need count as the need.
    need : (targets,) positive. costs : (choices,) positive.
    groups : (choices,) at most one choice of each.

    Raises
    ------
    InputError : a gain or need is not usable.
    """

    gain: sparse.csr_matrix
    need: Floats
    costs: Floats
    groups: Ints

    def __post_init__(self) -> None:
        if not (np.isfinite(self.need) & (self.need > 0)).all():
            raise InputError("is not positive", where="need")
        if (self.gain.data < 0).any() or np.isnan(self.gain.data).any():
            raise InputError("is negative or not a number", where="gain")
        capped = sparse.csr_matrix(self.gain, dtype=np.float64, copy=True)
        capped.data = np.minimum(capped.data, self.need[capped.indices])
        capped.eliminate_zeros()
        object.__setattr__(self, "gain", capped)

    def given(self, chosen: Ints) -> Floats:
        """What chosen choices give each target (targets,)."""
        return np.asarray(self.gain[chosen].sum(axis=0)).ravel()

    def reachable(self) -> Bools:
        """Targets (targets,) to which the best choices of all groups together give enough."""
        best = best_of_groups(self.gain, self.groups)
        return np.asarray(best.sum(axis=0)).ravel() >= self.need * (1 - TOLERANCE)


def best_of_groups(gain: sparse.csr_matrix, groups: Ints) -> sparse.csr_matrix:
    """Greatest gain of each group at each target, (groups, targets)."""
    table = gain.tocoo()
    group = np.unique(groups, return_inverse=True)[1].reshape(-1)[table.row]
    order = np.lexsort((-table.data, table.col, group))
    group, target, data = group[order], table.col[order], table.data[order]
    first = np.ones(len(group), bool)
    first[1:] = (group[1:] != group[:-1]) | (target[1:] != target[:-1])
    size = (int(group.max(initial=-1)) + 1, gain.shape[1])
    return sparse.csr_matrix((data[first], (group[first], target[first])), shape=size)


def least_number(share: Floats, groups: Ints) -> int:
    """How many choices a target needs at least of those that are not enough alone; 1 for none.

    With r of them, ``sum_alone r x_i + sum_others x_i >= r`` holds for every answer, and cuts off
    more of the relaxation than the gains themselves.

    Parameters
    ----------
    share : (k,) of the need that each choice gives. groups : (k,) of which one at most is taken.
    """
    others = share < 1 - TOLERANCE
    best: dict[int, float] = {}
    for group, value in zip(groups[others].tolist(), share[others].tolist(), strict=True):
        best[group] = max(best.get(group, 0.0), value)
    total = np.cumsum(sorted(best.values(), reverse=True))
    reached = np.flatnonzero(total >= 1 - TOLERANCE)
    return int(reached[0]) + 1 if len(reached) else max(len(best), 1)
