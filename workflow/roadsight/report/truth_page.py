"""Page of the product on real data: ours, a peer, published figures and goals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from typing import Any

import pandas as pd

from roadsight.evidence.truth_catalogue import AREAS, MEAN, Area, holds
from roadsight.report.files import filled_page
from roadsight.report.wording import MISSING, number, short

STYLES = ("base.css", "parts.css", "truth.css")
TEMPLATE = "truth.html.j2"
ASSETS = (TEMPLATE, *STYLES)  # Names of the files that `render_truth` needs
_WIDTH = 720.0
_LEFT = 190.0
_RIGHT = 60.0
_ROW = 20.0
_TOP = 8.0
_BOTTOM = 36.0


def render_truth(table: pd.DataFrame, assets: Mapping[str, str], version: str) -> str:
    """HTML of the page; the same table gives the same text.

    Parameters
    ----------
    table : as in ``truth.csv``. assets : text of the files named in `ASSETS`.
    """
    present = table[table["metric"] != "missing"]
    goals = [holds(_float(row.ours), str(row.goal or "")) for row in present.itertuples()]
    kept = [goal for goal in goals if goal is not None]
    return filled_page(
        TEMPLATE,
        STYLES,
        assets,
        areas=[_area(name, area, table[table["area"] == name]) for name, area in AREAS.items()],
        kept=sum(kept),
        goals=len(kept),
        version=version,
    )


def _area(name: str, area: Area, rows: pd.DataFrame) -> dict[str, Any]:
    figures = rows[rows["metric"] != "missing"]
    metrics = []
    for metric in area.metrics:
        part = figures[figures["metric"] == metric]
        if len(part):
            metrics.append(
                {
                    "name": words(metric),
                    "unit": part["unit"].iloc[0],
                    "rows": [_row(row) for _, row in part.iterrows()],
                    "chart": dumbbells(metric, part) if len(part) > 1 else "",
                }
            )
    return {
        "name": name,
        "title": area.title,
        "peer": area.peer,
        "missing": rows.loc[rows["metric"] == "missing", "dataset"].tolist(),
        "metrics": metrics,
    }


def words(name: str) -> str:
    """Name of a metric or data set as people read it."""
    return name.replace("_", " ")


def _row(row: pd.Series) -> dict[str, Any]:
    ours, goal = _float(row["ours"]), str(row["goal"] or "")
    goal = "" if goal == "nan" else goal
    return {
        "dataset": words(str(row["dataset"])),
        "mean": row["dataset"] == MEAN,
        "ours": _shown(ours),
        "peer": _shown(_float(row["peer"])),
        "published": _shown(_float(row["published"])),
        "goal": goal.replace("<", "< ").replace(">", "> "),
        "holds": holds(ours, goal),
        "cpu_s": _shown(_float(row["cpu_s"])),
    }


def _float(value: Any) -> float:
    return math.nan if value is None or value == "" else float(value)


def _shown(value: float) -> str:
    return short(value) if math.isfinite(value) else MISSING


def dumbbells(metric: str, rows: pd.DataFrame) -> str:
    """Ours and the peer of each data set on one axis, joined by a line; the goal as a rule."""
    ours = [_float(value) for value in rows["ours"]]
    peers = [_float(value) for value in rows["peer"]]
    goals = [float(str(goal)[1:]) for goal in rows["goal"] if str(goal or "")[:1] in "<>" and goal]
    known = [value for value in (*ours, *peers, *goals) if math.isfinite(value)]
    low, high = min(known), max(known)
    margin = 0.05 * (high - low) or max(abs(high), 1.0) * 0.05
    low, high = low - margin, high + margin
    floor = _TOP + _ROW * len(rows)

    def x(value: float) -> float:
        return _LEFT + (value - low) / (high - low) * (_WIDTH - _LEFT - _RIGHT)

    parts = []
    for tick in _ticks(low, high):
        parts.append(f'<path class="grid" d="M{x(tick):.1f} {_TOP:g}V{floor:g}"/>')
        parts.append(
            f'<text x="{x(tick):.1f}" y="{floor + 15:g}" text-anchor="middle">{number(tick)}</text>'
        )
    for goal in dict.fromkeys(goals):
        parts.append(f'<path class="limit" d="M{x(goal):.1f} {_TOP:g}V{floor:g}"/>')
    for place, (dataset, one, other) in enumerate(zip(rows["dataset"], ours, peers, strict=True)):
        name, y = words(str(dataset)), _TOP + _ROW * (place + 0.5)
        title = f"{name}: ours {_shown(one)}, peer {_shown(other)}"
        parts.append(
            f"<g><title>{escape(title)}</title>"
            f'<text class="name" x="{_LEFT - 10:g}" y="{y + 4:.1f}" text-anchor="end">'
            f"{escape(name)}</text>"
        )
        if math.isfinite(other):
            at = x(other)
            parts.append(f'<path class="span" d="M{x(one):.1f} {y:.1f}H{at:.1f}"/>')
            parts.append(f'<path class="naive" d="M{at - 4:.1f} {y - 4:.1f}l8 8m0 -8l-8 8"/>')
        parts.append(f'<circle class="ours" cx="{x(one):.1f}" cy="{y:.1f}" r="4.5"/></g>')
    label = f"{words(metric)}, {rows['unit'].iloc[0]}"
    return (
        f'<svg class="chart truth" role="img" aria-label="{escape(label)} by data set"'
        f' viewBox="0 0 {_WIDTH:g} {floor + _BOTTOM:g}">{"".join(parts)}'
        f'<text x="{(_LEFT + _WIDTH - _RIGHT) / 2:g}" y="{floor + 31:g}" text-anchor="middle">'
        f"{escape(label)}</text></svg>"
    )


def _ticks(low: float, high: float) -> list[float]:
    """Four to nine round values within a range."""
    step = 10.0 ** math.floor(math.log10(high - low))
    for part in (1.0, 0.5, 0.2):
        first = math.ceil(low / (part * step))
        last = math.floor(high / (part * step))
        if last - first >= 3:
            return [round(k * part * step, 10) for k in range(first, last + 1)]
    return [round(low + k * (high - low) / 4, 10) for k in range(5)]
