"""The report: one HTML file that needs nothing else."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.records.run_records import RunRecord
from roadsight.placement.sensors.sensors import KINDS
from roadsight.report import wording
from roadsight.report.files import SCRIPTS, STYLES, TEMPLATES
from roadsight.report.packing import unpack
from roadsight.report.paper.plan_map import plan_sketch
from roadsight.report.parameters import figure_rows, settings_asked_for
from roadsight.report.poles.poles_page import FORMAT as POLES_FORMAT
from roadsight.report.poles.poles_view import poles_cards, poles_view
from roadsight.report.result_files import ResultFile
from roadsight.report.site.effects import effect_rows
from roadsight.report.site.page import FORMAT
from roadsight.report.site.place import map_place
from roadsight.report.site.plan_view import best_plan, plan_views
from roadsight.report.templates import template_environment

_ROWS_SHOWN = 100
"""Rows of a long table that are shown before a reader asks for the rest."""
_FILTERS = ("number", "percent", "seconds", "metres", "bearing", "counted", "label", "pose")
_BELOW = {
    "orthophoto": "Orthophoto",
    "relief": "Terrain relief",
    "colour": "Colour of the cloud",
    "intensity": "Intensity near the ground",
    "height": "Height above ground, to 12 m",
    "plain": "Nothing",
}
"""Backgrounds of the map and their titles, in the order in which they are offered."""
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
    sites = _pairs(pages, poles_pages)
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


_Page = dict[str, Any]


def _pairs(
    pages: Sequence[_Page], poles_pages: Sequence[_Page]
) -> list[tuple[_Page | None, _Page | None]]:
    """Scene page and poles page of each site; sites with poles alone come last."""
    _check(pages, FORMAT, "--pages")
    _check(poles_pages, POLES_FORMAT, "--poles-pages")
    if not pages and not poles_pages:
        raise InputError("no site to report", where="--pages")
    poles = {page["summary"]["site"]: page for page in poles_pages}
    scenes = [(page, poles.pop(page["summary"]["site"], None)) for page in pages]
    return [*scenes, *((None, page) for page in poles.values())]


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
    return {
        "id": identifier,
        "title": about["title"] or about["summary"]["site"],
        "scene": page is not None,
        "poles": poles,
        "cards": cards_of(page, poles_page),
        "cautions": _cautions(page, poles_page),
        "sections": _sections(page, poles, about["summary"], files),
        "effects": effect_rows(about["summary"]["effects"]),
        **scene,
        **_coordinates(about["frame"]),
        **_provenance(about),
        "poles_data": None if poles_page is None else embedded(_drawn_poles(poles_page)),
    }


def _scene(page: _Page) -> dict[str, Any]:
    """Scene and placement."""
    costs = [sensor["cost"] for sensor in page["sensors"].values()]
    return {
        "plans": plan_views(page["plans"], Frame.from_dict(page["frame"])),
        "asked": _has(page, "options"),
        "sight": _has(page, "availability"),
        "shared": _has(page, "data"),
        "examined": _has(page, "proven_share"),
        "tolerance": _has(page, "tolerance"),
        "densified": _is_densified(page),
        "unexamined": bool(page["layers"].get("unexamined")),
        "priced": is_priced(page),
        "whole_costs": all(float(cost).is_integer() for cost in costs),
        "sketch": plan_sketch(page, best_plan(page["plans"])) if page["plans"] else "",
        "below": _below(page),
        **_cloud(page),
        **_evidence(page),
        "data": embedded(_drawn(page)),
    }


def _is_densified(page: _Page) -> bool:
    """Whether there are candidates of later rounds, which lie near gaps."""
    candidates = page["layers"].get("candidates")
    return candidates is not None and bool(unpack(candidates["round"]).any())


def _below(page: _Page) -> list[tuple[str, str]]:
    """What the map may lie on, as name and title; the first one is shown."""
    there = {"relief", "plain", *page["layers"]["below"]}
    return [(name, title) for name, title in _BELOW.items() if name in there]


def is_priced(page: _Page) -> bool:
    """Whether costs tell anything that the number of sensors does not."""
    costs = {sensor["cost"] for sensor in page["sensors"].values()}
    return len(costs) > 1 or any(p["objective"] != len(p["sensors"]) for p in page["plans"])


def _has(page: _Page, key: str) -> bool:
    """Whether any plan has such a part."""
    return any(key in plan for plan in page["plans"])


def _cautions(page: _Page | None, poles_page: _Page | None) -> list[dict[str, str]]:
    """Cautions of both jobs, warnings first; what both say stands once."""
    found = [caution for given in (page, poles_page) if given for caution in given["cautions"]]
    found = [caution for number, caution in enumerate(found) if caution not in found[:number]]
    return sorted(found, key=lambda caution: caution["level"] != "warning")


def _coordinates(about: dict[str, Any]) -> dict[str, Any]:
    """Coordinate system and units."""
    return {
        "crs": about["crs_name"],
        "located": about["crs_wkt"] is not None,
        "unit": _unit_sign(about["unit"]),
        "vertical_unit": _unit_sign(about["vertical_unit"]),
        "unit_name": about["unit"],
        "vertical_unit_name": about["vertical_unit"],
        "points": about["points"],
        "origin": ", ".join(wording.number(value, 3) for value in about["origin"]),
    }


def _cloud(page: dict[str, Any]) -> dict[str, Any]:
    """What there is of the cloud."""
    cloud = page["layers"]["cloud"]
    return {
        "shown_points": cloud["xyz"]["count"] // 3,
        "has_intensity": cloud["intensity"] is not None,
        "has_colour": cloud["colour"] is not None,
    }


def _evidence(page: dict[str, Any]) -> dict[str, Any]:
    """Scene, and the sensors' parameters."""
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


def _provenance(page: _Page) -> dict[str, Any]:
    """Parameters and what the results were made from."""
    summary = page["summary"]
    return {
        "settings": settings_asked_for(summary),
        "name": summary["site"],
        "version": summary["version"],
        "seed": summary["seed"],
        "inputs": summary["inputs"],
    }


def _drawn(page: dict[str, Any]) -> dict[str, Any]:
    """What map and 3D view draw."""
    return {
        "layers": page["layers"],
        "plans": page["plans"],
        "sensors": page["sensors"],
        "place": _place(page),
        "cell_size_m": page["summary"]["settings"]["targets"]["cell_size_m"],
    }


def _drawn_poles(page: _Page) -> dict[str, Any]:
    """What the poles' map and images draw."""
    kept = ("layers", "images", "hazard")
    errors = (page["validation"] or {}).get("errors", [])
    return {key: page[key] for key in kept} | {"errors": errors, "place": _place(page)}


def _place(page: _Page) -> dict[str, Any]:
    """What the maps tell coordinates by."""
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


def cards_of(page: _Page | None, poles_page: _Page | None) -> list[tuple[str, str, str]]:
    """Key figures of a site: name, value, remark."""
    scene = [] if page is None else _cards(page)
    return [*scene, *([] if poles_page is None else poles_cards(poles_page))]


def _cards(page: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Key figures of scene and placement."""
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
    first = [("Fewest sensors", count, best["title"]), *_proven_card(page)]
    if is_priced(page):
        first.append(("Cost", wording.number(best["objective"]), best["title"]))
    targets = len(page["layers"]["targets"]["names"])
    unseen = len(best["gaps"])
    remark = f"of {wording.number(targets)} to be seen"
    first.append(("Targets not covered", wording.number(unseen) if unseen else "none", remark))
    remark = f"at {wording.counted(positions, 'position')}"
    return [*first, *cards, ("Candidates", wording.number(candidates["total"]), remark)]


def _proven_card(page: dict[str, Any]) -> list[tuple[str, str, str]]:
    """What the proof of the plan shown first is about; nothing where nobody measured."""
    best = best_plan(page["plans"])
    if "proven_share" not in best:
        return []
    proven_m2, whole_m2 = round(best["proven_area_m2"]), round(page["pavement_area_m2"])
    remark = (
        f"{wording.quantity('area_m2', proven_m2)} of"
        f" {wording.quantity('area_m2', whole_m2)} of pavement, {best['title']}"
    )
    return [("Proven in sight", wording.percent(best["proven_share"]), remark)]


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
