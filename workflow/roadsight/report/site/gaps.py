"""Targets that a plan leaves out, why, and what stands in the way (paper 1, Appendix B)."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

OUT_OF_SIGHT = "no candidate sees it"
NOT_CHOSEN = "candidates see it, the chosen sensors do not"
TOO_FEW = "fewer sensors see it than asked for"

_TEXTS = ("kind", "target", "candidate")
_NUMBERS = ("height_m", "targets", "sensors", "sight_lines")
_DETAILS = ("nearest_m", "blocked_share", "obstacle_x", "obstacle_y")


def gaps_of(
    targets: pd.DataFrame,
    times_seen: NDArray,
    needed: NDArray | int,
    uncovered: Collection[str],
    explained: pd.DataFrame,
) -> list[dict[str, Any]]:
    """Targets seen by fewer sensors than asked for, in the order of ``targets``.

    Parameters
    ----------
    targets : columns target, x, y, z, local metres.
    times_seen : (n,) how many chosen sensors see each target.
    needed : how many must, one number or (n,).
    uncovered : names of the targets that no candidate sees.
    explained : columns target, reason, nearest_m (distance of the nearest candidate), blocked_share
        (of its sight lines), obstacle_x and obstacle_y (local metres) of uncovered targets.
    """
    details = explained.set_index("target")[["reason", *_DETAILS]].to_dict("index")
    must = np.broadcast_to(needed, len(targets))
    named = zip(targets["target"], targets["x"], targets["y"], times_seen, must, strict=True)
    return [
        {
            "target": str(name),
            "x": float(x),
            "y": float(y),
            "seen": int(seen),
            "reason": _reason(name in uncovered, bool(seen), details.get(name)),
            **{key: _known(details.get(name, {}).get(key)) for key in _DETAILS},
        }
        for name, x, y, seen, need in named
        if seen < need
    ]


def _reason(uncovered: bool, seen: bool, details: dict[Any, Any] | None) -> str:
    if uncovered:
        return OUT_OF_SIGHT if details is None else f"{OUT_OF_SIGHT}: {details['reason']}"
    return TOO_FEW if seen else NOT_CHOSEN


def _known(value: Any) -> float | None:
    return None if pd.isna(value) else float(value)


def obstacles_of(features: gpd.GeoDataFrame) -> list[dict[str, Any]]:
    """Obstacles as records, in the layer's order.

    Parameters
    ----------
    features : points in local metres with columns kind, height_m, targets, sensors, sight_lines
        (how many of each it cuts off), target and candidate (one of each, by name).
    """
    xy = shapely.get_coordinates(features.geometry.to_numpy())
    columns = features[[*_TEXTS, *_NUMBERS]].to_dict("records")
    return [
        {
            "x": float(x),
            "y": float(y),
            **{key: str(record[key]) for key in _TEXTS},
            **{key: _known(record[key]) for key in _NUMBERS},
        }
        for (x, y), record in zip(xy, columns, strict=True)
    ]


def objects_in_the_way(
    objects: Sequence[dict[str, Any]], removals: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Objects with what a plan would save without them; ``without`` is None where nobody tried.

    Parameters
    ----------
    objects : name, kind, targets and sensors of the greatest. removals : object, sensors,
        sensors_before and more_targets of those that were tried.
    """
    tried = {row["object"]: row for row in removals}
    listed = {entry["name"] for entry in objects}
    # What was tried is told even where greater objects fill the list.
    further = [
        {"name": row["object"], "kind": row["kind"], "targets": row["hidden_targets"]}
        for row in removals
        if row["object"] not in listed
    ]
    return [
        {"sensors": None, **entry, "without": tried.get(entry["name"])}
        for entry in [*objects, *further]
    ]
