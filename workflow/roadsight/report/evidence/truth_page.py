"""Page of the product on real data: ours, a peer, published figures and goals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from typing import Any

import pandas as pd

from roadsight.evidence.truth.catalogue import AREAS, Area
from roadsight.evidence.truth.table import MEAN, holds
from roadsight.report.files import template_environment
from roadsight.report.wording import number

STYLES = ("base.css", "parts.css", "truth.css")
TEMPLATE = "truth.html.j2"
ASSETS = (TEMPLATE, *STYLES)  # Names of the files that `render_truth` needs
_NONE = "\u2013"
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
    environment = template_environment({TEMPLATE: assets[TEMPLATE]})
    present = table[table["metric"] != "missing"]
    goals = [holds(_float(row.ours), str(row.goal or "")) for row in present.itertuples()]
    kept = [goal for goal in goals if goal is not None]
    return environment.get_template(TEMPLATE).render(
        css="\n".join(assets[name] for name in STYLES),
        areas=[_area(name, area, table[table["area"] == name]) for name, area in AREAS.items()],
        kept=sum(kept),
        goals=len(kept),
        version=version,
    )


def _area(name: str, area: Area, rows: pd.DataFrame) -> dict[str, Any]:
    figures = rows[rows["metric"] != "missing"]
    return {
        "name": name,
        "title": area.title,
        "peer": area.peer,
        "missing": rows.loc[rows["metric"] == "missing", "dataset"].tolist(),
        "metrics": [
            _metric(metric, figures[figures["metric"] == metric])
            for metric in area.metrics
            if (figures["metric"] == metric).any()
        ],
    }


def _metric(metric: str, rows: pd.DataFrame) -> dict[str, Any]:
    shown = [_row(row) for _, row in rows.iterrows()]
    return {
        "name": words(metric),
        "unit": rows["unit"].iloc[0],
        "rows": shown,
        "chart": dumbbells(metric, rows) if len(rows) > 1 else "",
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
    return number(float(f"{value:.3g}")) if math.isfinite(value) else _NONE


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
        y = _TOP + _ROW * (place + 0.5)
        parts.append(_pair(words(str(dataset)), one, other, x, y))
    label = f"{words(metric)}, {rows['unit'].iloc[0]}"
    return (
        f'<svg class="chart truth" role="img" aria-label="{escape(label)} by data set"'
        f' viewBox="0 0 {_WIDTH:g} {floor + _BOTTOM:g}">{"".join(parts)}'
        f'<text x="{(_LEFT + _WIDTH - _RIGHT) / 2:g}" y="{floor + 31:g}" text-anchor="middle">'
        f"{escape(label)}</text></svg>"
    )


def _pair(dataset: str, ours: float, peer: float, x: Any, y: float) -> str:
    title = f"{dataset}: ours {_shown(ours)}, peer {_shown(peer)}"
    parts = [
        f'<text class="name" x="{_LEFT - 10:g}" y="{y + 4:.1f}" text-anchor="end">'
        f"{escape(dataset)}</text>"
    ]
    if math.isfinite(peer):
        parts.append(f'<path class="span" d="M{x(ours):.1f} {y:.1f}H{x(peer):.1f}"/>')
        at = x(peer)
        parts.append(f'<path class="naive" d="M{at - 4:.1f} {y - 4:.1f}l8 8m0 -8l-8 8"/>')
    parts.append(f'<circle class="ours" cx="{x(ours):.1f}" cy="{y:.1f}" r="4.5"/>')
    return f"<g><title>{escape(title)}</title>{''.join(parts)}</g>"


def _ticks(low: float, high: float) -> list[float]:
    """Four to nine round values within a range."""
    step = 10.0 ** math.floor(math.log10(high - low))
    for part in (1.0, 0.5, 0.2):
        first = math.ceil(low / (part * step))
        last = math.floor(high / (part * step))
        if last - first >= 3:
            return [round(k * part * step, 10) for k in range(first, last + 1)]
    return [round(low + k * (high - low) / 4, 10) for k in range(5)]
