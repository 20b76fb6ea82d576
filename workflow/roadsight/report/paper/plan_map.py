"""Maps of a plan and of the poles on paper, from what the pages hold."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Floats
from roadsight.report.packing import unpack, unpack_points
from roadsight.report.paper.sheet import HATCH, HATCH_COLOUR, Drawing, Paper, fit
from roadsight.report.poles.poles_raster import LEVELS
from roadsight.report.site.layers import UNKNOWN_HEIGHT

SEEN = ("#dc2626", "#93c5fd", "#3b82f6", "#1e3a8a")
"""Targets that no sensor, one, two, and three or more sensors see."""
SEEN_LABELS = ("by none", "by one", "by two", "by three or more")
SENSOR = "#b45309"
_PAVEMENT = "#cbd5e1"
_EDGE, _MEDIAN = "#0f172a", "#8a6d1f"
_SKETCH_MM = (84.0, 46.0)
"""Size of the sketch in units in which a sensor's mark is 4 wide."""
_MARGIN_M = 5.0
"""Air around what a map is of."""
_LOW = np.array([148, 163, 184])
_HIGH = np.array([21, 94, 117])
"""Colours of points at the ground and 8 m above it, where the cloud has none of its own."""
_HIGH_M = 8.0
_KINDS = np.array(
    [
        (248, 250, 252),
        (226, 232, 240),
        (237, 233, 220),
        (220, 236, 214),
        (214, 205, 214),
        (176, 184, 194),
        (140, 148, 160),
    ],
    np.uint8,
)
"""Pale colours of nothing, other, ground, vegetation, building, road and bridge."""


def times_seen(plan: dict[str, Any], targets: int) -> NDArray:
    """How many chosen sensors see each target, (n,)."""
    counts = np.zeros(targets, np.int64)
    for seen in plan["seen"]:
        counts[unpack(seen)] += 1
    return counts


def plan_map(page: dict[str, Any], plan: dict[str, Any], width_mm: float, height_mm: float) -> str:
    """SVG: relief, pavement, targets by how many sensors see them, edges, numbered sensors."""
    layers = page["layers"]
    targets = unpack(layers["targets"]["xyz"]).reshape(-1, 3).astype(np.float64)
    sensors = np.array([[s["x"], s["y"]] for s in plan["sensors"]]).reshape(-1, 2)
    drawing = _scene(page, np.vstack([targets[:, :2], sensors]), width_mm, height_mm)
    counts = np.minimum(times_seen(plan, len(targets)), len(SEEN) - 1)
    side_m = float(page["summary"]["settings"]["targets"]["cell_size_m"])
    for number, colour in enumerate(SEEN):
        drawing.squares(targets[counts == number, :2], side_m, f'fill="{colour}"')
    for polygon in layers.get("unexamined", []):
        drawing.areas([_ring(ring) for ring in polygon], f'fill="url(#{HATCH})"')
    _edges(drawing, layers["edges"])
    drawing.numbered(sensors, [str(s["number"]) for s in plan["sensors"]], SENSOR)
    return _finished(drawing, page)


def plan_sketch(page: dict[str, Any], plan: dict[str, Any]) -> str:
    """Small SVG for the head of a page: pavement, numbered sensors, targets that none sees."""
    layers = page["layers"]
    rings = [[_ring(ring) for ring in polygon] for polygon in layers["pavement"]]
    targets = unpack(layers["targets"]["xyz"]).reshape(-1, 3).astype(np.float64)
    sensors = np.array([[s["x"], s["y"]] for s in plan["sensors"]]).reshape(-1, 2)
    drawing = Drawing(_around(np.vstack([targets[:, :2], sensors]), *_SKETCH_MM))
    for polygon in rings:
        drawing.areas(polygon, 'fill="var(--pavement)"')
    unseen = targets[times_seen(plan, len(targets)) == 0, :2]
    drawing.dots(unseen, 0.8, 'fill="var(--seen-0)"')
    drawing.numbered(sensors, [str(s["number"]) for s in plan["sensors"]], "var(--sensor)")
    about = f"{len(sensors)} sensors on the road as the plan {plan['title']} places them"
    return drawing.inline(about, _up(page))


def scene_map(page: dict[str, Any], width_mm: float, height_mm: float) -> str:
    """SVG of a site without plans: relief, pavement, edges."""
    rings = [_ring(part) for polygon in page["layers"]["pavement"] for part in polygon]
    relief = _bounds(page["layers"]["relief"])
    corners = np.array(relief).reshape(2, 2)
    drawing = _scene(page, np.vstack([corners, *rings]), width_mm, height_mm)
    _edges(drawing, page["layers"]["edges"])
    return _finished(drawing, page)


def pole_map(poles_page: dict[str, Any], width_mm: float, height_mm: float) -> str | None:
    """SVG of located poles as they are numbered, on the LiDAR's classes; None without poles."""
    poles = poles_page["layers"]["poles"]
    xy = np.array([[pole["x"], pole["y"]] for pole in poles]).reshape(-1, 2)
    if not len(xy):
        return None
    drawing = Drawing(_around(xy, width_mm, height_mm))
    raster = poles_page["layers"]["raster"]
    if raster is not None:
        png = np.frombuffer(base64.b64decode(raster["png"]), np.uint8)
        grey = np.asarray(cv2.imdecode(png, cv2.IMREAD_GRAYSCALE))
        kinds = np.minimum(grey // LEVELS, len(_KINDS) - 1)
        drawing.image(bytes(cv2.imencode(".png", _KINDS[kinds][..., ::-1])[1]), _bounds(raster))
    drawing.numbered(xy, [str(number) for number in range(1, len(xy) + 1)], SENSOR)
    return _finished(drawing, poles_page)


def cloud_colours(cloud: dict[str, Any]) -> tuple[Floats, Bytes]:
    """Points (n, 3) of a page's cloud in local metres, and their colours (n, 3)."""
    xyz_m = unpack_points(cloud)
    if cloud["colour"] is not None:
        return xyz_m, unpack(cloud["colour"]).reshape(-1, 3)
    steps = unpack(cloud["height"]).astype(np.float64)
    above = np.where(steps == UNKNOWN_HEIGHT, 0.0, steps * cloud["height_step_m"])
    share = np.clip(above / _HIGH_M, 0, 1)[:, None]
    colours = _LOW + share * (_HIGH - _LOW)
    if cloud["intensity"] is not None:
        bright = unpack(cloud["intensity"]).astype(np.float64)[:, None] / 255
        colours = colours * (0.55 + 0.6 * bright)
    return xyz_m, np.clip(np.rint(colours), 0, 255).astype(np.uint8)


def _scene(page: dict[str, Any], xy_m: NDArray, width_mm: float, height_mm: float) -> Drawing:
    """Map around points with relief and pavement."""
    drawing = Drawing(_around(xy_m, width_mm, height_mm))
    relief = page["layers"]["relief"]
    shade = unpack(relief["shade"]).reshape(relief["rows"], relief["columns"])
    pale = np.where(shade == 0, 255, 150 + np.rint(shade * (100 / 255))).astype(np.uint8)
    drawing.image(bytes(cv2.imencode(".png", pale)[1]), _bounds(relief))
    for polygon in page["layers"]["pavement"]:
        rings = [_ring(ring) for ring in polygon]
        drawing.areas(rings, f'fill="{_PAVEMENT}" stroke="#64748b" stroke-width="0.15"')
    return drawing


def _around(xy_m: NDArray, width_mm: float, height_mm: float) -> Paper:
    (west, south), (east, north) = xy_m.min(axis=0) - _MARGIN_M, xy_m.max(axis=0) + _MARGIN_M
    return fit((west, south, east, north), width_mm, height_mm)


def _bounds(raster: dict[str, Any]) -> tuple[float, float, float, float]:
    """West, south, east, north of a raster of a page."""
    cell = raster["cell_size_m"]
    west, north = raster["west_m"], raster["north_m"]
    return west, north - raster["rows"] * cell, west + raster["columns"] * cell, north


def legend(page: dict[str, Any]) -> list[list[str]]:
    """Kind of mark (fill, hatch, line, dashes), colour and meaning of what lies below targets."""
    layers = page["layers"]
    keys = [["fill", _PAVEMENT, "pavement"]]
    if layers.get("unexamined"):
        keys.append(["hatch", HATCH_COLOUR, "pavement not examined"])
    found = [list(_stroke(edge)) for edge in layers["edges"]]
    return [*keys, *(key for number, key in enumerate(found) if key not in found[:number])]


def _stroke(edge: dict[str, Any]) -> tuple[str, str, str]:
    """How a line is drawn, and what it is."""
    is_median = edge["kind"] == "median"
    is_dashed = edge["source"] == "automatic"
    name = ("median" if is_median else "road edge") + (", automatic" if is_dashed else "")
    return "dashes" if is_dashed else "line", _MEDIAN if is_median else _EDGE, name


def _edges(drawing: Drawing, edges: Sequence[dict[str, Any]]) -> None:
    for edge in edges:
        kind, colour, _ = _stroke(edge)
        dashes = ' stroke-dasharray="1.5 1"' if kind == "dashes" else ""
        drawing.line(_ring(edge["xy"]), f'stroke="{colour}" stroke-width="0.3"{dashes}')


def _ring(packed: dict[str, Any]) -> Floats:
    return unpack(packed).reshape(-1, 2).astype(np.float64)


def _finished(drawing: Drawing, page: dict[str, Any]) -> str:
    frame = page["frame"]
    east, north, _ = frame["origin"]
    return drawing.svg((float(east), float(north)), float(frame["unit_m"]), _up(page))


def _up(page: dict[str, Any]) -> str:
    """What lies up: north of the grid, or the axis of a site without CRS."""
    return "y" if page["frame"]["crs_wkt"] is None else "N"
