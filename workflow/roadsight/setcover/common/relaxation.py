"""Linear relaxation of a cover instance, kept between nodes of the search tree."""

from __future__ import annotations

from dataclasses import dataclass, replace

import highspy
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats, Ints, Ints32
from roadsight.setcover.common.cuts import Constraint, balas_ng_cuts, parity_cuts
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.kernels import coverage, reduced_costs
from roadsight.setcover.common.problem import Instance, power_of_two

# Targets to begin with, those that the fewest choices cover. Once more than so many constraints are
# in, slack targets leave.
FIRST_TARGETS = 300
ADDED_TARGETS = 60  # that join at once, the most broken ones: more make fewer, longer rounds
# So many broken targets, evenly spaced, are compared before the most broken of them join:
# neighbours say the same.
COMPARED_TARGETS = 400
MOST_CONSTRAINTS = 400  # that all stay from node to node; of more, slack targets leave
_TOLERANCE = 1e-6  # what breaks a constraint or makes it slack: ten times the solver's tolerance
# Targets that are seen by this more than they need leave while the relaxation is solved: 1,088
# constraints became 365 on the hardest corridor, and the simplex method's steps take time by them.
_LOOSE = 0.02
# Work of an iteration by the constraints of the linear program, in seconds. With the next it is
# fitted to rail507, scpnrg1 and scpcyc09 as they grow (20 to 320 us an iteration): within a third.
_ROW_S = 4.9e-8
_NONZERO_S = 2.3e-9  # the same by the entries
# Work of a call whatever its size; 6,389 calls for the 16-channel plan of the sample took 9.6 s
# beside their iterations.
_CALL_S = 1.5e-3
_RUN_S = 2.5e-8  # work of setting a linear program up by its entries, in seconds, measured
_READ_S = 3e-9  # work of reading the instance by its entries, in seconds, measured
# Costs beyond this many steps are given to the solver in larger units: its tolerances are absolute
# and its duals of such costs would never be within them.
_DEAREST = 2.0**16
ROUNDING = 2.0**-46  # share of the size of its terms by which a bound may be rounded: taken off it
_TARGET, _BRANCH, _GROUP, _CUT = 0, 1, 2, 3  # kinds of constraint


@dataclass(frozen=True)
class Node:
    """Subproblem of the search.

    Parameters
    ----------
    alive, fixed : (m,) choices that may be taken, that are taken (fixed ones are alive).
    path : numbers of the branch constraints (`Relaxation.add_branch`) that hold.
    """

    alive: Bools
    fixed: Bools
    path: tuple[int, ...] = ()


@dataclass(frozen=True)
class Solution:
    """Answer of the relaxation.

    Parameters
    ----------
    bound : Lagrangian bound of the duals, in steps: valid whatever the solver's tolerances.
    x : (m,) share of each choice.
    reduced_cost : (m,) of the same duals.
    target_dual : (n,) dual of each target, 0 where it is not in the relaxation.
    complete : False where the goal or the time limit stopped it: only ``bound`` is meant then.
    priced : other constraints with a dual above 0, and it.
    """

    bound: float
    x: Floats
    reduced_cost: Floats
    target_dual: Floats
    complete: bool
    priced: tuple[tuple[Constraint, float], ...] = ()

    def exceeds(self, goal: float) -> bool:
        """Whether nothing cheap enough is left: the bound is too high, or nothing is feasible."""
        return self.bound > goal or np.isinf(self.bound)


def quiet_highs(**options: bool | int | float | str) -> highspy.Highs:
    """Solver with one thread, a fixed seed and no output."""
    highs = highspy.Highs()
    settings: dict[str, bool | int | float | str] = {
        "output_flag": False,
        "threads": 1,
        "random_seed": 1,
    }
    for name, value in (settings | options).items():
        highs.setOptionValue(name, value)
    return highs


def run_simplex(highs: highspy.Highs, deadline: Deadline) -> float:
    """Solve a linear program from its last basis, within the limit.

    Returns
    -------
    Work that it took, in seconds, which is not counted yet.
    """
    entries = highs.getNumNz()
    iteration_s = _ROW_S * highs.getNumRow() + _NONZERO_S * entries
    clock_s = max(deadline.clock_left_s(), 1e-3)
    highs.setOptionValue("time_limit", highs.getRunTime() + clock_s)
    steps = deadline.count_left(max(iteration_s, _ROW_S))
    highs.setOptionValue("simplex_iteration_limit", steps)
    highs.run()
    iterations = max(highs.getInfo().simplex_iteration_count, 0)
    return _CALL_S + iteration_s * iterations + _RUN_S * entries


class Relaxation:
    """Relaxation that grows: constraints of targets and groups enter when violated.

    Costs never change, so the last basis is dual feasible at every node and the dual simplex goes
    on from it. ``work_s`` is what all of it took so far, in seconds.
    """

    def __init__(self, instance: Instance) -> None:
        self.instance = instance
        self.choices, self.targets = instance.shape
        self.branches: list[Ints32] = []
        self.cuts: dict[int, Constraint] = {}
        self._cuts_made, self.work_s = 0, 0.0
        self._kind = np.empty(0, np.int8)
        self._number = np.empty(0, np.int64)
        self._variables = np.arange(self.choices, dtype=np.int32)
        self._highs = quiet_highs(presolve="off", simplex_strategy=1)
        self._highs.addVars(self.choices, np.zeros(self.choices), np.ones(self.choices))
        self._unit = max(1.0, power_of_two(instance.least() / _DEAREST))
        self._highs.changeColsCost(self.choices, self._variables, instance.cost / self._unit)
        rare = np.argsort(np.diff(instance.by_target.indptr), kind="stable")
        self._add(_TARGET, np.sort(rare[:FIRST_TARGETS]))

    def add_branch(self, choices: Ints32) -> int:
        """Number of the new constraint that one of ``choices`` is taken."""
        self.branches.append(choices.astype(np.int32))
        return len(self.branches) - 1

    def members(self, path: tuple[int, ...]) -> Bools:
        """Branch constraints as masks, (len(path), m)."""
        mask = np.zeros((len(path), self.choices), bool)
        for k, branch in enumerate(path):
            mask[k, self.branches[branch]] = True
        return mask

    def solve(self, node: Node, goal: float, deadline: Deadline) -> Solution:
        """Solve the relaxation at a node, or stop once its bound exceeds ``goal``."""
        low = node.fixed.astype(np.float64)
        self._highs.changeColsBounds(self.choices, self._variables, low, node.alive.astype(float))
        self._delete((self._kind == _BRANCH) & ~np.isin(self._number, node.path))
        present = self._number[self._kind == _BRANCH]
        self._add(_BRANCH, np.setdiff1d(np.array(node.path, np.int64), present))
        self._highs.setOptionValue("objective_bound", float(goal) / self._unit + _TOLERANCE)
        risen = -np.inf
        while True:
            work_s = run_simplex(self._highs, deadline)
            work_s += _READ_S * self.instance.by_choice.nnz
            self.work_s += work_s
            deadline.spend(work_s)
            if self._highs.getModelStatus() == highspy.HighsModelStatus.kInfeasible:
                return self._stopped(np.inf)
            solution = self._read(node)
            if solution.bound > goal or not solution.complete or deadline.passed():
                return replace(solution, complete=False)
            # Only where the bound has risen, or the same targets could leave and join for ever.
            if solution.bound > risen + _TOLERANCE and len(self._kind) > FIRST_TARGETS:
                risen = solution.bound
                self._delete(self._slack(np.array(self._highs.getSolution().row_value)) > _LOOSE)
            if not self._separate(solution.x):
                return solution

    def strengthen(
        self, node: Node, solution: Solution, goal: float, deadline: Deadline, parity: bool
    ) -> Solution:
        """Add cuts that a solution breaks, by parity too where asked for, and solve again.

        Itself where there are none. Cuts without a dual leave, and targets that are seen by more
        than they need.
        """
        raw = self._highs.getSolution()
        value, dual = np.array(raw.row_value), np.array(raw.row_dual)
        sources = np.flatnonzero((self._kind == _TARGET) | (self._kind == _CUT))
        constraints = [self._constraint(self._kind[k], self._number[k]) for k in sources]
        excess = value[sources] - np.array([one.low for one in constraints])
        tight = [one for one, e in zip(constraints, excess, strict=True) if e <= _TOLERANCE]
        cuts, work_s = balas_ng_cuts(tight, solution.x)
        deadline.spend(work_s)
        if parity or not cuts:
            more, work_s = parity_cuts(tight, solution.x)
            deadline.spend(work_s)
            cuts += more
        if not cuts:
            return solution
        idle = (self._kind == _CUT) & (dual <= 0)
        for number in self._number[idle]:
            del self.cuts[number]
        self._delete(idle | (self._slack(value) > _LOOSE))
        numbers = np.arange(self._cuts_made, self._cuts_made + len(cuts))
        self.cuts |= dict(zip(numbers.tolist(), cuts, strict=True))
        self._cuts_made += len(cuts)
        self._add(_CUT, numbers)
        return self.solve(node, goal, deadline)

    def targets_inside(self) -> Ints:
        """Numbers of the targets that the relaxation holds at present."""
        return self._number[self._kind == _TARGET]

    def purge(self, solution: Solution) -> None:
        """Leave out slack targets once there are too many constraints."""
        if len(self._kind) <= MOST_CONSTRAINTS:
            return
        slack = self._slack(np.array(self._highs.getSolution().row_value)) > _TOLERANCE
        target = self._kind == _TARGET
        slack[target] &= solution.target_dual[self._number[target]] <= 0
        self._delete(slack)

    def _slack(self, value: Floats) -> Floats:
        """By how much targets are seen more than they need, by constraints' values; else 0."""
        target = self._kind == _TARGET
        slack = np.zeros(len(target))
        slack[target] = value[target] - self.instance.need[self._number[target]]
        return slack

    def _stopped(self, bound: float) -> Solution:
        nothing = np.zeros(self.choices)
        return Solution(bound, nothing, nothing, np.zeros(self.targets), False)

    def _read(self, node: Node) -> Solution:
        raw = self._highs.getSolution()
        x, dual = np.array(raw.col_value), self._unit * np.array(raw.row_dual)
        if len(dual) != len(self._kind) or not np.isfinite(dual).all():
            return self._stopped(0.0)
        # Duals of the right sign give a bound that holds, whatever the solver's tolerances.
        dual = np.where(self._kind == _GROUP, np.minimum(dual, 0.0), np.maximum(dual, 0.0))
        target_dual = np.zeros(self.targets)
        target = self._kind == _TARGET
        target_dual[self._number[target]] = dual[target]
        by_choice = self.instance.by_choice
        cost = reduced_costs(by_choice.indptr, by_choice.indices, self.instance.cost, target_dual)
        bound = size = float((target_dual * self.instance.need).sum())
        others = np.flatnonzero(~target & (dual != 0))
        constraints = [self._constraint(self._kind[k], self._number[k]) for k in others]
        for one, price in zip(constraints, dual[others], strict=True):
            cost[one.index] -= price * one.value
            bound += price * one.low
            size += abs(price * one.low)
        refunds = np.minimum(cost[node.alive & ~node.fixed], 0.0).sum()
        bound += cost[node.fixed].sum() + refunds
        size += np.abs(cost[node.fixed]).sum() - refunds
        bound -= ROUNDING * size
        optimal = self._highs.getModelStatus() == highspy.HighsModelStatus.kOptimal
        priced = tuple(
            (one, price) for one, price in zip(constraints, dual[others], strict=True) if price > 0
        )
        return Solution(float(bound), x, cost, target_dual, optimal, priced)

    def _separate(self, x: Floats) -> bool:
        """Add violated targets and groups; False where there are none."""
        by_choice, group = self.instance.by_choice, self.instance.group
        missing = self.instance.need - coverage(
            by_choice.indptr, by_choice.indices, x, self.targets
        )
        missing[self._number[self._kind == _TARGET]] = 0.0
        bad = np.flatnonzero(missing > _TOLERANCE)
        # Neighbours miss about as much and say the same: not all of them join.
        bad = bad[:: 1 + len(bad) // COMPARED_TARGETS]
        bad = bad[np.argsort(-missing[bad], kind="stable")[:ADDED_TARGETS]]
        grouped = group >= 0
        load = np.bincount(group[grouped], x[grouped], minlength=1)
        load[self._number[self._kind == _GROUP]] = 0.0
        crowded = np.flatnonzero(load > 1 + _TOLERANCE)
        self._add(_TARGET, bad)
        self._add(_GROUP, crowded)
        return bool(len(bad) or len(crowded))

    def _constraint(self, kind: int, number: int) -> Constraint:
        if kind == _CUT:
            return self.cuts[number]
        if kind == _BRANCH:
            return _counted(self.branches[number], 1.0)
        if kind == _GROUP:
            return _counted(np.flatnonzero(self.instance.group == number), 1.0)
        by_target = self.instance.by_target
        index = by_target.indices[by_target.indptr[number] : by_target.indptr[number + 1]]
        return _counted(index, float(self.instance.need[number]))

    def _add(self, kind: int, numbers: Ints) -> None:
        if not len(numbers):
            return
        constraints = [self._constraint(kind, number) for number in numbers]
        start = np.cumsum([0] + [len(one.index) for one in constraints])
        bound = np.array([one.low for one in constraints])
        low = np.full(len(constraints), -np.inf) if kind == _GROUP else bound
        high = bound if kind == _GROUP else np.full(len(constraints), np.inf)
        self._highs.addRows(
            len(constraints),
            low,
            high,
            start[-1],
            start[:-1].astype(np.int32),
            np.concatenate([one.index for one in constraints]),
            np.concatenate([one.value for one in constraints]),
        )
        self._kind = np.append(self._kind, np.full(len(constraints), kind, np.int8))
        self._number = np.append(self._number, numbers)

    def _delete(self, gone: Bools) -> None:
        if gone.any():
            self._highs.deleteRows(int(gone.sum()), np.flatnonzero(gone).astype(np.int32))
            self._kind, self._number = self._kind[~gone], self._number[~gone]


def _counted(index: NDArray[np.integer], low: float) -> Constraint:
    """So many of some choices."""
    return Constraint(index.astype(np.int32), np.ones(len(index)), low)
