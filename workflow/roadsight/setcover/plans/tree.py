"""Branch and cut over the relaxation of a deployment."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Floats, Ints, Ints32
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.relaxation import Node
from roadsight.setcover.common.result import is_within
from roadsight.setcover.plans.construct import Builder
from roadsight.setcover.plans.master import Master, Relaxed

_WHOLE = 1e-6
_ROOT_ROUNDS, _ROUNDS = 200, 12
_ROOT_STEPS, _STEPS, _LAST_STEPS = 200, 2, 2_000
_DIVES = 20
_PAIRED_TARGETS = 80
_FRACTION = 0.02


@dataclass(frozen=True)
class Proof:
    """Proven bound of the objective, and the nodes of the tree."""

    bound: float
    nodes: int


class Tree:
    """Best bound first, the deepest of equals first."""

    def __init__(self, master: Master, builder: Builder, gap: float = 0.0) -> None:
        self.master, self.builder, self.gap = master, builder, gap
        self.deployment = builder.deployment
        self.nodes = 0

    def run(self, floor: float, deadline: Deadline) -> Proof:
        """Search until proven, within the gap or out of work; ``floor``: a bound known before."""
        problem = self.deployment.problem
        node = Node(~problem.forbidden, problem.mandatory.copy())
        queue = [(max(floor, -np.inf), 0, 0, node)]
        pushed = 0
        while queue:
            bound, depth, _, node = queue[0]
            if bound > self.deployment.goal(self.builder.value):
                break
            if self.nodes and self._enough(bound, deadline):
                return Proof(bound, self.nodes)
            heapq.heappop(queue)
            below, children = self._expand(node, deadline)
            below = max(self.deployment.round_up(below), bound)
            if children is None:
                return Proof(min([below, *(entry[0] for entry in queue)]), self.nodes)
            for child in children:
                pushed += 1
                heapq.heappush(queue, (below, depth - 1, -pushed, child))
        return Proof(max(self.builder.value, floor), self.nodes)

    def _enough(self, bound: float, deadline: Deadline) -> bool:
        constant = self.deployment.worth * self.deployment.total
        value = self.builder.value
        if self.deployment.cost.any():
            value, bound = value + constant, bound + constant
        return deadline.passed() or is_within(self.gap, value, bound)

    def _expand(self, node: Node, deadline: Deadline) -> tuple[float, list[Node] | None]:
        """Bound and children of a node; None for children where work ran out."""
        self.nodes += 1
        root = self.nodes == 1
        rounds = _ROOT_ROUNDS if root else _ROUNDS
        while True:
            goal = self.deployment.goal(self.builder.value)
            answer = self.master.solve(node, goal, deadline.part(2) if root else deadline, rounds)
            if answer.bound > goal or answer.bound == np.inf:
                return answer.bound, []
            if not answer.complete:
                self.builder.improve(_LAST_STEPS if root else 0, answer.bound, deadline)
                return answer.bound, None
            self._build(answer, root, deadline)
            tighter = self._tighten(node, answer)
            changed = (tighter.alive != node.alive).sum() + (tighter.fixed != node.fixed).sum()
            node = tighter
            whole = np.minimum(answer.x, 1 - answer.x).max(initial=0.0) < _WHOLE
            if whole and self._forbid(np.flatnonzero(answer.x > 0.5)):
                continue
            if changed <= 0.05 * node.alive.sum() or not changed:
                break
        self.master.purge()
        if answer.bound > self.deployment.goal(self.builder.value):
            return answer.bound, []
        if (node.alive == node.fixed).all():
            self.builder.offer(np.flatnonzero(node.fixed))
            return answer.bound, []
        return answer.bound, self._divide(node, answer)

    def _forbid(self, chosen: Ints) -> bool:
        """Add what whole rows that the relaxation allows break after all."""
        if self.builder.deployment.objective(chosen) < np.inf:
            self.builder.offer(chosen)
            return False
        found = self.master.cuts.forbids(chosen)
        self.master.add(found)
        return bool(found)

    def _build(self, answer: Relaxed, root: bool, deadline: Deadline) -> None:
        """Deployments near the relaxation, more of them at the root and as the tree doubles."""
        power = not self.nodes & (self.nodes - 1)
        if self.nodes <= _DIVES or power:
            self.builder.build(np.flatnonzero(answer.x > 1 - _WHOLE), answer.x + 0.02)
            self.builder.build(np.empty(0, np.int64), answer.x + 1e-3)
        if power:
            steps = _ROOT_STEPS if root else _STEPS * self.nodes
            goal = answer.bound if root else -np.inf
            self.builder.improve(steps, goal, deadline)

    def _tighten(self, node: Node, answer: Relaxed) -> Node:
        """Fix rows whose other value costs more than the goal by the reduced costs alone."""
        goal = self.deployment.goal(self.builder.value)
        free = node.alive & ~node.fixed
        dear = free & (answer.bound + np.maximum(answer.reduced_cost, 0) > goal)
        needed = free & (answer.bound - np.minimum(answer.reduced_cost, 0) > goal)
        both = dear & needed
        return Node(node.alive & ~dear | both, node.fixed | (needed & ~both), node.path)

    def _divide(self, node: Node, answer: Relaxed) -> list[Node]:
        """Two nodes that share out all deployments of ``node``: some rows give none, or one."""
        rows = self._shared_rows(node, answer.x)
        free = node.alive & ~node.fixed
        if rows is None:
            nearness = np.where(free, np.minimum(answer.x, 1 - answer.x), -1.0)
            if nearness.max() < _WHOLE:  # whole already: the row whose value is least certain
                nearness = np.where(free, answer.x + 1e-3, -1.0)
            row = int(np.argmax(nearness))
            without, fixed = node.alive.copy(), node.fixed.copy()
            without[row], fixed[row] = False, True
            return [Node(without, node.fixed, node.path), Node(node.alive, fixed, node.path)]
        without = node.alive.copy()
        without[rows] = False
        branch = self.master.add_branch(rows)
        return [
            Node(without, node.fixed, node.path),
            Node(node.alive, node.fixed, (*node.path, branch)),
        ]

    def _shared_rows(self, node: Node, x: Floats) -> Ints32 | None:
        """Free rows that see both of the two targets (or one) whose division promises most."""
        cuts, free = self.master.cuts, node.alive & ~node.fixed
        support = np.flatnonzero((x > 1e-9) & free)
        targets = self._fractional_targets(cuts.count(np.where(free, x, 0.0)))
        if not len(targets) or not len(support):
            return None
        sees = cuts.rows[support][:, targets].astype(np.float64)
        share = (sees.T @ sparse.diags_array(x[support]) @ sees).toarray()
        first, second = np.triu_indices(len(targets))
        fraction = np.minimum(share, 1 - share)[first, second]
        if fraction.max() < _FRACTION:
            return None
        weight = np.minimum(cuts.weight[targets[first]], cuts.weight[targets[second]])
        best = int(np.argmax(fraction * np.maximum(weight, 1e-9)))
        start, index = cuts.columns.indptr, cuts.columns.indices
        one, two = (
            index[start[t] : start[t + 1]] for t in (targets[first[best]], targets[second[best]])
        )
        shared = np.intersect1d(one, two)
        return shared[free[shared]].astype(np.int32)

    def _fractional_targets(self, count: Floats) -> Ints:
        """Some targets that free rows see in part or just once, spread over all of them."""
        near = np.flatnonzero((count > _FRACTION) & (count < 1 + _WHOLE))
        near = near[self.master.cuts.weight[near] > 0] if not self.deployment.complete else near
        if len(near) <= _PAIRED_TARGETS:
            return near
        return near[np.linspace(0, len(near) - 1, _PAIRED_TARGETS).astype(np.int64)]
