"""Options of ``roadsight cover``: what they pose, the curve, and what could replace what."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.base.errors import InputError
from roadsight.io.records.matrices import read_vector
from roadsight.setcover import Cover, CoverProblem
from roadsight.setcover.common.problem import objective_step
from roadsight.setcover.plans.alternatives import replacements
from roadsight.setcover.plans.budget import budgeted
from roadsight.setcover.plans.conflicts import spacing_cliques
from roadsight.setcover.plans.curve import coverage_curve, spread_budgets
from roadsight.setcover.plans.deployment import Deployment


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

    @property
    def total(self) -> float:
        """Weight of all targets."""
        return self.deployment.total

    def shown(self, objective: float) -> float:
        """Covered weight for a budget, cost of rows and unseen targets for a price, else cost."""
        if self.counts:
            return -objective
        return objective + (0.0 if self.deployment.complete else self.deployment.worth * self.total)


def asked_of(arguments: argparse.Namespace, problem: CoverProblem) -> Asked:
    """Deployment of the verb's options.

    Raises
    ------
    InputError : an option or a file is not usable.
    """
    targets = problem.matrix.shape[1]
    weights = np.ones(targets) if arguments.weights is None else _floats(arguments.weights, targets)
    common: dict[str, Any] = {"cliques": _cliques(arguments, problem), "keep": arguments.keep_share}
    if arguments.budget is not None:
        base = budgeted(problem, arguments.budget, weights)
        fields = ("complete", "worth", "cost", "charge", "budget")
        rest = {name: getattr(base, name) for name in fields}
        return Asked(Deployment(problem, weights, **rest, **common), False, True)
    if arguments.price is not None:
        if not (math.isfinite(arguments.price) and arguments.price > 0):
            raise InputError(
                "is no price", where="--price", found=arguments.price, allowed="above 0"
            )
        priced = Deployment(problem, weights, complete=False, worth=arguments.price, **common)
        return Asked(priced, False, False)
    deployment = Deployment(problem, weights, **common)
    return Asked(deployment, not (common["cliques"] or arguments.keep_share), False)


def check_additions(arguments: argparse.Namespace) -> None:
    """Refuse a second objective or a curve that the other options leave no room for.

    Raises
    ------
    InputError : the limit is no time, fewer than two points, or an option they do not go with.
    """
    second, curve = arguments.second, arguments.curve
    if second is not None and not (math.isfinite(second) and second > 0):
        raise InputError("is no time", where="--second", found=second, allowed="above 0 s")
    others = arguments.budget is not None or arguments.price is not None or arguments.keep_share
    if second is not None and others:
        raise InputError("goes with no --budget, --price or --keep-share", where="--second")
    if curve is not None and curve < 2:
        raise InputError("is too small", where="--curve", found=curve, allowed="2 points")
    if curve is not None and arguments.price is not None:
        raise InputError("goes with no --price", where="--curve", hint="leave one of them out")


def curve_of(arguments: argparse.Namespace, asked: Asked, cover: Cover) -> list[dict[str, Any]]:
    """Coverage of budgets up to the cost of the answer, or up to the budget."""
    deployment = asked.deployment
    charge = deployment.charge
    most = deployment.budget if asked.counts else math.fsum(charge[cover.chosen])
    least = max(math.fsum(charge[deployment.problem.mandatory]), float(charge.min(initial=most)))
    budgets = spread_budgets(min(least, most), most, arguments.curve, objective_step(charge))
    points = coverage_curve(
        deployment, budgets, arguments.time_limit, arguments.seed, known=[cover.chosen]
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
        for p in points
    ]


def swaps_of(asked: Asked, cover: Cover) -> list[list[int]]:
    """Rows that could replace each chosen row alone."""
    return [rows.tolist() for rows in replacements(asked.deployment, cover.chosen)]


def _floats(path: str, length: int) -> Floats:
    values = read_vector(path)
    if values.shape != (length,) or values.dtype.kind not in "biuf":
        raise InputError(
            "has no number for each target",
            where=path,
            found=f"type {values.dtype}, shape {values.shape}",
            allowed=f"shape ({length},)",
        )
    return values.astype(np.float64)


def _cliques(arguments: argparse.Namespace, problem: CoverProblem) -> tuple[Ints, ...]:
    if (arguments.spacing is None) != (arguments.positions is None):
        raise InputError("go together", where="--spacing and --positions", hint="give both")
    if arguments.spacing is None:
        return ()
    if not (math.isfinite(arguments.spacing) and arguments.spacing > 0):
        raise InputError(
            "is no distance", where="--spacing", found=arguments.spacing, allowed="above 0"
        )
    xy = read_vector(arguments.positions, 2).astype(np.float64)
    rows = len(problem.costs)
    if xy.shape != (rows, 2) or not np.isfinite(xy).all():
        raise InputError(
            "has no x and y for each row",
            where=arguments.positions,
            found=f"shape {xy.shape}",
            allowed=f"finite, shape ({rows}, 2)",
        )
    return spacing_cliques(xy, arguments.spacing)
