"""Search tree that proves a cover optimal or finds a cheaper one."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadsight.placement.cover.branching import divide
from roadsight.placement.cover.deadline import Deadline
from roadsight.placement.cover.kernels import drop_dominated_choices, pack_bits, propagate
from roadsight.placement.cover.local_search import LocalSearch
from roadsight.placement.cover.problem import Instance
from roadsight.placement.cover.reductions import MAX_BITS, arrays
from roadsight.placement.cover.relaxation import Node, Relaxation, Solution
from roadsight.placement.cover.result import is_within

FIRST_STEPS = 2_000
_SPARE_STEPS, _MOST_SPARE = 4_000, 50
_WHOLE = 1e-6
_FIRST_RETRY = 32
_STEPS_PER_NODE = 400
_ENTRY_S = 4e-9  # work of a propagation by entry of the matrix, measured
FIRST_CUTS, _ROOT_CUTS, _NODE_CUTS = 3, 40, 2
_PATIENCE, _LEAST_RISE = 3, 0.05


@dataclass(frozen=True)
class Outcome:
    """Best cover of an instance (None: none found) and its proven bound, in steps."""

    best: NDArray[np.bool_] | None
    bound: float
    nodes: int


def search_while_it_pays(local: LocalSearch, bound: float, deadline: Deadline) -> None:
    """Search the longer, the more rows the bound leaves, and again after each find."""
    while True:
        spare = 1.0
        if local.best is not None:
            spare = local.best.sum() * (local.cost - bound) / local.cost
        before = local.cost
        more = int(np.clip(spare, 1, _MOST_SPARE)) - 1
        local.improve(FIRST_STEPS + _SPARE_STEPS * more, bound, deadline)
        if not local.cost < before:
            return


class Search:
    """Best bound first, the deepest of equals first.

    With whole costs all nodes of one rounded-up bound are equal, so that the search goes deep until
    that cost is refuted or reached, and its bound rises step by step: it is proven at any time.

    With a ``ceiling``, only covers that cost less count, and the first of them ends the search.
    """

    def __init__(
        self,
        relaxation: Relaxation,
        local: LocalSearch,
        gap: float = 0.0,
        ceiling: float = np.inf,
    ) -> None:
        self.relaxation, self.gap, self.ceiling = relaxation, gap, ceiling
        self.instance: Instance = relaxation.instance
        self.local = local
        self.best = local.best
        self.nodes = 0
        choices, targets = self.instance.shape
        rows = self.instance.by_choice
        small = choices * targets <= MAX_BITS
        self._bits = pack_bits(rows.indptr, rows.indices, targets) if small else None

    @property
    def cost(self) -> float:
        """Cost that a cover must go below to count, in steps."""
        own = np.inf if self.best is None else float(self.instance.cost[self.best].sum())
        return min(own, self.ceiling)

    def strengthen(self, root: Solution, deadline: Deadline, rounds: int = _ROOT_CUTS) -> Solution:
        """Cuts at the root, as long as they pay."""
        return self._strengthen(self._everything(), root, rounds, deadline)

    def search_locally(self, bound: float, deadline: Deadline) -> None:
        """Local search, as long as it pays."""
        search_while_it_pays(self.local, bound, deadline)
        self.best = self.local.best

    def run(self, root: Solution, deadline: Deadline) -> Outcome:
        """Search below the root, whose relaxation is solved."""
        start = self._tighten(self._everything(), root)
        queue = [(self.instance.round_up(root.bound), 0, 0, start)]
        pushed = 0
        while queue:
            key, depth, _, node = queue[0]
            if key > self.instance.goal(self.cost):
                break
            below = self.cost < self.ceiling < np.inf
            if below or deadline.passed() or is_within(self.gap, self.cost, key):
                return Outcome(self.best, key, self.nodes)
            heapq.heappop(queue)
            bound, children = self._expand(node, deadline)
            if children is None:
                return Outcome(self.best, key, self.nodes)
            key = max(key, self.instance.round_up(bound))
            self._search_again(queue[0][0] if queue else key, deadline)
            for child in children:
                pushed += 1
                heapq.heappush(queue, (key, depth - 1, -pushed, child))
        return Outcome(self.best, self.cost, self.nodes)

    def _search_again(self, bound: float, deadline: Deadline) -> None:
        """Look for a better cover again each time the tree has doubled."""
        if self.nodes < _FIRST_RETRY or self.nodes & (self.nodes - 1):
            return
        if self.cost < min(self.local.cost, self.ceiling):
            self.local.best = self.best
        enough = bound if np.isinf(self.ceiling) else self.instance.goal(self.ceiling)
        self.local.run(self.nodes * _STEPS_PER_NODE, enough, deadline)
        self.best = self.local.best

    def _everything(self) -> Node:
        alive = np.ones(self.instance.shape[0], bool)
        return Node(alive, ~alive)

    def _strengthen(
        self, node: Node, solution: Solution, rounds: int, deadline: Deadline
    ) -> Solution:
        """Cuts at a node, as long as they raise its bound by a part of what is missing.

        Cuts by parity join once the others no longer halve what is missing.
        """
        goal = self.instance.goal(self.cost)
        bounds = [solution.bound]
        while len(bounds) <= rounds and not solution.exceeds(goal):
            fast = len(bounds) == 1 or bounds[-1] - bounds[-2] > goal - bounds[-1]
            stronger = self.relaxation.strengthen(node, solution, goal, deadline, not fast)
            if stronger is solution or not (stronger.complete or stronger.exceeds(goal)):
                break
            solution = stronger
            bounds.append(solution.bound)
            rise = bounds[-1] - bounds[max(len(bounds) - 1 - _PATIENCE, 0)]
            if len(bounds) > _PATIENCE and rise < _LEAST_RISE * (goal - bounds[-1]):
                break
        return solution

    def _expand(self, node: Node, deadline: Deadline) -> tuple[float, tuple[Node, ...] | None]:
        """Bound and children of a node; None for children where time ran out."""
        self.nodes += 1
        node = Node(node.alive.copy(), node.fixed.copy(), node.path)
        while True:
            goal = self.instance.goal(self.cost)
            deadline.spend(_ENTRY_S * self.instance.by_choice.nnz)
            left = self._propagate(node)
            if left is None or self.instance.cost[node.fixed].sum() > goal:
                return np.inf, ()
            if (left <= 0).all() and self._keeps(node.fixed, node.path):
                self.best = node.fixed.copy()
                return np.inf, ()
            solution = self.relaxation.solve(node, goal, deadline)
            if solution.exceeds(goal):
                return solution.bound, ()
            if not solution.complete:
                return solution.bound, None
            if self._takes(solution):
                return solution.bound, ()
            tighter = self._tighten(node, solution)
            changed = (tighter.alive != node.alive).sum() + (tighter.fixed != node.fixed).sum()
            node = tighter
            if changed <= 0.05 * node.alive.sum():
                break
        return self._divide(node, solution, deadline)

    def _divide(
        self, node: Node, solution: Solution, deadline: Deadline
    ) -> tuple[float, tuple[Node, ...]]:
        """Bound and children of a node that only cuts can refute."""
        solution = self._strengthen(node, solution, _NODE_CUTS, deadline)
        if solution.exceeds(self.instance.goal(self.cost)) or self._takes(solution):
            return solution.bound, ()
        self.relaxation.purge(solution)
        return solution.bound, divide(self.relaxation, node, solution)

    def _propagate(self, node: Node) -> NDArray[np.int32] | None:
        """Needs left after forced rows; None where the node is infeasible. Changes the node."""
        instance = self.instance
        extra = self.relaxation.members(node.path)
        feasible, left, free = propagate(*arrays(instance), instance.need, instance.group,
                                         node.alive, node.fixed, extra)  # fmt: skip
        if not feasible:
            return None
        if self._bits is not None:
            unmet = extra[~(extra & node.fixed).any(axis=1)]
            drop_dominated_choices(*arrays(instance), self._bits, instance.cost, instance.group,
                                   left, free, node.alive, node.fixed, unmet)  # fmt: skip
        return left

    def _keeps(self, chosen: NDArray[np.bool_], path: tuple[int, ...]) -> bool:
        return all(chosen[self.relaxation.branches[k]].any() for k in path)

    def _takes(self, solution: Solution) -> bool:
        """Whether a solution is a cover; it becomes the best where it costs less."""
        whole = np.abs(solution.x - np.round(solution.x)).max() < _WHOLE
        chosen = solution.x > 0.5
        if whole and float(self.instance.cost[chosen].sum()) < self.cost:
            self.best = chosen
        return bool(whole)

    def _tighten(self, node: Node, solution: Solution) -> Node:
        """Fix rows whose other value costs more than the goal by the reduced costs alone."""
        goal = self.instance.goal(self.cost)
        free = node.alive & ~node.fixed
        dear = free & (solution.bound + np.maximum(solution.reduced_cost, 0) > goal)
        needed = free & (solution.bound - np.minimum(solution.reduced_cost, 0) > goal)
        both = dear & needed
        return Node(node.alive & ~dear | both, node.fixed | (needed & ~both), node.path)
