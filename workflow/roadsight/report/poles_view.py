"""What the templates show of a site's poles, made from ``poles/page.json``."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from roadsight.evidence import published
from roadsight.poles.risk.hazard import ROADSIDE_COLUMNS
from roadsight.report.charts import SAME_M, Chart, profile_chart, span_of, zone_text
from roadsight.report.poles_layers import ACCEPTED, REJECTED
from roadsight.report.wording import MISSING, counted, label, metres, number, quantity

_FORMATS = {".gpkg": "GeoPackage", ".geojson": "GeoJSON", ".csv": "CSV", ".parquet": "Parquet"}

_COORDINATES = {
    ".gpkg": "coordinate system of the LiDAR",
    ".geojson": "WGS 84",
    ".csv": "WGS 84 and coordinate system of the LiDAR",
    ".parquet": "local metres, with the poles that were withheld",
}

_HAZARD_FIRST = ("id", "pole", "kind")

_HAZARD_TITLES = {
    "id": "Object",
    "offset_m": "Offset to the road edge",
    "inside_clear_zone": "In the clear zone",
    "slope_rise_over_run": "Side slope, rise over run",
    "slope_class": "Slope",
    "objects_per_km": "Fixed objects per km",
}

# Of the roadside columns, what the report's table shows; hazard.csv has all of them
_HAZARD_TOLD = {"rank", "route", "shielded", "hazard_rating_1_to_7", "foreslope_ratio", "reasons"}
_HAZARD_HIDDEN = {"x", "y", "z", "latitude", "longitude", "station_m"} | (
    set(ROADSIDE_COLUMNS) - _HAZARD_TOLD
)
_RATINGS = ("high", "medium", "low", "unknown")


def poles_view(page: dict[str, Any]) -> dict[str, Any]:
    """Content of the templates.

    Parameters
    ----------
    page : content of ``poles/page.json``.
    """
    validation, poles = page["validation"], page["layers"]["poles"]
    rows = {pole["id"]: row for row, pole in enumerate(poles)}
    suffixes = {name: f".{name.rpartition('.')[2]}" for name in page["files"]}
    return {
        "counts": page["counts"],
        "cautions": page["cautions"],
        "rejections": page["rejections"],
        "images": page["images"],
        "poles": poles,
        "thing": _thing(page),
        "pictures": [one | {"pole": rows.get(one["id"])} for one in page.get("pictures", [])],
        "hidden": page.get("hidden", False),
        "routes": [
            {"name": route["route"], "images": len(route["state"]), "charts": route_charts(route)}
            for route in page["routes"]
        ],
        "depth_fit": page["depth_fit"]
        and {"svg": depth_fit_chart(page["depth_fit"]), **page["depth_fit"]},
        "depth_checks": [
            depth_check_chart(source, page["depth_checks"][source])
            for source in SOURCES
            if source in page["depth_checks"]
        ],
        "hazard": _hazard(page["hazard"], rows),
        "profiles": _profiles(page.get("hazard_profiles", []), rows),
        "checked": None if validation is None else _checked(validation),
        "ablation": _ablation((validation or {}).get("ablation", [])),
        "files": [
            {
                "name": name,
                "kind": _FORMATS.get(suffixes[name], ""),
                "coordinates": _COORDINATES.get(suffixes[name], ""),
            }
            for name in page["files"]
        ],
        "sections": _sections(page),
    }


def _thing(page: dict[str, Any]) -> dict[str, Any]:
    """What the located things are called, and whether columns of them hold anything."""
    poles = page["layers"]["poles"]
    one = "pole" if all(pole["kind"] == "pole" for pole in poles) else "object"
    return {
        "one": one,
        "many": one + "s",
        "a": f"{'an' if one == 'object' else 'a'} {one}",
        "likely": any(pole.get("probability") is not None for pole in poles),
        "high": any(pole.get("height_m") is not None for pole in poles),
        "shown": any(pole.get("cloud_shows") for pole in poles),
    }


def _sections(page: dict[str, Any]) -> list[tuple[str, str]]:
    """Anchors and titles of the sections, those without content left out."""
    things = _thing(page)["many"]
    shown = (
        ("poles", f"{things.capitalize()} on the map", True),
        ("pictures", "Pictures", bool(page.get("pictures"))),
        ("images", "Images", bool(page["images"])),
        ("alignment", "Alignment", True),
        ("depth", "Depth", bool(page["depth_fit"] or page["depth_checks"])),
        ("checked", "Against known poles", page["validation"] is not None),
        ("components", "Components", bool((page["validation"] or {}).get("ablation"))),
        ("hazard", "Roadside hazard", bool(page["hazard"]["rows"])),
        ("files", f"Files of the {things}", bool(page["files"])),
    )
    return [(anchor, title) for anchor, title, there in shown if there]


def poles_cards(page: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Key figures of the poles: name, value, remark."""
    counts, validation = page["counts"], page["validation"] or {}
    sigmas = [pole["sigma_major_m"] for pole in page["layers"]["poles"]]
    known = [sigma for sigma in sigmas if sigma is not None]
    km = f"{number(counts['length_m'] / 1000, 2)} km of road"
    kinds = Counter(pole["kind"] for pole in page["layers"]["poles"])
    named = ", ".join(counted(count, kind) for kind, count in kinds.most_common())
    things = _thing(page)["many"]
    cards = [
        (
            f"{things.capitalize()} located",
            number(counts["poles"]),
            (km if counts["length_m"] else "") if things == "poles" else named,
        ),
        ("Images aligned", number(counts["aligned"]), f"of {number(counts['images'])}"),
        ("Sightings kept", number(counts["kept"]), f"of {number(counts['sightings'])}"),
    ]
    if known:
        sigma = metres(float(np.median(known)), 2)
        cards.append(("Uncertainty, median", sigma, "one sigma, longer axis"))
    if validation.get("mean_m") is not None:
        checked = counted(len(validation.get("errors", [])), "pole")
        cards.append(("Mean error", metres(validation["mean_m"], 2), f"{checked} checked"))
    return cards


def _checked(validation: dict[str, Any]) -> dict[str, Any]:
    """Errors, scores and scenarios beside the paper's own."""
    errors, thresholds = validation.get("errors", []), validation.get("thresholds", [])
    geodesic, across = _distances(errors)
    spread = float(np.std(geodesic, ddof=1)) if len(geodesic) > 1 else None
    rows = [
        ("Poles matched to known ones", number(len(errors)), number(published.CHECKED)),
        ("Mean distance", _mean(geodesic), metres(published.MEAN_M)),
        ("Standard deviation", metres(spread, 2), metres(published.STD_M)),
        ("Three quarters within", _quartile(geodesic), metres(published.WITHIN_75_M)),
        (
            "Across the road, three quarters within",
            _quartile(across),
            metres(published.ACROSS_75_M),
        ),
    ]
    return {
        "truth": _truth(validation),
        "rows": rows,
        "errors": error_charts(errors) if errors else [],
        "f1": f1_chart(thresholds) if thresholds else "",
        "thresholds": [row | {"paper": published.F1.get(row["threshold_m"])} for row in thresholds],
        "scenarios": _scenarios(errors),
    }


def _distances(errors: Sequence[dict[str, Any]]) -> tuple[list[float], list[float]]:
    """Known distances to the true poles, anywhere and across the road, m."""
    geodesic = [error["geodesic_m"] for error in errors if error.get("geodesic_m") is not None]
    return geodesic, [abs(e["across_m"]) for e in errors if e.get("across_m") is not None]


def _truth(validation: dict[str, Any]) -> str:
    """Which known poles count."""
    truth = validation.get("truth")
    if not isinstance(truth, dict):
        return "" if truth is None else f"Known poles: {truth}."
    known, away = truth.get("within_reach", 0), truth.get("out_of_reach", 0)
    text = counted(known, "known pole") + " within reach of an image"
    if "reach_m" in truth:
        text += f" ({metres(truth['reach_m'], 0)})"
    return f"{text}{f'; {number(away)} out of reach do not count' if away else ''}."


def _mean(values: Sequence[float]) -> str:
    return metres(float(np.mean(values)), 2) if values else MISSING


def _quartile(values: Sequence[float]) -> str:
    return metres(float(np.quantile(values, 0.75)), 2) if values else MISSING


def _scenarios(errors: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Number of poles and errors by scenario, the paper's scenarios first."""
    groups: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for error in errors:
        for name in error.get("scenarios") or []:
            groups[str(name).replace("_", " ").lower()].append(error)
    first = [name for name in published.SCENARIOS if name in groups]
    rows = []
    for name in first + sorted(set(groups) - set(first)):
        geodesic, across = _distances(groups[name])
        rows.append(
            {
                "name": name[:1].upper() + name[1:],
                "poles": len(groups[name]),
                "mean_m": _mean(geodesic),
                "most_m": metres(max(geodesic, default=None), 2),
                "across_m": _mean(across),
                "paper": published.scenario_mean_m(name),
            }
        )
    return rows


def _ablation(records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """What each component of the paper is worth here, beside what the paper says of it."""
    keys = ("images_accepted", "poles", "mean_error_m", "f1_3m", "f1_6m")
    rows = []
    for record in records:
        name = str(record["component"])
        title, about = published.COMPONENTS.get(name, (label(name), ""))
        rows.append({"title": title, "about": about, **{key: record.get(key) for key in keys}})
    return rows


def _hazard(table: dict[str, Any], numbers: dict[str, int]) -> dict[str, Any] | None:
    """Hazard table: names of the columns, and rows with the number of their pole on the map."""
    if not table["rows"]:
        return None
    keys = [key for key in table["columns"] if key not in _HAZARD_HIDDEN]
    keys.sort(key=lambda key: key not in _HAZARD_FIRST)
    records = [dict(zip(table["columns"], row, strict=True)) for row in table["rows"]]
    counts = Counter(record.get("rating") for record in records)
    named = [f"{number(counts[rating])} {rating}" for rating in _RATINGS if counts[rating]]
    return {
        "ratings": ", ".join(named),
        "keys": keys,
        "titles": [_HAZARD_TITLES.get(key) or label(key) for key in keys],
        "rows": [
            {
                "pole": numbers.get(str(record.get("id", record.get("pole")))),
                "cells": [
                    _cell(key, record[key]) | _ranged(key, record) | {"long": key == "reasons"}
                    for key in keys
                ],
            }
            for record in records
        ],
    }


def _profiles(profiles: Sequence[dict[str, Any]], numbers: dict[str, int]) -> list[dict[str, Any]]:
    """Drawings of cross-sections with what they are of and why they are rated so."""
    found = []
    for profile in profiles:
        place = {-1: "left", 1: "right"}.get(profile["side"], "side unknown")
        if profile["route"]:
            station = metres(profile["station_m"], 1)
            place = f"route {profile['route']}, {station}, {place}"
        found.append(
            {
                "svg": profile_chart(profile),
                "id": profile["id"],
                "pole": numbers.get(profile["id"]),
                "rank": profile["rank"],
                "place": place,
                "reasons": profile["reasons"],
            }
        )
    return found


def _cell(key: str, value: Any) -> dict[str, Any]:
    """Text of a cell, what to sort it by, and whether it is a number."""
    if key == "rating" and value in _RATINGS:
        return {"text": value, "sort": _RATINGS.index(value), "number": False}
    if key == "side" and isinstance(value, int | float):
        return {
            "text": {-1: "left", 1: "right"}.get(int(value), "unknown"),
            "sort": value,
            "number": False,
        }
    numeric = isinstance(value, int | float) and not isinstance(value, bool)
    rounded = round(value, 2) if isinstance(value, float) else value
    text = quantity("" if key == "objects_per_km" else key, rounded)
    sort = "" if value is None else value
    return {"text": text, "sort": sort, "number": numeric}


def _ranged(key: str, record: dict[str, Any]) -> dict[str, str]:
    """Text of a cell whose value is known as a range; empty for others."""
    least, most = (record.get(f"clear_zone_{end}_m") for end in ("least", "greatest"))
    if least is None or most is None or most - least < SAME_M:
        return {}
    if key == "clear_zone_m":
        return {"text": zone_text(least, most)}
    offset = record.get("offset_m")
    if key == "inside_clear_zone" and offset is not None and least < offset <= most:
        return {"text": "perhaps"}
    return {}


# Plots.

_WIDE = 1000.0  # Width of a plot along a route, px: about that of the page
_LOW = 176.0  # Height of a plot along a route, px: several stand below each other
# Share of the values that an axis must show; a few wild ones lie outside, so that the others are
# not squeezed
_SHOWN_SHARE = 0.99
_BINS = 20  # Bars of a histogram

_PANELS = (
    ("residual_px", None, "Residual, px"),
    ("yaw_deg", "sigma_yaw_deg", "Turned right, °"),
    ("lateral_m", "sigma_lateral_m", "Moved right, m"),
)

# Where a single distance comes from, in words
SOURCES = {
    "network": "the depth network",
    "ground": "the ground under its foot",
    "lidar": "a LiDAR column",
}


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
    found = []
    for key, title, paper in kinds:
        known = [(abs(error[key]), error) for error in errors if error.get(key) is not None]
        known.sort(key=lambda pair: pair[0])
        values = [value for value, _ in known]
        axis, ranks = f"{title}, m", "Poles, from the best to the worst"
        span = span_of(values, start=0.0, least=1.0)
        scatter = Chart(axis, ranks, axis, (0.0, len(values) + 1.0), span)
        scatter.level(paper, "reference", f"paper: 75 % within {number(paper)} m")
        if values:
            quartile = float(np.quantile(values, 0.75))
            scatter.level(quartile, "fit", f"here: 75 % within {number(quartile, 2)} m")
        texts = [f"{error.get('pole')}: {number(value, 2)} m" for value, error in known]
        scatter.dots([float(n + 1) for n in range(len(known))], values, "good", texts)
        counts, edges = np.histogram(values, bins=_BINS, range=(0.0, span[1]))
        histogram = Chart(f"Histogram: {axis}", axis, "Poles", span, span_of(counts, start=0.0))
        histogram.bars(edges.tolist(), counts.tolist(), "good")
        found.append({"title": title, "scatter": scatter.svg(), "histogram": histogram.svg()})
    return found


def f1_chart(thresholds: Sequence[dict[str, Any]]) -> str:
    """F1 score by distance threshold, and the paper's."""
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
