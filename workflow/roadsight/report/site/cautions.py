"""What limits the worth of a result: proofs that lack, targets left out, thin data."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from roadsight.placement.plans.plan_doubts import EXAMINED_SHARE, FEW_POSITIONS, FEW_TARGETS, SAID
from roadsight.report.site.options_view import goal_text
from roadsight.report.wording import counted, number, percent


def page_cautions(warnings: Sequence[str], notes: Sequence[str]) -> list[dict[str, str]]:
    """As pages hold them.

    Parameters
    ----------
    warnings : sentences that limit what the result is worth. notes : assumptions to check.
    """
    found = [{"level": "warning", "text": text} for text in warnings]
    return found + [{"level": "note", "text": text} for text in notes]


def is_proven(status: str, objective: float, bound: float, whole_costs: bool) -> bool:
    """Whether a solution is called optimal and its bound bears that out.

    Parameters
    ----------
    whole_costs : every cost is a whole number, so that the bound may be rounded up.
    """
    if status != "optimal":
        return False
    tolerance = 1e-6 * max(1.0, abs(objective))
    least = math.ceil(bound - tolerance) if whole_costs else bound
    return objective <= least + tolerance


def plan_cautions(plans: Sequence[dict[str, Any]]) -> list[str]:
    """Warnings of the plans; what holds for several of them is said once.

    Parameters
    ----------
    plans : each with title, proven, objective, bound, targets, at_least and gaps.
    """
    titles: dict[str, list[str]] = {}
    for plan in plans:
        for text in _limits(plan):
            titles.setdefault(text, []).append(plan["title"])
    found = []
    for text, named in titles.items():
        together = "All plans" if len(named) == len(plans) > 1 else ", ".join(named)
        found.append(f"{together}: {text}")
    return found


def _limits(plan: dict[str, Any]) -> Iterator[str]:
    """What limits the worth of one plan's result."""
    if not plan["proven"] and "options" in plan:
        yield f"not proven optimal. {goal_text(plan['options'])}"
    elif not plan["proven"]:
        yield (
            f"not proven optimal. The solution costs {number(plan['objective'])}; the best"
            f" possible lies between {number(plan['bound'])} and that."
        )
    if plan["gaps"]:
        share = percent(len(plan["gaps"]) / plan["targets"])
        asked = "no sensor" if plan["at_least"] == 1 else f"fewer than {plan['at_least']} sensors"
        yield f"{asked} sees {counted(len(plan['gaps']), 'target')} ({share} of all)."


def data_cautions(
    targets: int | None,
    positions: int | None,
    pavement_area_m2: float,
    settings: dict[str, Any],
    examined_m2: float | None = None,
) -> list[str]:
    """Warnings where a result rests on too little data.

    Parameters
    ----------
    targets, positions : counts; None where a site has no placement.
    settings : all settings of the site.
    examined_m2 : pavement that targets stand for; else a cell for each target.
    """
    found = []
    if targets is not None and targets < FEW_TARGETS:
        many = counted(targets, "target")
        found.append(f"Only {many}: the number of sensors rests on little data.")
    if positions is not None and positions < FEW_POSITIONS:
        many = counted(positions, "candidate position")
        found.append(f"Only {many}: there is little to choose from.")
    cell_m2 = settings["targets"]["cell_size_m"] ** 2
    if examined_m2 is None and targets is not None:
        examined_m2 = targets * cell_m2
    share = 1.0 if examined_m2 is None else examined_m2 / max(pavement_area_m2, cell_m2)
    if share < EXAMINED_SHARE:
        found.append(
            f"{percent(1 - share)} of the pavement carries no target, because the cloud is too thin"
            " there or it lies at the road's edge: whether sensors see it is not known. It is"
            " hatched on the map."
        )
    return found


def told_cautions(doubts: Sequence[dict[str, Any]]) -> tuple[list[str], list[str]]:
    """What stages told: warnings and notes; not what pages say in their own words.

    Parameters
    ----------
    doubts : ``warnings`` of the summary.
    """
    warnings: list[str] = []
    notes: list[str] = []
    for doubt in doubts:
        if doubt["code"] in SAID:
            continue
        text = str(doubt["message"])
        if doubt["measured"] is not None and not doubt["code"].startswith("raised_"):
            is_share = "share" in text.lower()
            text += f": {_figure(doubt['measured'], is_share)}"
            limit = doubt["limit"]
            text += "" if limit is None else f" (limit {_figure(limit, is_share)})"
        level = notes if doubt["severity"] == "note" else warnings
        level.append(sentence(text))
    return warnings, notes


def sentence(text: str) -> str:
    """A message with a capital and a full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def _figure(value: Any, is_share: bool) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return percent(value) if is_share and 0 <= value <= 1 else number(value)


def scene_cautions(
    frame: dict[str, Any],
    scored: bool,
    traffic: dict[str, Any] | None,
    edge_sources: set[str],
    sensors: dict[str, dict[str, Any]],
) -> list[str]:
    """Notes on the scene: its CRS, its edges, unscored pavement, traffic, unit costs."""
    notes = [str(note) for note in frame.get("notes", [])]
    if frame["crs_wkt"] is None:
        notes.append("the site has no CRS: positions are local, without longitude and latitude")
    if "automatic" in edge_sources:
        notes.append("road edges were traced on the pavement, not digitised: check them on the map")
    if not scored:
        notes.append("no reference data for this site: the pavement's accuracy is not known here")
    if traffic:
        notes.append(
            f"{percent(traffic['cleared_points'] / max(traffic['points'], 1))} of the points were"
            f" taken for passing vehicles and left out: what stands on the pavement lower than"
            f" {number(traffic['clear_below_m'])} m, with nothing above it"
        )
    if len(sensors) > 1 and len({sensor["cost"] for sensor in sensors.values()}) == 1:
        notes.append("every sensor has the same cost, so plans compare by number, not by price")
    return [sentence(note) for note in notes]
