"""Page of the benchmarks: ours beside the reference way, a peer or a bound, in one run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from roadsight.report.files import filled_page
from roadsight.report.wording import MISSING, number, short

STYLES = ("base.css", "parts.css", "bench.css")
TEMPLATE = "bench.html.j2"
ASSETS = (TEMPLATE, *STYLES)  # Names of the files that `render_bench` needs
BOUND = "bound: "  # Begins the name of what nothing can be faster than
# Margins and sizes of the plot, px.
_LEFT = 400.0  # names of the rows
_RIGHT = 60.0  # the ratio behind the longest bar
_TOP = 12.0
_ROW = 20.0
_BOTTOM = 34.0  # numbers and title of the axis
_WIDTH = 1060.0
# Ratios below a hundredth are drawn as one, so that one of them does not squeeze all bars
_LEAST_DECADE = -2


def render_bench(
    rows: Sequence[Mapping[str, Any]], assets: Mapping[str, str], version: str, machine: str
) -> str:
    """HTML of the page; the same rows give the same text.

    Parameters
    ----------
    rows : as in ``bench.json``. assets : text of the files named in `ASSETS`. machine : one line.
    """
    bounds = [row for row in rows if is_bound(row)]
    peers = [row for row in rows if not is_bound(row)]
    return filled_page(
        TEMPLATE,
        STYLES,
        assets,
        chart=ratio_chart(peers) if peers else "",
        peers=[_shown(row) for row in peers],
        bounds=[_shown(row) for row in bounds],
        version=version,
        machine=machine,
    )


def is_bound(row: Mapping[str, Any]) -> bool:
    """Whether a row compares with what cannot be undercut."""
    return str(row["against"]).startswith(BOUND)


def _shown(row: Mapping[str, Any]) -> dict[str, Any]:
    clock = None  # seconds by the clock and their quotient, where they were taken
    if "wall_s_ours" in row:
        ours, against = row["wall_s_ours"], row["wall_s_against"]
        values = {"ours_s": ours, "against_s": against, "times": ours / max(against, 1e-9)}
        clock = {name: short(value) for name, value in values.items()}
    return {
        "kernel": row["kernel"],
        "ours": row["ours"],
        "against": str(row["against"]).removeprefix(BOUND),
        "workload": row["workload"],
        "ours_s": short(row["cpu_s_ours"]),
        "against_s": short(row["cpu_s_against"]),
        "ratio": short(row["ratio"]),
        "times": short(1 / row["ratio"]) if row["ratio"] > 0 else MISSING,
        "clock": clock,
        "ours_mib": _mib(row["peak_mib_ours"]),
        "against_mib": _mib(row["peak_mib_against"]),
        "agreement": MISSING if row["agreement"] is None else number(row["agreement"]),
        "metric": row["agreement_metric"],
        "slower": row["ratio"] < 1,
    }


def _mib(value: float | None) -> str:
    return MISSING if value is None else f"{value:.0f}"


def ratio_chart(rows: Sequence[Mapping[str, Any]]) -> str:
    """CPU time of the other way over ours, a bar a row, on a logarithmic scale from 1."""
    logs = [math.log10(max(row["ratio"], 10.0**_LEAST_DECADE)) for row in rows]
    least = min(0, math.floor(min(logs)))
    most = max(1, math.ceil(max(logs)))
    floor = _TOP + _ROW * len(rows)

    def x(decades: float) -> float:
        return _LEFT + (decades - least) / (most - least) * (_WIDTH - _LEFT - _RIGHT)

    parts = []
    for decade in range(least, most + 1):
        name = f"{10**decade:g}"
        parts.append(f'<path class="grid" d="M{x(decade):.1f} {_TOP:g}V{floor:g}"/>')
        parts.append(
            f'<text x="{x(decade):.1f}" y="{floor + 15:g}" text-anchor="middle">{name}</text>'
        )
    for place, (row, decades) in enumerate(zip(rows, logs, strict=True)):
        parts.append(_bar(row, x(0), x(decades), _TOP + _ROW * place))
    parts.append(f'<path class="limit" d="M{x(0):.1f} {_TOP:g}V{floor:g}"/>')
    label = "CPU time of the other way over ours"
    return (
        f'<svg class="chart ratios" role="img" aria-label="{label}"'
        f' viewBox="0 0 {_WIDTH:g} {floor + _BOTTOM:g}">{"".join(parts)}'
        f'<text x="{(_LEFT + _WIDTH - _RIGHT) / 2:g}" y="{floor + 30:g}" text-anchor="middle">'
        f"{label}</text></svg>"
    )


def _bar(row: Mapping[str, Any], one: float, end: float, y: float) -> str:
    left, width = min(one, end), abs(end - one)
    kind = "slower" if end < one else "faster"
    name, ratio = str(row["kernel"]), short(row["ratio"])
    title = f"{name}, {row['workload']}: {ratio} times ({row['against']})"
    other = row["workload"] if name.startswith("set cover") else row["against"]
    label = f"{name}: {str(other).split(' (')[0].split(', its ')[0]}"
    return (
        f"<g><title>{escape(title)}</title>"
        f'<text class="name" x="{_LEFT - 10:g}" y="{y + 14:.1f}" text-anchor="end">'
        f"{escape(label)}</text>"
        f'<rect class="{kind}" x="{left:.1f}" y="{y + 4:.1f}" width="{max(width, 1):.1f}"'
        f' height="{_ROW - 8:g}"/>'
        f'<text x="{max(one, end) + 6:.1f}" y="{y + 14:.1f}">{ratio}</text></g>'
    )
