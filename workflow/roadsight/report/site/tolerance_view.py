"""What the report says of a plan whose sensors do not stand exactly as planned."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roadsight.placement.plans.tolerance import OUT
from roadsight.report.packing import pack
from roadsight.report.wording import number, percent

LOST = (1e-9, 0.05, 0.2, 0.5)
"""Borders of the classes of the share of changes that lose a target, fewest last."""
NAMES = ("more than half", "20 to 50 %", "5 to 20 %", "less than 5 %", "none")
"""Of the changes, those that lose a target, by class: the map's colours from none to all seen."""


def lost_classes(shares: NDArray) -> dict[str, Any]:
    """Class of each target (n,) by the share of the changes that lose it, and targets by class."""
    classes = len(LOST) - np.searchsorted(LOST, shares, side="right")
    counts = np.bincount(classes, minlength=len(NAMES))
    return {"lost": pack(classes, "u1"), "lost_counts": counts.tolist()}


def tolerance_view(plan: dict[str, Any]) -> dict[str, Any] | None:
    """Rows of the table; None where nobody measured."""
    found = plan.get("tolerance")
    if found is None or not found["rows"]:
        return None
    numbers = {sensor["candidate"]: sensor["number"] for sensor in plan["sensors"]}
    rows = [
        {
            "kind": row["kind"],
            "lost": number(row["lost"]),
            "share": percent(row["share"]),
            "mean": number(row["mean_lost"], 1),
            "worst": _worst(row, numbers),
        }
        for row in found["rows"]
    ]
    counts = plan.get("lost_counts", [])
    return {
        "rows": rows,
        "not_measured": found["not_measured"],
        "classes": list(zip(NAMES, counts, strict=True)) if counts else [],
    }


def _worst(row: dict[str, Any], numbers: dict[str, int]) -> str:
    """The sensor and the change that lose most; a sensor that is out needs no name of a change."""
    if not row["lost"]:
        return "\u2013"
    sensor = f"sensor {numbers.get(row['sensor'], '?')}"
    return sensor if row["name"] == OUT else f"{sensor}, {row['name']}"
