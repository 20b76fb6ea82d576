"""The search tree of covers and of deployments: best bound first, nodes tightened and divided."""

from __future__ import annotations

import heapq
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints32
from roadsight.setcover.common.deadline import Deadline, Patience
from roadsight.setcover.common.relaxation import Node

# Share of a node's choices. Where tightening changes more, the relaxation is solved again before
# the node is divided; where it changes less, the next bound would hardly be higher.
_FEW_CHANGES = 0.05


class BestFirst(ABC):
    """Search of a tree, the node of the lowest bound first, the deepest of equals first.

    What is asked, and how a node is bounded and divided, is told by subclasses.

    Attributes
    ----------
    nodes : expanded so far.
    """

    def __init__(self, gap: float) -> None:
        self.gap = gap
        self.nodes = 0

    @property
    @abstractmethod
    def goal(self) -> float:
        """Largest bound below which something better than the best so far may lie."""

    @abstractmethod
    def round_up(self, bound: float) -> float:
        """Bound lifted to the next possible objective."""

    @abstractmethod
    def is_enough(self, bound: float, deadline: Deadline) -> bool:
        """Whether to stop here: near enough to what is proven, or out of work."""

    @abstractmethod
    def expand(self, node: Node, deadline: Deadline) -> tuple[float, tuple[Node, ...] | None]:
        """Bound and children of a node; None for children where work ran out."""

    def between(self, bound: float, deadline: Deadline) -> None:  # noqa: B027 (may stay as it is)
        """What is done between two nodes, given the bound of the next."""

    def cut_short(self, bound: float, below: float, waiting: Sequence[float]) -> float:
        """Bound that is proven where work runs out inside a node.

        Parameters
        ----------
        bound : of the node before it was expanded. below : of its children. waiting : of all other
            nodes that are left.
        """
        return min([below, *waiting])

    def prove(self, start: Node, bound: float, deadline: Deadline) -> float | None:
        """Bound that is proven where the search stops early; None where nothing better is left.

        Parameters
        ----------
        start : holds all answers that count. bound : of it.
        """
        # Entries are numbered downwards, so that of equals as deep the latest comes first.
        queue = [(bound, 0, 0, start)]
        pushed = 0
        patience = Patience(deadline)
        while queue:
            bound, depth, _, node = queue[0]
            if bound > self.goal:
                return None
            # The root is always tried, and something is always looked for until it is found.
            stalled = patience.is_over((self.goal, bound)) and bool(pushed)
            if self.is_enough(bound, deadline) or (stalled and np.isfinite(self.goal)):
                return bound
            heapq.heappop(queue)
            self.nodes += 1
            below, children = self.expand(node, deadline)
            below = max(self.round_up(below), bound)
            if children is None:
                return self.cut_short(bound, below, [entry[0] for entry in queue])
            if queue or children:
                self.between(queue[0][0] if queue else below, deadline)
            for child in children:
                pushed += 1
                heapq.heappush(queue, (below, depth - 1, -pushed, child))
        return None


def tighten(node: Node, bound: float, reduced_cost: Floats, goal: float) -> Node:
    """Fix choices whose other value costs more than the goal by the reduced costs alone.

    Where both values do, nothing of the node is left; such a choice stays as it is, and the bound
    tells.
    """
    free = node.alive & ~node.fixed
    dear = free & (bound + np.maximum(reduced_cost, 0) > goal)
    needed = free & (bound - np.minimum(reduced_cost, 0) > goal)
    both = dear & needed
    return Node(node.alive & ~dear | both, node.fixed | (needed & ~both), node.path)


def is_settled(before: Node, after: Node) -> bool:
    """Whether tightening has changed too little to solve the relaxation again."""
    changed = (after.alive != before.alive).sum() + (after.fixed != before.fixed).sum()
    return bool(changed <= _FEW_CHANGES * after.alive.sum())


def divide_by_choice(node: Node, choice: int) -> tuple[Node, Node]:
    """Nodes without and with one choice."""
    without, fixed = node.alive.copy(), node.fixed.copy()
    without[choice], fixed[choice] = False, True
    return Node(without, node.fixed, node.path), Node(node.alive, fixed, node.path)


def divide_by_choices(node: Node, choices: Ints32, branch: int) -> tuple[Node, Node]:
    """Nodes with none of some choices, and with one of them at least.

    Parameters
    ----------
    branch : number of the branch constraint that one of ``choices`` is taken.
    """
    without = node.alive.copy()
    without[choices] = False
    return (
        Node(without, node.fixed, node.path),
        Node(node.alive, node.fixed, (*node.path, branch)),
    )


def choices_of_both(by_target: sparse.csc_matrix, first: int, second: int, free: Bools) -> Ints32:
    """Free choices that cover both of two targets, sorted."""
    start, index = by_target.indptr, by_target.indices
    one, two = (index[start[t] : start[t + 1]] for t in (first, second))
    shared = np.intersect1d(one, two)
    return shared[free[shared]].astype(np.int32)
