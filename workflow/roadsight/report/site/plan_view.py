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

    def native(x_m: float | None, y_m: float | None) -> list[float] | None:
        return None if x_m is None else frame.to_native(np.array([x_m, y_m])).tolist()

    views = []
    for plan in plans:
        models = Counter(sensor["sensor"] for sensor in plan["sensors"])
        reasons = Counter(gap["reason"] for gap in plan["gaps"])
        histogram = _histogram(plan["histogram"])
        view = {
            "chosen": plan is first,
            "models": [
                {"name": name, "count": models[name], "width": _width(models[name], most)}
                for name in sorted(models)
            ],
            "cost_width": _width(plan["objective"], dearest),
            "bound_width": _width(plan["bound"] or 0.0, dearest),
            "asked": options_view(plan),
            "sight": sight_view(plan),
            "shared": data_view(plan),
            "margins": margins_view(plan),
            "tolerances": tolerance_view(plan),
            "covered": plan["targets"] - len(plan["gaps"]),
            "most_seen": max([1, *(count for _, count in histogram)]),
            "histogram": histogram,
            "reduced": _reductions(plan["reductions"]),
            "gaps": [
                gap
                | {
                    "native": native(gap["x"], gap["y"]),
                    "obstacle": native(gap["obstacle_x"], gap["obstacle_y"]),
                }
                for gap in plan["gaps"]
            ],
            "reasons": sorted(reasons.items(), key=lambda item: (-item[1], item[0])),
            "objects": [o | {"place": place_of_name(o["name"])} for o in plan["objects"]],
            "obstacles": [o | {"native": native(o["x"], o["y"])} for o in plan["obstacles"]],
        }
        views.append(plan | view)
    return views


def best_plan(plans: list[dict[str, Any]]) -> dict[str, Any]:
    """Plan with the fewest sensors; of several, the one that covers most, then the first.

    Plans that may leave targets unseen come after all others.
    """
    return min(plans, key=lambda p: (is_soft(p), len(p["sensors"]), len(p["gaps"])))


def _width(value: float, largest: float) -> float:
    """Per cent of the longest bar."""
    return 0.0 if largest <= 0 else round(min(100 * value / largest, 100.0), 2)


def _histogram(counts: list[int]) -> list[tuple[str, int]]:
    """Targets by how many sensors see them; those by four and more share a colour, and a row."""
    if len(counts) <= _COLOURED + 1:
        return [(str(times), count) for times, count in enumerate(counts)]
    rest = (f"{_COLOURED} or more", sum(counts[_COLOURED:]))
    return [*((str(times), counts[times]) for times in range(_COLOURED)), rest]


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


# What the report says of hand-over between sensors and of their data.


def data_view(plan: dict[str, Any]) -> dict[str, Any] | None:
    """Figures of a plan and rows of its sensors along the road; None where nobody measured."""
    found = plan.get("data")
    if found is None:
        return None
    chances, likely = found.get("probability"), []  # where a sensor of the plan has a curve
    if chances is not None and chances["targets"]:
        alone = percent(chances["independent"]["least"])
        likely = [
            ("Weakest target is found by its best sensor with", percent(chances["least"])),
            ("Targets are found by their best sensors with, mean", percent(chances["mean"])),
            ("Weakest target is found with, if sensors miss independently", alone),
        ]
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
    return f"{number(value / 1e6, 2)} million {unit}/s" if value else ""


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
    text = "Share of the peak hour in which at least one sensor sees each target past the traffic"
    if "level" in found:
        text += (
            ". Vehicles that hide a target from several sensors at once count as what they are: one"
            " vehicle."
        )
    else:
        text += (
            ", if sensors are hidden independently. The plan asks this of each sensor alone; a plan"
            " with the option availability asks it of all together."
        )
    # Names of the map's classes of targets.
    edges = [f"{100 * edge:g}" for edge in IN_SIGHT]
    between = [f"{low} to {high} %" for low, high in pairwise(edges)]
    names = [f"below {edges[0]} %, or unseen", *between, f"{edges[-1]} % and more"]
    return {
        "rows": rows,
        "chart": _chart(found),
        "text": text,
        "classes": list(zip(names, plan["in_sight_counts"], strict=True)),
    }


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
