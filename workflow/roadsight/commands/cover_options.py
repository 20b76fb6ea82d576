"""Options of ``roadsight cover``: what they pose, the curve, and what could replace what."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.base.errors import InputError
from roadsight.base.seeds import SEED
from roadsight.io.records.matrices import read_vector
from roadsight.setcover import Cover, CoverProblem
from roadsight.setcover.common.problem import objective_step
from roadsight.setcover.common.result import OWN
from roadsight.setcover.plans.alternatives import replacements
from roadsight.setcover.plans.budget import budgeted
from roadsight.setcover.plans.conflicts import spacing_cliques
from roadsight.setcover.plans.curve import coverage_curve, spread_budgets
from roadsight.setcover.plans.deployment import Deployment


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

    @property
    def total(self) -> float:
        """Weight of all targets."""
        return self.deployment.total

    def shown(self, objective: float) -> float:
        """Covered weight for a budget, cost of rows and unseen targets for a price, else cost."""
        return self.deployment.shown(objective)


def asked_of(given: CoverOptions, problem: CoverProblem) -> Asked:
    """Deployment of the verb's options.

    Raises
    ------
    InputError : an option or a file is not usable.
    """
    targets = problem.matrix.shape[1]
    weights = np.ones(targets) if given.weights is None else _floats(given.weights, targets)
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


def check_additions(given: CoverOptions) -> None:
    """Refuse a second objective or a curve that the other options leave no room for.

    Raises
    ------
    InputError : the limit is no time, fewer than two points, or an option they do not go with.
    """
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


def curve_of(given: CoverOptions, points: int, asked: Asked, cover: Cover) -> list[dict[str, Any]]:
    """Coverage of budgets up to the cost of the answer, or up to the budget."""
    deployment = asked.deployment
    charge = deployment.charge
    most = deployment.budget if asked.counts else math.fsum(charge[cover.chosen])
    least = max(math.fsum(charge[deployment.problem.mandatory]), float(charge.min(initial=most)))
    budgets = spread_budgets(min(least, most), most, points, objective_step(charge))
    curve = coverage_curve(
        deployment,
        budgets,
        given.time_limit,
        given.seed,
        known=[cover.chosen],
        solver=given.solver,
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
