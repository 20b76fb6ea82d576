"""Cross-sections of severe objects as drawings, made from the content of ``poles/page.json``."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from roadsight.report.charts import Chart
from roadsight.report.wording import number

# Drawings of a site: the worst by rank. The layer `cross_sections` and the table have all.
MOST = 24
_WIDE = 470.0
# Pixels of a chart that its axes take, across and upwards (`roadsight.report.charts`)
_AXES = (70.0, 54.0)
# Heights of the plotted part, px: flat sections stay readable, cliffs do not fill the page
_LEAST, _TALLEST = 90.0, 300.0
_ROW_PX = 13.0  # Height of a row of letters
_CHARACTER_PX = 6.0  # Width of the letters of a drawing
_POST_M = 1.2  # How much of an object is drawn above its ground
_PLACES = ("start_m", "end_m", "rise_m")
_STEPS = ("kerb", "drop-off", "wall")
_ENDS = ("least", "greatest")
# Ends of a range this near to each other are told as one number: tenths of a metre are shown
SAME_M = 0.05


def hazard_profiles(
    hazard: pd.DataFrame, sections: pd.DataFrame, profiles: dict[str, Any]
) -> list[dict[str, Any]]:
    """Cross-sections of the worst objects that are rated high, or might be, by rank.

    Parameters
    ----------
    hazard : table of rated objects; ``rating_greatest`` tells which might be.
    sections : see `roadsight.poles.risk.roadside.section_table`.
    profiles : ``run_m`` and ``height_m`` (above the edge) of each object.
    """
    if not {"rank", "rating", "reasons"} <= set(hazard) or sections.empty:
        return []
    low, high = (hazard.get(f"clear_zone_{end}_m", hazard["clear_zone_m"]) for end in _ENDS)
    drawn = hazard.get("rating_greatest", hazard["rating"]) == "high"
    hazard = hazard.assign(clear_zone_least_m=low, clear_zone_greatest_m=high)
    severe = hazard[drawn & hazard["id"].astype(str).isin(list(profiles))]
    found = []
    for row in severe.sort_values("rank", kind="stable").head(MOST).to_dict("records"):
        name = str(row["id"])
        own = sections[sections["object"] == name]
        if own.empty:
            continue
        found.append(
            {
                "id": name,
                "kind": str(row["kind"]),
                "rank": int(row["rank"]),
                "route": str(row["route"]),
                "station_m": _finite(row["station_m"]),
                "side": int(row["side"]),
                "offset_m": _finite(row["offset_m"]),
                "clear_zone_m": [_finite(row[f"clear_zone_{end}_m"]) for end in _ENDS],
                "reasons": str(row["reasons"]),
                "elements": [
                    {
                        "kind": str(element["kind"]),
                        **{name: round(float(element[name]), 3) for name in _PLACES},
                        "ratio": str(element["slope_ratio"]),
                    }
                    for element in own.to_dict("records")
                ],
                **profiles[name],
            }
        )
    return found


def profile_chart(profile: dict[str, Any]) -> str:
    """Cross-section to scale: measured heights, straight pieces with slopes, object, clear zone."""
    run, height = profile["run_m"], profile["height_m"]
    level = float(height[0]) if height else 0.0
    xs, ys = [], []
    for element in profile["elements"]:
        start = level
        level += element["rise_m"]
        xs += [element["start_m"], element["end_m"]]
        ys += [start, level]
    offset, (least, zone) = profile["offset_m"], profile["clear_zone_m"]
    foot = float(np.interp(offset, xs, ys)) if offset is not None else 0.0
    tops = [] if offset is None else [foot + _POST_M]
    span = (min([*xs, offset or 0.0]) - 0.5, max([*xs, offset or 0.0]) + 0.5)
    low, high = min([*height, *ys]) - 0.4, max([*height, *ys, *tops]) + 0.4
    per_m = (_WIDE - _AXES[0]) / (span[1] - span[0])
    texts, middles, rows = [], [], []
    ends: list[float] = []  # of each row of texts below the ground
    for element in profile["elements"]:
        kind, ratio = str(element["kind"]), element["ratio"]
        text = kind if kind == ratio else f"{kind} {ratio}".strip()
        if kind in _STEPS:
            text = f"{kind} {number(abs(element['rise_m']), 2)} m"
        half = _CHARACTER_PX * len(text) / 2 / per_m
        middle = max((element["start_m"] + element["end_m"]) / 2, span[0] + half)
        # The first row in which the text covers no other.
        row = next((n for n, end in enumerate(ends) if middle - half > end), len(ends))
        ends[row : row + 1] = [middle + half + 6 / per_m]
        texts.append(text)
        middles.append(middle)
        rows.append(row)
    low -= (max(rows, default=-1) + 1) * _ROW_PX / per_m
    tall = float(np.clip((high - low) * per_m, _LEAST, _TALLEST))
    # To scale: where the drawing is held taller, the heights' range gives way.
    high += max(tall / per_m - (high - low), 0.0)
    title = f"Cross-section at {profile['id']}: {profile['reasons']}"
    labels = ("From the road edge outwards, m", "Height, m")
    chart = Chart(title, *labels, span, (low, high), _WIDE, tall + _AXES[1])
    shown = [end for end in dict.fromkeys((least, zone)) if end is not None and end <= span[1]]
    for end in shown:
        chart.level(end, "reference", upright=True)
    if shown and least is not None and zone is not None:
        before = shown[-1] > span[0] + 0.6 * (span[1] - span[0])
        aside = -0.15 if before else 0.15
        words = f"clear zone {zone_text(least, zone)}"
        place = shown[-1] + aside, high - 11 / per_m
        chart.note(*place, words, "end" if before else "start")
    chart.line(xs, ys, "fit")
    chart.dots(run, height, "good faint")
    if offset is not None:
        chart.line([offset, offset], [foot, foot + _POST_M], "object")
    ground = min([*height, *ys])
    for text, middle, row in zip(texts, middles, rows, strict=True):
        chart.note(middle, ground - ((row + 1) * _ROW_PX + 4) / per_m, text)
    return chart.svg()


def zone_text(least: float, greatest: float) -> str:
    """Width of a clear zone, a range where its ends differ."""
    width = f"{number(greatest, 1)} m"
    return width if greatest - least < SAME_M else f"{number(least, 1)} to {width}"


def _finite(value: Any) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None
