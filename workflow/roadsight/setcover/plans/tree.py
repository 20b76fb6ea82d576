"""Branch and cut over the relaxation of a deployment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Floats, Ints, Ints32
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.relaxation import Node
from roadsight.setcover.common.result import is_within
from roadsight.setcover.common.tree import (
    BestFirst,
    choices_of_both,
    divide_by_choice,
    divide_by_choices,
    is_settled,
    tighten,
)
from roadsight.setcover.plans.construct import Builder
from roadsight.setcover.plans.master import Master, Relaxed

_WHOLE = 1e-6
"""Shares nearer than this to a whole number are whole: ten times the solver's own tolerance."""
_ROOT_ROUNDS = 200
"""Most rounds of cuts at the root: its cuts hold for the whole tree and are found once."""
_ROUNDS = 12
"""Most rounds of cuts at other nodes; what is still violated there is left to their children."""
_ROOT_STEPS = 200
"""Trials of the greedy search at the root: a good answer there keeps the tree small."""
_STEPS = 2
"""Trials by node of the tree, each time the tree has doubled."""
_LAST_STEPS = 2_000
"""Most trials where the root's half of the work is out: no tree will come, so what is left goes to
better answers. With the two, a budget of 15 sensors sees 17,669 of 20,000 targets on 1 km of road
after 60 s, where it saw 16,639."""
_DIVES = 20
"""At so many first nodes an answer is built from the relaxation; later only as the tree doubles."""
_PAIRED_TARGETS = 80
"""Targets that are compared in pairs; a larger number takes time by its square."""
_FRACTION = 0.02
"""Pairs whose common share is nearer to a whole number than this are no use: one half of the node
would be nearly the node itself."""


@dataclass(frozen=True)
class Proof:
    """Proven bound of the objective, and the nodes of the tree."""

    bound: float
    nodes: int


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

    def run(self, floor: float, deadline: Deadline) -> Proof:
        """Search until proven, within the gap or out of work; ``floor``: a bound known before."""
        problem = self.deployment.problem
        start = Node(~problem.forbidden, problem.mandatory.copy())
        bound = self.prove(start, floor, deadline)
        return Proof(max(self.builder.value, floor) if bound is None else bound, self.nodes)

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
            self._build(answer, root, deadline)
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
        targets = self._fractional_targets(cuts.count(np.where(free, x, 0.0)))
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

    def _fractional_targets(self, count: Floats) -> Ints:
        """Some targets that free choices see in part or just once, spread over all of them."""
        near = np.flatnonzero((count > _FRACTION) & (count < 1 + _WHOLE))
        near = near[self.master.cuts.weight[near] > 0] if not self.deployment.complete else near
        if len(near) <= _PAIRED_TARGETS:
            return near
        return near[np.linspace(0, len(near) - 1, _PAIRED_TARGETS).astype(np.int64)]
