"""``roadsight cover``: the cheapest rows that cover all columns, or the best for a budget."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from roadsight.base.errors import InputError
from roadsight.commands.cover_options import (
    Asked,
    CoverOptions,
    asked_of,
    check_additions,
    curve_of,
    swaps_of,
)
from roadsight.commands.verb import Verb
from roadsight.io.records.atomic import write_json
from roadsight.io.records.matrices import read_matrix, read_vector
from roadsight.setcover import Cover, CoverProblem, solve_cover_problem
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.setcover.common.program import version
from roadsight.setcover.common.result import HIGHS
from roadsight.setcover.plans.deploy import solve_deployment
from roadsight.setcover.plans.second import chosen_again
from roadsight.setcover.plans.whole import solve_whole, verify

_FIRST = 5
"""Columns that a message names of those that nothing covers."""


def run(
    matrix: Annotated[str, "scipy sparse .npz; rows = choices, columns = targets"],
    /,
    given: CoverOptions,
    *,
    out: Annotated[Path, "JSON file to write"],
) -> None:
    """Write the chosen rows with their proof.

    Raises
    ------
    InputError : a file or value is not usable, or no choice of rows is feasible.
    """
    _check_numbers(given)
    check_additions(given)
    often = given.at_least if given.needs is None else read_vector(given.needs)
    problem = CoverProblem(
        read_matrix(matrix),
        _vector(given.costs),
        _vector(given.groups),
        often,
        () if given.mandatory is None else read_vector(given.mandatory),
        () if given.forbidden is None else read_vector(given.forbidden),
    )
    asked = asked_of(given, problem)
    limit, seed = given.time_limit, given.seed
    if given.solver == HIGHS:
        cover = solve_whole(asked.deployment, limit)
    elif asked.plain:
        cover = solve_cover_problem(problem, limit, seed)
    else:
        cover = solve_deployment(asked.deployment, limit, seed).cover
    _check_feasible(given, cover, matrix, problem.matrix.shape[1])
    cover, second = _second(given, asked, cover)
    content = _content(asked, cover) | second
    if given.verify is not None:
        checked = verify(asked.deployment, cover, WorkLimit(given.verify))
        content["verified"] = checked.record()
    if given.curve is not None:
        content["curve"] = curve_of(given, given.curve, asked, cover)
    if given.alternatives:
        content["alternatives"] = swaps_of(asked, cover)
    write_json(out, content)
    value, bound = content["objective"], content["bound"]
    of = "targets" if given.weights is None else "weight"
    found = f"{value:g} of {asked.total:g} {of} covered" if asked.counts else f"cost {value:g}"
    print(f"{len(cover.chosen)} rows, {found}, bound {bound:g}, {cover.status}: {out}")


def _second(given: CoverOptions, asked: Asked, cover: Cover) -> tuple[Cover, dict[str, Any]]:
    """The rows that cover most targets once more for the same cost, and how far that is proven."""
    if given.second is None:
        return cover, {}
    cover, found = chosen_again(asked.deployment, cover, WorkLimit(given.second))
    proven = found.proven and cover.status == "optimal"
    record = {
        "covered_once_more": float(found.value[0]),
        "bound_once_more": found.bound,
        "covered_twice_more": float(found.value[1]),
        "status": "optimal" if proven else "time_limit",
    }
    return cover, {"second": record}


def _vector(path: str | None) -> Any:
    return None if path is None else read_vector(path)


def _check_numbers(given: CoverOptions) -> None:
    limit = given.time_limit
    if limit is not None and not (math.isfinite(limit) and limit >= 0):
        raise InputError("is no time", where="--time-limit", found=limit, allowed="0 s or more")
    if given.at_least < 1:
        raise InputError(
            "is too small", where="--at-least", found=given.at_least, allowed="1 or more"
        )
    if given.seed < 0:
        raise InputError("is negative", where="--seed", found=given.seed, allowed="0 or more")


def _check_feasible(given: CoverOptions, cover: Cover, where: str, targets: int) -> None:
    if cover.status == "infeasible" and len(cover.uncoverable):
        first = ", ".join(str(t) for t in cover.uncoverable[:_FIRST])
        more = ", ..." if len(cover.uncoverable) > _FIRST else ""
        times = "often enough" if given.needs else f"{given.at_least} times"
        raise InputError(
            f"{len(cover.uncoverable)} of {targets} targets cannot be covered"
            f" {times}: columns {first}{more}",
            where=where,
            hint="leave these columns out or add rows that cover them",
        )
    if cover.status == "infeasible" and (given.spacing or given.keep_share):
        raise InputError(
            "no choice of rows covers all targets under these conditions",
            where=where,
            hint="lower --spacing or --keep-share, or give a --budget or --price",
        )
    if cover.status == "infeasible":
        raise InputError("no choice of one row for each group covers all targets", where=where)
    if not math.isfinite(cover.objective):
        raise InputError(
            "no feasible choice was found in time",
            where="--time-limit",
            found=f"{given.time_limit:g} s",
            hint="allow more time",
        )


def _content(asked: Asked, cover: Cover) -> dict[str, Any]:
    return {
        "status": cover.status,
        "objective": asked.shown(cover.objective),
        "bound": asked.shown(cover.bound),
        "gap": cover.gap,
        "solver": cover.solver,
        "solver_version": version(cover.solver),
        "proved_by": cover.proved_by,
        "chosen": cover.chosen.tolist(),
        "seconds_cpu": cover.seconds_cpu,
        "lp_bound": cover.lp_bound,
        "nodes": cover.nodes,
        "reductions": cover.reductions,
        **({} if asked.plain else _figures(asked, cover)),
    }


def _figures(asked: Asked, cover: Cover) -> dict[str, float]:
    """Cost and covered weight of the chosen rows."""
    costs = np.asarray(asked.deployment.problem.costs)[cover.chosen]
    return {"cost": math.fsum(costs), "covered": asked.deployment.guaranteed(cover.chosen)}


VERB = Verb("cover", "choose sensors: least cost, or most for a budget", run)
