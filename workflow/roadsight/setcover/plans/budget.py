"""Best coverage for a budget."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.setcover.common.problem import CoverProblem
from roadsight.setcover.common.result import Cover
from roadsight.setcover.plans.deploy import solve_deployment
from roadsight.setcover.plans.deployment import Deployment


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
