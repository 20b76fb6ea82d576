"""Targets that a plan leaves out, why, and what stands in the way (paper 1, Appendix B)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import geopandas as gpd
import pandas as pd
import shapely
from numpy.typing import NDArray

OUT_OF_SIGHT = "no candidate sees it"
NOT_CHOSEN = "candidates see it, the chosen sensors do not"
TOO_FEW = "fewer sensors see it than asked for"

_TEXTS = ("kind", "target", "sensor")
_NUMBERS = ("height_m", "targets", "sensors", "sight_lines")


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
    return [
        {
            "target": str(name),
            "x": float(x),
            "y": float(y),
            "seen": int(seen),
            "reason": reasons.get(str(name)) or (TOO_FEW if seen else NOT_CHOSEN),
        }
        for name, x, y, seen in zip(
            targets["target"], targets["x"], targets["y"], times_seen, strict=True
        )
        if seen < at_least
    ]


def reasons_of(uncovered: Sequence[str], explained: pd.DataFrame) -> dict[str, str]:
    """Why no candidate sees a target.

    Parameters
    ----------
    uncovered : names of the targets that no candidate sees.
    explained : columns target and reason of those for which a reason was found.
    """
    why = dict(zip(explained["target"], explained["reason"], strict=True))
    return {
        str(name): f"{OUT_OF_SIGHT}: {why[name]}" if name in why else OUT_OF_SIGHT
        for name in uncovered
    }


def obstacles_of(features: gpd.GeoDataFrame) -> list[dict[str, Any]]:
    """Obstacles as records, in the layer's order.

    Parameters
    ----------
    features : points in local metres with columns kind, height_m, targets, sensors, sight_lines
        (how many of each it cuts off), target and sensor (one of each, by name).
    """
    xy = shapely.get_coordinates(features.geometry.to_numpy())
    columns = features[[*_TEXTS, *_NUMBERS]].to_dict("records")
    return [
        {
            "x": float(x),
            "y": float(y),
            **{key: str(record[key]) for key in _TEXTS},
            **{key: None if pd.isna(record[key]) else float(record[key]) for key in _NUMBERS},
        }
        for (x, y), record in zip(xy, columns, strict=True)
    ]
