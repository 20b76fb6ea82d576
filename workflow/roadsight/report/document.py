"""The report: one HTML file that needs nothing else."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import longitudes_latitudes
from roadsight.io.records.run_records import RunRecord
from roadsight.placement.sensors.sensors import KINDS
from roadsight.report import wording
from roadsight.report.files import SCRIPTS, STYLES, TEMPLATES, template_environment
from roadsight.report.packing import unpack
from roadsight.report.parameters import effect_rows, figure_rows, settings_asked_for
from roadsight.report.poles_page import FORMAT as POLES_FORMAT
from roadsight.report.poles_view import poles_cards, poles_view
from roadsight.report.printed_map import plan_sketch
from roadsight.report.site.page import FORMAT
from roadsight.report.site.plan_view import best_plan, plan_views

_Page = dict[str, Any]

_ROWS_SHOWN = 100  # Rows of a long table that are shown before a reader asks for the rest
_FILTERS = ("number", "percent", "seconds", "metres", "bearing", "counted", "label", "pose")

# Backgrounds of the map and their titles, in the order in which they are offered
_BELOW = {
    "orthophoto": "Orthophoto",
    "relief": "Terrain relief",
    "colour": "Colour of the cloud",
    "intensity": "Intensity near the ground",
    "height": "Height above ground, to 12 m",
    "plain": "Nothing",
}

_UNIT_SIGNS = {"metre": "m", "foot": "ft", "us-survey-foot": "US ft"}


def render_report(
    pages: Sequence[dict[str, Any]],
    poles_pages: Sequence[dict[str, Any]],
    assets: Mapping[str, str],
    plotly_js: str,
    version: str,
    evidence: Mapping[str, str] | None = None,
    runs: Mapping[str, RunRecord] | None = None,
    files: Mapping[str, Sequence[ResultFile]] | None = None,
) -> str:
    """HTML of the report; the same pages give the same text.

    Parameters
    ----------
    pages : content of each site's page.json, in the order of the report.
    poles_pages : content of each site's poles/page.json; a site may have either page, or both.
    assets : text of the files named in `ASSETS`.
    plotly_js : source of plotly.js.
    evidence : titles of further pages and their addresses from the report, for links.
    runs, files : by site, when and by what it was made, and the files that people open.

    Raises
    ------
    InputError : no page, a page of another format, or two pages of one site.
    """
    _check(pages, FORMAT, "--pages")
    _check(poles_pages, POLES_FORMAT, "--poles-pages")
    if not pages and not poles_pages:
        raise InputError("no site to report", where="--pages")
    poles = {page["summary"]["site"]: page for page in poles_pages}
    scenes = [(page, poles.pop(page["summary"]["site"], None)) for page in pages]
    sites = [*scenes, *((None, page) for page in poles.values())]  # those with poles alone last
    environment = template_environment({name: assets[name] for name in TEMPLATES})
    environment.filters |= {name: getattr(wording, name) for name in _FILTERS} | {
        "quantity": wording.quantity,
        "css_text": css_text,
    }
    return environment.get_template("report.html.j2").render(
        sites=[_site(*pair, f"site-{number}", files or {}) for number, pair in enumerate(sites)],
        css="\n".join(assets[name] for name in STYLES),
        script="\n".join(assets[name] for name in SCRIPTS),
        plotly=plotly_js,
        version=version,
        evidence=evidence or {},
        runs={site: run.rows() for site, run in (runs or {}).items()},
        lines={site: run.line() for site, run in (runs or {}).items()},
        files=files or {},
        rows=_ROWS_SHOWN,
    )


def _check(pages: Sequence[_Page], allowed: str, where: str) -> None:
    for page in pages:
        if page.get("format") != allowed:
            raise InputError(
                "is no page of this version",
                where=where,
                found=page.get("format"),
                allowed=allowed,
                hint="run the workflow again",
            )
    names = [page["summary"]["site"] for page in pages]
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise InputError("two pages of one site", where=where, found=repeated[0])


def _site(
    page: _Page | None,
    poles_page: _Page | None,
    identifier: str,
    files: Mapping[str, Sequence[ResultFile]],
) -> dict[str, Any]:
    """What the templates show of a site."""
    about = next(given for given in (page, poles_page) if given is not None)
    poles = None if poles_page is None else poles_view(poles_page)
    scene = {"plans": [], "sensors": {}, "sketch": ""} if page is None else _scene(page)
    summary, frame = about["summary"], about["frame"]
    poles_data = None
    if poles_page is not None:  # what the poles' map and images draw
        drawn = {key: poles_page[key] for key in ("layers", "images", "hazard")}
        errors = (poles_page["validation"] or {}).get("errors", [])
        poles_data = embedded(drawn | {"errors": errors, "place": _place(poles_page)})
    return {
        "id": identifier,
        "title": about["title"] or summary["site"],
        "scene": page is not None,
        "poles": poles,
        "cards": cards_of(page, poles_page),
        "cautions": cautions_of(page, poles_page),
        "sections": _sections(page, poles, summary, files),
        "effects": effect_rows(summary["effects"]),
        **scene,
        "crs": frame["crs_name"],
        "located": frame["crs_wkt"] is not None,
        "unit": _unit_sign(frame["unit"]),
        "vertical_unit": _unit_sign(frame["vertical_unit"]),
        "unit_name": frame["unit"],
        "vertical_unit_name": frame["vertical_unit"],
        "points": frame["points"],
        "origin": ", ".join(wording.number(value, 3) for value in frame["origin"]),
        "settings": settings_asked_for(summary),
        "name": summary["site"],
        "version": summary["version"],
        "seed": summary["seed"],
        "inputs": summary["inputs"],
        "poles_data": poles_data,
    }


def _scene(page: _Page) -> dict[str, Any]:
    costs = [sensor["cost"] for sensor in page["sensors"].values()]
    candidates = page["layers"].get("candidates")
    there = {"relief", "plain", *page["layers"]["below"]}
    cloud = page["layers"]["cloud"]
    return {
        "plans": plan_views(page["plans"], Frame.from_dict(page["frame"])),
        "asked": _has(page, "options"),
        "sight": _has(page, "availability"),
        "shared": _has(page, "data"),
        "examined": _has(page, "proven_share"),
        "tolerance": _has(page, "tolerance"),
        # Candidates of later rounds lie near gaps.
        "densified": candidates is not None and bool(unpack(candidates["round"]).any()),
        "unexamined": bool(page["layers"].get("unexamined")),
        "priced": is_priced(page),
        "whole_costs": all(float(cost).is_integer() for cost in costs),
        "sketch": plan_sketch(page, best_plan(page["plans"])) if page["plans"] else "",
        "below": [(name, title) for name, title in _BELOW.items() if name in there],
        "shown_points": cloud["xyz"]["count"] // 3,
        "has_intensity": cloud["intensity"] is not None,
        "has_colour": cloud["colour"] is not None,
        **_evidence(page),
        # What map and 3D view draw.
        "data": embedded(
            {
                "layers": page["layers"],
                "plans": page["plans"],
                "sensors": page["sensors"],
                "place": _place(page),
                "cell_size_m": page["summary"]["settings"]["targets"]["cell_size_m"],
            }
        ),
    }


def is_priced(page: _Page) -> bool:
    """Whether costs tell anything that the number of sensors does not."""
    costs = {sensor["cost"] for sensor in page["sensors"].values()}
    return len(costs) > 1 or any(p["objective"] != len(p["sensors"]) for p in page["plans"])


def _has(page: _Page, key: str) -> bool:
    return any(key in plan for plan in page["plans"])


def _evidence(page: dict[str, Any]) -> dict[str, Any]:
    summary, sensors = page["summary"], page["sensors"]
    figures = dict(summary["scene"])
    scores, _ = figures.pop("pavement_scores", None), figures.pop("traffic", None)
    return {
        "edges": page["layers"]["edges"],
        "scene_rows": figure_rows(figures),
        "score_rows": figure_rows(scores or {}),
        "sensors": sensors,
        "sensor_keys": [
            key
            for key in dict.fromkeys(key for kind in KINDS.values() for key in kind.model_fields)
            if any(sensor.get(key) is not None for sensor in sensors.values())
        ],
    }


def _place(page: _Page) -> dict[str, Any]:
    about = page["frame"]
    bounds = about.get("bounds_m") or [0.0] * 6
    corners = [bounds[0], bounds[1], bounds[3], bounds[4]]
    return map_place(Frame.from_dict(about), corners, _unit_sign(about["unit"]))


def embedded(content: Any) -> str:
    """JSON that is safe inside a script element, whatever the texts hold."""
    text = json.dumps(content, separators=(",", ":"), sort_keys=True, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def css_text(text: str) -> str:
    """Text that is safe between the quotes of a style sheet, whatever it holds."""
    return "".join(c if c.isalnum() or c in " .,-+/:" else f"\\{ord(c):x} " for c in text)


def cautions_of(page: _Page | None, poles_page: _Page | None) -> list[dict[str, str]]:
    """What limits a site's results, each once: warnings first."""
    found = [caution for given in (page, poles_page) if given for caution in given["cautions"]]
    once = [caution for number, caution in enumerate(found) if caution not in found[:number]]
    return sorted(once, key=lambda caution: caution["level"] != "warning")


def cards_of(page: _Page | None, poles_page: _Page | None) -> list[tuple[str, str, str]]:
    """Key figures of a site: name, value, remark."""
    scene = [] if page is None else _scene_cards(page)
    return [*scene, *([] if poles_page is None else poles_cards(poles_page))]


def _scene_cards(page: _Page) -> list[tuple[str, str, str]]:
    lengths = [edge["length_m"] for edge in page["layers"]["edges"]]
    cards = [
        ("Pavement", wording.quantity("area_m2", round(page["pavement_area_m2"])), ""),
        ("Road edges", wording.metres(float(np.sum(lengths)), 0), f"{len(lengths)} lines"),
    ]
    scores = page["summary"]["scene"].get("pavement_scores")
    if scores:
        f1 = wording.percent(scores["f1"])
        cards.append(("Pavement F1 score", f1, "against the reference"))
    if not page["plans"]:
        return cards
    candidates = page["layers"]["candidates"]
    positions = candidates["heights"]["count"]
    best = best_plan(page["plans"])
    count = wording.counted(len(best["sensors"]), "sensor")
    first = [("Fewest sensors", count, best["title"])]
    if "proven_share" in best:
        proven = wording.quantity("area_m2", round(best["proven_area_m2"]))
        whole = wording.quantity("area_m2", round(page["pavement_area_m2"]))
        remark = f"{proven} of {whole} of pavement, {best['title']}"
        first.append(("Proven in sight", wording.percent(best["proven_share"]), remark))
    if is_priced(page):
        first.append(("Cost", wording.number(best["objective"]), best["title"]))
    targets = len(page["layers"]["targets"]["names"])
    unseen = len(best["gaps"])
    remark = f"of {wording.number(targets)} to be seen"
    first.append(("Targets not covered", wording.number(unseen) if unseen else "none", remark))
    remark = f"at {wording.counted(positions, 'position')}"
    return [*first, *cards, ("Candidates", wording.number(candidates["total"]), remark)]


def _sections(
    page: _Page | None,
    poles: dict[str, Any] | None,
    summary: dict[str, Any],
    files: Mapping[str, Sequence[ResultFile]],
) -> list[tuple[str, str]]:
    """Anchors and titles of a site's sections."""
    found = []
    if page is not None:
        views = [("map", "Map"), ("scene3d", "3D view")]
        results = [("sensors", "Chosen sensors"), ("gaps", "Uncovered targets")]
        asked = [("options", "Plan options")] if _has(page, "options") else []
        seen = [("sight", "In sight past traffic")] if _has(page, "availability") else []
        data = [("data", "Hand-over and data")] if _has(page, "data") else []
        ways = [("tolerance", "Tolerance")] if _has(page, "tolerance") else []
        results[1:1] = [*asked, *seen, *data, *ways]
        found = [("plans", "Plans compared"), *views, *results] if page["plans"] else views
    if poles is not None:
        found += poles["sections"]
    if page is not None:
        found.append(("scene", "Scene"))
    if summary["effects"]:
        found.append(("effects", "Effects"))
    found.append(("parameters", "Parameters"))
    if files.get(summary["site"]):
        found.append(("results", "Files"))
    return [*found, ("provenance", "Provenance")]


def _unit_sign(name: str) -> str:
    return _UNIT_SIGNS.get(name, name)


# Where a map is: what turns its local metres into native coordinates and degrees.

_SIDE = 5  # Places a side at which the projection is asked; six coefficients need no more
_LEAST_SPAN_M = 100.0  # The box is at least so wide, so that the coefficients are determined


def map_place(frame: Frame, bounds_m: ArrayLike, unit: str) -> dict[str, Any]:
    """What a page needs to tell the coordinates at a place of its map.

    Longitude and latitude are polynomials of second degree of the local x and y over a box: within
    10 km they differ from the projection by less than a millimetre for each kilometre.

    Parameters
    ----------
    bounds_m : west, south, east, north of what the map shows, local metres.
    unit : sign of the native horizontal unit.

    Returns
    -------
    ``origin`` (native units), ``unit_m``, ``unit``; ``centre_m``, ``span_m`` and ``lon_lat``, two
    rows of coefficients of 1, u, v, u², uv, v² with u, v = (x, y - centre) / span, or None for a
    site without CRS
    """
    west, south, east, north = np.asarray(bounds_m, np.float64)
    centre = np.array([(west + east) / 2, (south + north) / 2])
    span = max(east - west, north - south, _LEAST_SPAN_M)
    u, v = (part.ravel() for part in np.meshgrid(*[np.linspace(-0.5, 0.5, _SIDE)] * 2))
    degrees = longitudes_latitudes(frame, centre + span * np.column_stack([u, v]))
    coefficients = None
    if degrees is not None:
        terms = np.column_stack([np.ones(len(u)), u, v, u * u, u * v, v * v])
        coefficients = np.linalg.lstsq(terms, degrees, rcond=None)[0].T.tolist()
    return {
        "origin": [float(value) for value in frame.origin[:2]],
        "unit_m": frame.unit_m,
        "unit": unit,
        "centre_m": centre.tolist(),
        "span_m": float(span),
        "lon_lat": coefficients,
    }


# Files of a site that people open: pattern within its folder, what it holds, what opens it
FILES = (
    ("report.pdf", "the report on paper", "any PDF reader"),
    ("stakeout.csv", "where to set the sensors", "a spreadsheet, a total station"),
    ("gis/*.qgs", "all layers, grouped and styled", "QGIS"),
    ("gis/*.gpkg", "all layers in one file", "QGIS, ArcGIS, geopandas"),
    ("gis/*.kml", "sensors, poles and road on an online map", "Google Earth and other online maps"),
    ("gis/*.dxf", "drawing with layers, blocks and texts", "any CAD"),
    ("scene/dem.tif", "terrain model; band 2 marks measured cells", "any GIS"),
    ("scene/pavement.gpkg", "pavement", "any GIS"),
    ("placement/edges.gpkg", "road edges", "any GIS"),
    ("placement/unexamined.gpkg", "pavement for which nothing is proven", "any GIS"),
    ("placement/*/solution.gpkg", "sensors and targets of a plan", "any GIS"),
    ("placement/*/solution.json", "solution of a plan with its bound", "programs"),
    ("placement/*/obstacles.gpkg", "what stands in the way", "any GIS"),
    ("placement/objects.gpkg", "objects of the scene by their names", "any GIS"),
    ("placement/*/removals.json", "objects in the way, and sensors saved without them", "programs"),
    ("placement/*/data.json", "hand-over, data rates and margins of a plan", "programs"),
    ("placement/*/data.gpkg", "hand-over and data of a plan's sensors", "any GIS"),
    ("placement/*/tolerance.gpkg", "targets that a sensor's small changes lose", "any GIS"),
    ("placement/*/tolerance.json", "what small changes of a sensor lose", "programs"),
    ("placement/round-*/candidates.parquet", "candidates", "programs (pandas)"),
    ("placement/*/scans.laz", "what the sensors would see", "CloudCompare, QGIS"),
    ("poles/poles.gpkg", "poles, their hazard, cross-sections, road geometry", "any GIS"),
    ("poles/poles.csv", "poles", "a spreadsheet"),
    ("poles/poles.geojson", "poles", "any GIS, web maps"),
    ("poles/placed.gpkg", "poles, sight lines and ellipses before hazard was rated", "any GIS"),
    ("poles/top.tif", "class, height and share of road of the highest voxels", "any GIS"),
    ("poles/pictures.zip", "a picture of each pole", "any picture viewer"),
    ("poles/hazard.csv", "hazard of the poles", "a spreadsheet"),
    ("poles/road_geometry.csv", "radius, grade, cross-slope, width by station", "a spreadsheet"),
    ("poles/road_edges.gpkg", "edges of the road in the LiDAR", "any GIS"),
    ("scene/frame.json", "reference system, local origin, inputs, contradictions", "programs"),
    ("run.json", "when, from what code and in what time it was computed", "programs"),
    ("effects.json", "effects simulated or skipped, and why", "programs"),
    ("summary.json", "all of it in numbers", "programs"),
)


@dataclass(frozen=True)
class ResultFile:
    """One file. path : from the report. size : for people. about, opens : words."""

    path: str
    size: str
    about: str
    opens: str


def result_files(results: Path, site: str) -> Sequence[ResultFile]:
    """Files of a site that there are, in the order of `FILES`.

    Parameters
    ----------
    results : folder in which the report and the sites' folders lie.
    """
    return [
        ResultFile(str(path.relative_to(results)), size_text(path.stat().st_size), about, opens)
        for pattern, about, opens in FILES
        for path in sorted((results / site).glob(pattern))
    ]


def size_text(size: int) -> str:
    """Bytes as people say them: ``12 kB``, ``3.4 MB``."""
    for step, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if size >= step:
            value = size / step
            return f"{value:.0f} {unit}" if value >= 10 else f"{value:.1f} {unit}"
    return f"{size} bytes"
