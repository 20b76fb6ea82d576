"""What the tables of the report show of each plan."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from roadsight.geometry.frames import Frame
from roadsight.placement.sight.objects import place_of_name
from roadsight.report.site.data_view import data_view, margins_view
from roadsight.report.site.options_view import is_soft, options_view
from roadsight.report.site.sight_view import sight_view
from roadsight.report.site.tolerance_view import tolerance_view
from roadsight.report.wording import number

_COLOURED = 4
"""Targets that are seen so often, or more often, have one colour on the map."""


def plan_views(plans: list[dict[str, Any]], frame: Frame) -> list[dict[str, Any]]:
    """Plans of page.json with the widths of their bars and the cells of their tables.

    The best plan is shown first.
    """
    counts = [len(plan["sensors"]) for plan in plans]
    most = max(counts, default=0)
    dearest = max((plan["objective"] for plan in plans), default=0.0)
    first = best_plan(plans) if plans else None
    return [
        plan
        | {
            "chosen": plan is first,
            "models": _models(plan["sensors"], most),
            "cost_width": _width(plan["objective"], dearest),
            "bound_width": _width(plan["bound"] or 0.0, dearest),
            "asked": options_view(plan),
            "sight": sight_view(plan),
            "shared": data_view(plan),
            "margins": margins_view(plan),
            "tolerances": tolerance_view(plan),
            "covered": plan["targets"] - len(plan["gaps"]),
            "most_seen": max([1, *(count for _, count in _histogram(plan["histogram"]))]),
            "histogram": _histogram(plan["histogram"]),
            "reduced": _reductions(plan["reductions"]),
            "gaps": [_gap(gap, frame) for gap in plan["gaps"]],
            "reasons": _by_count(Counter(gap["reason"] for gap in plan["gaps"])),
            "objects": [o | {"place": place_of_name(o["name"])} for o in plan["objects"]],
            "obstacles": [o | {"native": _native(o, frame)} for o in plan["obstacles"]],
        }
        for plan in plans
    ]


def best_plan(plans: list[dict[str, Any]]) -> dict[str, Any]:
    """Plan with the fewest sensors; of several, the one that covers most, then the first.

    Plans that may leave targets unseen come after all others.
    """
    return min(plans, key=lambda p: (is_soft(p), len(p["sensors"]), len(p["gaps"])))


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


def _histogram(counts: list[int]) -> list[tuple[str, int]]:
    """Targets by how many sensors see them; those by four and more share a colour, and a row."""
    if len(counts) <= _COLOURED + 1:
        return [(str(times), count) for times, count in enumerate(counts)]
    rest = (f"{_COLOURED} or more", sum(counts[_COLOURED:]))
    return [*((str(times), counts[times]) for times in range(_COLOURED)), rest]


def _by_count(counts: Counter[str]) -> list[tuple[str, int]]:
    """Most frequent first, ties by name."""
    return sorted(counts.items(), key=lambda item: (-item[1], item[0]))


def _reductions(counts: dict[str, int]) -> str:
    """How small the problem became before it was solved; empty where the solver does not say."""
    keys = ("rows", "columns", "rows_reduced", "columns_reduced")
    if not counts.keys() >= set(keys):
        return ""
    choices, targets, fewer_choices, fewer_targets = (number(counts[key]) for key in keys)
    return (
        f"{choices} choices for {targets} targets; after reductions that cannot change the answer,"
        f" {fewer_choices} for {fewer_targets}"
    )


def _gap(gap: dict[str, Any], frame: Frame) -> dict[str, Any]:
    """A gap with native positions of the target and of its obstacle, if one is known."""
    obstacle = None
    if gap["obstacle_x"] is not None:
        obstacle = _native({"x": gap["obstacle_x"], "y": gap["obstacle_y"]}, frame)
    return gap | {"native": _native(gap, frame), "obstacle": obstacle}
