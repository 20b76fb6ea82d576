"""What the printed report says of a site, as texts and tables without any markup."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Floats
from roadsight.geometry.frames import Frame
from roadsight.io.records.run_records import RunRecord
from roadsight.report import wording
from roadsight.report.document import cards_of, cautions_of, is_priced
from roadsight.report.handover.styles import SEEN
from roadsight.report.parameters import effect_rows, settings_asked_for
from roadsight.report.poles_view import poles_view
from roadsight.report.printed_map import (
    cloud_colours,
    legend,
    plan_map,
    pole_map,
    scene_map,
    times_seen,
)
from roadsight.report.site.plan_view import best_plan, plan_views

# Columns of the hazard table that paper has no room for; the page and hazard.csv have them
_TOO_LONG = ("reasons", "route", "shielded")
_WIDTH_MM = 164.0  # Width of a map: an A4 page less its margins and the coordinates beside the map
_THUMBNAIL_MM = 95.0  # Height of the map on the first page
_MAP_MM = 190.0  # Height of a map on a page of its own
_PICTURES_SHOWN = 20  # Pictures of poles, the most dangerous first: a page
_GAPS_SHOWN = 40  # Uncovered targets that are listed; all are in solution.json and on the map


def paper_content(
    page: dict[str, Any] | None, poles_page: dict[str, Any] | None, run: RunRecord | None
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Texts and pictures of a site's printed report.

    Parameters
    ----------
    page : content of page.json. poles_page : content of poles/page.json. One of them is there.
    run : when and by what the site was made, where that is known.

    Returns
    -------
    content (plain lists, mappings and strings), and pictures by the name that content uses
    """
    about = next(given for given in (page, poles_page) if given is not None)
    pictures: dict[str, bytes] = {}
    frame = about["frame"]
    content = {
        "title": about["title"] or about["summary"]["site"],
        "site": about["summary"]["site"],
        "crs": frame["crs_name"],
        "points": wording.counted(frame["points"], "point"),
        "cards": [list(card) for card in cards_of(page, poles_page)],
        "cautions": [[one["level"], one["text"]] for one in cautions_of(page, poles_page)],
        "plans": [],
        "compared": [],
        "columns": [],
        "keys": [] if page is None else legend(page),
        "still": "",
        "map": "",
        "map_of": "",
        "poles": None,
        "seen": [[colour, by] for by, colour in SEEN.items()],
        "effects": effect_rows(about["summary"]["effects"]),
        "settings": [
            {"title": group.title, "rows": [[r.label, r.value, r.about] for r in group.rows]}
            for group in settings_asked_for(about["summary"])
        ],
        "inputs": [list(item) for item in about["summary"]["inputs"].items()],
        "run": run.rows() if run else [],
        "run_line": run.line() if run else "",
        "located": frame["crs_wkt"] is not None,
        "unit": frame["unit"],
    }
    if page is not None:
        _add_scene(content, pictures, page)
    if poles_page is not None:
        _add_poles(content, pictures, poles_page)
    return content, pictures


def _add_scene(content: dict[str, Any], pictures: dict[str, bytes], page: dict[str, Any]) -> None:
    """Maps, plans and the still."""
    frame = Frame.from_dict(page["frame"])
    sensors = feet = np.empty((0, 3))
    if page["plans"]:
        views = plan_views(page["plans"], frame)
        best = best_plan(page["plans"])
        views.sort(key=lambda view: view["name"] != best["name"])
        targets = len(page["layers"]["targets"]["names"])
        content["plans"] = [
            _plan(view, page, times_seen(view, targets), pictures) for view in views
        ]
        priced, proven = is_priced(page), any("proven_share" in view for view in views)
        compared = [_compared(view, priced, proven) for view in views]
        content["compared"] = [list(row.values()) for row in compared]
        content["columns"] = list(compared[0])
        content["map"], content["map_of"] = "map.svg", f"{best['title']}: targets seen"
        pictures["map.svg"] = plan_map(page, best, _WIDTH_MM, _THUMBNAIL_MM).encode()
        sensors = np.array([[s["x"], s["y"], s["z"]] for s in best["sensors"]]).reshape(-1, 3)
        feet = sensors - np.array([[0, 0, s["height_m"]] for s in best["sensors"]]).reshape(-1, 3)
    else:
        content["map"], content["map_of"] = "map.svg", "Ground, pavement and road edges"
        pictures["map.svg"] = scene_map(page, _WIDTH_MM, _THUMBNAIL_MM).encode()
    xyz_m, colours = cloud_colours(page["layers"]["cloud"])
    if len(xyz_m):
        content["still"] = "still.png"
        pictures["still.png"] = still(xyz_m, colours, sensors, feet)


def _compared(view: dict[str, Any], priced: bool, proven: bool) -> dict[str, str]:
    """Row of the table of plans, by the titles of the columns."""
    bound, share = view["bound"], wording.percent(view.get("proven_share"))
    covered, targets = wording.number(view["covered"]), wording.number(view["targets"])
    return {
        "Plan": view["title"],
        "Sensors": wording.number(len(view["sensors"])),
        **({"Cost": wording.number(view["objective"])} if priced else {}),
        "Result": _verdict(view),
        **({"Pavement proven in sight": share} if proven else {}),
        "Lower bound": wording.MISSING if bound is None else wording.number(bound),
        "Targets covered": f"{covered} of {targets}",
    }


def _verdict(view: dict[str, Any]) -> str:
    if view["proven"]:
        return "Proven optimal"
    return f"Gap {wording.percent(view['gap'])}" if view["gap"] is not None else "Not proven"


def _plan(
    view: dict[str, Any], page: dict[str, Any], seen: NDArray, pictures: dict[str, bytes]
) -> dict[str, Any]:
    name = f"map-{view['name']}.svg"
    pictures[name] = plan_map(page, view, _WIDTH_MM, _MAP_MM).encode()
    cost = f", cost {wording.number(view['objective'])}" if is_priced(page) else ""
    return {
        "title": view["title"],
        "map": name,
        "verdict": _verdict(view),
        "line": (
            f"{wording.counted(len(view['sensors']), 'sensor')}"
            f"{cost}; {wording.number(view['covered'])} of"
            f" {wording.counted(view['targets'], 'target')} seen by at least"
            f" {wording.counted(view['at_least'], 'sensor')}."
        ),
        "counts": [
            wording.number(int(np.sum(np.minimum(seen, len(SEEN) - 1) == k)))
            for k in range(len(SEEN))
        ],
        "sensors": [_sensor(sensor) for sensor in view["sensors"]],
        "reasons": [[reason, wording.number(count)] for reason, count in view["reasons"]],
        "gaps": [
            [gap["target"], *(wording.number(v, 2) for v in gap["native"][:2]), gap["reason"]]
            for gap in view["gaps"][:_GAPS_SHOWN]
        ],
        "gaps_left": max(len(view["gaps"]) - _GAPS_SHOWN, 0),
    }


def _sensor(sensor: Mapping[str, Any]) -> list[str]:
    degrees = sensor["lon_lat_deg"]
    pitch_deg, roll_deg = sensor.get("pitch_deg", 0.0), sensor.get("roll_deg", 0.0)
    turned = f", {wording.pose(pitch_deg, roll_deg)}" if pitch_deg or roll_deg else ""
    return [
        str(sensor["number"]),
        sensor["sensor"],
        str(sensor["edge"]),
        wording.metres(sensor["height_m"], 2),
        wording.bearing(sensor["bearing_deg"]) + turned,
        *(f"{value:.2f}" for value in sensor["native"]),
        *(() if degrees is None else (f"{degrees[1]:.6f}", f"{degrees[0]:.6f}")),
        wording.number(sensor["targets"]),
        wording.number(sensor["only"]),
    ]


def _add_poles(
    content: dict[str, Any], pictures: dict[str, bytes], poles_page: dict[str, Any]
) -> None:
    view = poles_view(poles_page)
    frame = Frame.from_dict(poles_page["frame"])
    drawn = pole_map(poles_page, _WIDTH_MM, _MAP_MM)
    if drawn is not None:
        pictures["map-poles.svg"] = drawn.encode()
        content["map"] = content["map"] or "map-poles.svg"
        content["map_of"] = content["map_of"] or f"Located {view['thing']['many']}"
    hazard = view["hazard"]
    printed = [n for n, key in enumerate((hazard or {}).get("keys", [])) if key not in _TOO_LONG]
    checked = view["checked"]
    shown = view["pictures"][:_PICTURES_SHOWN]
    for number, picture in enumerate(shown):
        pictures[f"pole-{number}.jpg"] = base64.b64decode(picture["jpeg"])
    content["poles"] = {
        "things": view["thing"]["many"].capitalize(),
        "map": "" if drawn is None else "map-poles.svg",
        "pictures": [[f"pole-{n}.jpg", picture["id"]] for n, picture in enumerate(shown)],
        "pictures_left": len(view["pictures"]) - len(shown),
        "rows": [_pole(number, pole, frame) for number, pole in enumerate(view["poles"], start=1)],
        "checked": checked
        and {"truth": checked["truth"], "rows": [list(row) for row in checked["rows"]]},
        "thresholds": [
            [
                wording.metres(row["threshold_m"], 0),
                *(wording.percent(row[key]) for key in ("precision", "recall", "f1")),
                wording.MISSING if row["paper"] is None else wording.number(row["paper"], 2),
            ]
            for row in (checked or {}).get("thresholds", [])
        ],
        "hazard": hazard
        and {
            "titles": [hazard["titles"][n] for n in printed],
            "rows": [[str(row["cells"][n]["text"]) for n in printed] for row in hazard["rows"]],
            "ratings": hazard["ratings"],
        },
    }


def _pole(number: int, pole: Mapping[str, Any], frame: Frame) -> list[str]:
    degrees = pole["lon_lat_deg"]
    sigma = pole["sigma_major_m"]
    return [
        str(number),
        pole["id"],
        pole["kind"],
        *(f"{value:.2f}" for value in frame.to_native(np.array([pole[axis] for axis in "xyz"]))),
        *(() if degrees is None else (f"{degrees[1]:.6f}", f"{degrees[0]:.6f}")),
        wording.MISSING if sigma is None else wording.metres(sigma, 2),
        wording.number(pole["images"]),
    ]


# A still of the 3D view: points of the cloud in perspective, nearer ones before farther ones.

_WIDTH_PX = 1800
_HEIGHT_PX = 900  # Size of the still: 180 mm on paper at 250 dots per inch
_FIELD_DEG = 40.0  # Horizontal field of view, about that of a camera with a normal lens
# The eye looks down so steeply: lower, cars hide the road; higher, posts have no length
_ELEVATION_DEG = 35.0
# Points are drawn this large, so that a sample of 150,000 closes a road of some hundred metres
_POINT_M = 0.35
_LARGEST_PX = 7
_BACKGROUND = (252, 250, 248)  # Almost white, blue first


@dataclass(frozen=True)
class View:
    """Perspective from outside.

    Parameters
    ----------
    eye_m : (3,) local metres. axes : (3, 3) rows right, down, forward. focal_px : focal length.
    """

    eye_m: Floats
    axes: Floats
    focal_px: float

    def project(self, xyz_m: NDArray) -> tuple[Floats, Floats]:
        """Pixels (n, 2) and depths (n,) in metres; depth is not positive behind the eye."""
        seen = (np.asarray(xyz_m, np.float64).reshape(-1, 3) - self.eye_m) @ self.axes.T
        depth = seen[:, 2]
        ahead = np.where(depth > 0, depth, np.nan)
        centre = np.array([_WIDTH_PX / 2, _HEIGHT_PX / 2])
        return centre + self.focal_px * seen[:, :2] / ahead[:, None], depth


def view_of(xyz_m: NDArray) -> View:
    """View along the shorter side of a cloud (n, 3), so that its longer side spans the still."""
    centre = xyz_m.mean(axis=0)
    spread = np.linalg.svd(xyz_m[:, :2] - centre[:2], full_matrices=False)[2]
    along = spread[0] if spread[0][0] >= 0 else -spread[0]
    away = np.array([-along[1], along[0]])
    elevation = np.radians(_ELEVATION_DEG)
    forward = np.array([*(away * np.cos(elevation)), -np.sin(elevation)])
    right = np.array([*along, 0.0])
    down = np.cross(forward, right)
    focal = _WIDTH_PX / 2 / np.tan(np.radians(_FIELD_DEG / 2))
    axes = np.array([right, down, forward])
    inside = (xyz_m - centre) @ axes.T
    # The eye goes back until every point is in the field, whichever way it lies.
    needed = np.abs(inside[:, :2]) * focal / np.array([_WIDTH_PX / 2, _HEIGHT_PX / 2])
    back = float((needed.max(axis=1) - inside[:, 2]).max())
    return View(centre - max(back, 1.0) * forward, axes, focal)


def still(xyz_m: NDArray, colours: Bytes, sensors_m: NDArray, grounds_m: NDArray) -> bytes:
    """PNG of a cloud with its sensors.

    Parameters
    ----------
    xyz_m : (n, 3) local metres, n at least 1. colours : (n, 3) red, green, blue.
    sensors_m : (k, 3) sensors. grounds_m : (k, 3) feet of their masts.
    """
    view = view_of(xyz_m)
    picture = np.full((_HEIGHT_PX, _WIDTH_PX, 3), _BACKGROUND, np.uint8)
    _paint(picture, view, xyz_m, colours[:, ::-1])
    # Masts.
    tops, _ = view.project(sensors_m)
    feet, _ = view.project(grounds_m)
    for top, foot in zip(np.rint(tops).astype(int), np.rint(feet).astype(int), strict=True):
        cv2.line(picture, tuple(map(int, foot)), tuple(map(int, top)), (20, 20, 20), 2, cv2.LINE_AA)
        cv2.circle(picture, tuple(map(int, top)), 9, (255, 255, 255), -1, cv2.LINE_AA)
        cv2.circle(picture, tuple(map(int, top)), 7, (38, 38, 220), -1, cv2.LINE_AA)
    return bytes(cv2.imencode(".png", picture)[1])


def _paint(picture: Bytes, view: View, xyz_m: NDArray, blue_first: Bytes) -> None:
    """Paint points as squares of their size in the world, farther ones first."""
    pixels, depth = view.project(xyz_m)
    ahead = np.flatnonzero(depth > 0)
    size = np.clip(np.rint(view.focal_px * _POINT_M / depth[ahead]), 1, _LARGEST_PX).astype(int)
    owners = np.repeat(ahead, size**2)
    number = np.arange(len(owners)) - np.repeat(np.cumsum(size**2) - size**2, size**2)
    rows, columns = np.divmod(number, np.repeat(size, size**2))
    columns = columns + np.rint(pixels[owners, 0]).astype(np.int64)
    rows = rows + np.rint(pixels[owners, 1]).astype(np.int64)
    inside = (columns >= 0) & (columns < _WIDTH_PX) & (rows >= 0) & (rows < _HEIGHT_PX)
    order = np.flatnonzero(inside)[np.argsort(-depth[owners[inside]], kind="stable")]
    picture[rows[order], columns[order]] = blue_first[owners[order]]
