"""Branch and cut over the relaxation of a deployment."""

from __future__ import annotations

from dataclasses import dataclass, replace

import highspy
import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints, Ints32
from roadsight.setcover.common.cuts import Constraint
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import is_within
from roadsight.setcover.common.relaxation import ROUNDING, Node, quiet_highs, run_simplex
from roadsight.setcover.common.tree import (
    BestFirst,
    choices_of_both,
    divide_by_choice,
    divide_by_choices,
    is_settled,
    tighten,
)
from roadsight.setcover.plans.construct import Builder
from roadsight.setcover.plans.cuts import Cuts

_WHOLE = 1e-6  # shares nearer to a whole number are whole: ten times the solver's tolerance
_ROOT_ROUNDS = 200  # most rounds of cuts at the root: its cuts hold for the whole tree
_ROUNDS = 12  # most at other nodes; what is still violated is left to their children
_ROOT_STEPS = 200  # greedy trials at the root: a good answer there keeps the tree small
_STEPS = 2  # trials by node of the tree, each time the tree has doubled
# Most trials where the root's half of the work is out: no tree will come, so what is left goes to
# better answers. With the two, a budget of 15 sensors sees 17,669 of 20,000 targets on 1 km of road
# after 60 s, where it saw 16,639.
_LAST_STEPS = 2_000
_DIVES = 20  # first nodes at which answers are built from the relaxation; later as the tree doubles
_PAIRED_TARGETS = 80  # targets that are compared in pairs; a larger number takes time by its square
# Pairs whose common share is nearer to a whole number than this are no use: one half of the node
# would be nearly the node itself.
_FRACTION = 0.02


class Tree(BestFirst):
    """Tree over the relaxation of a deployment."""

    def __init__(self, master: Master, builder: Builder, gap: float) -> None:
        super().__init__(gap)
        self.master, self.builder = master, builder
        self.deployment = builder.deployment

    @property
    def goal(self) -> float:
        """Largest bound that still allows a better deployment."""
        return self.deployment.goal(self.builder.value)

    def run(self, floor: float, deadline: Deadline) -> float:
        """Proven bound: until nothing is better, within the gap or out of work.

        ``floor`` : a bound known before.
        """
        problem = self.deployment.problem
        start = Node(~problem.forbidden, problem.mandatory.copy())
        bound = self.prove(start, floor, deadline)
        return max(self.builder.value, floor) if bound is None else bound

    def round_up(self, bound: float) -> float:
        """Bound lifted to the next possible objective."""
        return self.deployment.round_up(bound)

    def is_enough(self, bound: float, deadline: Deadline) -> bool:
        """Whether the gap is reached or work is out; the root is always tried."""
        if not self.nodes:
            return False
        shift = self.deployment.shift
        near = is_within(self.gap, self.builder.value + shift, bound + shift)
        return deadline.passed() or near

    def expand(self, node: Node, deadline: Deadline) -> tuple[float, tuple[Node, ...] | None]:
        """Bound and children of a node; None for children where work ran out."""
        root = self.nodes == 1
        rounds = _ROOT_ROUNDS if root else _ROUNDS
        forbidden = 0
        while True:
            goal = self.goal
            answer = self.master.solve(node, goal, deadline.part(2) if root else deadline, rounds)
            if answer.bound > goal or answer.bound == np.inf:
                return answer.bound, ()
            if not answer.complete:
                self.builder.improve(_LAST_STEPS if root else 0, answer.bound, deadline)
                return answer.bound, None
            # Deployments near the relaxation, more of them at the root and as the tree doubles.
            doubled = not self.nodes & (self.nodes - 1)
            if self.nodes <= _DIVES or doubled:
                self.builder.build(np.flatnonzero(answer.x > 1 - _WHOLE), answer.x + 0.02)
                self.builder.build(np.empty(0, np.int64), answer.x + 1e-3)
            if doubled:
                steps = _ROOT_STEPS if root else _STEPS * self.nodes
                self.builder.improve(steps, answer.bound if root else -np.inf, deadline)
            before = node
            node = tighten(before, answer.bound, answer.reduced_cost, self.goal)
            whole = np.minimum(answer.x, 1 - answer.x).max(initial=0.0) < _WHOLE
            if whole and self._forbid(np.flatnonzero(answer.x > 0.5)) and forbidden < _ROUNDS:
                forbidden += 1  # what is within tolerances even so is left to the children
                continue
            if is_settled(before, node):
                break
        self.master.purge()
        if answer.bound > self.goal:
            return answer.bound, ()
        if (node.alive == node.fixed).all():
            self.builder.offer(np.flatnonzero(node.fixed))
            return answer.bound, ()
        return answer.bound, self._divide(node, answer)

    def _forbid(self, chosen: Ints) -> bool:
        """Add what whole choices that the relaxation allows break after all."""
        if self.builder.deployment.objective(chosen) < np.inf:
            self.builder.offer(chosen)
            return False
        found = self.master.cuts.forbids(chosen)
        self.master.add(found)
        return bool(found)

    def _divide(self, node: Node, answer: Relaxed) -> tuple[Node, Node]:
        """Two nodes that share out all deployments of ``node``.

        Of some choices either none or at least one is taken; where no such choices are found, the
        node is divided by one choice.
        """
        choices = self._shared_choices(node, answer.x)
        known = (self.master.branches[k].index for k in node.path)
        if choices is not None and not any(np.array_equal(choices, one) for one in known):
            return divide_by_choices(node, choices, self.master.add_branch(choices))
        free = node.alive & ~node.fixed
        nearness = np.where(free, np.minimum(answer.x, 1 - answer.x), -1.0)
        if nearness.max() < _WHOLE:  # whole already: the free choice of the largest share
            nearness = np.where(free, answer.x + 1e-3, -1.0)
        return divide_by_choice(node, int(np.argmax(nearness)))

    def _shared_choices(self, node: Node, x: Floats) -> Ints32 | None:
        """Free choices that see both of the two targets (or one) whose division promises most."""
        cuts, free = self.master.cuts, node.alive & ~node.fixed
        support = np.flatnonzero((x > 1e-9) & free)
        # Targets that free choices see in part or just once; some of them, spread over all.
        count = cuts.count(np.where(free, x, 0.0))
        targets = np.flatnonzero((count > _FRACTION) & (count < 1 + _WHOLE))
        if not self.deployment.complete:
            targets = targets[cuts.weight[targets] > 0]
        if len(targets) > _PAIRED_TARGETS:
            some = np.linspace(0, len(targets) - 1, _PAIRED_TARGETS).astype(np.int64)
            targets = targets[some]
        if not len(targets) or not len(support):
            return None
        # Sparse, because the order of sums in a dense product depends on the number of threads.
        sees = cuts.by_choice[support][:, targets].astype(np.float64)
        share = (sees.T @ sparse.diags_array(x[support]) @ sees).toarray()
        # With the diagonal: one target alone may be divided as well.
        first, second = np.triu_indices(len(targets))
        fraction = np.minimum(share, 1 - share)[first, second]
        if fraction.max() < _FRACTION:
            return None
        weight = np.minimum(cuts.weight[targets[first]], cuts.weight[targets[second]])
        best = int(np.argmax(fraction * np.maximum(weight, 1e-9)))
        return choices_of_both(cuts.by_target, targets[first[best]], targets[second[best]], free)


MOST_CONSTRAINTS = 1_200  # of the linear program; of more, slack cuts leave between nodes
_SLACK = 1e-6  # from a right side, or above the goal, that counts: ten times the solver's tolerance
_SEARCH_S = 3e-9  # work of a search for violated cuts by entry of the matrix, in seconds, measured


@dataclass(frozen=True)
class Relaxed:
    """Answer of the relaxation.

    Parameters
    ----------
    bound : Lagrangian bound of the duals: valid whatever the solver's tolerances.
    x : (m,) share of each choice. reduced_cost : (m,) of the same duals.
    complete : False where the goal or the limit stopped it.
    """

    bound: float
    x: Floats
    reduced_cost: Floats
    complete: bool


class Master:
    """Relaxation over choices and blocks of targets; cuts enter when violated."""

    def __init__(self, cuts: Cuts, pool: list[Constraint] | None = None) -> None:
        self.cuts, deployment = cuts, cuts.deployment
        self.choices, self.variables = cuts.choices, cuts.choices + cuts.blocks
        self.price = np.concatenate(
            [np.asarray(deployment.cost), np.full(cuts.blocks, -deployment.worth)]
        )
        # What is guaranteed for certain once every target must be seen.
        self.constant = -deployment.worth * deployment.total if deployment.complete else 0.0
        self.branches: list[Constraint] = []
        self._constraints: list[Constraint] = []
        self._branch: list[int] = []  # number of the branch that a constraint is, or -1
        self._high = np.concatenate([np.ones(self.choices), cuts.block_weight[: cuts.blocks]])
        self._number = np.arange(self.variables, dtype=np.int32)
        self._highs = quiet_highs(presolve="off", simplex_strategy=1)
        self._highs.addVars(self.variables, np.zeros(self.variables), self._high)
        self._highs.changeColsCost(self.variables, self._number, self.price)
        first = cuts.first()
        self._kept = len(first)
        self.add(first + (pool or []))

    def add(self, found: list[Constraint], branch: int = -1) -> None:
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
        self.branches.append(Constraint(choices.astype(np.int32), np.ones(len(choices)), 1.0))
        return len(self.branches) - 1

    def pool(self) -> list[Constraint]:
        """Cuts at present that hold for any budget, worth and floor."""
        blocks = [
            cut for cut in self._constraints if len(cut.index) and cut.index[-1] >= self.choices
        ]
        return [cut for cut in blocks if (cut.value < 0).sum() == 1]

    def solve(self, node: Node, goal: float, deadline: Deadline, rounds: int) -> Relaxed:
        """Solve at a node until no cut is violated, the bound exceeds ``goal`` or rounds end."""
        low = np.concatenate([node.fixed, np.zeros(self.cuts.blocks)]).astype(np.float64)
        high = np.concatenate([node.alive, self._high[self.choices :]]).astype(np.float64)
        self._highs.changeColsBounds(self.variables, self._number, low, high)
        branch = np.array(self._branch, np.int64)
        self._delete((branch >= 0) & ~np.isin(branch, node.path))
        present = set(self._branch)
        for number in node.path:
            if number not in present:
                self.add([self.branches[number]], number)
        limit = goal - self.constant
        self._highs.setOptionValue("objective_bound", float(min(limit + _SLACK, 1e200)))
        best = -np.inf
        for turn in range(rounds):
            deadline.spend(run_simplex(self._highs, deadline))
            deadline.spend(_SEARCH_S * self.cuts.by_choice.nnz)
            if self._highs.getModelStatus() == highspy.HighsModelStatus.kInfeasible:
                return self._stopped(np.inf)
            answer = self._read(node)
            best = max(best, answer.bound)
            if best > goal or not answer.complete or deadline.passed():
                return replace(answer, bound=best, complete=False)
            value = np.array(self._highs.getSolution().col_value)[self.choices :]
            found = self.cuts.violated(answer.x, value)
            if not found or turn == rounds - 1:
                return replace(answer, bound=best)
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

    def _stopped(self, bound: float) -> Relaxed:
        nothing = np.zeros(self.choices)
        return Relaxed(bound, nothing, nothing, False)

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
        return Relaxed(float(bound), x[: self.choices], reduced[: self.choices], optimal)

    def _delete(self, gone: Bools) -> None:
        if gone.any():
            self._highs.deleteRows(int(gone.sum()), np.flatnonzero(gone).astype(np.int32))
            self._constraints = [
                cut for cut, out in zip(self._constraints, gone, strict=True) if not out
            ]
            self._branch = [b for b, out in zip(self._branch, gone, strict=True) if not out]
