"""What the tables of the report show of each plan."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from typing import Any

import numpy as np

from roadsight.geometry.frames import Frame
from roadsight.placement.sight.objects import place_of_name
from roadsight.report.charts import Chart, span_of
from roadsight.report.site.options_view import is_soft, options_view, tolerance_view
from roadsight.report.site.page import IN_SIGHT
from roadsight.report.wording import counted, metres, number, percent

_COLOURED = 4  # Targets that are seen so often, or more often, have one colour on the map


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


# What the report says of hand-over between sensors and of their data.

_MEGA = 1e6


def data_view(plan: dict[str, Any]) -> dict[str, Any] | None:
    """Figures of a plan and rows of its sensors along the road; None where nobody measured."""
    found = plan.get("data")
    if found is None:
        return None
    likely = _probable(found.get("probability"))
    rows = [
        *likely,
        ("Targets seen by two sensors or more", percent(found["share_seen_by_two"])),
        *_again(plan),
        ("Sensors that see a target, mean", number(found["mean_sensors"], 2)),
        ("Road that neighbours both see, mean", _metres(found["mean_overlap_m"])),
        ("Points measured", _millions(found["points_per_s"], "points")),
        ("of these on the road", _millions(found["road_points_per_s"], "points")),
        ("Pixels taken", _millions(found["pixels_per_s"], "pixels")),
    ]
    numbers = {sensor["candidate"]: sensor["number"] for sensor in plan["sensors"]}
    sensors = [
        {
            "number": numbers.get(entry["candidate"]),
            "sensor": entry["sensor"],
            "station": metres(entry["along_road_m"]),
            "overlap": _metres(entry.get("overlap_with_next_m")),
            "points": _millions(entry["points_per_s"], "points")
            or _millions(entry["pixels_per_s"], "pixels"),
            "road": _millions(entry["road_points_per_s"], "points"),
        }
        for entry in sorted(found["sensors"], key=lambda entry: entry["along_road_m"])
    ]
    return {
        "rows": [row for row in rows if row[1]],
        "likely": bool(likely),
        "sensors": sensors,
        "heights": [_heights(part) for part in found.get("heights", [])],
    }


def margins_view(plan: dict[str, Any]) -> dict[str, str] | None:
    """What a plan would lose to dark targets and to a shorter range; None where nobody measured."""
    found = plan.get("data", {}).get("margins")
    if found is None:
        return None
    return {
        name: f"{number(part['lost'])} ({percent(part['share'])})" if part["lost"] else "none"
        for name, part in found.items()
    }


def _again(plan: dict[str, Any]) -> list[tuple[str, str]]:
    """How the plan was chosen among those that cost as little."""
    found = plan.get("second")
    if found is None:
        return []
    share, before = percent(found["once_more"]), percent(found["once_more_before"])
    if found["status"] == "optimal":
        told = f"{share}: none of the plans that cost as little sees more; that is proven"
    else:
        bound = percent(found["once_more_bound"])
        told = f"{share}, the most that was found among plans that cost as little; at most {bound}"
    rows = [
        ("Targets seen once more than asked", told),
        ("in the first plan of that cost", before),
        ("Targets seen twice more than asked", percent(found["twice_more"])),
    ]
    if "shared_road_m" in found:
        rows.append(("Road with targets seen once more", metres(found["shared_road_m"])))
    return rows


def _probable(found: dict[str, Any] | None) -> list[tuple[str, str]]:
    """How likely targets are found; nothing where no sensor of the plan has a curve."""
    if found is None or not found["targets"]:
        return []
    alone = found["independent"]["least"]
    return [
        ("Weakest target is found by its best sensor with", percent(found["least"])),
        ("Targets are found by their best sensors with, mean", percent(found["mean"])),
        ("Weakest target is found with, if sensors miss independently", percent(alone)),
    ]


def _heights(found: dict[str, Any]) -> dict[str, Any]:
    """Chart and rows of what sensors measure of targets by height."""
    unit, bands = found["unit"], found["bands"]
    edges = [bands[0]["from_m"], *(band["to_m"] for band in bands)]
    means = [band["mean"] for band in bands]
    names = [f"{number(band['from_m'], 2)} to {number(band['to_m'], 2)} m" for band in bands]
    chart = Chart(
        f"{unit.capitalize()} on a target by height",
        "Height over the foot, m",
        f"{unit.capitalize()}, mean",
        (0.0, edges[-1]),
        span_of(means, start=0.0),
        numbered=False,
    )
    chart.bars(edges, means, "good", names)
    for edge in edges:
        chart.tick(edge, number(edge, 2))
    rows = [
        (name, number(band["mean"], 1), number(band["median"], 1), percent(band["share_none"]))
        for name, band in zip(names, bands, strict=True)
    ]
    return {"unit": unit, "chart": chart.svg(), "rows": rows[::-1]}


def _metres(value: float | None) -> str:
    return "" if value is None else metres(value)


def _millions(value: float, unit: str) -> str:
    """Nothing for none."""
    return f"{number(value / _MEGA, 2)} million {unit}/s" if value else ""


# What the report says of how often targets are in sight past traffic.


def sight_view(plan: dict[str, Any]) -> dict[str, Any] | None:
    """Figures and chart of a plan's availability; None where no traffic is simulated."""
    found = plan.get("availability")
    if found is None or "histogram" not in found:
        return None
    rows = [
        ("Mean over all targets", percent(found["mean"])),
        ("Least of all targets", percent(found["least"])),
    ]
    if "level" in found:
        rows.insert(0, ("Asked for", percent(found["level"])))
        alone = found["independent"]["least"]
        rows.append(("Least, if sensors were hidden independently", percent(alone)))
        below = len(found["below"])
        rows.append(("Out of reach of the level", counted(below, "target") if below else "none"))
    return {
        "rows": rows,
        "chart": _chart(found),
        "text": _text(found),
        "classes": _classes(plan["in_sight_counts"]),
    }


def _classes(counts: list[int]) -> list[tuple[str, int]]:
    """Names of the map's classes of targets, and how many targets each has."""
    edges = [f"{100 * edge:g}" for edge in IN_SIGHT]
    between = [f"{low} to {high} %" for low, high in pairwise(edges)]
    names = [f"below {edges[0]} %, or unseen", *between, f"{edges[-1]} % and more"]
    return list(zip(names, counts, strict=True))


def _text(found: dict[str, Any]) -> str:
    if "level" in found:
        return (
            "Share of the peak hour in which at least one sensor sees each target past the traffic."
            " Vehicles that hide a target from several sensors at once count as what they are: one"
            " vehicle."
        )
    return (
        "Share of the peak hour in which at least one sensor sees each target past the traffic, if"
        " sensors are hidden independently. The plan asks this of each sensor alone; a plan with"
        " the option availability asks it of all together."
    )


def _chart(found: dict[str, Any]) -> str:
    """Targets by availability; classes are narrow near certainty, so each is one bar wide."""
    edges, counts = found["histogram"]["edges"], found["histogram"]["targets"]
    chart = Chart(
        "Targets by the share of the time in which they are in sight",
        "Share of the peak hour in sight, %",
        "Targets",
        (0.0, float(len(counts))),
        span_of(counts, start=0.0),
        numbered=False,
    )
    names = [f"{100 * a:g} to {100 * b:g} %" for a, b in pairwise(edges)]
    chart.bars(list(range(len(edges))), counts, "good", names)
    for place, edge in enumerate(edges):
        chart.tick(float(place), f"{100 * edge:g}")
    if "level" in found:
        chart.level(_place(edges, found["level"]), "reference", "asked for", upright=True)
    return chart.svg()


def _place(edges: list[float], level: float) -> float:
    """Where a level lies among classes of equal width."""
    last = sum(edge <= level for edge in edges) - 1
    if last >= len(edges) - 1:
        return float(last)
    return last + (level - edges[last]) / (edges[last + 1] - edges[last])
