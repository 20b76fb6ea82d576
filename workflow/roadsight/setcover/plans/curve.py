"""Coverage against cost: the best deployment for each of several budgets."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base import SEED
from roadsight.base.arrays import Floats, Ints
from roadsight.base.errors import InputError
from roadsight.setcover.common.cuts import Constraint
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import (
    HIGHS,
    INFEASIBLE,
    OPTIMAL,
    OWN,
    TIME_LIMIT,
    WITHIN_GAP,
    Cover,
    CoverProblem,
    is_within,
)
from roadsight.setcover.plans.deploy import solve_deployment
from roadsight.setcover.plans.deployment import Deployment
from roadsight.setcover.plans.whole import solve_whole


@dataclass(frozen=True)
class CurvePoint:
    """Best deployment within one budget.

    Parameters
    ----------
    budget : what the charges may add up to. spent : what they do. chosen : sorted choices.
    value : weight that is covered (guaranteed, where a share must be kept), 0 for no choices.
    bound : no deployment within the budget covers more. status : as of a cover.
    """

    budget: float
    spent: float
    chosen: Ints
    value: float
    bound: float
    status: str


def coverage_curve(
    deployment: Deployment,
    budgets: Sequence[float],
    limit: Deadline | float | None = None,
    seed: int = SEED,
    gap: float = 0.0,
    known: Sequence[Ints] = (),
    full: float = 0.0,
    solver: str = OWN,
) -> list[CurvePoint]:
    """Points for increasing budgets; values and bounds never fall.

    Each budget starts from the choices and the cuts of the one before, which is less work than to
    solve each by itself: cuts on coverage hold for any budget. Budgets that cannot pay for the
    mandatory choices have no point.

    Parameters
    ----------
    deployment : its budget, worth, cost and floor are replaced. known : choices to begin with.
    full : no smaller budget than this sees everything, as is known from elsewhere.
    solver : "own", or "highs" for each budget by itself (`solve_whole`).

    Raises
    ------
    InputError : no budget pays for the mandatory choices.
    """
    deadline = limit if isinstance(limit, Deadline) else Deadline(limit)
    choices = len(deployment.problem.costs)
    base = replace(deployment, complete=False, worth=1.0, cost=np.zeros(choices), floor=0.0)
    points: list[CurvePoint] = []
    pool: list[Constraint] = []
    ordered = sorted(set(budgets))
    for number, budget in enumerate(ordered):
        asked = replace(base, budget=budget)
        starts = [*(p.chosen for p in points[-1:]), *known]
        part = deadline.part(len(ordered) - number)
        if solver == HIGHS:
            cover = solve_whole(asked, part, gap)
        else:
            found = solve_deployment(asked, part, seed, gap, starts, pool)
            cover, pool = found.cover, found.pool or pool
        if cover.status != INFEASIBLE and math.isfinite(cover.objective):
            bound = -cover.bound
            weights = np.asarray(asked.weights)[asked.problem.at_least > 0]
            if not asked.keep and budget < full * (1 - 1e-9) and (weights > 0).all():
                # A budget that does not see everything leaves out one target at least.
                bound = min(bound, asked.total - float(weights.min(initial=0.0)))
            spent = math.fsum(np.asarray(asked.charge)[cover.chosen])
            value = asked.guaranteed(cover.chosen)
            bound = max(bound, value)
            points.append(CurvePoint(budget, spent, cover.chosen, value, bound, ""))
    if not points:
        raise InputError("no budget pays for the mandatory rows", where="curve", found=ordered)
    # What a larger budget cannot reach, a smaller one cannot either.
    least = math.inf
    result = []
    for point in reversed(points):
        least = max(min(least, point.bound), point.value)
        proven = -least > base.goal(-point.value)
        bound = point.value if proven else least
        within = WITHIN_GAP if is_within(gap, point.value, bound) else TIME_LIMIT
        result.append(replace(point, bound=bound, status=OPTIMAL if proven else within))
    return result[::-1]


def spread_budgets(least: float, most: float, points: int, step: float) -> list[float]:
    """About so many budgets from least to most, multiples of ``step`` where that is above 0."""
    values = np.linspace(least, most, points)
    if step > 0:
        values = np.unique(np.ceil(values / step - 1e-9)) * step
    return [float(v) for v in np.minimum(values, most)]


def maximise_coverage(
    problem: CoverProblem,
    budget: float,
    weights: ArrayLike | None = None,
    time_limit_s: float | None = None,
) -> Cover:
    """Choices within a budget that cover the greatest weight of targets.

    maximise ``sum w_j y_j`` subject to ``y_j <= sum_i a_ij x_i``, ``sum c_i x_i <= budget`` and at
    most one choice of a group. ``at_least`` is not used: a target counts once it is covered once.

    Parameters
    ----------
    weights : (targets,) finite, 0 or more; None = 1 each.

    Returns
    -------
    objective is the covered weight, ``bound`` an upper bound of it.

    Raises
    ------
    InputError : the budget or a weight is not usable, or the mandatory choices do not fit.
    """
    start = time.process_time()
    once = problem.changed(at_least=1)
    deployment = budgeted(once, budget, None if weights is None else np.asarray(weights))
    cover = solve_deployment(deployment, time_limit_s).cover
    seconds = time.process_time() - start
    return replace(cover, objective=-cover.objective, bound=-cover.bound, seconds_cpu=seconds)


def budgeted(problem: CoverProblem, budget: float, weights: Floats | None) -> Deployment:
    """Deployment of the greatest weight within a budget.

    Raises
    ------
    InputError : the budget or a weight is not usable, or the mandatory choices do not fit.
    """
    if not (np.isfinite(budget) and budget >= 0):
        raise InputError("is not usable", where="budget", found=budget, allowed="0 or more")
    deployment = Deployment(
        problem,
        weights,  # type: ignore[arg-type]
        complete=False,
        worth=1.0,
        cost=np.zeros(len(problem.costs)),
        charge=problem.costs,
        budget=float(budget),
    )
    if deployment.broken(np.flatnonzero(problem.mandatory)):
        raise InputError(
            "the mandatory rows do not fit the budget and the groups", where="budget", found=budget
        )
    return deployment
