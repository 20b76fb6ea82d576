"""What the report says of how often targets are in sight past traffic."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from roadsight.report.charts import Chart, span_of
from roadsight.report.site.page import IN_SIGHT
from roadsight.report.wording import counted, percent


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
