"""Linear relaxation of a deployment by cuts, kept between nodes of the search tree."""

from __future__ import annotations

from dataclasses import dataclass

import highspy
import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints32
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.relaxation import ROUNDING, Node, quiet_highs, run_simplex
from roadsight.setcover.plans.cuts import Cut, Cuts

MOST_CONSTRAINTS = 1_200
"""Constraints of the linear program above which slack cuts leave between nodes."""
_SLACK = 1e-6
"""Distance from a right side, and above the goal, that counts: ten times the solver's tolerance."""
_SEARCH_S = 3e-9
"""Work of a search for violated cuts by entry of the matrix, in seconds, measured."""


@dataclass(frozen=True)
class Relaxed:
    """Answer of the relaxation.

    Parameters
    ----------
    bound : Lagrangian bound of the duals: valid whatever the solver's tolerances.
    x : (m,) share of each choice. reduced_cost : (m,) of the same duals.
    settled : whether no cut is violated. complete : False where the goal or the limit stopped it.
    """

    bound: float
    x: Floats
    reduced_cost: Floats
    settled: bool
    complete: bool


class Master:
    """Relaxation over choices and blocks of targets; cuts enter when violated."""

    def __init__(self, cuts: Cuts, pool: list[Cut] | None = None) -> None:
        self.cuts, deployment = cuts, cuts.deployment
        self.choices, self.variables = cuts.choices, cuts.choices + cuts.blocks
        self.price = np.concatenate(
            [np.asarray(deployment.cost), np.full(cuts.blocks, -deployment.worth)]
        )
        # What is guaranteed for certain once every target must be seen.
        self.constant = -deployment.worth * deployment.total if deployment.complete else 0.0
        self.branches: list[Cut] = []
        self._constraints: list[Cut] = []
        self._branch: list[int] = []  # number of the branch that a constraint is, or -1
        self._high = np.concatenate([np.ones(self.choices), cuts.block_weight[: cuts.blocks]])
        self._number = np.arange(self.variables, dtype=np.int32)
        self._highs = quiet_highs(presolve="off", simplex_strategy=1)
        self._highs.addVars(self.variables, np.zeros(self.variables), self._high)
        self._highs.changeColsCost(self.variables, self._number, self.price)
        first = cuts.first()
        self._kept = len(first)
        self.add(first + (pool or []))

    def add(self, found: list[Cut], branch: int = -1) -> None:
        """Add constraints."""
        if not found:
            return
        found = [cut.scaled() for cut in found]
        start = np.cumsum([0, *(len(cut.index) for cut in found)])
        self._highs.addRows(
            len(found),
            np.array([cut.low for cut in found]),
            np.full(len(found), np.inf),
            int(start[-1]),
            start[:-1].astype(np.int32),
            np.concatenate([cut.index for cut in found]).astype(np.int32),
            np.concatenate([cut.value for cut in found]),
        )
        self._constraints += found
        self._branch += [branch] * len(found)

    def add_branch(self, choices: Ints32) -> int:
        """Number of the new constraint that one of ``choices`` is taken."""
        self.branches.append(Cut(choices.astype(np.int32), np.ones(len(choices)), 1.0))
        return len(self.branches) - 1

    def pool(self) -> list[Cut]:
        """Cuts at present that hold for any budget, worth and floor."""
        blocks = [
            cut for cut in self._constraints if len(cut.index) and cut.index[-1] >= self.choices
        ]
        return [cut for cut in blocks if (cut.value < 0).sum() == 1]

    def solve(self, node: Node, goal: float, deadline: Deadline, rounds: int) -> Relaxed:
        """Solve at a node until no cut is violated, the bound exceeds ``goal`` or rounds end."""
        self._enter(node)
        limit = goal - self.constant
        self._highs.setOptionValue("objective_bound", float(min(limit + _SLACK, 1e200)))
        best = -np.inf
        for turn in range(rounds):
            self._run(deadline)
            if self._highs.getModelStatus() == highspy.HighsModelStatus.kInfeasible:
                return self._stopped(np.inf)
            answer = self._read(node)
            best = max(best, answer.bound)
            if best > goal or not answer.complete or deadline.passed():
                return Relaxed(best, answer.x, answer.reduced_cost, False, False)
            value = np.array(self._highs.getSolution().col_value)[self.choices :]
            found = self.cuts.violated(answer.x, value)
            if not found or turn == rounds - 1:
                return Relaxed(best, answer.x, answer.reduced_cost, not found, True)
            self.add(found)
        raise AssertionError("at least one round")

    def purge(self) -> None:
        """Leave out slack cuts once there are too many constraints."""
        if len(self._constraints) <= MOST_CONSTRAINTS:
            return
        raw = self._highs.getSolution()
        value, dual = np.array(raw.row_value), np.array(raw.row_dual)
        if len(value) != len(self._constraints):
            return
        low = np.array([cut.low for cut in self._constraints])
        slack = (value > low + _SLACK * np.maximum(1, np.abs(low))) & (dual <= 0)
        slack[: self._kept] = False
        self._delete(slack & (np.array(self._branch) < 0))

    def _run(self, deadline: Deadline) -> None:
        deadline.spend(run_simplex(self._highs, deadline))
        deadline.spend(_SEARCH_S * self.cuts.by_choice.nnz)

    def _stopped(self, bound: float) -> Relaxed:
        nothing = np.zeros(self.choices)
        return Relaxed(bound, nothing, nothing, False, False)

    def _read(self, node: Node) -> Relaxed:
        raw = self._highs.getSolution()
        x, dual = np.array(raw.col_value), np.array(raw.row_dual)
        if len(dual) != len(self._constraints) or not np.isfinite(dual).all():
            return self._stopped(-np.inf)
        reduced, bound, size = self.price.copy(), self.constant, abs(self.constant)
        # Without duals of the wrong sign the bound holds, whatever the solver's tolerances.
        for k in np.flatnonzero(dual > 0):
            cut = self._constraints[k]
            reduced[cut.index] -= dual[k] * cut.value
            bound += dual[k] * cut.low
            size += abs(dual[k] * cut.low)
        low = np.concatenate([node.fixed, np.zeros(self.cuts.blocks)])
        high = np.concatenate([node.alive, self._high[self.choices :]])
        rest = np.where(reduced > 0, reduced * low, reduced * high)
        bound += float(rest.sum()) - ROUNDING * (size + float(np.abs(rest).sum()))
        optimal = self._highs.getModelStatus() == highspy.HighsModelStatus.kOptimal
        return Relaxed(float(bound), x[: self.choices], reduced[: self.choices], False, optimal)

    def _enter(self, node: Node) -> None:
        """Bounds and branch constraints of a node."""
        low = np.concatenate([node.fixed, np.zeros(self.cuts.blocks)]).astype(np.float64)
        high = np.concatenate([node.alive, self._high[self.choices :]]).astype(np.float64)
        self._highs.changeColsBounds(self.variables, self._number, low, high)
        branch = np.array(self._branch, np.int64)
        self._delete((branch >= 0) & ~np.isin(branch, node.path))
        present = set(self._branch)
        for number in node.path:
            if number not in present:
                self.add([self.branches[number]], number)

    def _delete(self, gone: Bools) -> None:
        if gone.any():
            self._highs.deleteRows(int(gone.sum()), np.flatnonzero(gone).astype(np.int32))
            self._constraints = [
                cut for cut, out in zip(self._constraints, gone, strict=True) if not out
            ]
            self._branch = [b for b, out in zip(self._branch, gone, strict=True) if not out]
