"""Why targets stay unseen beyond what stands in the way: weather, dark targets, vehicles."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools
from roadsight.placement.sight.lanes import Traffic, free_shares
from roadsight.placement.sight.obstacles import NEAREST

# Reasons as tables and reports name them; the first two are those of `explain_gaps`.
OUT_OF_RANGE = "out of range"
HIDDEN = "hidden"
WEATHER = "in range only without rain and fog"
DARK = "in range only of brighter targets"
VEHICLES = "hidden by vehicles too often"


def refine_reasons(
    gaps: pd.DataFrame, bright_m: float, dark_m: float, often: Bools | None
) -> pd.Series:
    """Reasons of `explain_gaps` with what effects take away.

    A target beyond a range that effects shorten is told apart from one that nothing could reach;
    what stands in the way of most lines of sight comes before vehicles.

    Parameters
    ----------
    gaps : columns reason (by the range in clear air) and nearest_m.
    bright_m : longest range of the plan's sensors in the air of the site, to targets as bright as
        those of which ranges are stated. dark_m : the same to the site's targets.
    often : (n,) whether vehicles hide the target too often from all near candidates; None: no
        traffic.
    """
    within = gaps["reason"] != OUT_OF_RANGE
    nearest_m = gaps["nearest_m"].to_numpy(np.float64)
    reason = gaps["reason"].to_numpy(dtype=object).copy()
    if often is not None:
        reason[within & (gaps["reason"] != HIDDEN) & often] = VEHICLES
    reason[within & (nearest_m > dark_m)] = DARK
    reason[within & (nearest_m > bright_m)] = WEATHER
    return pd.Series(reason, index=gaps.index)


def hidden_too_often(
    targets: pd.DataFrame,
    candidates: pd.DataFrame,
    traffic: Traffic,
    availability: float,
    target_height_m: float,
) -> Bools:
    """Whether vehicles hide each target (n,) from its nearest candidates more than is allowed.

    Parameters
    ----------
    targets : columns x, y, z (feet). candidates : x, y, z; local metres.
    availability : share of the time in which a sensor must see its targets.
    """
    place = candidates[["x", "y", "z"]].to_numpy(np.float64)
    foot = targets[["x", "y", "z"]].to_numpy(np.float64)
    count = min(NEAREST, len(place))
    near = cKDTree(place).query(foot, k=count)[1].reshape(-1, count)
    middles = foot + np.array([0.0, 0.0, target_height_m / 2])
    best = np.zeros(len(foot))
    for candidate in np.unique(near):
        rows = np.flatnonzero((near == candidate).any(axis=1))
        best[rows] = np.maximum(best[rows], free_shares(traffic, place[candidate], middles[rows]))
    return np.asarray(best < availability)
