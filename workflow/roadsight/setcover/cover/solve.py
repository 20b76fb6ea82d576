"""Minimum-cost covers with proof."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from roadsight.base.arrays import Bools
from roadsight.base.seeds import SEED
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import CoverProblem, Instance
from roadsight.setcover.common.reductions import Reduced, reduce_problem
from roadsight.setcover.common.relaxation import Node, Relaxation, Solution
from roadsight.setcover.common.result import (
    HIGHS,
    INFEASIBLE,
    OPTIMAL,
    OWN,
    TIME_LIMIT,
    WITHIN_GAP,
    Cover,
    is_within,
    relative_gap,
)
from roadsight.setcover.cover.core import is_small, prove_on_core
from roadsight.setcover.cover.handover import branch_by_highs, is_for_highs
from roadsight.setcover.cover.interior import interior_bound, is_large
from roadsight.setcover.cover.local_search import (
    FIRST_STEPS,
    LocalSearch,
    greedy_cover,
    search_while_it_pays,
)
from roadsight.setcover.cover.long_search import LongSearch
from roadsight.setcover.cover.search import Outcome, Search

_TRIAL = 8
"""Part of the limit in which all parts of a problem are tried once: easy ones are done with then,
and hard ones share what is left."""


def solve_cover_problem(
    problem: CoverProblem,
    limit: Deadline | float | None = None,
    seed: int = SEED,
    gap: float = 0.0,
) -> Cover:
    """Cheapest cover, proven, or the best one found within the limit.

    Reductions, a linear relaxation that targets join as they are violated, greedy and local search,
    cuts and enumeration, then a search tree over the relaxation. The answer depends on the seed
    alone, also where a `WorkLimit` is reached, but not where a limit by the clock (a number of
    seconds) is. Neither does it depend on the unit of cost. Costs that are no multiples of a common
    step (`objective_step`) are proven to 1e-7 of the objective. With ``gap``, each part of the
    problem is left as soon as its cover is proven to cost at most that share too much. Parts that
    share nothing are tried for a while, the smallest first; what they leave of the limit goes to
    those that this was not enough for.
    """
    start = time.process_time()
    deadline = limit if isinstance(limit, Deadline) else Deadline(limit)
    reduced = reduce_problem(problem)
    if len(reduced.uncoverable) or not reduced.feasible:
        return _infeasible(reduced, start)
    parts = sorted(reduced.parts, key=lambda part: part.by_choice.nnz)
    solved = _solve_parts(parts, np.random.default_rng(seed), deadline, gap)
    if any(one.impossible for one in solved):
        return _infeasible(reduced, start)
    return _assemble(problem, reduced, solved, start, gap)


@dataclass(frozen=True)
class _Solved:
    """A part (what is left of it), its outcome, the bound of its relaxation, all in its steps.

    ``short``: it had less work than it asked for.
    """

    part: Instance
    outcome: Outcome
    relaxed: float | None
    short: bool

    @property
    def proven(self) -> bool:
        """Whether nothing cheaper is left."""
        return _proven(self.part, self.outcome.best, self.outcome.bound)

    @property
    def impossible(self) -> bool:
        """Whether there is no cover."""
        return self.outcome.best is None and not np.isfinite(self.outcome.bound)


def _solve_parts(
    parts: list[Instance], rng: np.random.Generator, deadline: Deadline, gap: float
) -> list[_Solved]:
    """Parts one by one, all with a little work first, then what is not proven with all the rest."""
    solved: list[_Solved] = []
    had_s = np.zeros(len(parts))
    for number, part in enumerate(parts):
        share = deadline.part(_TRIAL * (len(parts) - number)) if len(parts) > 1 else deadline
        had_s[number] = share.left_s()
        solved.append(_solve_share(part, rng, share, gap))
        if solved[-1].impossible:
            return solved
    tried = True
    while tried and not deadline.passed():
        tried = False
        short = [number for number, one in enumerate(solved) if one.short]
        for place, number in enumerate(short):
            share = deadline.part(len(short) - place)
            if share.left_s() > had_s[number]:  # it begins anew, but for the cover
                tried, had_s[number] = True, share.left_s()
                before = solved[number]
                again = _solve_share(before.part, rng, share, gap, before.outcome.best)
                solved[number] = _better(before, again)
    return solved


def _solve_share(
    part: Instance,
    rng: np.random.Generator,
    share: Deadline,
    gap: float,
    known: Bools | None = None,
) -> _Solved:
    """One part within its share of the limit, from a cover that is known, if any."""
    best = greedy_cover(part) if known is None else known
    part, best = _affordable(part, best)
    outcome, relaxed = _solve_part(part, best, rng, share, gap)
    cost = math.inf if outcome.best is None else float(part.cost[outcome.best].sum())
    enough = _proven(part, outcome.best, outcome.bound) or is_within(gap, cost, outcome.bound)
    return _Solved(part, outcome, relaxed, share.passed() and not enough)


def _affordable(part: Instance, best: Bools | None) -> tuple[Instance, Bools | None]:
    """Without choices that cost more than a whole cover does: they would set the scale of costs."""
    if best is None:
        return part, best
    dear = part.cost > part.cost[best].sum()
    if not dear.any():
        return part, best
    left = part.select(~dear, np.ones(part.shape[1], bool))
    return left.rescaled(), best[~dear]


def _better(first: _Solved, second: _Solved) -> _Solved:
    """Of two tries of one part the cheaper cover and the higher bound."""
    scale = second.part.step / first.part.step
    bound = max(first.outcome.bound / scale, second.outcome.bound)
    nodes = first.outcome.nodes + second.outcome.nodes
    return replace(second, outcome=Outcome(second.outcome.best, bound, nodes))


def _solve_part(
    instance: Instance,
    best: Bools | None,
    rng: np.random.Generator,
    deadline: Deadline,
    gap: float,
) -> tuple[Outcome, float | None]:
    """Outcome of one instance from a cover, if any, and the bound of its relaxation, in steps."""
    bound = instance.round_up(_simple_bound(instance))
    if _enough(instance, best, bound, gap) or deadline.passed():
        return Outcome(best, bound, 0), None
    if is_large(instance) and best is not None:
        return _solve_large(instance, best, rng, deadline, gap)
    relaxation, root = _root(instance, np.inf, deadline.part(2))
    if np.isinf(root.bound):
        return Outcome(None, np.inf, 0), None
    bound = max(bound, instance.round_up(root.bound))
    local = LocalSearch(instance, best, root.target_dual > 0, rng)
    local.run(FIRST_STEPS, bound, deadline)
    if _enough(instance, local.best, bound, gap):
        return Outcome(local.best, bound, 0), root.bound
    if not root.complete:  # no tree will come, so what is left goes to better covers
        LongSearch(local, root.reduced_cost, deadline).to_the_end(bound, deadline)
        return Outcome(local.best, bound, 0), root.bound
    long = LongSearch(local, root.reduced_cost, deadline)
    long.ahead(bound, deadline)
    search = Search(relaxation, local, gap, long=long)
    return _cut_and_branch(search, root, bound, rng, deadline), root.bound


def _cut_and_branch(
    search: Search, root: Solution, bound: float, rng: np.random.Generator, deadline: Deadline
) -> Outcome:
    """Outcome of an instance whose root is solved: by cuts alone, else on a core or by a tree."""
    instance, local, gap = search.instance, search.local, search.gap
    cut = search.strengthen(root, deadline)
    bound = min(max(bound, instance.round_up(cut.bound)), local.cost)
    if _enough(instance, local.best, bound, gap) or deadline.passed():
        return Outcome(local.best, bound, 0)
    node = search.start(cut)
    if local.best is not None and is_for_highs(instance, node, local.best, cut.bound):
        return branch_by_highs(instance, node, local.best, bound, deadline, gap)
    if is_small(local):
        local.active[search.relaxation.targets_inside()] = True
        return _prove(local, bound, rng, deadline, gap)
    outcome = search.run(cut, deadline)
    return Outcome(outcome.best, max(outcome.bound, bound), outcome.nodes)


def _solve_large(
    instance: Instance,
    best: Bools,
    rng: np.random.Generator,
    deadline: Deadline,
    gap: float,
) -> tuple[Outcome, float]:
    """Outcome of a large instance from a cover: at most a third of the time goes to a bound."""
    inner = interior_bound(instance, rng, deadline.part(3))
    bound = instance.round_up(max(inner.bound, _simple_bound(instance)))
    local = LocalSearch(instance, best, inner.target_dual > 0, rng)
    search_while_it_pays(local, bound, deadline)
    LongSearch(local, inner.reduced_cost, deadline).ahead(bound, deadline)
    if _enough(instance, local.best, bound, gap) or deadline.passed():
        return Outcome(local.best, bound, 0), inner.bound
    return _prove(local, bound, rng, deadline, gap), inner.bound


def _prove(
    local: LocalSearch, bound: float, rng: np.random.Generator, deadline: Deadline, gap: float
) -> Outcome:
    """Proof on the targets that a local search looks at, or a cheaper cover."""
    solve = partial(_solve_core, rng=rng, gap=gap)
    return prove_on_core(local, bound, solve, deadline, gap)


def _solve_core(
    core: Instance, deadline: Deadline, ceiling: float, rng: np.random.Generator, gap: float
) -> Outcome:
    """A cover of a core that costs less than a ceiling, or the proof that there is none.

    Without a ceiling, the cheapest cover.
    """
    goal = core.goal(ceiling)
    relaxation, root = _root(core, goal, deadline)
    bound = core.round_up(root.bound)
    if root.exceeds(goal):
        return Outcome(None, bound, 0)
    local = LocalSearch(core, greedy_cover(core), root.target_dual > 0, rng)
    enough = core.round_up(bound if np.isinf(ceiling) else goal)
    local.run(FIRST_STEPS, enough, deadline)
    if local.cost <= enough or not root.complete:
        return Outcome(local.best, bound, 0)
    long = LongSearch(local, root.reduced_cost, deadline)
    search = Search(relaxation, local, gap, ceiling, long)
    outcome = search.run(search.strengthen(root, deadline), deadline)
    return Outcome(outcome.best, max(outcome.bound, bound), outcome.nodes)


def _root(instance: Instance, goal: float, deadline: Deadline) -> tuple[Relaxation, Solution]:
    """Relaxation of an instance, solved, or stopped once its bound exceeds the goal."""
    relaxation = Relaxation(instance)
    everything = np.ones(instance.shape[0], bool)
    return relaxation, relaxation.solve(Node(everything, ~everything), goal, deadline)


def _proven(instance: Instance, best: Bools | None, bound: float) -> bool:
    return best is not None and bound > instance.goal(float(instance.cost[best].sum()))


def _enough(instance: Instance, best: Bools | None, bound: float, gap: float) -> bool:
    if best is None:
        return False
    within = is_within(gap, float(instance.cost[best].sum()), bound)
    return within or _proven(instance, best, bound)


def _simple_bound(instance: Instance) -> float:
    """Each target pays the least share of cost that one of its choices asks of its targets."""
    share = instance.cost / np.maximum(np.diff(instance.by_choice.indptr), 1)
    by_target = instance.by_target
    if not by_target.nnz:
        return 0.0
    least = np.minimum.reduceat(share[by_target.indices], by_target.indptr[:-1])
    return float((least * instance.need).sum())


def _infeasible(reduced: Reduced, start: float) -> Cover:
    return Cover(
        INFEASIBLE,
        np.empty(0, np.int64),
        math.inf,
        math.inf,
        0.0,
        time.process_time() - start,
        reduced.uncoverable,
        reduced.counts,
    )


def _assemble(
    problem: CoverProblem, reduced: Reduced, solved: list[_Solved], start: float, gap: float
) -> Cover:
    """Answer of the whole problem from those of its parts."""
    found = all(one.outcome.best is not None for one in solved)
    proven = all(one.proven for one in solved)
    base = math.fsum(problem.costs[reduced.taken])
    bound = base + math.fsum(one.outcome.bound * one.part.step for one in solved)
    taken = [one.part.choice[one.outcome.best] for one in solved if one.outcome.best is not None]
    chosen = np.sort(np.concatenate([reduced.taken, *taken])) if found else np.empty(0, np.int64)
    objective = math.fsum(problem.costs[chosen]) if found else math.inf
    bound = objective if proven else min(bound, objective)
    unproven = WITHIN_GAP if is_within(gap, objective, bound) else TIME_LIMIT
    relaxed = [math.nan if one.relaxed is None else one.part.step * one.relaxed for one in solved]
    lp = None if np.isnan(relaxed).any() else base + math.fsum(relaxed)
    return Cover(
        OPTIMAL if proven else unproven,
        chosen.astype(np.int64),
        objective,
        bound,
        relative_gap(objective, bound),
        time.process_time() - start,
        reduced.uncoverable,
        reduced.counts,
        lp,
        sum(one.outcome.nodes for one in solved),
        proved_by=HIGHS if any(o.outcome.proved_by == HIGHS for o in solved) else OWN,
    )
