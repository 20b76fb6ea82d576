"""The page of what accuracy costs: a frontier for each measure, tables, published figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from roadsight.evidence.metrics import METRICS
from roadsight.evidence.studies import WHOLE_JOB, PublishedStage, Study
from roadsight.evidence.tradeoffs import Cost, next_step
from roadsight.report.charts import Chart, span_of
from roadsight.report.files import filled_page
from roadsight.report.wording import MISSING, number, percent

TEMPLATE = "tradeoffs.html.j2"
STYLES = ("base.css", "parts.css", "poles.css")
_MILE_KM = 1.609344  # An international mile; published figures are by the mile
_PRECISION = {
    "coordinate_error_m": "Largest error of a coordinate",
    "normal_error_deg": "Error of normals, 95th percentile",
}

Row = Mapping[str, Any]


def render_page(
    studies: Mapping[str, Study],
    rows: Sequence[Row],
    stages: Sequence[Mapping[str, Any]],
    assets: Mapping[str, str],
    version: str,
) -> str:
    """HTML of the page; needs nothing else.

    Parameters
    ----------
    rows : all rows of ``tradeoffs.csv`` with the study's name under ``study``.
    """

    def shown(job: str) -> list[dict[str, Any]]:
        return [
            {
                "id": name,
                "study": study,
                "views": measure_views([row for row in rows if row["study"] == name]),
            }
            for name, study in studies.items()
            if study.job == job
        ]

    precision = measure_views([row for row in rows if row["study"] == "coordinates"])
    return filled_page(
        TEMPLATE,
        STYLES,
        assets,
        jobs=[("Placement of sensors", shown("placement")), ("Utility poles", shown("poles"))],
        precision=precision,
        stages=stages,
        version=version,
    )


def measure_views(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Chart and table of each measure of one study, in order."""
    measures: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        measures.setdefault((row["stage"], row["metric"]), []).append(row)
    views = []
    for (stage, _), part in measures.items():
        default = _default(part)
        cost_of = "whole job" if stage == WHOLE_JOB else f"step {stage}"
        views.append(
            {
                "title": f"{title(part[0])}: {cost_of}",
                "reference": part[0]["reference"],
                "svg": _chart(part),
                "rows": [
                    {
                        "level": row["level"],
                        "cpu_s": number(row["cpu_seconds"]),
                        "mib": number(row["peak_mib"]),
                        "value": amount(row["value"], row["unit"]),
                        "error": amount(row["error_vs_reference"], row["unit"]),
                        "is_default": row["is_default"],
                        "on_frontier": row["on_frontier"],
                    }
                    for row in part
                ],
                # Where a perfect result is 0, a value is its own error.
                "has_error": any(row["value"] != row["error_vs_reference"] for row in part),
                "on_frontier": None if default is None else default["on_frontier"],
                "verdict": verdict(part),
            }
        )
    return views


def title(row: Row) -> str:
    """What a row's metric measures."""
    name = row["metric"]
    return METRICS[name].title if name in METRICS else _PRECISION[name]


def verdict(rows: Sequence[Row]) -> str:
    """One sentence: whether the default is on the frontier, and what the next step costs."""
    default = _default(rows)
    if default is None:
        return "There is no default row, so what the next step costs cannot be said."
    name = f"The default {default['level']}"
    place = "is on the frontier" if default["on_frontier"] else "is off the frontier"
    step = next_step(rows)
    if step is None:
        return f"{name} {place}; no level is more accurate."
    gain = amount(abs(step["error"]), default["unit"])
    cost = f"{_signed(step['cpu_s'])} CPU s and {_signed(step['mib'])} MiB"
    return f"{name} {place}; {step['level']} is better by {gain} and costs {cost}."


def _default(rows: Sequence[Row]) -> Row | None:
    return next((row for row in rows if row["is_default"]), None)


def amount(value: float, unit: str) -> str:
    """Value with its unit."""
    if not math.isfinite(value):
        return MISSING
    if unit == "share":
        return percent(value)
    return number(value) if unit in ("count", "1") else f"{number(value)} {unit}"


def _signed(value: float) -> str:
    return ("+" if value >= 0 else "") + number(round(value, 1))


def _chart(rows: Sequence[Row]) -> str:
    """Error against processor time; the frontier as a line."""
    scale = 100.0 if rows[0]["unit"] == "share" else 1.0
    unit = {"share": "%", "count": "", "1": ""}.get(rows[0]["unit"], rows[0]["unit"])
    known = [row for row in rows if math.isfinite(row["error_vs_reference"])]
    x = [row["cpu_seconds"] for row in known]
    y = [scale * row["error_vs_reference"] for row in known]
    chart = Chart(
        f"{title(rows[0])} against processor time",
        "Processor time, CPU s",
        f"Error{', ' + unit if unit else ''}",
        span_of(x, start=0.0, least=0.1),
        span_of(y, start=0.0, least=1e-3 if any(y) else 1.0),
    )
    best = sorted((a, b) for a, b, row in zip(x, y, known, strict=True) if row["on_frontier"])
    chart.line([a for a, _ in best], [b for _, b in best], "fit")
    for look, chosen in (("reference", False), ("good", True)):
        part = [n for n, row in enumerate(known) if bool(row["is_default"]) is chosen]
        texts = [f"{known[n]['level']}: {number(x[n])} CPU s" for n in part]
        chart.dots([x[n] for n in part], [y[n] for n in part], look, texts)
    # Where labels have no room for all, the default's and those of the frontier have it first.
    points = sorted(
        zip(x, y, known, strict=True),
        key=lambda point: (not point[2]["is_default"], not point[2]["on_frontier"]),
    )
    for a, b, row in points:
        chart.label(a, b, str(row["level"]))
    return chart.svg()


def stage_rows(
    published: Sequence[PublishedStage], costs: Mapping[str, Cost], length_km: float
) -> list[dict[str, Any]]:
    """Published and own core-minutes a mile by stage (paper 2, Table 4)."""
    miles = length_km / _MILE_KM
    rows = []
    for stage in published:
        own = [costs[rule].cpu_s for rule in stage.rules if rule in costs]
        rows.append(
            {
                "title": stage.title,
                "hardware": f"{stage.cores} core{'s' if stage.cores > 1 else ''}"
                + (" and a GPU" if stage.gpu else ""),
                "published": number(stage.minutes_per_mile * stage.cores),
                "own": number(math.fsum(own) / 60 / miles) if own else MISSING,
                "rules": ", ".join(stage.rules),
            }
        )
    return rows


def plain_table(rows: Sequence[Row]) -> str:
    """The main table as Markdown: one line for each measure of each level."""
    head = "| Study | Level | Cost of | CPU s | MiB | Accuracy | Value | Error | Frontier |"
    lines = [head, "|---|---|---|--:|--:|---|--:|--:|---|"]
    for row in rows:
        level = f"**{row['level']}**" if row["is_default"] else row["level"]
        cells = (
            row["knob"],
            level,
            row["stage"],
            f"{row['cpu_seconds']:.1f}",
            f"{row['peak_mib']:.0f}",
            title(row),
            amount(row["value"], row["unit"]),
            amount(row["error_vs_reference"], row["unit"]),
            "yes" if row["on_frontier"] else "",
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"
