"""``roadsight cover``: the cheapest rows that cover all columns, or the best for a budget."""

from __future__ import annotations

import argparse
import math
from typing import Any

import numpy as np

from roadsight.base.errors import InputError
from roadsight.commands.cover_options import Asked, asked_of, check_additions, curve_of, swaps_of
from roadsight.io.records.atomic import write_json
from roadsight.io.records.matrices import read_matrix, read_vector
from roadsight.setcover import Cover, CoverProblem, solve_cover_problem
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.setcover.plans.deploy import solve_deployment
from roadsight.setcover.plans.second import chosen_again

_FIRST = 5
"""Columns that a message names of those that nothing covers."""


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("cover", help="choose sensors: least cost, or most for a budget")
    parser.add_argument("matrix", help="scipy sparse .npz; rows = choices, columns = targets")
    parser.add_argument("--costs", help=".npy, one positive cost for each row; default 1 each")
    parser.add_argument(
        "--groups",
        help=".npy, one whole number for each row; at most one row of"
        " a group is chosen, negative = no group",
    )
    task = parser.add_mutually_exclusive_group()
    task.add_argument("--budget", type=float, help="cover the most targets within this cost")
    task.add_argument("--price", type=float, help="cost of leaving a target of weight 1 uncovered")
    parser.add_argument("--at-least", type=int, default=1, help="rows that cover each target")
    parser.add_argument("--needs", help=".npy, the same for each target of its own, 0 or more")
    parser.add_argument("--weights", help=".npy, weight of each target; default 1 each")
    parser.add_argument("--mandatory", help=".npy, numbers of rows that must be chosen")
    parser.add_argument("--forbidden", help=".npy, numbers of rows that must not be chosen")
    parser.add_argument("--positions", help=".npy, x and y of each row, for --spacing")
    parser.add_argument("--spacing", type=float, help="least distance of any two chosen rows")
    parser.add_argument(
        "--keep-share",
        type=float,
        default=0.0,
        help="share of the coverage that is left when any one row fails",
    )
    parser.add_argument("--curve", type=int, help="add the coverage of so many smaller budgets")
    parser.add_argument(
        "--alternatives",
        action="store_true",
        help="add the rows that could replace each one chosen, as cheap and as good",
    )
    parser.add_argument(
        "--second",
        type=float,
        metavar="SECONDS",
        help="of the cheapest, choose the rows that cover most targets once more; at most so long,"
        " counted in steps of work",
    )
    parser.add_argument("--time-limit", type=float, help="seconds; default none")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--out", required=True, help="JSON file to write")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Write the chosen rows with their proof.

    Raises
    ------
    InputError : a file or value is not usable, or no choice of rows is feasible.
    """
    _check_numbers(arguments)
    check_additions(arguments)
    often = arguments.at_least if arguments.needs is None else read_vector(arguments.needs)
    problem = CoverProblem(
        read_matrix(arguments.matrix),
        _vector(arguments.costs),
        _vector(arguments.groups),
        often,
        () if arguments.mandatory is None else read_vector(arguments.mandatory),
        () if arguments.forbidden is None else read_vector(arguments.forbidden),
    )
    asked = asked_of(arguments, problem)
    limit, seed = arguments.time_limit, arguments.seed
    if asked.plain:
        cover = solve_cover_problem(problem, limit, seed)
    else:
        cover = solve_deployment(asked.deployment, limit, seed).cover
    _check_feasible(arguments, cover, problem.matrix.shape[1])
    cover, second = _second(arguments, asked, cover)
    content = _content(asked, cover) | second
    if arguments.curve is not None:
        content["curve"] = curve_of(arguments, asked, cover)
    if arguments.alternatives:
        content["alternatives"] = swaps_of(asked, cover)
    write_json(arguments.out, content)
    value, bound = content["objective"], content["bound"]
    of = "targets" if arguments.weights is None else "weight"
    found = f"{value:g} of {asked.total:g} {of} covered" if asked.counts else f"cost {value:g}"
    print(f"{len(cover.chosen)} rows, {found}, bound {bound:g}, {cover.status}: {arguments.out}")


def _second(
    arguments: argparse.Namespace, asked: Asked, cover: Cover
) -> tuple[Cover, dict[str, Any]]:
    """The rows that cover most targets once more for the same cost, and how far that is proven."""
    if arguments.second is None:
        return cover, {}
    cover, found = chosen_again(asked.deployment, cover, WorkLimit(arguments.second))
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


def _check_numbers(arguments: argparse.Namespace) -> None:
    limit = arguments.time_limit
    if limit is not None and not (math.isfinite(limit) and limit >= 0):
        raise InputError("is no time", where="--time-limit", found=limit, allowed="0 s or more")
    if arguments.at_least < 1:
        raise InputError(
            "is too small", where="--at-least", found=arguments.at_least, allowed="1 or more"
        )
    if arguments.seed < 0:
        raise InputError("is negative", where="--seed", found=arguments.seed, allowed="0 or more")


def _check_feasible(arguments: argparse.Namespace, cover: Cover, targets: int) -> None:
    if cover.status == "infeasible" and len(cover.uncoverable):
        first = ", ".join(str(t) for t in cover.uncoverable[:_FIRST])
        more = ", ..." if len(cover.uncoverable) > _FIRST else ""
        times = "often enough" if arguments.needs else f"{arguments.at_least} times"
        raise InputError(
            f"{len(cover.uncoverable)} of {targets} targets cannot be covered"
            f" {times}: columns {first}{more}",
            where=arguments.matrix,
            hint="leave these columns out or add rows that cover them",
        )
    if cover.status == "infeasible" and (arguments.spacing or arguments.keep_share):
        raise InputError(
            "no choice of rows covers all targets under these conditions",
            where=arguments.matrix,
            hint="lower --spacing or --keep-share, or give a --budget or --price",
        )
    if cover.status == "infeasible":
        raise InputError(
            "no choice of one row for each group covers all targets", where=arguments.matrix
        )
    if not math.isfinite(cover.objective):
        raise InputError(
            "no feasible choice was found in time",
            where="--time-limit",
            found=f"{arguments.time_limit:g} s",
            hint="allow more time",
        )


def _content(asked: Asked, cover: Cover) -> dict[str, Any]:
    return {
        "status": cover.status,
        "objective": asked.shown(cover.objective),
        "bound": asked.shown(cover.bound),
        "gap": cover.gap,
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
