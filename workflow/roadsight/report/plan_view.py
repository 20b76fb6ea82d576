"""What the tables of the report show of each plan."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from roadsight.geometry.frames import Frame
from roadsight.report.wording import MISSING, label, lower_first, number

_OBSTACLE_COLUMNS = (
    ("kind", "Kind", False),
    ("targets", "Targets hidden", True),
    ("sensors", "Sensors", True),
    ("sight_lines", "Sight lines", True),
    ("height_m", "Height, m", True),
    ("points", "Points", True),
    ("target", "Target", False),
    ("sensor", "Seen from", False),
)


def plan_views(plans: list[dict[str, Any]], frame: Frame) -> list[dict[str, Any]]:
    """Plans of page.json with the widths of their bars and the cells of their tables.

    The plan shown first is the one with the fewest sensors, the first of them in the plans' order.
    """
    counts = [len(plan["sensors"]) for plan in plans]
    costs = [plan["objective"] for plan in plans if plan["objective"] is not None]
    most, dearest = max(counts, default=0), max(costs, default=0.0)
    solved = [plan for plan in plans if plan["objective"] is not None] or plans
    first = min(solved, key=lambda plan: len(plan["sensors"]), default=None)
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
            **_obstacle_table(plan["obstacles"], frame),
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


def _width(value: float | None, largest: float) -> float:
    """Per cent of the longest bar."""
    return 0.0 if value is None or largest <= 0 else round(min(100 * value / largest, 100.0), 2)


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


def _obstacle_table(obstacles: list[dict[str, Any]], frame: Frame) -> dict[str, Any]:
    """Titles (text, numeric) and rows of the columns that hold anything, and where each is."""
    shown = [
        column for column in _OBSTACLE_COLUMNS if any(o[column[0]] is not None for o in obstacles)
    ]
    titles = [(title, numeric) for _, title, numeric in shown]
    rows = [
        [_cell(obstacle[key]) for key, _, _ in shown]
        + [number(value, 2) for value in _native(obstacle, frame)]
        for obstacle in obstacles
    ]
    return {
        "obstacle_titles": [*titles, ("Easting", True), ("Northing", True)],
        "obstacle_rows": rows,
    }


def _cell(value: Any) -> str:
    if value is None:
        return MISSING
    return number(value) if isinstance(value, int | float) else str(value)
