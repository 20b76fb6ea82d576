"""Minimum-cost covers with proof."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import partial

import highspy
import numpy as np
from scipy import sparse

from roadsight.base import SEED
from roadsight.base.arrays import Bools, Ints
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import (
    HIGHS,
    NEAR,
    OPTIMAL,
    OWN,
    TIME_LIMIT,
    WITHIN_GAP,
    Cover,
    CoverProblem,
    Instance,
    infeasible,
    is_within,
    relative_gap,
)
from roadsight.setcover.common.program import Program, run_program
from roadsight.setcover.common.reductions import Reduced, reduce_problem
from roadsight.setcover.common.relaxation import ROUNDING, Node, Relaxation, Solution, quiet_highs
from roadsight.setcover.cover.local_search import (
    FIRST_STEPS,
    LocalSearch,
    LongSearch,
    greedy_cover,
    search_while_it_pays,
)
from roadsight.setcover.cover.search import Outcome, Search, is_small, prove_on_core

# Part of the limit in which all parts of a problem are tried once: easy ones are done with then,
# and hard ones share what is left.
_TRIAL = 8


def solve_cover_problem(
    problem: CoverProblem, limit: Deadline | float | None = None, seed: int = SEED, gap: float = 0.0
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
        return infeasible(start, uncoverable=reduced.uncoverable, reductions=reduced.counts)
    parts = sorted(reduced.parts, key=lambda part: part.by_choice.nnz)
    solved = _solve_parts(parts, np.random.default_rng(seed), deadline, gap)
    if any(one.impossible for one in solved):
        return infeasible(start, uncoverable=reduced.uncoverable, reductions=reduced.counts)
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
                # Of both tries the cheaper cover and the higher bound.
                scale = again.part.step / before.part.step
                bound = max(before.outcome.bound / scale, again.outcome.bound)
                nodes = before.outcome.nodes + again.outcome.nodes
                best = Outcome(again.outcome.best, bound, nodes)
                solved[number] = replace(again, outcome=best)
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
    # Choices that cost more than a whole cover does would set the scale of costs.
    if best is not None and (dear := part.cost > part.cost[best].sum()).any():
        part = part.select(~dear, np.ones(part.shape[1], bool)).rescaled()
        best = best[~dear]
    outcome, relaxed = _solve_part(part, best, rng, share, gap)
    cost = math.inf if outcome.best is None else float(part.cost[outcome.best].sum())
    enough = _proven(part, outcome.best, outcome.bound) or is_within(gap, cost, outcome.bound)
    return _Solved(part, outcome, relaxed, share.passed() and not enough)


def _solve_part(
    instance: Instance, best: Bools | None, rng: np.random.Generator, deadline: Deadline, gap: float
) -> tuple[Outcome, float | None]:
    """Outcome of one instance from a cover, if any, and the bound of its relaxation, in steps."""
    bound = instance.round_up(_simple_bound(instance))
    if _enough(instance, best, bound, gap) or deadline.passed():
        return Outcome(best, bound, 0), None
    if is_large(instance) and best is not None:
        # At most a third of the time goes to a bound.
        inner = interior_bound(instance, rng, deadline.part(3))
        bound = instance.round_up(max(inner.bound, _simple_bound(instance)))
        local = LocalSearch(instance, best, inner.target_dual > 0, rng)
        search_while_it_pays(local, bound, deadline)
        LongSearch(local, inner.reduced_cost, deadline).ahead(bound, deadline)
        outcome = Outcome(local.best, bound, 0)
        if not (_enough(instance, local.best, bound, gap) or deadline.passed()):
            outcome = _prove(local, bound, rng, deadline, gap)
        return outcome, inner.bound
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


def _assemble(
    problem: CoverProblem, reduced: Reduced, solved: list[_Solved], start: float, gap: float
) -> Cover:
    """Answer of the whole problem from those of its parts."""
    found = all(one.outcome.best is not None for one in solved)
    proven = all(_proven(one.part, one.outcome.best, one.outcome.bound) for one in solved)
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


# Instances whose tree is left to HiGHS: what reduced costs leave of them is small.
#
# Our tree gains by what sensors along a road have in common: far more targets than its relaxation
# holds, and neighbours that are nearly alike. Where few entries are left, HiGHS has more to
# branch with: pseudo-costs, conflicts, cuts of many families.

_MOST_ENTRIES = 60_000  # entries that reduced costs leave, up to which HiGHS branches better
_TREE_TOLERANCE = 1e-6  # HiGHS's own: with 1e-9 the same trees took up to three times as long
_MOST_SPARE = 6.0  # mean costs that cover and bound may be apart for it: no tree closes more


def is_for_highs(instance: Instance, node: Node, best: Bools, bound: float) -> bool:
    """Whether HiGHS is to branch: decided by sizes and bound alone, so that runs agree."""
    width = np.diff(instance.by_choice.indptr)
    left = int(width[node.alive | best].sum())
    cost = instance.cost[best]
    spare = instance.goal(float(cost.sum())) - bound
    return left <= _MOST_ENTRIES and spare <= _MOST_SPARE * cost.mean()


def branch_by_highs(
    instance: Instance, node: Node, best: Bools, bound: float, deadline: Deadline, gap: float
) -> Outcome:
    """Outcome of an instance whose cheaper covers, if any, lie in a node.

    HiGHS is not told of the best cover: with it a tree of 60 choices and 400 targets took 28 CPU s,
    without 10.

    Parameters
    ----------
    node : choices that are not alive in it are in no cheaper cover. best : a cover.
    bound : known before, in steps.
    """
    cost = float(instance.cost[best].sum())
    alive = node.alive | best
    left = instance.select(alive, np.ones(instance.shape[1], bool))
    found = run_program(
        cover_program(left, (node.fixed & best)[alive]),
        deadline,
        gap if gap else 0.0 if instance.integral else NEAR / 2,
        1.0 if instance.integral else 0.0,
        tolerance=_TREE_TOLERANCE,
    )
    # Covers that the node leaves out cost more than the goal, by a step where there is one.
    beyond = cost if instance.integral else float(np.nextafter(instance.goal(cost), np.inf))
    bound = max(bound, min(instance.round_up(found.bound), beyond))
    if found.x is not None:
        chosen = np.zeros(len(best), bool)
        chosen[np.flatnonzero(alive)[found.x > 0.5]] = True
        if instance.is_cover(chosen) and float(instance.cost[chosen].sum()) < cost:
            best = chosen
    return Outcome(best, min(bound, float(instance.cost[best].sum())), found.nodes, HIGHS)


def cover_program(instance: Instance, fixed: Bools) -> Program:
    """Targets and groups of an instance as an integer program, some choices taken."""
    choices, targets = instance.shape
    member = np.flatnonzero(instance.group >= 0)
    groups = int(instance.group.max(initial=-1)) + 1
    shape = (groups, choices)
    sets = sparse.csr_matrix((np.ones(len(member)), (instance.group[member], member)), shape)
    return Program(
        instance.cost,
        sparse.vstack([instance.by_choice.T.astype(np.float64), sets], format="csr"),
        np.concatenate([instance.need.astype(np.float64), np.full(groups, -np.inf)]),
        np.concatenate([np.full(targets, np.inf), np.ones(groups)]),
        fixed.astype(np.float64),
        np.ones(choices),
        np.ones(choices, bool),
    )


# Bound of a large instance by interior points.
#
# The simplex method walks from vertex to vertex, the longer the more targets a road has. A bound
# asks for good duals only, which an interior point method finds in some twenty steps. Targets
# enter where the last shares leave them open, and leave without a dual. Groups are left out:
# without them a cover is at most cheaper.

# Choices x targets above which interior points are used: the published sizes have up to 17 million.
# 1 km of road took 16 s with them and 42 s with the simplex method; 250 m took that 0.9 s.
_LARGE = 40_000_000
_LEAST_TARGETS = 500  # the two shares below stand for so many targets at least
_FIRST_SHARE = 1 / 12  # share of all targets to begin with, drawn at random over the road
_ADDED_SHARE = 1 / 24  # share of all targets that join at once at most
_OPEN = 1e-3  # targets that lack more are open: interior points stop near the optimum, not at it
_IDLE = 1e-6  # targets whose dual is no more than this leave
_LEAST_RISE = 2e-3  # share by which a round must raise the bound to count as progress
_ACCURACY = 1e-5  # of the solver: any duals give a bound, and the last digits cost steps
_PATIENCE = 3  # rounds without progress that end it
_STEP_S = 3e-7  # work of a step by entry of the linear program, in seconds, measured


def is_large(instance: Instance) -> bool:
    """Whether interior points are faster than the simplex method: from some 500 m of road on."""
    choices, targets = instance.shape
    return choices * targets > _LARGE


def interior_bound(instance: Instance, rng: np.random.Generator, deadline: Deadline) -> Solution:
    """Relaxation with the best bound that was found, as far as it rises and time allows."""
    choices, targets = instance.shape
    inside = np.zeros(targets, bool)
    inside[rng.permutation(targets)[: _some(targets, _FIRST_SHARE)]] = True
    best = Solution(0.0, np.zeros(choices), instance.cost, np.zeros(targets), False)
    rounds_alike = 0
    while True:
        found = _solve(instance, np.flatnonzero(inside), deadline)
        rises = found.bound > (1 + _LEAST_RISE) * best.bound
        best = max(best, found, key=lambda one: one.bound)
        missing = np.where(inside, 0.0, instance.need - instance.by_choice.T @ found.x)
        entering = np.argsort(-missing, kind="stable")[: _some(targets, _ADDED_SHARE)]
        entering = entering[missing[entering] > _OPEN]
        rounds_alike = 0 if rises else rounds_alike + 1
        if deadline.passed() or rounds_alike == _PATIENCE or not len(entering):
            return best
        inside &= found.target_dual > _IDLE
        inside[entering] = True


def _some(targets: int, share: float) -> int:
    return max(_LEAST_TARGETS, round(share * targets))


def _solve(instance: Instance, targets: Ints, deadline: Deadline) -> Solution:
    """Relaxation on some targets."""
    choices = instance.shape[0]
    by_target = instance.by_choice[:, targets].T.tocsr()
    step_s = _STEP_S * by_target.nnz
    highs = quiet_highs(
        solver="ipm",
        run_crossover="off",
        presolve="off",
        ipm_optimality_tolerance=_ACCURACY,
        ipm_iteration_limit=deadline.count_left(step_s),
    )
    if np.isfinite(deadline.clock_left_s()):
        highs.setOptionValue("time_limit", max(deadline.clock_left_s(), 1e-3))
    highs.addVars(choices, np.zeros(choices), np.ones(choices))
    highs.changeColsCost(choices, np.arange(choices, dtype=np.int32), instance.cost)
    need = instance.need[targets].astype(np.float64)
    highs.addRows(
        len(targets),
        need,
        np.full(len(targets), highspy.kHighsInf),
        by_target.nnz,
        by_target.indptr[:-1].astype(np.int32),
        by_target.indices.astype(np.int32),
        np.ones(by_target.nnz),
    )
    highs.run()
    deadline.spend(step_s * max(highs.getInfo().ipm_iteration_count, 0))
    return _read(highs, instance, targets)


def _read(highs: highspy.Highs, instance: Instance, targets: Ints) -> Solution:
    """Shares and duals, all 0 where the method was stopped before it had any."""
    raw = highs.getSolution()
    share, row_dual = np.array(raw.col_value), np.array(raw.row_dual)
    whole = len(share) == instance.shape[0] and len(row_dual) == len(targets)
    if not (whole and np.isfinite(share).all() and np.isfinite(row_dual).all()):
        share, row_dual = np.zeros(instance.shape[0]), np.zeros(len(targets))
    dual = np.zeros(instance.shape[1])
    dual[targets] = np.maximum(row_dual, 0.0)
    reduced = instance.cost - instance.by_choice @ dual
    worth, refunds = float(dual @ instance.need), float(np.minimum(reduced, 0.0).sum())
    bound = worth + refunds - ROUNDING * (worth - refunds)
    complete = highs.getModelStatus() == highspy.HighsModelStatus.kOptimal
    return Solution(bound, np.clip(share, 0.0, 1.0), reduced, dual, complete)
