"""The choices of a plan: each of its sensors at each candidate, in each pose worth keeping."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from roadsight.placement.sensors.poses import split_pose


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
