"""Nodes are closed: cuts raise their bound, and what is left near it is enumerated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import is_within
from roadsight.setcover.common.relaxation import Node, Relaxation, Solution
from roadsight.setcover.cover.enumeration import enumerate_covers
from roadsight.setcover.cover.local_search import (
    MOST_SPARE,
    LocalSearch,
    LongSearch,
    search_while_it_pays,
)

_ROOT_CUTS = 40  # most rounds of cuts at the root; on corridors two to thirteen do
_NODE_CUTS = 2  # most rounds of cuts at a node of the tree, where dividing does more
# Bounds that are known when local search is long once: after three rounds of cuts it shows how many
# choices may be spared. Between all rounds it took all of a minute's work on a highway with 16
# channels (25 sensors, bound 18 instead of 19).
_LONG_SEARCH = 4
_PATIENCE = 3  # rounds whose rise is looked at together: single ones may stand still
_LEAST_RISE = 0.05  # cuts end where a round closes less than this share of what is missing
# So many mean costs before the goal the relaxation stops for enumeration: there, bounds often stand
# still on a whole number for thousands of simplex steps.
_NEAR = 0.1
# Least slack for enumeration, in mean costs. Exactly at the goal, where 1,604 choices had no
# reduced cost, it excluded 5 of 659 nodes.
_LEAST_SLACK = 1e-3
_NODE_SLACK = 0.15  # most slack for enumeration below the root, in mean costs: nodes must be quick
_ROOT_SLACK = 0.5  # the same at the root: its work grows steeply with the slack
_ENUMERATED = 0.25  # share of the relaxation's work that enumerations may take
_LESS_SLACK = 0.85  # it is tried again at a node once the slack is this share of the last one tried


class Closing:
    """Strengthens relaxations until no cover that counts is left, or it does not pay any more.

    Parameters
    ----------
    local : keeps the best cover. gap : share of its cost that is close enough to the bound.
    ceiling : covers have to cost less to count, too, and the first that does is enough.
    long : local search that shares the time, if any.
    """

    def __init__(
        self,
        relaxation: Relaxation,
        local: LocalSearch,
        gap: float,
        ceiling: float,
        long: LongSearch | None = None,
    ) -> None:
        self.relaxation, self.local, self._long = relaxation, local, long
        self.gap, self.ceiling = gap, ceiling
        self._mean_cost = float(relaxation.instance.cost.mean())
        self._tried, self._enumerated_s = np.inf, 0.0

    @property
    def goal(self) -> float:
        """What a cover may cost to count, in steps."""
        return self.relaxation.instance.goal(min(self.local.cost, self.ceiling))

    def strengthen(
        self, node: Node, solution: Solution, deadline: Deadline, at_root: bool = False
    ) -> Solution:
        """Rounds of cuts, as long as they raise the bound by a part of what is missing.

        Cuts by parity join once the others no longer halve what is missing. At the root, there is
        local search between them while cover and bound are farther apart than enumeration reaches.
        """
        bounds, self._tried = [solution.bound], np.inf
        instance, rounds = self.relaxation.instance, _ROOT_CUTS if at_root else _NODE_CUTS
        while True:
            solution = self._enumerate(node, solution, deadline)
            # No cover that counts is left, or what is known of them is enough.
            cost, bound = min(self.local.cost, self.ceiling), instance.round_up(solution.bound)
            found = self.local.cost < self.ceiling < np.inf
            if found or solution.exceeds(self.goal) or is_within(self.gap, cost, bound):
                return solution
            if len(bounds) > rounds:
                return solution
            fast = len(bounds) == 1 or bounds[-1] - bounds[-2] > self.goal - bounds[-1]
            stronger = self._cut(node, solution, not fast, deadline, at_root)
            if stronger is solution or not (stronger.complete or stronger.exceeds(self.goal)):
                return solution
            solution = stronger
            bounds.append(solution.bound)
            if at_root:
                if self._long is not None:
                    enough = solution.bound if np.isinf(self.ceiling) else self.goal
                    self._long.catch_up(enough, deadline)
                most_spare = MOST_SPARE if len(bounds) == _LONG_SEARCH else 1
                search_while_it_pays(self.local, solution.bound, deadline, _ROOT_SLACK, most_spare)
            rise = bounds[-1] - bounds[max(len(bounds) - 1 - _PATIENCE, 0)]
            if len(bounds) > _PATIENCE and rise < _LEAST_RISE * (self.goal - bounds[-1]):
                return solution

    def _cut(
        self, node: Node, solution: Solution, parity: bool, deadline: Deadline, at_root: bool
    ) -> Solution:
        """Solution with more cuts, itself where there are none.

        Near the goal, where the simplex method takes its longest ways and often stands still, it
        makes way for the enumeration first.
        """
        near = self.goal - _NEAR * self._mean_cost
        stop = near if solution.bound < near else self.goal
        stronger = self.relaxation.strengthen(node, solution, stop, deadline, parity)
        if stronger.complete or stronger.exceeds(self.goal) or not stronger.exceeds(stop):
            return stronger
        stronger = self._enumerate(node, stronger, deadline)
        if at_root:
            search_while_it_pays(self.local, stronger.bound, deadline)
        if stronger.exceeds(self.goal):
            return stronger
        return self.relaxation.solve(node, self.goal, deadline)

    def _enumerate(self, node: Node, solution: Solution, deadline: Deadline) -> Solution:
        """Solution, its bound lifted to the goal's cost where no cover that counts is left.

        It takes a part of the relaxation's work at most, and is tried again only where the slack is
        a good deal smaller.
        """
        instance = self.relaxation.instance
        share = _NODE_SLACK if node.path or node.fixed.any() else _ROOT_SLACK
        least, most = _LEAST_SLACK * self._mean_cost, share * self._mean_cost
        while least <= (slack := self.goal - solution.bound) <= most:
            left_s = _ENUMERATED * self.relaxation.work_s - self._enumerated_s
            if slack > _LESS_SLACK * self._tried or left_s <= 0:
                break
            self._tried = slack
            answer = enumerate_covers(instance, node, solution, self.goal, left_s)
            self._enumerated_s += answer.work_s
            deadline.spend(answer.work_s)
            if answer.excluded:
                return replace(solution, bound=min(self.local.cost, self.ceiling))
            if answer.cover is None or not self.local.accept(answer.cover):
                break
        return solution
