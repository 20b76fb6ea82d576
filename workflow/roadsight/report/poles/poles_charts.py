"""The plots of the poles job, made from the content of ``poles/page.json``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from roadsight.evidence import published
from roadsight.report.charts import Chart, span_of
from roadsight.report.poles.poles_layers import ACCEPTED, REJECTED
from roadsight.report.wording import counted, number

_WIDE = 1000.0
"""Width of a plot along a route, px: about that of the page."""
_LOW = 176.0
"""Height of a plot along a route, px: several stand below each other."""
_SHOWN_SHARE = 0.99
"""Share of the values that an axis must show; a few wild ones lie outside, so that the others are
not squeezed."""
_BINS = 20
"""Bars of a histogram."""
_PANELS = (
    ("residual_px", None, "Residual, px"),
    ("yaw_deg", "sigma_yaw_deg", "Turned right, °"),
    ("lateral_m", "sigma_lateral_m", "Moved right, m"),
)
SOURCES = {
    "network": "the depth network",
    "ground": "the ground under its foot",
    "lidar": "a LiDAR column",
}
"""Where a single distance comes from, in words."""


def route_charts(route: dict[str, Any]) -> list[str]:
    """Residual, yaw correction and lateral offset of each image along a route."""
    return [
        _route_chart(route, *panel, is_last=number == len(_PANELS) - 1)
        for number, panel in enumerate(_PANELS)
    ]


def _route_chart(
    route: dict[str, Any], key: str, sigma_key: str | None, title: str, is_last: bool
) -> str:
    """One quantity along a route; its range is that of the accepted images."""
    x, states, values = route["station_m"], route["state"], route[key]
    good = _where(values, states, ACCEPTED)
    sigma = [None] * len(x) if sigma_key is None else route[sigma_key]
    low, high = _around(good, sigma, -1), _around(good, sigma, 1)
    if sigma_key is None:
        span = span_of(values, start=0.0, least=0.5, share=_SHOWN_SHARE)
    else:
        span = span_of(good, low, high, least=0.5, share=_SHOWN_SHARE)
    chart = Chart(
        f"{title} along route {route['route']}",
        "Distance along the route, m" if is_last else "",
        title,
        span_of(x, start=0.0, least=10.0),
        span,
        _WIDE,
        _LOW,
    )
    chart.band(x, low, high, "sigma")
    chart.line(x, good, "good")
    chart.dots(x, good, "good")
    chart.dots(x, _where(values, states, REJECTED), "bad")
    return chart.svg()


def _around(
    values: Sequence[float | None], sigma: Sequence[float | None], sign: int
) -> list[float | None]:
    return [
        None if v is None or s is None else v + sign * s for v, s in zip(values, sigma, strict=True)
    ]


def _where(
    values: Sequence[float | None], states: Sequence[int], wanted: int
) -> list[float | None]:
    """Values of the images in a state, None elsewhere."""
    return [v if state == wanted else None for v, state in zip(values, states, strict=True)]


def depth_fit_chart(fit: dict[str, Any]) -> str:
    """Relative depth of the road in one image against its LiDAR distance."""
    x, y = fit["distance_m"], fit["relative"]
    along = np.geomspace(fit["near_m"], fit["far_m"], 120)
    curve = fit["c1"] / along + fit["c2"]
    chart = Chart(
        f"Relative depth against LiDAR distance in {fit['image']}",
        "Distance of the road from LiDAR, m",
        "Relative depth (1 = nearest)",
        span_of(x, start=0.0),
        span_of(y, curve),
    )
    chart.dots(x, y, "good faint")
    chart.line(along.tolist(), curve.tolist(), "fit")
    return chart.svg()


def depth_check_chart(source: str, check: dict[str, Any]) -> dict[str, str]:
    """Distances that one source says against the distance to the located pole."""
    x, y = np.array(check["pole_m"]), np.array(check["said_m"])
    span = span_of(x, y, start=0.0, share=_SHOWN_SHARE)
    name = SOURCES[source]
    chart = Chart(
        f"Distance of poles by {name} against the located pole",
        "Distance to the located pole, m",
        "Distance in this image, m",
        span,
        span,
    )
    chart.line([0.0, span[1]], [0.0, span[1]], "reference")
    chart.dots(x.tolist(), y.tolist(), "good")
    ratio = np.abs(y - x)
    text = (
        f"{counted(len(x), 'sighting')}; half of the distances by {name} are within"
        f" {number(float(np.median(ratio)), 1)} m of the distance to the located pole."
    )
    return {"title": f"Distance by {name}", "svg": chart.svg(), "text": text}


def error_charts(errors: Sequence[dict[str, Any]]) -> list[dict[str, str]]:
    """Scatter and histogram of the errors: anywhere, and across the road."""
    kinds = (
        ("geodesic_m", "Distance to the known pole", published.WITHIN_75_M),
        ("across_m", "Distance across the road", published.ACROSS_75_M),
    )
    return [
        {"title": title, "scatter": scatter, "histogram": histogram}
        for key, title, paper in kinds
        for scatter, histogram in [_error_pair(errors, key, title, paper)]
    ]


def _error_pair(
    errors: Sequence[dict[str, Any]], key: str, title: str, paper: float
) -> tuple[str, str]:
    known = [error for error in errors if error.get(key) is not None]
    values = [abs(error[key]) for error in known]
    order = sorted(range(len(values)), key=lambda n: values[n])
    label = f"{title}, m"
    span = span_of(values, start=0.0, least=1.0)
    scatter = Chart(
        label, "Poles, from the best to the worst", label, (0.0, len(values) + 1.0), span
    )
    scatter.level(paper, "reference", f"paper: 75 % within {number(paper)} m")
    if values:
        quartile = float(np.quantile(values, 0.75))
        scatter.level(quartile, "fit", f"here: 75 % within {number(quartile, 2)} m")
    texts = [f"{known[n].get('pole')}: {number(values[n], 2)} m" for n in order]
    ranks = [float(n + 1) for n in range(len(order))]
    scatter.dots(ranks, [values[n] for n in order], "good", texts)
    counts, edges = np.histogram(values, bins=_BINS, range=(0.0, span[1]))
    histogram = Chart(f"Histogram: {label}", label, "Poles", span, span_of(counts, start=0.0))
    histogram.bars(edges.tolist(), counts.tolist(), "good")
    return scatter.svg(), histogram.svg()


def f1_chart(thresholds: Sequence[dict[str, Any]]) -> str:
    """F1 score, precision and recall by distance threshold, and the paper's F1 score."""
    x = [float(row["threshold_m"]) for row in thresholds]
    chart = Chart(
        "F1 score by distance threshold",
        "Threshold, m",
        "Score",
        span_of(x, list(published.F1), start=0.0),
        (0.0, 1.0),
        560.0,
        300.0,
    )
    chart.line(list(map(float, published.F1)), list(published.F1.values()), "reference")
    paper = [f"paper, {m} m: {f1:.2f}" for m, f1 in published.F1.items()]
    chart.dots(list(map(float, published.F1)), list(published.F1.values()), "reference", paper)
    f1 = [row["f1"] for row in thresholds]
    chart.line(x, f1, "fit")
    texts = [f"{number(a)} m: F1 {number(b or 0.0, 2)}" for a, b in zip(x, f1, strict=True)]
    chart.dots(x, f1, "good", texts)
    return chart.svg()
