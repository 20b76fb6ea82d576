"""What the tables of the report show of each plan."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from roadsight.geometry.frames import Frame
from roadsight.report.wording import label, lower_first, number


def plan_views(plans: list[dict[str, Any]], frame: Frame) -> list[dict[str, Any]]:
    """Plans of page.json with the widths of their bars and the cells of their tables.

    The plan shown first is the one with the fewest sensors, the first of them in the plans' order.
    """
    counts = [len(plan["sensors"]) for plan in plans]
    most = max(counts, default=0)
    dearest = max((plan["objective"] for plan in plans), default=0.0)
    first = min(plans, key=lambda plan: len(plan["sensors"]), default=None)
    return [
        plan
        | {
            "chosen": plan is first,
            "models": _models(plan["sensors"], most),
            "cost_width": _width(plan["objective"], dearest),
            "bound_width": _width(plan["bound"], dearest),
            "covered": plan["targets"] - len(plan["gaps"]),
            "most_seen": max([1, *plan["histogram"]]),
            "reduced": _reductions(plan["reductions"]),
            "gaps": [gap | {"native": _native(gap, frame)} for gap in plan["gaps"]],
            "reasons": _by_count(Counter(gap["reason"] for gap in plan["gaps"])),
            "obstacles": [o | {"native": _native(o, frame)} for o in plan["obstacles"]],
        }
        for plan in plans
    ]


def _models(sensors: list[dict[str, Any]], most: int) -> list[dict[str, Any]]:
    """How many sensors of each model, in order of name, with the width of their bar."""
    counts = Counter(sensor["sensor"] for sensor in sensors)
    return [
        {"name": name, "count": counts[name], "width": _width(counts[name], most)}
        for name in sorted(counts)
    ]


def _width(value: float, largest: float) -> float:
    """Per cent of the longest bar."""
    return 0.0 if largest <= 0 else round(min(100 * value / largest, 100.0), 2)


def _native(place: dict[str, Any], frame: Frame) -> list[float]:
    return frame.to_native(np.array([place["x"], place["y"]])).tolist()


def _by_count(counts: Counter[str]) -> list[tuple[str, int]]:
    """Most frequent first, ties by name."""
    return sorted(counts.items(), key=lambda item: (-item[1], item[0]))


def _reductions(reductions: dict[str, Any] | None) -> str:
    """Size of the problem before and after its reductions, as the solver reports them."""
    parts = [
        f"{lower_first(label(key))} {number(value)}"
        for key, value in (reductions or {}).items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    ]
    return f"reductions: {', '.join(parts)}" if parts else ""
