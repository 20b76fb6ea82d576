"""Deployments with proof: the best choices for everything that a plan asks for."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from roadsight.base import SEED
from roadsight.base.arrays import Ints
from roadsight.setcover.common.cuts import Constraint
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import (
    INFEASIBLE,
    OPTIMAL,
    TIME_LIMIT,
    WITHIN_GAP,
    Cover,
    CoverProblem,
    infeasible,
    is_within,
    relative_gap,
)
from roadsight.setcover.cover.solve import solve_cover_problem
from roadsight.setcover.plans.construct import Builder
from roadsight.setcover.plans.cuts import Cuts
from roadsight.setcover.plans.deployment import ROUNDED, Deployment
from roadsight.setcover.plans.tree import Master, Tree
from roadsight.setcover.plans.whole import any_allowed

_STEPS = 2_000  # trials of the greedy search between two covers that are not proven
_FAR_APART = 2.0**20  # ratio of costs beyond which dear choices are looked for
# The cover without further conditions, which bounds the answer, has one of so many shares of the
# work.
_COVER_SHARES = 3


@dataclass(frozen=True)
class Deployed:
    """A deployment found, and what other ones may start from.

    ``objective`` and ``bound`` of the cover are those of the deployment (a minimum).
    """

    cover: Cover
    pool: list[Constraint]


def solve_deployment(
    deployment: Deployment,
    limit: Deadline | float | None = None,
    seed: int = SEED,
    gap: float = 0.0,
    starts: Iterable[Ints] = (),
    pool: list[Constraint] | None = None,
) -> Deployed:
    """Best choices, proven, or the best ones found within the limit.

    Where every target must be seen, the cover without the further conditions is solved first: it
    bounds the answer and is one where it meets them. The rest is branch and cut: cuts in the space
    of choices, a greedy search that takes out and fills again, and a tree that divides by whether
    two targets share a choice. The answer depends on the seed alone, as that of
    `solve_cover_problem` does.

    Parameters
    ----------
    starts : sorted choices to begin with; those that are not allowed are mended.
    pool : cuts of a deployment that differs in budget, worth or floor alone.
    """
    start = time.process_time()
    if deployment.out_of_reach:
        return Deployed(infeasible(start), [])
    deadline = limit if isinstance(limit, Deadline) else Deadline(limit)
    deployment, unit, _ = _affordable(deployment).normalised()
    builder = Builder(Cuts(deployment), np.random.default_rng(seed))
    floor = -deployment.worth * deployment.total
    if deployment.complete:
        floor = _by_cover(deployment, builder, deadline, seed, gap)
        if math.isinf(floor):
            return Deployed(infeasible(start), [])
    for chosen in starts:
        builder.offer(chosen)
        builder.build(chosen)
    builder.build(np.empty(0, np.int64))
    proof, nodes, pool = floor, 0, pool or []
    if floor <= deployment.goal(builder.value):
        master = Master(builder.cuts, pool)
        tree = Tree(master, builder, gap)
        proof = tree.run(floor, deadline)
        nodes, pool = tree.nodes, master.pool()
    if builder.best is None and math.isfinite(proof):
        if (allowed := any_allowed(deployment, deadline)) is None:
            return Deployed(infeasible(start), pool)
        builder.offer(allowed)
    found = _assemble(deployment, builder, proof, nodes, start, gap)
    return Deployed(
        replace(found, objective=found.objective * unit, bound=found.bound * unit), pool
    )


def solve_costly_cover(
    problem: CoverProblem, limit: Deadline, seed: int = SEED, gap: float = 0.0
) -> Cover:
    """Cheapest cover where many choices differ in cost, as `solve_cover_problem` finds it.

    Where half of the work does not prove it, the cover of the fewest choices and what a greedy
    search makes of both are tried as well: costs that differ a little from place to place lead
    astray.
    """
    start = time.process_time()
    cover = solve_cover_problem(problem, limit.part(2), seed, gap)
    if cover.status != TIME_LIMIT or (problem.costs == problem.costs[0]).all():
        return cover
    ones = problem.changed(costs=None)
    builder = Builder(Cuts(Deployment(problem)), np.random.default_rng(seed))
    for chosen in (cover.chosen, solve_cover_problem(ones, limit.part(2), seed).chosen):
        builder.offer(chosen)
    builder.improve(_STEPS, cover.bound, limit)
    if builder.best is None or builder.value >= cover.objective:
        return cover
    value, bound = builder.value, min(cover.bound, builder.value)
    proven = bound > builder.deployment.goal(value)
    return replace(
        cover,
        status=OPTIMAL if proven else WITHIN_GAP if is_within(gap, value, bound) else TIME_LIMIT,
        chosen=builder.best,
        objective=value,
        bound=value if proven else bound,
        gap=0.0 if proven else relative_gap(value, bound),
        seconds_cpu=time.process_time() - start,
    )


def _by_cover(
    deployment: Deployment, builder: Builder, deadline: Deadline, seed: int, gap: float
) -> float:
    """Bound by the cheapest cover, whose choices are a start; infinite where there is none."""
    problem, cost = deployment.problem, np.asarray(deployment.cost)
    least = -deployment.worth * deployment.total
    if not (cost > 0).all():
        return least
    costly = problem.changed(costs=cost)
    cover = solve_cover_problem(costly, deadline.part(_COVER_SHARES), seed, gap)
    if cover.status == INFEASIBLE:
        return math.inf
    if len(cover.chosen):
        builder.offer(cover.chosen)
        builder.build(cover.chosen)
    return cover.bound + least


def _affordable(deployment: Deployment) -> Deployment:
    """Without choices that cost more than everything does elsewhere, where costs are far apart.

    They would set the scale of costs, and tolerances with it.
    """
    cost = np.asarray(deployment.cost)
    if cost.max(initial=0.0) <= _FAR_APART * cost[cost > 0].min(initial=math.inf):
        return deployment
    builder = Builder(Cuts(deployment), np.random.default_rng(SEED))
    builder.build(np.empty(0, np.int64))
    worth = deployment.worth * deployment.total
    most = builder.value + worth + ROUNDED * worth  # the sum may cancel but for its rounding
    dear = (cost > most * (1 + 1e-9)) & ~deployment.problem.mandatory
    banned = np.flatnonzero(deployment.problem.forbidden | dear)
    problem = deployment.problem.changed(forbidden=banned)
    return replace(deployment, problem=problem, cost=np.where(dear, most, cost))


def _assemble(
    deployment: Deployment, builder: Builder, bound: float, nodes: int, start: float, gap: float
) -> Cover:
    if builder.best is None and math.isinf(bound) and bound > 0:
        return infeasible(start, nodes=nodes)
    value = builder.value
    proven = bound > deployment.goal(value)
    bound = value if proven else min(deployment.round_up(bound), value)
    shift = deployment.shift
    near = is_within(gap, value + shift, bound + shift)
    choices, targets = deployment.problem.matrix.shape
    return Cover(
        OPTIMAL if proven else WITHIN_GAP if near else TIME_LIMIT,
        np.empty(0, np.int64) if builder.best is None else builder.best,
        value,
        bound,
        relative_gap(value + shift, bound + shift),
        time.process_time() - start,
        reductions={"rows": choices, "columns": targets},
        nodes=nodes,
    )
