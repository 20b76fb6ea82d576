"""``roadsight cover``: the cheapest rows that cover all columns, or the best for a budget."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from roadsight.base import SEED
from roadsight.base.arrays import Ints
from roadsight.base.errors import InputError
from roadsight.commands.verb import Verb
from roadsight.io.records.atomic import write_json
from roadsight.io.records.matrices import read_matrix, read_vector
from roadsight.setcover import Cover, CoverProblem, solve_cover_problem
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.setcover.common.problem import HIGHS, OWN, objective_step
from roadsight.setcover.common.program import version
from roadsight.setcover.plans.alternatives import replacements
from roadsight.setcover.plans.curve import budgeted, coverage_curve, spread_budgets
from roadsight.setcover.plans.deploy import solve_deployment
from roadsight.setcover.plans.deployment import Deployment, spacing_cliques
from roadsight.setcover.plans.second import chosen_again
from roadsight.setcover.plans.whole import solve_whole, verify

_FIRST = 5  # columns that a message names of those that nothing covers


@dataclass(frozen=True)
class CoverOptions:
    """What the verb's command line says of a cover, beside its matrix."""

    costs: Annotated[str | None, ".npy, one positive cost for each row; default 1 each"] = None
    groups: Annotated[
        str | None,
        ".npy, one whole number for each row; at most one row of a group is chosen, negative = no"
        " group",
    ] = None
    budget: Annotated[float | None, "cover the most targets within this cost"] = None
    price: Annotated[float | None, "cost of leaving a target of weight 1 uncovered"] = None
    at_least: Annotated[int, "rows that cover each target"] = 1
    needs: Annotated[str | None, ".npy, the same for each target of its own, 0 or more"] = None
    weights: Annotated[str | None, ".npy, weight of each target; default 1 each"] = None
    mandatory: Annotated[str | None, ".npy, numbers of rows that must be chosen"] = None
    forbidden: Annotated[str | None, ".npy, numbers of rows that must not be chosen"] = None
    positions: Annotated[str | None, ".npy, x and y of each row, for --spacing"] = None
    spacing: Annotated[float | None, "least distance of any two chosen rows"] = None
    keep_share: Annotated[float, "share of the coverage that is left when any one row fails"] = 0.0
    curve: Annotated[int | None, "add the coverage of so many smaller budgets"] = None
    alternatives: Annotated[
        bool, "add the rows that could replace each one chosen, as cheap and as good"
    ] = False
    second: Annotated[
        float | None,
        "of the cheapest, choose the rows that cover most targets once more; at most so long,"
        " seconds, counted in steps of work",
    ] = None
    solver: Annotated[Literal["own", "highs"], "highs: HiGHS on the whole integer program"] = OWN
    verify: Annotated[
        float | None, "let HiGHS check the bound, at most so long, seconds of counted work"
    ] = None
    time_limit: Annotated[float | None, "seconds; default none"] = None
    seed: int = SEED


@dataclass(frozen=True)
class Asked:
    """What the options pose.

    Parameters
    ----------
    plain : a cover and nothing else. counts : coverage is what is optimised.
    """

    deployment: Deployment
    plain: bool
    counts: bool


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
    _check_options(given)
    often = given.at_least if given.needs is None else read_vector(given.needs)
    problem = CoverProblem(
        read_matrix(matrix),
        _vector(given.costs),
        _vector(given.groups),
        often,
        () if given.mandatory is None else read_vector(given.mandatory),
        () if given.forbidden is None else read_vector(given.forbidden),
    )
    asked = _asked(given, problem)
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
        content["curve"] = _curve(given, given.curve, asked, cover)
    if given.alternatives:
        swaps = replacements(asked.deployment, cover.chosen)  # for each chosen row alone
        content["alternatives"] = [rows.tolist() for rows in swaps]
    write_json(out, content)
    value, bound = content["objective"], content["bound"]
    of = "targets" if given.weights is None else "weight"
    found = (
        f"{value:g} of {asked.deployment.total:g} {of} covered"
        if asked.counts
        else f"cost {value:g}"
    )
    print(f"{len(cover.chosen)} rows, {found}, bound {bound:g}, {cover.status}: {out}")


def _vector(path: str | None) -> Any:
    return None if path is None else read_vector(path)


def _check_options(given: CoverOptions) -> None:
    """Refuse numbers out of range, and options that do not go with each other."""
    limit = given.time_limit
    if limit is not None and not (math.isfinite(limit) and limit >= 0):
        raise InputError("is no time", where="--time-limit", found=limit, allowed="0 s or more")
    if given.at_least < 1:
        raise InputError(
            "is too small", where="--at-least", found=given.at_least, allowed="1 or more"
        )
    if given.seed < 0:
        raise InputError("is negative", where="--seed", found=given.seed, allowed="0 or more")
    if given.budget is not None and given.price is not None:
        raise InputError("goes with no --price", where="--budget", hint="leave one of them out")
    second, curve = given.second, given.curve
    if second is not None and not (math.isfinite(second) and second > 0):
        raise InputError("is no time", where="--second", found=second, allowed="above 0 s")
    others = given.budget is not None or given.price is not None or given.keep_share
    if second is not None and others:
        raise InputError("goes with no --budget, --price or --keep-share", where="--second")
    if given.verify is not None and not (math.isfinite(given.verify) and given.verify > 0):
        raise InputError("is no time", where="--verify", found=given.verify, allowed="above 0 s")
    if curve is not None and curve < 2:
        raise InputError("is too small", where="--curve", found=curve, allowed="2 points")
    if curve is not None and given.price is not None:
        raise InputError("goes with no --price", where="--curve", hint="leave one of them out")


def _asked(given: CoverOptions, problem: CoverProblem) -> Asked:
    targets = problem.matrix.shape[1]
    weights = np.ones(targets)
    if given.weights is not None:
        values = read_vector(given.weights)
        if values.shape != (targets,) or values.dtype.kind not in "biuf":
            raise InputError(
                "has no number for each target",
                where=given.weights,
                found=f"type {values.dtype}, shape {values.shape}",
                allowed=f"shape ({targets},)",
            )
        weights = values.astype(np.float64)
    common: dict[str, Any] = {"cliques": _cliques(given, problem), "keep": given.keep_share}
    if given.budget is not None:
        base = budgeted(problem, given.budget, weights)
        fields = ("complete", "worth", "cost", "charge", "budget")
        rest = {name: getattr(base, name) for name in fields}
        return Asked(Deployment(problem, weights, **rest, **common), False, True)
    if given.price is not None:
        if not (math.isfinite(given.price) and given.price > 0):
            raise InputError("is no price", where="--price", found=given.price, allowed="above 0")
        priced = Deployment(problem, weights, complete=False, worth=given.price, **common)
        return Asked(priced, False, False)
    deployment = Deployment(problem, weights, **common)
    return Asked(deployment, not (common["cliques"] or given.keep_share), False)


def _cliques(given: CoverOptions, problem: CoverProblem) -> tuple[Ints, ...]:
    if given.spacing is None and given.positions is None:
        return ()
    if given.spacing is None or given.positions is None:
        raise InputError("go together", where="--spacing and --positions", hint="give both")
    if not (math.isfinite(given.spacing) and given.spacing > 0):
        raise InputError(
            "is no distance", where="--spacing", found=given.spacing, allowed="above 0"
        )
    xy = read_vector(given.positions, 2).astype(np.float64)
    rows = len(problem.costs)
    if xy.shape != (rows, 2) or not np.isfinite(xy).all():
        raise InputError(
            "has no x and y for each row",
            where=given.positions,
            found=f"shape {xy.shape}",
            allowed=f"finite, shape ({rows}, 2)",
        )
    return spacing_cliques(xy, given.spacing)


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


def _content(asked: Asked, cover: Cover) -> dict[str, Any]:
    figures = {}
    if not asked.plain:  # cost and covered weight of the chosen rows
        costs = np.asarray(asked.deployment.problem.costs)[cover.chosen]
        covered = asked.deployment.guaranteed(cover.chosen)
        figures = {"cost": math.fsum(costs), "covered": covered}
    return {
        "status": cover.status,
        "objective": asked.deployment.shown(cover.objective),
        "bound": asked.deployment.shown(cover.bound),
        "gap": cover.gap,
        "solver": cover.solver,
        "solver_version": version(cover.solver),
        "proved_by": cover.proved_by,
        "chosen": cover.chosen.tolist(),
        "seconds_cpu": cover.seconds_cpu,
        "lp_bound": cover.lp_bound,
        "nodes": cover.nodes,
        "reductions": cover.reductions,
        **figures,
    }


def _curve(given: CoverOptions, points: int, asked: Asked, cover: Cover) -> list[dict[str, Any]]:
    """Coverage of budgets up to the cost of the answer, or up to the budget."""
    deployment = asked.deployment
    charge = deployment.charge
    most = deployment.budget if asked.counts else math.fsum(charge[cover.chosen])
    least = max(math.fsum(charge[deployment.problem.mandatory]), float(charge.min(initial=most)))
    budgets = spread_budgets(min(least, most), most, points, objective_step(charge))
    curve = coverage_curve(
        deployment, budgets, given.time_limit, given.seed, known=[cover.chosen], solver=given.solver
    )
    return [
        {
            "budget": p.budget,
            "cost": p.spent,
            "covered": p.value,
            "bound": p.bound,
            "status": p.status,
            "chosen": p.chosen.tolist(),
        }
        for p in curve
    ]


VERB = Verb("cover", "choose sensors: least cost, or most for a budget", run)
