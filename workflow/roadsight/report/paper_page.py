"""The page of both studies: each table and figure, published beside ours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from roadsight.evidence import paper, published
from roadsight.report.charts import Chart, span_of
from roadsight.report.files import filled_page
from roadsight.report.wording import MISSING, number, short

TEMPLATE = "paper.html.j2"
STYLES = ("base.css", "parts.css", "poles.css", "truth.css")
ASSETS = (TEMPLATE, *STYLES)

# What a reader has to know of each item
_ABOUT = {
    "Table 2 placement": "Facts of each site. Ours are generated.",
    "Table 4": "Pavement points against the truth. The study labelled its own sites.",
    "Fig. 18": "Sensors of each plan. Bars: as published, with the sensors of the study's Table 5."
    " Line: by default, with the products as sold. Dots: the study's; its text repeats five of"
    " them.",
    "Fig. 19": "Time of one candidate: its depth map and its row of the detection matrix. The"
    " study's curves have no numbers in the text. The default is of the product as sold.",
    "Fig. 20": "Sensors by the U-Net's depth maps, and their mean distance to the nearest sensor of"
    " the baseline, which is Algorithm 1. The study reports distances above 3 m at all sites.",
    "Table 1": "F1 at 3 m when one component is left out. The study gives no numbers.",
    "Table 2 poles": "Scores by distance threshold.",
    "Table 3": "Mean error by scenario on the generated route. Extraneous features are driveways"
    " and car parks within 25 m.",
    "Fig. 12": "Errors of the poles that match a known one, from the smallest to the largest. Blue:"
    " as published. Black: by default. The map (Fig. 10) shows the drive, dashed, and the poles"
    " that the default located.",
    "Table 4 poles": "The study's minutes a mile times its cores, GPUs not counted, and our"
    " processor time.",
    "Image height": "Images that show fewer poles than at their own height, which is"
    f" {paper.NATIVE_PX} px here.",
    "Voxel size": "The raster of the LiDAR cloud by the edge of a voxel. The study's cloud has 34"
    " million points, ours a million for each kilometre.",
}

Row = Mapping[str, Any]


def render_paper(
    rows: Sequence[Row],
    measured: paper.Measured,
    size: paper.Size,
    assets: Mapping[str, str],
    version: str,
) -> str:
    """HTML of the page; the same content gives the same text.

    Parameters
    ----------
    rows : of ``paper.csv``. measured : the runs, see `roadsight.evidence.paper`.
    assets : text of the files named in `ASSETS`.
    """
    studies = [
        ("placement", "Placement of roadside LiDAR", _placement_figures(measured)),
        ("poles", "Pole geolocation", _pole_figures(measured)),
    ]
    return filled_page(
        TEMPLATE,
        STYLES,
        assets,
        studies=[
            {"title": title, "items": _items(study, rows, figures)}
            for study, title, figures in studies
        ],
        size=size,
        cpu_minutes=number(cpu_minutes(measured)),
        version=version,
    )


def cpu_minutes(measured: paper.Measured) -> float:
    """Processor time that all runs need where nothing is shared but the generated sites, min."""
    return math.fsum(math.fsum(run["cpu_s"].values()) for run in measured.values()) / 60


def _items(
    study: str, rows: Sequence[Row], figures: Mapping[str, list[str]]
) -> list[dict[str, Any]]:
    own = [row for row in rows if row["study"] == study]
    return [
        {
            "id": f"{study}-{item}".lower().replace(" ", "-").replace(".", ""),
            "title": item,
            "about": _ABOUT.get(f"{item} {study}", _ABOUT.get(item, "")),
            "rows": [_shown(row) for row in own if row["item"] == item],
            "timed": any(row["item"] == item and row["cpu_s_default"] is not None for row in own),
            "figures": figures.get(item, []),
        }
        for item in dict.fromkeys(row["item"] for row in own)
    ]


def _shown(row: Row) -> dict[str, str]:
    unit = f", {row['unit']}" if row["unit"] else ""
    name = row["row"] if row["row"] == row["quantity"] else f"{row['row']}: {row['quantity']}"
    shown = {"site": row["site"], "name": f"{name}{unit}"}
    for key in ("published", "as_published", "default", "cpu_s_as_published", "cpu_s_default"):
        value = row[key]
        shown[key] = MISSING
        if value is not None and math.isfinite(value):
            shown[key] = short(value) if abs(value) < 1000 else number(value)
    return shown


def _placement_figures(measured: paper.Measured) -> dict[str, list[str]]:
    site = paper.NETWORK_SITE
    ways = {
        "Algorithm 1, steps 1 to 4": "preliminary",
        "Algorithm 1": "hybrid",
        **{title: way for way, title in paper.NETWORKS.items()},
    }
    maps = []
    for title, way in ways.items():
        url = measured[f"{site}-{way}"]["maps"].get("table5-OS-64")
        picture = f'<img src="{url}" alt="Depth map"><figcaption>{title}, OS-64</figcaption>'
        maps.append("" if url is None else f"<figure>{picture}</figure>")
    return {
        "Fig. 18": [_plans_chart(measured, site) for site in paper.PLACEMENT_SITES],
        "Fig. 19": [_time_chart(measured), *maps],
    }


def _plans_chart(measured: paper.Measured, site: str) -> str:
    """Sensors of each plan: bars as published, a line for the default, crosses of the study."""
    title = paper.PLACEMENT_SITES[site]
    one = [measured[f"{site}-published"]["plans"][f"table5-{p}"]["sensors"] for p in paper.PLANS]
    other = [measured[f"{site}-default"]["plans"][p]["sensors"] for p in paper.PLANS]
    theirs = [published.SENSORS[title].get(name) for name in published.PLANS]
    places = [float(n) for n in range(len(one))]
    known = [value for value in theirs if value is not None]
    chart = Chart(
        f"{title}: sensors of each plan",
        f"{title}: plan",
        "Sensors",
        (-0.6, len(one) - 0.4),
        span_of(one, other, known, start=0.0, least=1.0),
        numbered=False,
    )
    edges = [place - 0.5 for place in (*places, len(places))]
    chart.bars(edges, one, "good", [f"{name}, as published" for name in published.PLANS])
    chart.line(places, other, "fit")
    chart.dots(places, theirs, "reference", [f"{name}, the study" for name in published.PLANS])
    for place, name in zip(
        places, ("VLP-16", "Puck", "either", "OS-32", "OS-64", "OS-128"), strict=True
    ):
        chart.tick(place, name)
    return chart.svg()


def _time_chart(measured: paper.Measured) -> str:
    """Time of a candidate by number of channels, a line for each way."""
    channels = {"table5-OS-64": 64.0, "table5-OS-128": 128.0}
    ways = {"Algorithm 1": "hybrid", **{title: way for way, title in paper.NETWORKS.items()}}
    times = {
        title: [
            measured[f"{paper.NETWORK_SITE}-{way}"]["seconds_per_candidate"].get(sensor)
            for sensor in channels
        ]
        for title, way in ways.items()
    }
    chart = Chart(
        "Time of a candidate by channels",
        "Channels",
        "CPU s a candidate",
        (48.0, 150.0),
        span_of(*times.values(), start=0.0),
    )
    for look, (title, values) in zip(("fit", "good", "reference"), times.items(), strict=True):
        chart.line(list(channels.values()), values, look)
        chart.dots(list(channels.values()), values, look, [title] * len(values))
        if values[-1] is not None:
            chart.label(128.0, values[-1], title)
    return chart.svg()


def _pole_figures(measured: paper.Measured) -> dict[str, list[str]]:
    ways = {way: measured[f"route-{way}"]["validation"] for way in ("published", "default")}
    anywhere, across = "Distance to the known pole, m", "Distance across the road, m"
    return {
        "Table 2": [_scores_chart(ways)],
        "Fig. 12": [
            _map_chart(measured["route-default"]),
            _errors_chart(ways, "geodesic_m", anywhere, published.WITHIN_75_M),
            _errors_chart(ways, "across_m", across, published.ACROSS_75_M),
        ],
    }


def _scores_chart(ways: Mapping[str, Any]) -> str:
    """Fig. 13: F1 by threshold, the study's, ours as published and by default."""
    chart = Chart(
        "F1 by distance threshold", "Threshold, m", "F1", (0.0, 17.0), (0.0, 1.05), 560.0, 300.0
    )
    lines = {"study": ("reference", {k: v["f1"] for k, v in published.SCORES.items()})}
    looks = {"published": ("good", "as published"), "default": ("fit", "default")}
    for way, (look, name) in looks.items():
        lines[name] = (look, {row["threshold_m"]: row["f1"] for row in ways[way]["thresholds"]})
    for name, (look, scores) in lines.items():
        xs, ys = [float(x) for x in scores], list(scores.values())
        chart.line(xs, ys, look)
        texts = [f"{name}, {x:g} m: {number(y or 0.0, 2)}" for x, y in zip(xs, ys, strict=True)]
        chart.dots(xs, ys, look, texts)
        chart.label(xs[-3], ys[-3] or 0.0, name)
    return chart.svg()


def _errors_chart(ways: Mapping[str, Any], key: str, label: str, theirs_m: float) -> str:
    """Fig. 12: errors from the best to the worst."""
    looks = {"published": ("good", "as published"), "default": ("fit", "default")}
    values = {
        way: sorted(abs(e[key]) for e in ways[way]["errors"] if e.get(key) is not None)
        for way in looks
    }
    most = max(map(len, values.values()), default=1)
    chart = Chart(
        label,
        "Poles, from the best to the worst",
        label,
        (0.0, most + 1.0),
        span_of(*values.values(), [theirs_m], start=0.0, least=1.0),
    )
    chart.level(theirs_m, "reference", f"study: 75 % within {number(theirs_m)} m")
    for way, (look, name) in looks.items():
        ranks = [float(n + 1) for n in range(len(values[way]))]
        chart.dots(ranks, values[way], look, [f"{name}: {number(v, 2)} m" for v in values[way]])
    return chart.svg()


def _map_chart(run: Mapping[str, Any]) -> str:
    """Fig. 10: the route's cameras and the poles that were located."""
    cameras, poles = (
        np.asarray(run[key], float).reshape(-1, 2) for key in ("cameras_m", "poles_m")
    )
    both = np.concatenate([cameras, poles])
    half = 0.525 * max(float(np.ptp(both, axis=0).max()), 1.0)
    spans = [(float(m - half), float(m + half)) for m in (both.max(axis=0) + both.min(axis=0)) / 2]
    chart = Chart(
        "Route with located poles", "East, m", "North, m", spans[0], spans[1], 470.0, 440.0
    )
    chart.line(cameras[:, 0].tolist(), cameras[:, 1].tolist(), "reference")
    names = [f"pole {n + 1}" for n in range(len(poles))]
    chart.dots(poles[:, 0].tolist(), poles[:, 1].tolist(), "good", names)
    return chart.svg()
