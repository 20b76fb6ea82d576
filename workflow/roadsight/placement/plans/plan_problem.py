"""From the options of a plan to the deployment problem that they pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.errors import InputError
from roadsight.placement.candidates.siting import (
    mounting_costs,
    needs_by_area,
    snapped,
    within_zones,
)
from roadsight.placement.sensors.poses import split_pose
from roadsight.setcover.common.problem import CoverProblem
from roadsight.setcover.common.reductions import times_coverable
from roadsight.setcover.plans.deployment import Deployment, spacing_cliques

_NAMED = 5  # targets that a message names


@dataclass(frozen=True)
class Asked:
    """Options of a plan with its maps.

    Parameters
    ----------
    options : as `roadsight.config.plans`, those that are set.
    at_least : sensors that must see each target where no area says otherwise.
    where : site and plan, for messages.
    areas, zones : polygons in local metres. fixed, poles : points.
    exclude : targets that cannot be seen often enough are left out or asked less often.
    """

    options: dict[str, Any]
    at_least: int
    where: str
    areas: gpd.GeoDataFrame | None = None
    zones: gpd.GeoDataFrame | None = None
    fixed: pd.DataFrame | None = None
    poles: pd.DataFrame | None = None
    exclude: bool = False

    @property
    def soft(self) -> bool:
        """Whether targets may stay unseen."""
        return "budget" in self.options or "price" in self.options


@dataclass(frozen=True)
class Posed:
    """The problem that a plan poses, and what the report says of it.

    Parameters
    ----------
    targets : the targets that count, with columns weight, asked and needed (how often it is to
        be seen, and that as far as it can be) and reachable (so often it can be).
    unseen : names of the targets that no allowed candidate sees.
    short : {target: how often it can be seen}, where that is less than asked.
    forbidden : candidates that carry none. pole : (candidates,) name of the pole used, or "".
    """

    deployment: Deployment
    targets: pd.DataFrame
    unseen: list[str]
    short: dict[str, int]
    forbidden: Bools
    pole: list[str] = field(default_factory=list)


def pose(
    asked: Asked,
    matrix: sparse.csr_matrix,
    choices: pd.DataFrame,
    candidates: pd.DataFrame,
    targets: pd.DataFrame,
) -> Posed:
    """Problem of a plan.

    Parameters
    ----------
    matrix : (choices, targets), as `detection_matrix` gives it.
    choices, targets : tables in the order of rows (see `choices_of`) and columns.
    candidates : table that ``position`` of the choices counts in.

    Raises
    ------
    InputError : options contradict each other or the site, or ask more than candidates can see.
    """
    position = choices["position"].to_numpy(np.int64)
    zone = np.zeros(len(candidates), bool)
    if asked.zones is not None:
        zone = within_zones(asked.zones, candidates)
    if zone.all():
        raise InputError("every candidate lies in a zone without sensors", where=asked.where)
    forbidden = zone[position]
    mandatory: list[int] = []
    if asked.fixed is not None:
        within_m = asked.options["mandatory"]["within_m"]
        where = f"{asked.where}: mandatory"
        mandatory = snapped(asked.fixed, candidates, choices, matrix, zone, within_m, where)
    mount, pole = np.zeros(len(candidates)), [""] * len(candidates)
    if asked.poles is not None:
        option = asked.options["poles"]
        mount, used = mounting_costs(
            asked.poles, candidates, option["within_m"], option["cost"], option["new_cost"]
        )
        poles = asked.poles["id"].astype(str).tolist()
        pole = [poles[p] if p >= 0 else "" for p in used]
    cost = choices["cost"].to_numpy(np.float64) + mount[position]
    if not (cost > 0).all():
        raise InputError(
            "a sensor with its mounting must cost something",
            where=asked.where,
            found=cost.min(),
            hint="raise the sensor's cost or poles.cost",
        )
    weight, need = np.ones(len(targets)), np.full(len(targets), asked.at_least, np.int64)
    if asked.areas is not None:
        weight, need = needs_by_area(asked.areas, targets, asked.at_least)
    reachable = times_coverable(matrix, position, forbidden)
    short = np.flatnonzero(reachable < need)
    known = targets.assign(weight=weight, asked=need, needed=need, reachable=reachable)
    _check_reach(asked, known, short)
    if not asked.soft:
        need = np.minimum(need, reachable)
        known["needed"] = need
    keep, fold = _failure_folds(asked, known, weight, need)
    problem = CoverProblem(matrix, cost, position, fold, mandatory, np.flatnonzero(forbidden))
    cliques: tuple[Ints, ...] = ()
    if (spacing_m := asked.options.get("spacing_m")) is not None:
        xy_m = candidates[["x", "y"]].to_numpy(np.float64)
        cliques = spacing_cliques(xy_m[position], spacing_m)
    deployment = _deployment(asked, problem, weight, keep, cliques)
    _check_mandatory(asked, deployment, mandatory, choices)
    names = known["target"].to_numpy()
    return Posed(
        deployment,
        known,
        [str(name) for name in names[reachable == 0]],
        {str(names[t]): int(reachable[t]) for t in short},
        zone,
        pole,
    )


def _failure_folds(
    asked: Asked, targets: pd.DataFrame, weight: Floats, need: Ints
) -> tuple[float, Ints]:
    """Share to keep, and how often to see: all of it is to see everything once more."""
    keep = float(asked.options.get("keep_share") or 0.0)
    if keep < 1 or asked.soft:
        return keep, need
    more = need + ((need > 0) & (weight > 0))
    lacking = int((more > targets["reachable"]).sum())
    if lacking:
        raise InputError(
            f"no sensor may fail, but {lacking} of {len(targets)} targets cannot be seen by one"
            " sensor more than asked for",
            where=asked.where,
            hint="lower keep_share, or densify the candidates",
        )
    return 0.0, more


def _deployment(
    asked: Asked, problem: CoverProblem, weight: Floats, keep: float, cliques: tuple[Ints, ...]
) -> Deployment:
    budget, price = asked.options.get("budget"), asked.options.get("price")
    common: dict[str, Any] = {"weights": weight, "cliques": cliques, "keep": keep}
    if budget is not None:
        sensors = budget.get("sensors")
        return Deployment(
            problem,
            complete=False,
            worth=1.0,
            cost=np.zeros(len(problem.costs)),
            charge=np.ones(len(problem.costs)) if sensors else problem.costs,
            budget=float(sensors or budget["cost"]),
            **common,
        )
    if price is not None:
        return Deployment(problem, complete=False, worth=float(price), **common)
    return Deployment(problem, **common)


def _check_reach(asked: Asked, targets: pd.DataFrame, short: Ints) -> None:
    """One message about all targets that cannot be seen as often as asked."""
    if not len(short) or asked.exclude or asked.soft:
        return
    lacking = targets.iloc[short]
    first = ", ".join(
        f"{row.target} ({row.reachable} of {row.needed})"
        for row in lacking.head(_NAMED).itertuples()
    )
    more = ", ..." if len(short) > _NAMED else ""
    raise InputError(
        f"{len(short)} of {len(targets)} targets cannot be seen by as many sensors as asked for,"
        f" {int((lacking['reachable'] == 0).sum())} of them by none",
        where=asked.where,
        found=f"{first}{more}",
        hint="ask for less (at_least, areas), allow more candidates, or ask each target for what it"
        " can reach with coverage.uncoverable: exclude",
    )


def _check_mandatory(
    asked: Asked, deployment: Deployment, mandatory: list[int], choices: pd.DataFrame
) -> None:
    if not mandatory or not deployment.broken(np.array(sorted(mandatory), np.int64)):
        return
    inside = np.zeros(len(deployment.problem.costs), np.int32)
    inside[mandatory] = 1
    crowded = (deployment.exclusive @ inside > 1).any()
    spent = np.asarray(deployment.charge)[mandatory].sum()
    raise InputError(
        "the mandatory sensors stand too near each other"
        if crowded
        else "the mandatory sensors alone exceed the budget",
        where=asked.where,
        found=", ".join(choices["candidate"].astype(str).iloc[mandatory])
        if crowded
        else f"{spent:g} of {deployment.budget:g}",
        hint="lower spacing_m or leave one out"
        if crowded
        else "raise the budget or leave some out",
    )


def choices_of(
    costs: Mapping[str, float], candidates: pd.DataFrame, detections: pd.DataFrame
) -> pd.DataFrame:
    """One row per choice: sensor by sensor, candidate by candidate, pose by pose.

    A sensor whose detections name poses of candidates has a choice for each of these, in their
    order; any other sensor has one for each candidate.

    Parameters
    ----------
    costs : of each sensor of the plan. candidates : column candidate, unique.
    detections : columns sensor and candidate (in a pose, or not).

    Returns
    -------
    sensor, candidate (in its pose), position (row of ``candidates``; choices at one exclude each
    other), posed, cost.
    """
    rows = {str(name): row for row, name in enumerate(candidates["candidate"])}
    pairs = detections[["sensor", "candidate"]].drop_duplicates()
    parts = []
    for sensor, cost in costs.items():
        names = pairs.loc[pairs["sensor"] == sensor, "candidate"].astype(str)
        posed = [name for name in names if name not in rows and split_pose(name)[0] in rows]
        at = [rows[split_pose(name)[0]] for name in posed]
        order = np.argsort(at, kind="stable") if posed else np.arange(len(rows))
        named = np.array(posed or list(rows), dtype=object)[order]
        position = np.array(at or list(rows.values()), np.int64)[order]
        parts.append(
            pd.DataFrame(
                {
                    "sensor": sensor,
                    "candidate": named,
                    "position": position,
                    "posed": bool(posed),
                    "cost": cost,
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def posed_candidates(chosen: pd.DataFrame, candidates: pd.DataFrame) -> pd.DataFrame:
    """The candidates of chosen rows of `choices_of`, turned.

    Returns
    -------
    the columns of ``candidates``, station_m as edge_m: it runs along the candidate's own edge, and
    what people read of a plan stands beside stations along the road; if any is posed, candidate is
    named with its pose, yaw_deg is where it looks, in (-180, 180], and position (the candidate),
    pitch_deg and roll_deg come last.
    """
    table = candidates.iloc[chosen["position"]].reset_index(drop=True)
    table = table.rename(columns={"station_m": "edge_m"})
    if not chosen["posed"].any():
        return table
    turns = [split_pose(name)[1] for name in chosen["candidate"]]
    table["position"], table["candidate"] = table["candidate"], chosen["candidate"].to_numpy()
    yaw = table["yaw_deg"].to_numpy() + [turn.yaw_deg for turn in turns]
    table["yaw_deg"] = 180.0 - (180.0 - yaw) % 360.0
    table["pitch_deg"] = [turn.pitch_deg for turn in turns]
    table["roll_deg"] = [turn.roll_deg for turn in turns]
    return table
