"""Search tree that proves a cover optimal or finds a cheaper one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools, Ints32
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.kernels import drop_dominated_choices, pack_bits, propagate
from roadsight.setcover.common.problem import OWN, Instance, is_within
from roadsight.setcover.common.reductions import MAX_BITS, arrays, shrink, split_components
from roadsight.setcover.common.relaxation import Node, Relaxation, Solution
from roadsight.setcover.common.tree import (
    BestFirst,
    choices_of_both,
    divide_by_choice,
    divide_by_choices,
    is_settled,
    tighten,
)
from roadsight.setcover.cover.enumeration import enumerate_covers
from roadsight.setcover.cover.local_search import (
    MOST_SPARE,
    LocalSearch,
    LongSearch,
    search_while_it_pays,
)

_WHOLE = 1e-6  # shares nearer to a whole number are whole: ten times the solver's tolerance
_FIRST_RETRY = 32  # nodes before local search is tried again: smaller trees end soon
# Steps of local search by node of the tree, each time the tree has doubled. More of them take work
# from the proof, fewer leave the tree to refute covers that local search would have found.
_STEPS_PER_NODE = 400
_ENTRY_S = 4e-9  # work of a propagation by entry of the matrix, in seconds, measured


@dataclass(frozen=True)
class Outcome:
    """Best cover of an instance (None: none found) and its proven bound, in steps.

    ``proved_by``: "own", or "highs" where the bound is that solver's.
    """

    best: Bools | None
    bound: float
    nodes: int
    proved_by: str = OWN


class Search(BestFirst):
    """Tree over the relaxation of an instance.

    With whole costs all nodes of one rounded-up bound are equal, so that the search goes deep until
    that cost is refuted or reached, and its bound rises step by step: it is proven at any time.

    With a ``ceiling``, only covers that cost less count, and the first of them ends the search.
    ``long`` is the local search that shares the time, if any.
    """

    def __init__(
        self,
        relaxation: Relaxation,
        local: LocalSearch,
        gap: float,
        ceiling: float = np.inf,
        long: LongSearch | None = None,
    ) -> None:
        super().__init__(gap)
        self.relaxation, self.local = relaxation, local
        self.ceiling, self._long = ceiling, long
        self.instance: Instance = relaxation.instance
        self._closing = Closing(relaxation, local, gap, ceiling, long)
        choices, targets = self.instance.shape
        matrix = self.instance.by_choice
        small = choices * targets <= MAX_BITS
        self._bits = pack_bits(matrix.indptr, matrix.indices, targets) if small else None

    @property
    def cost(self) -> float:
        """Cost that a cover must go below to count, in steps."""
        return min(self.local.cost, self.ceiling)

    @property
    def goal(self) -> float:
        """Largest bound that still allows a cover that counts, in steps."""
        return self.instance.goal(self.cost)

    @property
    def best(self) -> Bools | None:
        """Best cover so far."""
        return self.local.best

    def strengthen(self, root: Solution, deadline: Deadline) -> Solution:
        """Cuts at the root, as long as they pay, and local search between them."""
        return self._closing.strengthen(self._everything(), root, deadline, at_root=True)

    def run(self, root: Solution, deadline: Deadline) -> Outcome:
        """Search below the root, whose relaxation is solved."""
        bound = self.prove(self.start(root), self.round_up(root.bound), deadline)
        return Outcome(self.best, self.cost if bound is None else bound, self.nodes)

    def start(self, root: Solution) -> Node:
        """What reduced costs leave of everything."""
        return tighten(self._everything(), root.bound, root.reduced_cost, self.goal)

    def round_up(self, bound: float) -> float:
        """Bound lifted to the next possible cost, in steps."""
        return self.instance.round_up(bound)

    def is_enough(self, bound: float, deadline: Deadline) -> bool:
        """Whether a cover below the ceiling is found, the gap is reached, or work is out."""
        below = self.cost < self.ceiling < np.inf
        return below or deadline.passed() or is_within(self.gap, self.cost, bound)

    def cut_short(self, bound: float, below: float, waiting: Sequence[float]) -> float:
        """Bound of the node before it was expanded: its relaxation was not solved to the end."""
        return bound

    def between(self, bound: float, deadline: Deadline) -> None:
        """Look for a better cover beside the tree, and each time the tree has doubled."""
        enough = bound if np.isinf(self.ceiling) else self.instance.goal(self.ceiling)
        if self._long is not None:
            self._long.catch_up(enough, deadline)
        if self.nodes < _FIRST_RETRY or self.nodes & (self.nodes - 1):
            return
        self.local.run(self.nodes * _STEPS_PER_NODE, enough, deadline)

    def expand(self, node: Node, deadline: Deadline) -> tuple[float, tuple[Node, ...] | None]:
        """Bound and children of a node; None for children where work ran out."""
        node = Node(node.alive.copy(), node.fixed.copy(), node.path)
        while True:
            goal = self.goal
            deadline.spend(_ENTRY_S * self.instance.by_choice.nnz)
            left = self._propagate(node)
            if left is None or self.instance.cost[node.fixed].sum() > goal:
                return np.inf, ()
            branches = (self.relaxation.branches[k] for k in node.path)
            if (left <= 0).all() and all(node.fixed[choices].any() for choices in branches):
                self.local.best = node.fixed.copy()
                return np.inf, ()
            solution = self.relaxation.solve(node, goal, deadline)
            if solution.exceeds(goal):
                return solution.bound, ()
            if not solution.complete:
                return solution.bound, None
            if self._takes(solution):
                return solution.bound, ()
            before = node
            node = tighten(before, solution.bound, solution.reduced_cost, self.goal)
            if is_settled(before, node):
                break
        return self._divide(node, solution, deadline)

    def _divide(
        self, node: Node, solution: Solution, deadline: Deadline
    ) -> tuple[float, tuple[Node, ...]]:
        """Bound and children of a node that only cuts can refute."""
        solution = self._closing.strengthen(node, solution, deadline)
        if solution.exceeds(self.goal) or self._takes(solution):
            return solution.bound, ()
        self.relaxation.purge(solution)
        if (node.alive == node.fixed).all():
            return solution.bound, (node,)  # nothing is free: it is a cover or none
        return solution.bound, divide(self.relaxation, node, solution)

    def _everything(self) -> Node:
        alive = np.ones(self.instance.shape[0], bool)
        return Node(alive, ~alive)

    def _propagate(self, node: Node) -> Ints32 | None:
        """Needs left after forced choices; None where the node is infeasible. Changes the node."""
        instance = self.instance
        extra = self.relaxation.members(node.path)
        feasible, left, free = propagate(
            *arrays(instance), instance.need, instance.group, node.alive, node.fixed, extra
        )
        if not feasible:
            return None
        if self._bits is not None:
            unmet = extra[~(extra & node.fixed).any(axis=1)]
            drop_dominated_choices(
                *arrays(instance),
                self._bits,
                instance.cost,
                instance.group,
                left,
                free,
                node.alive,
                node.fixed,
                unmet,
            )
        return left

    def _takes(self, solution: Solution) -> bool:
        """Whether a solution is a cover that nothing below its node is cheaper than.

        It becomes the best where it costs less. Shares that are whole within the solver's
        tolerance may cost less than the cover: the bound decides.
        """
        if np.abs(solution.x - np.round(solution.x)).max() >= _WHOLE:
            return False
        chosen, instance = solution.x > 0.5, self.instance
        if instance.is_cover(chosen) and float(instance.cost[chosen].sum()) < self.cost:
            self.local.best = chosen
        return solution.exceeds(self.goal)


# Proof on a core: the few targets that keep covers from being cheaper.
#
# A cover of all targets covers those of the core, so that what the core cannot be covered for is
# refuted for all. Its instance is far smaller, and many of its choices are alike. A cheap cover
# of the core either covers everything, or leaves targets open that join the core.

# Share of all targets that is still a core: with more of them the proof is hardly easier, and may
# have to begin again once other targets join.
_LARGEST_SHARE = 0.5
_STEPS = 2_000  # steps of local search after a cover of the core that leaves targets open
# Outcome of an instance: its best cover, or any that costs less than a ceiling.
SolvePart = Callable[[Instance, Deadline, float], Outcome]


def is_small(local: LocalSearch) -> bool:
    """Whether the targets that a local search looks at are few enough to be a core."""
    return float(local.active.mean()) <= _LARGEST_SHARE


def prove_on_core(
    local: LocalSearch, bound: float, solve: SolvePart, deadline: Deadline, gap: float
) -> Outcome:
    """Prove the best cover of a local search, or find cheaper ones, on the targets it looks at.

    Parameters
    ----------
    bound : known before, in steps. solve : how a core is solved.
    gap : share of the cost that is close enough to the bound.
    """
    instance, nodes = local.instance, 0
    while True:
        outcome = _on_core(local, solve, deadline)
        nodes += outcome.nodes
        bound = max(bound, outcome.bound)
        if bound > instance.goal(local.cost):
            return Outcome(local.best, local.cost, nodes)
        if outcome.best is None or deadline.passed() or is_within(gap, local.cost, bound):
            return Outcome(local.best, bound, nodes)
        if not local.accept(outcome.best):
            local.run(_STEPS, bound, deadline)


def _on_core(local: LocalSearch, solve: SolvePart, deadline: Deadline) -> Outcome:
    """Proven bound of the core, and a cover of it (of the whole instance's choices) if cheap."""
    instance = local.instance
    everything = np.ones(instance.shape[0], bool)
    core, taken, feasible = shrink(instance.select(everything, local.active), ~everything)
    if not feasible:
        return Outcome(None, np.inf, 0)
    parts = sorted(split_components(core), key=lambda part: part.by_choice.nnz)
    chosen = np.isin(instance.choice, taken)
    bound, nodes = float(instance.cost[chosen].sum()), 0
    for number, part in enumerate(parts):
        ceiling = local.cost - bound if len(parts) == 1 else np.inf
        outcome = solve(part, deadline.part(len(parts) - number), ceiling)
        bound, nodes = bound + outcome.bound, nodes + outcome.nodes
        if outcome.best is None:
            return Outcome(None, bound, nodes)
        chosen |= np.isin(instance.choice, part.choice[outcome.best])
    cheap = float(instance.cost[chosen].sum()) < local.cost
    return Outcome(chosen if cheap else None, bound, nodes)


# So many targets of the highest duals are compared in pairs. The bound rises by the duals, so that
# pairs of others promise less; a larger number takes time by its square.
_PAIRED_TARGETS = 80
# Pairs whose common share is nearer to a whole number than this count as decided: what is left may
# be the solver's tolerance, and a division by it changes next to nothing.
_FRACTION = 1e-3


def divide(relaxation: Relaxation, node: Node, solution: Solution) -> tuple[Node, Node]:
    """Two nodes that share out all covers of ``node``.

    Neighbouring candidates are nearly equal, so forbidding one changes little. Instead two targets
    are taken whose common choices have a fractional share in total: either none of these choices is
    taken, or at least one is (the rule of Ryan and Foster for partitioning, here for covering).
    Where there are no such targets, the node is divided by one choice.
    """
    choices = _shared_choices(relaxation.instance, node, solution)
    if choices is None:
        free, x = node.alive & ~node.fixed, solution.x
        nearness = np.where(free, np.minimum(x, 1 - x), -1.0)
        if nearness.max() <= 0:  # whole already: the free choice of the largest share
            nearness = np.where(free, x, -1.0)
        return divide_by_choice(node, int(np.argmax(nearness)))
    return divide_by_choices(node, choices, relaxation.add_branch(choices))


def _shared_choices(instance: Instance, node: Node, solution: Solution) -> Ints32 | None:
    """Free choices that cover both of the two targets whose division promises most."""
    tight = np.flatnonzero(solution.target_dual > 1e-9)
    dual = solution.target_dual[tight]
    order = np.argsort(-dual, kind="stable")[:_PAIRED_TARGETS]
    tight, dual = tight[order], dual[order]
    free = node.alive & ~node.fixed
    support = np.flatnonzero((solution.x > 1e-9) & free)
    # Sparse, because the order of sums in a dense product depends on the number of threads.
    covers = instance.by_choice[support][:, tight].astype(np.float64)
    share = (covers.T @ sparse.diags_array(solution.x[support]) @ covers).toarray()
    first, second = np.triu_indices(len(tight), 1)
    fraction = np.minimum(share, 1 - share)[first, second]
    if not len(fraction) or fraction.max() < _FRACTION:
        return None
    score = np.where(fraction < _FRACTION, -1.0, fraction * np.minimum(dual[first], dual[second]))
    best = int(np.argmax(score))
    return choices_of_both(instance.by_target, tight[first[best]], tight[second[best]], free)


# Nodes are closed: cuts raise their bound, and what is left near it is enumerated.

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
