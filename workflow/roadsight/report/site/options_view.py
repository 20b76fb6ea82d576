"""What the report says of a plan that asks for more than the cheapest cover."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roadsight.placement.plans.tolerance import OUT
from roadsight.report.charts import Chart, span_of
from roadsight.report.packing import pack
from roadsight.report.wording import MISSING, counted, number, percent

_LISTED = 6  # Names in a cell of a table; of more, their number is told


def goal_proven(goal: dict[str, Any], status: str) -> bool:
    """Whether a goal is called optimal and its bound bears that out."""
    size = max(1.0, abs(goal["value"]))
    return status == "optimal" and abs(goal["value"] - goal["bound"]) <= 1e-6 * size


def is_soft(plan: dict[str, Any]) -> bool:
    """Whether a plan may leave targets unseen, for a budget or a price."""
    options = plan.get("options")
    return options is not None and options["goal"]["kind"] != "cost"


def goal_text(options: dict[str, Any]) -> str:
    """Value and bound of what the plan optimises, one sentence."""
    goal = options["goal"]
    value, bound = number(goal["value"]), number(goal["bound"])
    if goal["kind"] == "coverage":
        of = number(options["weight"]["of"])
        return f"It sees a weight of {value} of {of}; nothing within the budget sees over {bound}."
    if goal["kind"] == "cost and price":
        return f"Sensors and unseen targets cost {value} together; no choice costs under {bound}."
    return f"It costs {value}; nothing that meets the same conditions costs under {bound}."


def options_view(plan: dict[str, Any]) -> dict[str, Any] | None:
    """Rows, curve and alternatives of a plan; None where it has no options."""
    options = plan.get("options")
    if options is None:
        return None
    return {
        "goal": goal_text(options),
        "rows": _asked_rows(options),
        "curve": curve_chart(options["curve"]) if "curve" in options else None,
        "points": _points(options["curve"]) if "curve" in options else [],
        "alternatives": _alternatives(plan, options),
    }


def _asked_rows(options: dict[str, Any]) -> list[tuple[str, str, str]]:
    """What is asked for, how much of it, and what came of it."""
    asked = options["asked"]
    left = f"{percent(options['failure']['left_share'])} left when the worst sensor fails"
    short = len(options["short"])
    weight = options["weight"]
    share = percent(weight["seen"] / weight["of"]) if weight["of"] else "all"
    budget, spacing_m, keep = (asked.get(name) for name in ("budget", "spacing_m", "keep_share"))
    most = ""
    if budget:
        is_count = bool(budget.get("sensors"))
        most = (
            counted(int(budget["sensors"]), "sensor")
            if is_count
            else f"cost {number(budget['cost'])}"
        )
    rows = [
        ("Budget", most, f"{share} of the weight seen"),
        ("Price of an unseen target", _number(asked.get("price")), f"{share} of the weight seen"),
        ("Sensors that see each target", _number(asked.get("at_least")), _short(short)),
        ("Areas with weights or numbers of their own", _yes(asked, "areas"), _short(short)),
        (
            "Zones without sensors",
            _yes(asked, "forbidden"),
            f"{counted(options['forbidden_candidates'], 'candidate')} dropped",
        ),
        ("Sensors that must stand", _yes(asked, "mandatory"), "marked in the table of sensors"),
        ("Poles that stand already", _yes(asked, "poles"), "used where a sensor names one"),
        (
            "Distance of sensors, at least",
            "" if spacing_m is None else f"{number(spacing_m)} m",
            "kept",
        ),
        ("Coverage that any one failure leaves", "" if keep is None else percent(keep), left),
    ]
    found = [row for row in rows if row[1]]
    return found if keep else [*found, ("One sensor fails", "", left)]


def _number(value: float | None) -> str:
    return "" if value is None else number(value)


def _yes(asked: dict[str, Any], name: str) -> str:
    return "given" if name in asked else ""


def _short(short: int) -> str:
    return f"{counted(short, 'target')} cannot be seen so often" if short else "every target can be"


def curve_chart(curve: dict[str, Any]) -> str:
    """Coverage against budget with the bound above it."""
    points, total = curve["points"], curve["total"]
    budgets = [point["budget"] for point in points]
    shares, bounds = (
        [100 * point[name] / total for point in points] for name in ("weight", "bound")
    )
    chart = Chart(
        "Coverage against budget",
        "Sensors" if curve["of"] == "sensors" else "Cost",
        "Weight seen, %",
        span_of(budgets, start=0.0),
        span_of(shares, bounds),
    )
    chart.band(budgets, shares, bounds, "sigma")
    chart.line(budgets, bounds, "reference")
    chart.line(budgets, shares, "fit")
    texts = [
        f"{number(p['budget'])}: {number(share, 2)} % seen, at most {number(bound, 2)} %"
        for p, share, bound in zip(points, shares, bounds, strict=True)
    ]
    chart.dots(budgets, shares, "good", texts)
    return chart.svg()


def _points(curve: dict[str, Any]) -> list[dict[str, Any]]:
    """Points with shares of the weight, and what each adds to the one before."""
    total = curve["total"]
    before = np.concatenate([[0.0], [point["weight"] for point in curve["points"]]])
    return [
        point
        | {
            "share": point["weight"] / total,
            "bound_share": point["bound"] / total,
            "added": (point["weight"] - float(before[n])) / total,
            "proven": point["status"] == "optimal",
        }
        for n, point in enumerate(curve["points"])
    ]


def _alternatives(plan: dict[str, Any], options: dict[str, Any]) -> dict[str, Any] | None:
    """Which candidates could replace each sensor, and how different another answer is."""
    found = options.get("alternatives")
    if found is None:
        return None
    rows = []
    for sensor, names, count in zip(
        plan["sensors"], found["by"], found["replaceable"], strict=True
    ):
        more = f", and {number(count - _LISTED)} more" if count > _LISTED else ""
        rows.append(
            {
                "number": sensor["number"],
                "candidate": sensor["candidate"],
                "count": count,
                "by": ", ".join(names[:_LISTED]) + more if names else "",
            }
        )
    return {"rows": rows, "text": _uniqueness(found, len(plan["sensors"]))}


def _uniqueness(found: dict[str, Any], sensors: int) -> str:
    shared, least = found["shared_places"], found["least_shared_places"]
    if shared >= sensors and least >= sensors:
        return "Every answer that is no dearer and sees no less stands at the same places."
    text = (
        "Another answer, no dearer and seeing no less, has"
        f" {counted(sensors - shared, 'sensor')} elsewhere and {number(shared)} at the same places."
        if shared < sensors
        else "No such answer was found that stands elsewhere."
    )
    if least >= shared:
        return f"{text} None shares fewer: that is proven."
    return f"{text} Within its limit the search proves only that {number(least)} must be shared."


# What the report says of a plan whose sensors do not stand exactly as planned.

# Borders of the classes of the share of changes that lose a target, fewest last
LOST = (1e-9, 0.05, 0.2, 0.5)
# Of the changes, those that lose a target, by class: the map's colours from none to all seen
NAMES = ("more than half", "20 to 50 %", "5 to 20 %", "less than 5 %", "none")


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
    rows = []
    for row in found["rows"]:
        # The sensor and the change that lose most; a sensor that is out needs no name of a change.
        worst = f"sensor {numbers.get(row['sensor'], '?')}" if row["lost"] else MISSING
        if row["lost"] and row["name"] != OUT:
            worst += f", {row['name']}"
        rows.append(
            {
                "kind": row["kind"],
                "lost": number(row["lost"]),
                "share": percent(row["share"]),
                "mean": number(row["mean_lost"], 1),
                "worst": worst,
            }
        )
    counts = plan.get("lost_counts", [])
    return {
        "rows": rows,
        "not_measured": found["not_measured"],
        "classes": list(zip(NAMES, counts, strict=True)) if counts else [],
    }
