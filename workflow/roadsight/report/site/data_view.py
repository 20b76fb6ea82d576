"""What the report says of hand-over between sensors and of their data."""

from __future__ import annotations

from typing import Any

from roadsight.report.charts import Chart, span_of
from roadsight.report.wording import metres, number, percent

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
