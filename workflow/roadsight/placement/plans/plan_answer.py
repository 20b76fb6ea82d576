"""Solves what a plan asks for, and says it in the terms of a report."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.errors import InputError
from roadsight.placement.plans.plan_problem import Asked, Posed
from roadsight.setcover.common.deadline import Effort, WorkLimit
from roadsight.setcover.common.problem import HIGHS, INFEASIBLE, OPTIMAL, Cover, objective_step
from roadsight.setcover.cover.solve import solve_cover_problem
from roadsight.setcover.plans.alternatives import most_different, replacements
from roadsight.setcover.plans.curve import coverage_curve, spread_budgets
from roadsight.setcover.plans.deploy import solve_costly_cover, solve_deployment
from roadsight.setcover.plans.deployment import Deployment
from roadsight.setcover.plans.second import chosen_again
from roadsight.setcover.plans.whole import solve_whole

_LISTED = 50  # interchangeable positions named for each sensor; their number is told in any case
# A cover of the same cost that is better in another way.
Better = Callable[[Deployment, Cover], Cover]


@dataclass(frozen=True)
class Answer:
    """Answer of a plan with options.

    Parameters
    ----------
    cover : its objective is the cost of the sensors; its bound that of the cost, or NaN where cost
        is not what is minimised.
    record : what solution.json says under ``options``.
    sensors : columns by chosen row. alternatives, different : rows, with what they replace.
    """

    cover: Cover
    record: dict[str, Any]
    sensors: pd.DataFrame
    alternatives: list[tuple[int, int]]
    different: Ints


def answer(
    asked: Asked,
    posed: Posed,
    choices: pd.DataFrame,
    candidates: pd.DataFrame,
    effort: Effort,
    seed: int,
    gap: float,
    better: Better | None = None,
) -> Answer:
    """Solve a plan; the curve and the alternatives have the same limit of work once more.

    ``better`` gives the cover that is shown instead of one of the same cost.

    Raises
    ------
    InputError : nothing meets what is asked, or nothing was found within the limit.
    """
    deployment = posed.deployment
    limit = effort.limit()
    plain = deployment.complete and not deployment.keep and not len(deployment.cliques)
    if effort.solver == HIGHS:
        cover = solve_whole(deployment, limit, gap)
    elif plain and math.isinf(deployment.budget):  # a plain cover by the solver for covers
        equal = len(np.unique(deployment.problem.costs)) == 1
        solve = solve_cover_problem if equal else solve_costly_cover
        cover = solve(deployment.problem, limit, seed, gap)
    else:
        cover = solve_deployment(deployment, limit, seed, gap).cover
    _check(asked, cover, effort.seconds)
    if better is not None:
        cover = better(deployment, cover)
    names = choices["candidate"].astype(str).to_numpy()
    position = choices["position"].to_numpy(np.int64)
    name = lambda row: str(names[row])  # noqa: E731
    # What the plan is for, with its value and its bound.
    goal = {"kind": "cost", "value": cover.objective, "bound": cover.bound}
    if "budget" in asked.options:
        goal = {"kind": "coverage", "value": -cover.objective, "bound": -cover.bound}
    elif "price" in asked.options:
        most = deployment.worth * deployment.total
        value, bound = cover.objective + most, cover.bound + most
        goal = {"kind": "cost and price", "value": value, "bound": bound}
    record = {"asked": asked.options, "goal": goal}
    record |= _targets_record(asked, posed, deployment, cover, name)
    if "curve" in asked.options:
        record["curve"] = _curve(asked, posed, cover, effort, seed, gap)
    swaps: list[tuple[int, int]] = []
    different = np.empty(0, np.int64)
    if asked.options.get("alternatives"):
        others = replacements(deployment, cover.chosen)
        # All heights of one place share its number.
        xy_m = candidates[["x", "y"]].to_numpy(np.float64)
        number = np.unique(xy_m, axis=0, return_inverse=True)[1].reshape(-1)
        place = number.astype(np.int64)[position]
        found = most_different(deployment, cover.chosen, place, effort.limit(), seed)
        swaps = [(k, int(row)) for k, rows in enumerate(others) for row in rows]
        different = found.chosen
        record["alternatives"] = {
            "replaceable": [len(rows) for rows in others],
            "by": [[name(row) for row in rows[:_LISTED]] for rows in others],
            "places": len(np.unique(place[cover.chosen])),
            "shared_places": found.shared,
            "least_shared_places": found.least_shared,
            "different": [name(row) for row in found.chosen],
        }
    # Weight that is no longer seen often enough when a sensor fails. How often is what the targets
    # need, not what a plan that survives failures makes of it.
    rows = deployment.problem.matrix[cover.chosen]
    count = np.asarray(rows.sum(axis=0, dtype=np.int64)).ravel()
    need = posed.targets["needed"].to_numpy(np.int64)
    weight = posed.targets["weight"].to_numpy(np.float64)
    sensors = pd.DataFrame(
        {
            "cost": deployment.problem.costs[cover.chosen],
            "loses": np.asarray(rows @ np.where((count == need) & (need > 0), weight, 0.0)),
            "mandatory": deployment.problem.mandatory[cover.chosen],
            "pole": [posed.pole[position[row]] for row in cover.chosen],
        }
    )
    if not deployment.complete:
        cost = math.fsum(deployment.problem.costs[cover.chosen])
        cover = replace(cover, objective=cost, bound=math.nan)
    return Answer(cover, record, sensors, swaps, different)


def _check(asked: Asked, cover: Cover, limit_s: float) -> None:
    if cover.status == INFEASIBLE:
        raise InputError(
            "no set of sensors meets what the plan asks for",
            where=asked.where,
            found=", ".join(sorted(asked.options)),
            hint="ask for less (spacing_m, keep_share, at_least), or for the best within a budget"
            " or price",
        )
    if not math.isfinite(cover.objective):
        raise InputError(
            "no set of sensors was found within the time limit",
            where=asked.where,
            found=f"{limit_s:g} s",
            hint="raise cover.time_limit_s, or ask for less (spacing_m, keep_share)",
        )


def _targets_record(
    asked: Asked, posed: Posed, deployment: Deployment, cover: Cover, name: Any
) -> dict[str, Any]:
    """Weight seen, folds that lack, and what a failure leaves."""
    needed = posed.targets["asked"].to_numpy(np.int64)
    weight = posed.targets["weight"].to_numpy(np.float64)
    rows = deployment.problem.matrix[cover.chosen]
    count = np.asarray(rows.sum(axis=0, dtype=np.int64)).ravel()
    seen = (count >= needed) & (needed > 0)
    critical = np.where(seen & (count == needed), weight, 0.0)
    lost = np.asarray(rows @ critical)
    covered = math.fsum(weight[seen])
    worst = int(np.argmax(lost)) if len(lost) else -1
    asked_weight = math.fsum(weight[needed > 0])
    own = posed.targets[posed.targets["asked"] != asked.at_least]  # another number than the plan's
    return {
        "weight": {"seen": covered, "of": asked_weight},
        "seen_targets": int(seen.sum()),
        "short": posed.short,
        "needs": dict(
            zip(own["target"].astype(str), own["asked"].astype(int).tolist(), strict=True)
        ),
        "forbidden_candidates": int(posed.forbidden.sum()),
        "failure": {
            "left_share": 1.0 if not covered else 1 - float(lost.max(initial=0.0)) / covered,
            "worst": name(cover.chosen[worst]) if worst >= 0 else None,
        },
    }


def _curve(
    asked: Asked, posed: Posed, cover: Cover, effort: Effort, seed: int, gap: float
) -> dict[str, Any]:
    deployment = posed.deployment
    if deployment.complete and asked.options.get("keep_share") == 1:
        # A cover that keeps everything sees each target once more; a budget that buys less cannot.
        once = deployment.problem.changed(at_least=posed.targets["needed"].to_numpy(np.int64))
        deployment = replace(deployment, problem=once, keep=1.0)
    charge = np.asarray(deployment.charge)
    mandatory = deployment.problem.mandatory
    step = objective_step(charge)
    most = math.fsum(charge[cover.chosen]) if deployment.complete else deployment.budget
    least = max(math.fsum(charge[mandatory]), float(charge.min()))
    budgets = spread_budgets(min(least, most), most, asked.options["curve"], step)
    full = cover.bound if deployment.complete else 0.0
    known = [cover.chosen]
    found = coverage_curve(
        deployment, budgets, effort.limit(), seed, gap, known, full, effort.solver
    )
    counted = "sensors" if asked.options.get("budget", {}).get("sensors") else "cost"
    points = [
        {
            "budget": point.budget,
            "spent": point.spent,
            "sensors": len(point.chosen),
            "weight": point.value,
            "bound": point.bound,
            "status": point.status,
        }
        for point in found
    ]
    return {"of": counted, "total": deployment.total, "points": points}


def stretches(station_m: Floats, cell_m: float) -> Ints:
    """Number of the stretch of road (n,) of each target, from 0; ``cell_m``: length of each."""
    number = np.floor(station_m / cell_m)
    return np.unique(number, return_inverse=True)[1].reshape(-1).astype(np.int64)


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
    # A budget or a price weighs coverage itself, and a share to be kept has its own redundancy.
    second = deployment.complete and not deployment.keep
    if not (second and limit_s > 0 and len(cover.chosen)):
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
