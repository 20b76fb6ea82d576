"""A sheet of map: local metres onto millimetres of paper, at one scale in both directions."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats

SCALES = (100, 200, 250, 500, 750, 1000, 1250, 1500, 2000, 2500, 4000, 5000, 7500, 10_000)
"""Denominators that scale rulers have; beyond the last, whole multiples of it."""
_GRID_STEPS_M = (5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
"""Steps of the coordinate ticks."""
_TICK_EVERY_MM = 30.0
"""Ticks are no closer on paper, so that six digits of a coordinate fit between them."""
_BAR_SHARE = 0.3
"""The scale bar is no longer than this share of the map's width."""
HATCH, HATCH_COLOUR = "hatch", "#7c2d12"
"""Name of the pattern of hatched areas, and its colour."""
_MARKS_APART_MM = 3.4
"""Numbered marks are 4 mm wide; nearer ones hide each other's numbers."""
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
        (left, top), (right, bottom) = self.paper.millimetres(
            np.array([[west, north], [east, south]])
        )
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
        width, height = self.paper.width_mm, self.paper.height_mm
        margin = 8.0
        inner = "".join(self.parts)
        furniture = Drawing(self.paper)
        furniture._ticks(origin, unit_m)
        furniture._upwards(up)
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
            f'<g clip-path="url(#c)">{inner}</g>'
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
        west, south = (
            origin[0] + self.paper.west_m / unit_m,
            origin[1] + self.paper.south_m / unit_m,
        )
        east, north = (
            origin[0] + self.paper.east_m / unit_m,
            origin[1] + self.paper.north_m / unit_m,
        )
        height = self.paper.height_mm
        for value in range(math.ceil(west / step) * step, math.floor(east) + 1, step):
            x = (value - west) * per_unit
            self._stroke(x, 0, x, -1.2)
            self._stroke(x, height, x, height + 1.2)
            self.text(x, -2, str(value), style)
        for value in range(math.ceil(south / step) * step, math.floor(north) + 1, step):
            y = (north - value) * per_unit
            self._stroke(0, y, -1.2, y)
            self._stroke(self.paper.width_mm, y, self.paper.width_mm + 1.2, y)
            turned = f'{style} transform="rotate(-90 -2 {y:.2f})"'
            self.text(-2, y, str(value), turned)

    def _upwards(self, up: str) -> None:
        """Arrow to grid north, or along an axis."""
        x = self.paper.width_mm - 6
        self.parts.append(
            f'<path d="M{x:.2f} 3L{x + 2:.2f} 10L{x:.2f} 8.4L{x - 2:.2f} 10Z" fill="#0f172a"'
            ' stroke="#ffffff" stroke-width="0.3"/>'
        )
        style = 'font-size="3" text-anchor="middle" fill="#0f172a" stroke="none"'
        self.text(x, 13, up, style)

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
        style = 'font-size="2.4" fill="#0f172a"'
        label = f"{length} m, 1 : {self.paper.scale:,}"
        self.text(4 * part + 1.5, y + 1.4, label, style)

    def _stroke(self, x0: float, y0: float, x1: float, y1: float) -> None:
        self.parts.append(
            f'<path d="M{x0:.2f} {y0:.2f}L{x1:.2f} {y1:.2f}" stroke="#0f172a" stroke-width="0.25"/>'
        )
