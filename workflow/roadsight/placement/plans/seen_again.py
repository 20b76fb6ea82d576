"""Of the plans of one cost, the one whose sensors see the most targets again."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.setcover.common.result import OPTIMAL, Cover
from roadsight.setcover.plans.deployment import Deployment
from roadsight.setcover.plans.second import chosen_again


def stretches(station_m: Floats, cell_m: float) -> Ints:
    """Number of the stretch of road (n,) of each target, from 0; ``cell_m``: length of each."""
    number = np.floor(station_m / cell_m)
    return np.unique(number, return_inverse=True)[1].reshape(-1).astype(np.int64)


def applies(deployment: Deployment) -> bool:
    """Whether a plan has a second objective: it sees all targets, and no share is to be kept.

    A budget or a price weighs coverage itself, and a share to be kept has its own redundancy.
    """
    return deployment.complete and not deployment.keep


def see_again(
    deployment: Deployment,
    cover: Cover,
    limit_s: float,
    stretch: Ints | None,
    cell_m: float,
    allowed: Bools | None,
    gap: float,
) -> tuple[Cover, dict[str, Any] | None]:
    """A cover of the same cost that sees the most targets once more than asked, and its record.

    Of these, the one that sees the most twice more, and then the one on the longest road of which
    sensors see the same targets. Status, objective and bound of the cover are about the cost.

    Parameters
    ----------
    limit_s : limit of work; 0: the cover stays as it is, without a record.
    stretch : (targets,) as `stretches` gives it; ``cell_m``: length of each.
    allowed : (choices,) that may be taken beside the forbidden ones; None: all.
    gap : share of the cost that was allowed for its proof.

    Returns
    -------
    the cover, with the CPU time of both; shares of the weight, metres and status (`Second`)
    """
    if not limit_s > 0 or not len(cover.chosen) or not applies(deployment):
        return cover, None
    whole_choice = True
    if allowed is not None and not allowed.all():
        problem = deployment.problem
        forbidden = np.flatnonzero(problem.forbidden | ~allowed)
        deployment = replace(deployment, problem=problem.changed(forbidden=forbidden))
        whole_choice = False
    cover, found = chosen_again(deployment, cover, WorkLimit(limit_s), stretch, gap)
    proven = whole_choice and cover.status == OPTIMAL and found.proven
    whole = found.total or 1.0
    record = {
        "once_more": found.value[0] / whole,
        "once_more_before": found.before[0] / whole,
        "once_more_bound": found.bound / whole,
        "twice_more": found.value[1] / whole,
        "twice_more_before": found.before[1] / whole,
        "status": "optimal" if proven else "time_limit",
    }
    if stretch is not None:
        record["shared_road_m"] = found.stretches * cell_m
        record["shared_road_m_before"] = found.stretches_before * cell_m
    return cover, record
