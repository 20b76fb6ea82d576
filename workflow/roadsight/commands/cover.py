"""``roadsight cover``: the cheapest rows that cover all columns, or the best for a budget."""

from __future__ import annotations

import argparse
import math
from typing import Any

from roadsight.errors import InputError
from roadsight.io.atomic import write_json
from roadsight.io.matrices import read_matrix, read_vector
from roadsight.placement.cover import (
    Cover,
    CoverProblem,
    maximise_coverage,
    solve_cover_problem,
)

_FIRST = 5


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("cover", help="choose sensors: least cost, or most for a budget")
    parser.add_argument("matrix", help="scipy sparse .npz; rows = choices, columns = targets")
    parser.add_argument("--costs", help=".npy, one positive cost for each row; default 1 each")
    parser.add_argument("--groups", help=".npy, one whole number for each row; at most one row of"
                        " a group is chosen, negative = no group")  # fmt: skip
    task = parser.add_mutually_exclusive_group()
    task.add_argument("--budget", type=float, help="cover the most targets within this cost")
    task.add_argument("--at-least", type=int, default=1, help="rows that cover each target")
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
    problem = CoverProblem(
        read_matrix(arguments.matrix),
        None if arguments.costs is None else read_vector(arguments.costs),
        None if arguments.groups is None else read_vector(arguments.groups),
        arguments.at_least,
    )
    if arguments.budget is None:
        cover = solve_cover_problem(problem, arguments.time_limit, arguments.seed)
        _check_feasible(arguments, cover, problem.matrix.shape[1])
        found = f"cost {cover.objective:g}"
    else:
        cover = maximise_coverage(problem, arguments.budget, time_limit_s=arguments.time_limit)
        found = f"{cover.objective:g} of {problem.matrix.shape[1]} targets covered"
    write_json(arguments.out, _content(cover))
    print(
        f"{len(cover.chosen)} rows, {found}, bound {cover.bound:g}, {cover.status}: {arguments.out}"
    )


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
        raise InputError(
            f"{len(cover.uncoverable)} of {targets} targets cannot be covered"
            f" {arguments.at_least} times: columns {first}{more}",
            where=arguments.matrix,
            hint="leave these columns out or add rows that cover them",
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


def _content(cover: Cover) -> dict[str, Any]:
    return {
        "status": cover.status,
        "objective": cover.objective,
        "bound": cover.bound,
        "gap": cover.gap,
        "chosen": cover.chosen.tolist(),
        "seconds_cpu": cover.seconds_cpu,
        "lp_bound": cover.lp_bound,
        "nodes": cover.nodes,
        "reductions": cover.reductions,
    }
