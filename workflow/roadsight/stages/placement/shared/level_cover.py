"""Covers that must see each target with a probability: traffic read, solved, told."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.io.records.lanes import read_traffic
from roadsight.placement.plans.availability import (
    CommonTraffic,
    at_level,
    counted_shares,
    past_traffic,
    share_matrix,
)
from roadsight.setcover import Cover
from roadsight.setcover.joint.joint import solve_joint
from roadsight.stages.placement.shared.cover_inputs import PlanFiles

log = logging.getLogger("solve_cover")


@dataclass(frozen=True, kw_only=True)
class LevelFiles(PlanFiles):
    """A plan that must see each target with a probability."""

    availability: Annotated[float | None, "how often targets must be in sight"] = None
    lanes: Annotated[Sequence[Path], "lanes and their traffic"] = ()
    target_height_m: float = 0.6


@dataclass(frozen=True)
class Levelled:
    """A cover at a level.

    Parameters
    ----------
    shares : (targets,) how often at least one sensor sees each target. record : what solution.json
        says of it.
    """

    cover: Cover
    shares: Floats
    record: dict[str, Any]


def cover_at_level(
    given: LevelFiles,
    level: float,
    detections: pd.DataFrame,
    choices: pd.DataFrame,
    candidates: pd.DataFrame,
    targets: pd.DataFrame,
) -> Levelled:
    """Cheapest sensors that together see each target with the plan's probability.

    Raises
    ------
    InputError : targets cannot reach the level and may not be left below it.
    """
    pairs = pd.MultiIndex.from_frame(choices[["sensor", "candidate"]].astype(str))
    shares = share_matrix(detections, pairs, pd.Index(targets["target"].astype(str)))
    position = choices["position"].to_numpy(np.int64)
    costs = choices["cost"].to_numpy(np.float64)
    oracle = None
    if given.lanes:
        feet = targets[["x", "y", "z"]].to_numpy(np.float64)
        middles = feet + np.array([0.0, 0.0, given.target_height_m / 2])
        sensors_m = candidates[["x", "y", "z"]].to_numpy(np.float64)[position]
        traffic = read_traffic(given.lanes[0]).lanes
        shares = past_traffic(shares, traffic, sensors_m, middles)
        posed = at_level(shares, costs, position, level)
        oracle = CommonTraffic(traffic, sensors_m, middles, shares, level, posed.below)
    else:
        log.warning("no traffic is simulated: every sensor sees its targets for certain")
        posed = at_level(shares, costs, position, level)
    _check_below(given, level, posed.below.tolist(), targets)
    cover = solve_joint(posed.problem, given.cover.time_limit_s, given.cover.gap, oracle)
    hidden = shares[cover.chosen].copy()
    hidden.data = np.log1p(-np.minimum(hidden.data, 1 - 1e-12))
    alone = -np.expm1(np.asarray(hidden.sum(axis=0)).ravel())
    seen = alone if oracle is None else oracle.joint_shares(cover.chosen)
    below = sorted({*posed.below.tolist(), *(oracle.given_up if oracle else ())})
    _check_below(given, level, below, targets)
    record = {
        "level": level,
        "independent": described(alone),
        "below": {str(targets["target"].iloc[t]): float(seen[t]) for t in below},
        **described(seen),
    }
    return Levelled(cover, seen, record)


def described(shares: Floats) -> dict[str, Any]:
    """Mean, least and classes of availability."""
    return {
        "mean": float(shares.mean()),
        "least": float(shares.min()),
        "histogram": counted_shares(shares),
    }


def _check_below(given: LevelFiles, level: float, below: list[int], targets: pd.DataFrame) -> None:
    if not below or given.uncoverable == "exclude":
        return
    first = ", ".join(targets["target"].astype(str).iloc[below[:5]])
    raise InputError(
        f"{len(below)} of {len(targets)} targets are in sight less often than the plan asks,"
        " even if every candidate carries a sensor",
        where=f"site {given.site}, plan {given.plan}",
        found=first,
        allowed=f"{level:g} of the time",
        hint="lower the plan's availability, lower conditions.availability so that sensors count"
        " that see a target less often, or leave these targets below it with"
        " coverage.uncoverable: exclude",
    )
