"""Targets that a plan leaves out, why, and what stands in the way (paper 1, Appendix B)."""

from __future__ import annotations

from typing import Any

import geopandas as gpd
import pandas as pd
import shapely
from numpy.typing import NDArray

OUT_OF_SIGHT = "no candidate position of this plan sees it"
NOT_CHOSEN = "candidates see it, the chosen sensors do not"
TOO_FEW = "fewer sensors see it than asked for"

_TEXTS = ("kind", "target", "sensor")
_NUMBERS = ("height_m", "targets", "sensors", "sight_lines", "points")


def gaps_of(
    targets: pd.DataFrame, times_seen: NDArray, at_least: int, reasons: dict[str, str]
) -> list[dict[str, Any]]:
    """Targets seen by fewer sensors than asked for, in the order of ``targets``.

    Parameters
    ----------
    targets : columns target, x, y, z, local metres.
    times_seen : (n,) how many chosen sensors see each target.
    reasons : why no candidate at all sees a target, for the targets where that is so.
    """
    short = targets.assign(seen=times_seen)[times_seen < at_least]
    return [
        {
            "target": str(row.target),
            "x": float(row.x),
            "y": float(row.y),
            "seen": int(row.seen),
            "reason": reasons.get(str(row.target)) or (TOO_FEW if row.seen else NOT_CHOSEN),
        }
        for row in short.itertuples()
    ]


def uncovered_reasons(uncovered: list[Any]) -> dict[str, str]:
    """Targets out of every candidate's sight, with the reason where one is given.

    Parameters
    ----------
    uncovered : names of targets, or records with target and perhaps reason.
    """
    records = [entry if isinstance(entry, dict) else {"target": entry} for entry in uncovered]
    return {str(entry["target"]): str(entry.get("reason") or OUT_OF_SIGHT) for entry in records}


def obstacles_of(features: gpd.GeoDataFrame) -> list[dict[str, Any]]:
    """Obstacles as records; what the layer does not tell is None.

    Parameters
    ----------
    features : points in local metres; columns kind, target, sensor, height_m, targets, sensors,
        sight_lines and points are taken where they are there.
    """
    xy = shapely.get_coordinates(features.geometry.to_numpy())
    columns = features.reindex(columns=[*_TEXTS, *_NUMBERS]).to_dict("records")
    return [
        {
            "x": float(x),
            "y": float(y),
            **{key: None if pd.isna(record[key]) else str(record[key]) for key in _TEXTS},
            **{key: None if pd.isna(record[key]) else float(record[key]) for key in _NUMBERS},
        }
        for (x, y), record in zip(xy, columns, strict=True)
    ]
