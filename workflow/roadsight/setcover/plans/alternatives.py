"""How unique an answer is: what can replace a choice, and how different others can be."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from roadsight.base import SEED
from roadsight.base.arrays import Bools, Ints
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import objective_step
from roadsight.setcover.cover.solve import solve_cover_problem
from roadsight.setcover.plans.deploy import solve_deployment
from roadsight.setcover.plans.deployment import Deployment


@dataclass(frozen=True)
class Different:
    """Another answer, no dearer and seeing no less, that shares as few places as can be.

    Parameters
    ----------
    chosen : its sorted choices. shared : how many of them stand at a place of the first answer.
    least_shared : proven: in every such answer at least so many do.
    """

    chosen: Ints
    shared: int
    least_shared: int


def replacements(deployment: Deployment, chosen: Ints) -> list[Ints]:
    """For each choice taken the sorted others that could replace it alone, as cheap and as good.

    Mandatory ones have none. ``chosen`` must be an allowed answer.
    """
    scaled, *_ = deployment.normalised()
    return [_replacing(scaled, chosen, int(choice)) for choice in chosen]


def _replacing(deployment: Deployment, chosen: Ints, choice: int) -> Ints:
    problem = deployment.problem
    if problem.mandatory[choice]:
        return np.empty(0, np.int64)
    rest = chosen[chosen != choice]
    mask = np.zeros(len(problem.costs), np.int32)
    mask[rest] = 1
    count = np.asarray(problem.matrix[rest].sum(axis=0, dtype=np.int64)).ravel()
    lost = (count == problem.at_least - 1) & (problem.at_least > 0)
    lost_by_it = lost & (np.asarray(problem.matrix[[choice]].todense()).ravel() > 0)
    crowded = deployment.exclusive.T @ (deployment.exclusive @ mask > 0) > 0
    cost, charge = np.asarray(deployment.cost), np.asarray(deployment.charge)
    left = deployment.spendable - charge[rest].sum()
    fits = (mask == 0) & ~problem.forbidden & ~crowded & (charge <= left)
    fits &= np.abs(cost - cost[choice]) <= 1e-9 * max(1.0, cost[choice])
    weight = np.asarray(deployment.weights)
    needed = lost_by_it.astype(np.float64) if deployment.complete else np.where(lost, weight, 0.0)
    gain = problem.matrix @ needed
    if deployment.complete or not deployment.keep:
        fits &= gain >= gain[choice] - 1e-9 * max(1.0, gain[choice])
    fits[choice] = False
    found = np.flatnonzero(fits)
    if deployment.keep:
        goal = deployment.objective(chosen) + 1e-9
        as_good = [deployment.objective(np.sort(np.append(rest, one))) <= goal for one in found]
        found = found[np.array(as_good, bool)] if len(found) else found
    return found.astype(np.int64)


def most_different(
    deployment: Deployment,
    chosen: Ints,
    place: Ints,
    limit: Deadline | float | None = None,
    seed: int = SEED,
) -> Different:
    """Answer, no dearer and seeing no less, that shares the fewest places with ``chosen``.

    With a price, answers that see more for as much more money are as good too, but other choices.

    Parameters
    ----------
    place : (choices,) number of the place of each choice, such as one for all heights of a pole.
    """
    shared = np.isin(place, place[chosen])
    plain = deployment.complete and not deployment.keep and not len(deployment.cliques)
    step = objective_step(np.asarray(deployment.cost)) if plain else 0.0
    if step and not math.isfinite(deployment.budget):
        # As a cover whose costs count the overlap last.
        both = np.round(np.asarray(deployment.cost) / step) * (len(chosen) + 1) + shared
        old = both[chosen].sum() - shared[chosen].sum()
        cover = solve_cover_problem(deployment.problem.changed(costs=both), limit, seed)
        found = cover.chosen if cover.objective <= both[chosen].sum() else chosen
        bound = max(cover.bound - old, 0.0)
    else:
        found, bound = _by_deployment(deployment, chosen, shared, limit, seed)
    overlap = int(shared[found].sum())
    return Different(found, overlap, min(math.ceil(bound - 1e-6), overlap))


def _by_deployment(
    deployment: Deployment, chosen: Ints, shared: Bools, limit: Deadline | float | None, seed: int
) -> tuple[Ints, float]:
    """As a deployment that minimises the overlap within the cost and coverage that there are."""
    cost = np.asarray(deployment.cost)
    costs_count = bool(cost.any())
    value = 0.0 if deployment.complete else deployment.guaranteed(chosen)
    asked = replace(
        deployment,
        cost=shared.astype(np.float64),
        worth=0.0,
        charge=cost if costs_count else deployment.charge,
        budget=math.fsum(cost[chosen]) if costs_count else deployment.budget,
        floor=value * (1 - 1e-12),
    )
    cover = solve_deployment(asked, limit, seed, starts=[chosen]).cover
    return cover.chosen, cover.bound
