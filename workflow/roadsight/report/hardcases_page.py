"""Page of the hard cases: what the naive way gets wrong, and what ours does."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from itertools import groupby
from typing import Any

from roadsight.report.files import filled_page
from roadsight.report.wording import number, short
from roadsight_hardcases.case import CaseResult

STYLES = ("base.css", "parts.css", "hardcases.css")
TEMPLATE = "hardcases.html.j2"
ASSETS = (TEMPLATE, *STYLES)  # Names of the files that `render_hardcases` needs
# Errors over bounds are drawn from 1e-9 to 1e9; smaller and larger ones stand at the ends
_DECADES = 9
# Margins and sizes of the plot, px.
_LEFT = 300.0  # names of the cases
_RIGHT = 24.0
_TOP = 26.0  # the word above the line of the bounds
_ROW = 15.0
_BOTTOM = 34.0  # numbers and title of the axis
_WIDTH = 1060.0


def render_hardcases(results: Sequence[CaseResult], assets: Mapping[str, str], version: str) -> str:
    """HTML of the page; the same results give the same text.

    Parameters
    ----------
    results : in the catalogue's order. assets : text of the files named in `ASSETS`.
    """
    ordered = sorted(results, key=lambda result: result.case.stage)
    stages = groupby(ordered, key=lambda result: result.case.stage)
    return filled_page(
        TEMPLATE,
        STYLES,
        assets,
        chart=chart_svg(ordered),
        stages=[(stage, [_row(result) for result in group]) for stage, group in stages],
        cases=len(results),
        passed=sum(result.passed for result in results),
        version=version,
    )


def _row(result: CaseResult) -> dict[str, Any]:
    case = result.case
    return {
        "name": case.name.replace("_", " "),
        "hazard": case.hazard,
        "naive": short(result.naive_error),
        "ours": short(result.our_error),
        "bound": number(case.bound),
        "unit": case.unit,
        "passed": result.passed,
        "known": case.known,
    }


def share_of_bound(error: float, bound: float) -> float:
    """Decimal logarithm of an error over its bound, held within the picture; zero at its left."""
    if error <= 0:
        return -_DECADES
    return min(max(math.log10(error / bound), -_DECADES), _DECADES)


def _x(decades: float) -> float:
    return _LEFT + (decades + _DECADES) / (2 * _DECADES) * (_WIDTH - _LEFT - _RIGHT)


def chart_svg(results: Sequence[CaseResult]) -> str:
    """Naive error and ours over the bound of each case, on a logarithmic scale."""
    height = _TOP + _ROW * len(results) + _BOTTOM
    floor = height - _BOTTOM
    lines = [_line(result, _TOP + _ROW * (n + 0.5)) for n, result in enumerate(results)]
    title = "Error over bound of each case, by the naive way and by ours"
    parts = []
    for decade in range(-_DECADES, _DECADES + 1, 3):
        text = "1" if decade == 0 else f"10<tspan dy='-5' font-size='9'>{decade}</tspan>"
        text = {-_DECADES: "none", _DECADES: f"≥ {text}"}.get(decade, text)
        x = _x(decade)
        parts.append(f'<path class="grid" d="M{x:.1f} {_TOP:g}V{floor:.1f}"/>')
        parts.append(f'<text x="{x:.1f}" y="{floor + 15:.1f}" text-anchor="middle">{text}</text>')
    parts.append(f'<path class="limit" d="M{_x(0):.1f} {_TOP - 8:g}V{floor:.1f}"/>')
    parts.append(f'<text x="{_x(0):.1f}" y="{_TOP - 12:g}" text-anchor="middle">bound</text>')
    return (
        f'<svg class="chart cases" role="img" aria-label="{title}"'
        f' viewBox="0 0 {_WIDTH:g} {height:g}">{"".join(parts)}{"".join(lines)}'
        f'<text x="{_x(0):.1f}" y="{height - 4:.1f}" text-anchor="middle">'
        "error over bound</text></svg>"
    )


def _line(result: CaseResult, y: float) -> str:
    case = result.case
    ends = [_x(share_of_bound(e, case.bound)) for e in (result.our_error, result.naive_error)]
    row = _row(result)
    title = (
        f"{row['name']}: naive {row['naive']}, ours {row['ours']},"
        f" bound {row['bound']} ({case.unit})"
    )
    return (
        f"<g><title>{escape(title)}</title>"
        f'<text class="name" x="{_LEFT - 10:g}" y="{y + 4:.1f}" text-anchor="end">'
        f"{escape(row['name'])}</text>"
        f'<path class="span" d="M{ends[0]:.1f} {y:.1f}H{ends[1]:.1f}"/>'
        f'<circle class="ours" cx="{ends[0]:.1f}" cy="{y:.1f}" r="4.5"/>'
        f'<path class="naive" d="M{ends[1] - 4:.1f} {y - 4:.1f}l8 8m0 -8l-8 8"/></g>'
    )
