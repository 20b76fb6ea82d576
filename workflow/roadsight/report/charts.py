"""Plots and cross-sections as SVG that follows the page's theme and needs no script."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from itertools import pairwise, product
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from roadsight.report.wording import number

# Margins of a plot, px.
_LEFT = 56.0  # numbers of the y axis
_RIGHT = 14.0
_TOP = 12.0
_BOTTOM = 42.0  # numbers and title of the x axis
_TICKS = 6  # Most numbers on an axis; more would touch each other on a plot of ordinary size
_CHARACTER = 5.8  # About the width of a label's letter, px
_LINE = 11.0  # About the height of a label's letters, px
Span = tuple[float, float]
Box = tuple[float, float, float, float]  # Left, top, right, bottom, px


def span_of(
    *values: ArrayLike | Sequence[float | None],
    start: float | None = None,
    least: float = 0.0,
    share: float = 1.0,
) -> Span:
    """Range of all values that are finite, a little wider than they are.

    Parameters
    ----------
    start : where the range begins, if not at the least value. least : width at the least.
    share : of the values that must lie within; a few wild ones then lie outside.
    """
    # As floats, None becomes NaN.
    joined = np.concatenate([np.asarray(part, np.float64).ravel() for part in values])
    known = joined[np.isfinite(joined)]
    if not len(known):
        return (start or 0.0), (start or 0.0) + max(least, 1.0)
    low, high = np.quantile(known, [(1 - share) / 2, (1 + share) / 2])
    if start is not None:
        low, high = start, max(high, start)
    margin = max(0.05 * (high - low), (least - (high - low)) / 2, 1e-9)
    return (float(low) if start is not None else float(low - margin)), float(high + margin)


def ticks(span: Span, most: int = _TICKS) -> list[float]:
    """Round numbers within a range, in steps of 1, 2 or 5 times a power of ten."""
    low, high = span
    rough = (high - low) / max(most - 1, 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = power * next(m for m in (1, 2, 5, 10) if m * power >= rough * (1 - 1e-9))
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [0.0 if n == 0 else float(f"{n * step:.12g}") for n in range(first, last + 1)]


class Chart:
    """One plot; later parts lie above earlier ones.

    Parameters
    ----------
    title : what one sees, for people who cannot see it. x_label, y_label : with units.
    x_span, y_span : ranges of the axes. width, height : in pixels, axes included.
    numbered : whether numbers stand along x; otherwise `tick` says what does.
    """

    def __init__(
        self,
        title: str,
        x_label: str,
        y_label: str,
        x_span: Span,
        y_span: Span,
        width: float = 470.0,
        height: float = 270.0,
        numbered: bool = True,
    ) -> None:
        self.title, self.labels = title, (x_label, y_label)
        self.spans, self.size = (x_span, y_span), (width, height)
        self._parts: list[str] = []
        self._labels: list[Box] = []
        self._numbered = numbered

    def x(self, value: float) -> float:
        """Pixel of a value across."""
        low, high = self.spans[0]
        return _LEFT + (value - low) / (high - low) * (self.size[0] - _LEFT - _RIGHT)

    def y(self, value: float) -> float:
        """Pixel of a value upwards; what lies outside the range is drawn on its edge."""
        low, high = self.spans[1]
        share = (min(max(value, low), high) - low) / (high - low)
        return self.size[1] - _BOTTOM - share * (self.size[1] - _TOP - _BOTTOM)

    def line(self, xs: Sequence[float], ys: Sequence[float | None], look: str) -> None:
        """Line that breaks where a value is missing."""
        steps, pen_down = [], False
        for x, y in zip(xs, ys, strict=True):
            if y is None or not math.isfinite(y):
                pen_down = False
                continue
            steps.append(f"{'L' if pen_down else 'M'}{self.x(x):.1f} {self.y(y):.1f}")
            pen_down = True
        self._parts.append(f'<path class="line {look}" d="{"".join(steps)}"/>')

    def band(
        self,
        xs: Sequence[float],
        low: Sequence[float | None],
        high: Sequence[float | None],
        look: str,
    ) -> None:
        """Areas between two lines, wherever both are known."""
        run: list[tuple[float, float, float]] = []
        for x, a, b in [*zip(xs, low, high, strict=True), (0.0, None, None)]:
            if a is not None and b is not None:
                run.append((self.x(x), self.y(a), self.y(b)))
                continue
            if len(run) > 1:
                there = [f"{x:.1f} {a:.1f}" for x, a, _ in run]
                back = [f"{x:.1f} {b:.1f}" for x, _, b in reversed(run)]
                self._parts.append(f'<path class="band {look}" d="M{"L".join(there + back)}Z"/>')
            run = []

    def dots(
        self,
        xs: Sequence[float],
        ys: Sequence[float | None],
        look: str,
        texts: Sequence[str] | None = None,
    ) -> None:
        """Dots, with a text each that shows when one points at them, or all as one path."""
        known = [
            (x, y, n)
            for n, (x, y) in enumerate(zip(xs, ys, strict=True))
            if y is not None and math.isfinite(y)
        ]
        if texts is None:
            path = "".join(f"M{self.x(x):.1f} {self.y(y):.1f}h0" for x, y, _ in known)
            self._parts.append(f'<path class="dots {look}" d="{path}"/>')
            return
        for x, y, n in known:
            self._parts.append(
                f'<circle class="dot {look}" cx="{self.x(x):.1f}" cy="{self.y(y):.1f}" r="4">'
                f"<title>{escape(texts[n])}</title></circle>"
            )

    def bars(
        self,
        edges: Sequence[float],
        counts: Sequence[float],
        look: str,
        names: Sequence[str] | None = None,
    ) -> None:
        """Histogram; classes are named by their edges or as given."""
        names = names or [f"{number(low)} to {number(high)}" for low, high in pairwise(edges)]
        floor = self.y(self.spans[1][0])
        for low, high, count, name in zip(edges[:-1], edges[1:], counts, names, strict=True):
            left, right, top = self.x(low) + 0.5, self.x(high) - 0.5, self.y(count)
            self._parts.append(
                f'<rect class="{look}" x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}"'
                f' height="{floor - top:.1f}"><title>{escape(name)}: {number(count)}</title></rect>'
            )

    def level(self, value: float, look: str, text: str = "", upright: bool = False) -> None:
        """Line across the whole plot at a value, with a note."""
        (low_x, high_x), (low_y, high_y) = self.spans
        if not (low_x <= value <= high_x if upright else low_y <= value <= high_y):
            return
        if upright:
            ends = [(value, low_y), (value, high_y)]
            place = f'x="{self.x(value) + 5:.1f}" y="{_TOP + 11:.1f}"'
        else:
            ends = [(low_x, value), (high_x, value)]
            place = (
                f'x="{self.size[0] - _RIGHT - 4:.1f}" y="{self.y(value) - 5:.1f}" text-anchor="end"'
            )
        path = "L".join(f"{self.x(x):.1f} {self.y(y):.1f}" for x, y in ends)
        self._parts.append(f'<path class="line {look}" d="M{path}"/>')
        if text:
            self._parts.append(f"<text {place}>{escape(text)}</text>")

    def tick(self, value: float, text: str) -> None:
        """Tick of the x axis with a text of its own."""
        x, floor = self.x(value), self.size[1] - _BOTTOM
        self._parts.append(f'<path class="tick" d="M{x:.1f} {floor:.1f}v4"/>')
        place = f'x="{x:.1f}" y="{floor + 17:.1f}" text-anchor="middle"'
        self._parts.append(f"<text {place}>{escape(text)}</text>")

    def label(self, x: float, y: float, text: str) -> None:
        """Text beside a place where it covers no earlier one; none where there is no room."""
        wide, sides = _CHARACTER * len(text), [(7, "start"), (-7, "end")]
        if self.x(x) > 0.6 * self.size[0]:
            sides.reverse()
        for below, (beside, anchor) in product((-6, 14), sides):
            at, base = self.x(x) + beside, self.y(y) + below
            left = at if anchor == "start" else at - wide
            right, top = left + wide, base - _LINE
            inside = left >= _LEFT and right <= self.size[0] and top >= 0
            if (inside and base <= self.size[1] - _BOTTOM) and not any(
                left < b[2] and b[0] < right and top < b[3] and b[1] < base for b in self._labels
            ):
                self._labels.append((left, top, right, base))
                place = f'x="{at:.1f}" y="{base:.1f}" text-anchor="{anchor}"'
                self._parts.append(f'<text class="note" {place}>{escape(text)}</text>')
                return

    def note(self, x: float, y: float, text: str, anchor: str = "middle") -> None:
        """Text at a place, whatever lies there."""
        place = f'x="{self.x(x):.1f}" y="{self.y(y):.1f}" text-anchor="{anchor}"'
        self._parts.append(f'<text class="note" {place}>{escape(text)}</text>')

    def svg(self) -> str:
        """The plot."""
        width, height = self.size
        x_label, y_label = self.labels
        middle = (_TOP + height - _BOTTOM) / 2
        return (
            f'<svg class="chart" role="img" aria-label="{escape(self.title, quote=True)}"'
            f' viewBox="0 0 {width:g} {height:g}" style="max-width:{1.15 * width:g}px">'
            f"{self._grid()}{''.join(self._parts)}"
            f'<text x="{(_LEFT + width - _RIGHT) / 2:.1f}" y="{height - 6:.1f}"'
            f' text-anchor="middle">{escape(x_label)}</text>'
            f'<text transform="translate(13 {middle:.1f}) rotate(-90)"'
            f' text-anchor="middle">{escape(y_label)}</text></svg>'
        )

    def _grid(self) -> str:
        width, height = self.size
        floor, parts = height - _BOTTOM, []
        across = ticks(self.spans[0], 9 if width > 700 else _TICKS) if self._numbered else []
        for value in across:
            x, text = self.x(value), number(value)
            parts.append(f'<path class="tick" d="M{x:.1f} {floor:.1f}v4"/>')
            parts.append(
                f'<text x="{x:.1f}" y="{floor + 17:.1f}" text-anchor="middle">{text}</text>'
            )
        for value in ticks(self.spans[1], 5 if height < 240 else _TICKS):
            y = self.y(value)
            parts.append(f'<path class="grid" d="M{_LEFT:g} {y:.1f}H{width - _RIGHT:g}"/>')
            parts.append(
                f'<text x="{_LEFT - 7:g}" y="{y + 4:.1f}" text-anchor="end">{number(value)}</text>'
            )
        parts.append(f'<path class="axis" d="M{_LEFT:g} {floor:g}H{width - _RIGHT:g}"/>')
        return "".join(parts)


# Drawings of a site: the worst by rank. The layer `cross_sections` and the table have all.
MOST = 24
_WIDE = 470.0
# Pixels of a chart that its axes take, across and upwards
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
