"""Maps of a plan and of the poles on paper, from what the pages hold."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Floats
from roadsight.report.handover.styles import SEEN
from roadsight.report.packing import unpack, unpack_points
from roadsight.report.poles_layers import LEVELS
from roadsight.report.site.layers import UNKNOWN_HEIGHT

SENSOR = "#b45309"
_PAVEMENT = "#cbd5e1"
_EDGE, _MEDIAN = "#0f172a", "#8a6d1f"
_SKETCH_MM = (84.0, 46.0)  # Size of the sketch in units in which a sensor's mark is 4 wide
_MARGIN_M = 5.0  # Air around what a map is of
_LOW = np.array([148, 163, 184])
# Colours of points at the ground and 8 m above it, where the cloud has none of its own
_HIGH = np.array([21, 94, 117])
_HIGH_M = 8.0

# Pale colours of nothing, other, ground, vegetation, building, road and bridge
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
    for number, colour in enumerate(SEEN.values()):
        drawing.squares(targets[counts == number, :2], side_m, f'fill="{colour}"')
    for polygon in layers.get("unexamined", []):
        drawing.areas([_ring(ring) for ring in polygon], f'fill="url(#{HATCH})"')
    _edges(drawing, layers["edges"])
    drawing.numbered(sensors, [str(s["number"]) for s in plan["sensors"]], SENSOR)
    return _finished(drawing, page)


def plan_sketch(page: dict[str, Any], plan: dict[str, Any]) -> str:
    """Small SVG for the head of a page: pavement, numbered sensors, targets that none sees."""
    layers = page["layers"]
    targets = unpack(layers["targets"]["xyz"]).reshape(-1, 3).astype(np.float64)
    sensors = np.array([[s["x"], s["y"]] for s in plan["sensors"]]).reshape(-1, 2)
    drawing = Drawing(_around(np.vstack([targets[:, :2], sensors]), *_SKETCH_MM))
    for polygon in layers["pavement"]:
        drawing.areas([_ring(ring) for ring in polygon], 'fill="var(--pavement)"')
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
        style = f'fill="{_PAVEMENT}" stroke="#64748b" stroke-width="0.15"'
        drawing.areas([_ring(ring) for ring in polygon], style)
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


# A sheet of map: local metres onto millimetres of paper, at one scale in both directions.

# Denominators that scale rulers have; beyond the last, whole multiples of it
SCALES = (100, 200, 250, 500, 750, 1000, 1250, 1500, 2000, 2500, 4000, 5000, 7500, 10_000)
_GRID_STEPS_M = (5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)  # Steps of the coordinate ticks
# Ticks are no closer on paper, so that six digits of a coordinate fit between them
_TICK_EVERY_MM = 30.0
_BAR_SHARE = 0.3  # The scale bar is no longer than this share of the map's width
# Name of the pattern of hatched areas, and its colour
HATCH, HATCH_COLOUR = "hatch", "#7c2d12"
_MARKS_APART_MM = 3.4  # Numbered marks are 4 mm wide; nearer ones hide each other's numbers
_FONT = "Libertinus Serif"


@dataclass(frozen=True)
class Paper:
    """What part of the world a map shows, and how large.

    Parameters
    ----------
    west_m, south_m, east_m, north_m : local metres.
    scale : denominator, one metre is 1000 / scale millimetres of paper in both directions.
    """

    west_m: float
    south_m: float
    east_m: float
    north_m: float
    scale: int

    @property
    def width_mm(self) -> float:
        """Width on paper."""
        return (self.east_m - self.west_m) * 1000 / self.scale

    @property
    def height_mm(self) -> float:
        """Height on paper."""
        return (self.north_m - self.south_m) * 1000 / self.scale

    def millimetres(self, xy_m: NDArray) -> Floats:
        """Places on paper (n, 2), from the upper left corner, of local metres (n, 2)."""
        xy = np.asarray(xy_m, np.float64).reshape(-1, 2)
        per_m = 1000 / self.scale
        return np.column_stack([(xy[:, 0] - self.west_m), (self.north_m - xy[:, 1])]) * per_m


def fit(bounds_m: Sequence[float], width_mm: float, height_mm: float) -> Paper:
    """Largest usual scale at which the bounds fit on paper.

    Parameters
    ----------
    bounds_m : west, south, east, north in local metres, finite; a point is given 10 m around it.
    """
    west, south, east, north = (float(value) for value in bounds_m)
    if east - west <= 0 or north - south <= 0:
        west, south, east, north = west - 10, south - 10, east + 10, north + 10
    needed = 1000 * max((east - west) / width_mm, (north - south) / height_mm)
    scale = next((known for known in SCALES if known >= needed), 0)
    return Paper(west, south, east, north, scale or math.ceil(needed / SCALES[-1]) * SCALES[-1])


@dataclass
class Drawing:
    """SVG of a map that is drawn from the ground up, in millimetres."""

    paper: Paper
    parts: list[str] = field(default_factory=list)

    def image(self, png: bytes, bounds_m: Sequence[float]) -> None:
        """Lay a picture on its bounds (west, south, east, north, local metres)."""
        west, south, east, north = bounds_m
        corners = np.array([[west, north], [east, south]])
        (left, top), (right, bottom) = self.paper.millimetres(corners)
        data = base64.b64encode(png).decode("ascii")
        self.parts.append(
            f'<image x="{left:.3f}" y="{top:.3f}" width="{right - left:.3f}"'
            f' height="{bottom - top:.3f}" preserveAspectRatio="none"'
            f' href="data:image/png;base64,{data}"/>'
        )

    def areas(self, rings: Iterable[NDArray], style: str) -> None:
        """Fill polygons, of which rings within rings are holes."""
        path = "".join(self._path(ring) + "Z" for ring in rings)
        if path:
            self.parts.append(f'<path d="{path}" fill-rule="evenodd" {style}/>')

    def line(self, xy_m: NDArray, style: str) -> None:
        """Draw a line."""
        if len(xy_m) > 1:
            self.parts.append(f'<path d="{self._path(xy_m)}" fill="none" {style}/>')

    def squares(self, xy_m: NDArray, side_m: float, style: str) -> None:
        """Draw squares of one style around points; one path, however many there are."""
        if not len(xy_m):
            return
        side = side_m * 1000 / self.paper.scale
        corners = self.paper.millimetres(xy_m) - side / 2
        path = "".join(f"M{x:.2f} {y:.2f}h{side:.2f}v{side:.2f}h{-side:.2f}z" for x, y in corners)
        self.parts.append(f'<path d="{path}" {style}/>')

    def dots(self, xy_m: NDArray, radius_mm: float, style: str) -> None:
        """Draw round marks."""
        for x, y in self.paper.millimetres(xy_m):
            self.parts.append(f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{radius_mm}" {style}/>')

    def numbered(self, xy_m: NDArray, texts: Sequence[str], fill: str) -> None:
        """Draw round marks with a text each, as the numbers of sensors.

        A mark that would hide one before it is a dot without a text.
        """
        places = self.paper.millimetres(xy_m)
        free: list[int] = []
        for number, place in enumerate(places):
            if all(math.dist(place, places[other]) >= _MARKS_APART_MM for other in free):
                free.append(number)
        crowded = np.setdiff1d(np.arange(len(places)), free)
        self.dots(xy_m[crowded], 0.9, f'fill="{fill}" stroke="#ffffff" stroke-width="0.2"')
        for number in free:
            (x, y), text = places[number], texts[number]
            self.parts.append(
                f'<circle cx="{x:.2f}" cy="{y:.2f}" r="2" fill="{fill}" stroke="#ffffff"'
                ' stroke-width="0.4"/>'
            )
            self.text(x, y + 0.85, text, 'font-size="2.4" text-anchor="middle" fill="#ffffff"')

    def text(self, x_mm: float, y_mm: float, text: str, style: str) -> None:
        """Write a text at a place on paper."""
        self.parts.append(
            f'<text x="{x_mm:.2f}" y="{y_mm:.2f}" font-family="{_FONT}" {style}>'
            f"{escape(text)}</text>"
        )

    def svg(self, origin: tuple[float, float], unit_m: float, up: str = "N") -> str:
        """The map with frame, coordinate ticks, north arrow and scale bar.

        Parameters
        ----------
        origin : native coordinates of local (0, 0). unit_m : metres of a native unit.
        up : what lies there, N or the axis of a site without CRS.
        """
        width, height, margin = self.paper.width_mm, self.paper.height_mm, 8.0
        furniture = Drawing(self.paper)
        furniture._ticks(origin, unit_m)
        x = width - 6  # arrow to grid north, or along an axis
        furniture.parts.append(
            f'<path d="M{x:.2f} 3L{x + 2:.2f} 10L{x:.2f} 8.4L{x - 2:.2f} 10Z" fill="#0f172a"'
            ' stroke="#ffffff" stroke-width="0.3"/>'
        )
        style = 'font-size="3" text-anchor="middle" fill="#0f172a" stroke="none"'
        furniture.text(x, 13, up, style)
        furniture._bar()
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width + 2 * margin:.3f}mm"'
            f' height="{height + 2 * margin + 6:.3f}mm" viewBox="{-margin} {-margin}'
            f' {width + 2 * margin:.3f} {height + 2 * margin + 6:.3f}">'
            f'<defs><clipPath id="c"><rect width="{width:.3f}" height="{height:.3f}"/></clipPath>'
            f'<pattern id="{HATCH}" width="2" height="2" patternUnits="userSpaceOnUse"'
            ' patternTransform="rotate(45)"><path d="M0 0V2"'
            f' stroke="{HATCH_COLOUR}"'
            ' stroke-width="0.5"/></pattern></defs>'
            f'<rect width="{width:.3f}" height="{height:.3f}" fill="#f8fafc"/>'
            f'<g clip-path="url(#c)">{"".join(self.parts)}</g>'
            f'<rect width="{width:.3f}" height="{height:.3f}" fill="none" stroke="#0f172a"'
            ' stroke-width="0.25"/>'
            f"{''.join(furniture.parts)}</svg>"
        )

    def inline(self, about: str, up: str = "N") -> str:
        """The map with scale and what lies up, as an element of a page and in its colours.

        Parameters
        ----------
        about : what it is of. up : N or the axis of a site without CRS.
        """
        width, height = self.paper.width_mm, self.paper.height_mm
        length = self._bar_m()
        bar = length * 1000 / self.paper.scale
        y = height + 5.5
        style = 'font-size="3.6" style="fill: var(--ink)"'
        furniture = (
            f'<path d="M0.3 {y - 1.2:.2f}v1.2h{bar:.2f}v-1.2" fill="none" stroke="var(--ink)"'
            f' stroke-width="0.5"/><text x="{bar + 1.5:.2f}" y="{y:.2f}" {style}>{length} m</text>'
            f'<path d="M{width - 2:.2f} {y - 4.5:.2f}l1.6 4.5l-1.6 -1.2l-1.6 1.2z"'
            f' fill="var(--ink)"/><text x="{width - 4.6:.2f}" y="{y:.2f}" text-anchor="end"'
            f" {style}>{escape(up)}</text>"
        )
        return (
            f'<svg class="sketch" viewBox="0 0 {width:.2f} {height + 6.5:.2f}" role="img"'
            f' aria-label="{escape(about, quote=True)}">{"".join(self.parts)}{furniture}</svg>'
        )

    def _path(self, xy_m: NDArray) -> str:
        points = self.paper.millimetres(xy_m)
        return "M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in points)

    def _ticks(self, origin: tuple[float, float], unit_m: float) -> None:
        """Native coordinates along the frame."""
        per_unit = unit_m * 1000 / self.paper.scale
        step = next((s for s in _GRID_STEPS_M if s * per_unit >= _TICK_EVERY_MM), _GRID_STEPS_M[-1])
        style = 'font-size="2.2" fill="#334155" text-anchor="middle"'
        paper = self.paper
        west, east = (origin[0] + x_m / unit_m for x_m in (paper.west_m, paper.east_m))
        south, north = (origin[1] + y_m / unit_m for y_m in (paper.south_m, paper.north_m))
        width, height = paper.width_mm, paper.height_mm
        for value in range(math.ceil(west / step) * step, math.floor(east) + 1, step):
            x = (value - west) * per_unit
            self._stroke(x, 0, x, -1.2)
            self._stroke(x, height, x, height + 1.2)
            self.text(x, -2, str(value), style)
        for value in range(math.ceil(south / step) * step, math.floor(north) + 1, step):
            y = (north - value) * per_unit
            self._stroke(0, y, -1.2, y)
            self._stroke(width, y, width + 1.2, y)
            self.text(-2, y, str(value), f'{style} transform="rotate(-90 -2 {y:.2f})"')

    def _bar_m(self) -> int:
        """Round length of the scale bar."""
        longest = (self.paper.east_m - self.paper.west_m) * _BAR_SHARE
        return max((s for s in _GRID_STEPS_M if s <= longest), default=_GRID_STEPS_M[0])

    def _bar(self) -> None:
        """Scale bar of a round length, in four parts."""
        length = self._bar_m()
        part = length * 1000 / self.paper.scale / 4
        y = self.paper.height_mm + 5
        for number in range(4):
            fill = "#0f172a" if number % 2 == 0 else "#ffffff"
            self.parts.append(
                f'<rect x="{number * part:.2f}" y="{y:.2f}" width="{part:.2f}" height="1.4"'
                f' fill="{fill}" stroke="#0f172a" stroke-width="0.2"/>'
            )
        label = f"{length} m, 1 : {self.paper.scale:,}"
        self.text(4 * part + 1.5, y + 1.4, label, 'font-size="2.4" fill="#0f172a"')

    def _stroke(self, x0: float, y0: float, x1: float, y1: float) -> None:
        self.parts.append(
            f'<path d="M{x0:.2f} {y0:.2f}L{x1:.2f} {y1:.2f}" stroke="#0f172a" stroke-width="0.25"/>'
        )
