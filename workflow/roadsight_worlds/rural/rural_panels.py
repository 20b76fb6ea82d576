"""Signs of any form, colour and size, so that a network learns signs and not one road's four."""

from __future__ import annotations

import math

import numpy as np

from roadsight.base.arrays import Floats
from roadsight_worlds.rural.rural_furniture import Furnisher
from roadsight_worlds.rural.rural_materials import Material
from roadsight_worlds.rural.rural_mesh import raised, turned

_OFFSET_M = (4.8, 9.5)  # From the centreline: from the shoulder to beyond the ditch.
_SIZE_M = (0.3, 1.4)  # Across a panel: from a marker's to a destination's.
_FOOT_M = (0.9, 2.4)  # Of a panel's lower edge over the ground.
_WIDE_M = 1.1  # Wider panels stand on two posts.
# Triangle, diamond, hexagon, octagon, disc; as many panels again are rectangles.
_CORNERS = (3, 4, 6, 8, 16)
_SHEET_M = 0.006  # Between a panel's front and its back; its legend is as far before its front.


def add_panels(add: Furnisher, per_km: float) -> None:
    """Place ``per_km`` signs a kilometre on both sides, where no side road or bridge is."""
    rng, line = add.rng, add.ground.line
    first, last = float(line.station_m[0]) + 5.0, float(line.station_m[-1]) - 5.0
    for station in np.sort(rng.uniform(first, last, round(per_km * (last - first) / 1000.0))):
        side = int(rng.choice([-1, 1]))
        offset = add.ground.section.beside(side * rng.uniform(*_OFFSET_M))
        if abs(station - add.ground.gully_m) > 10.0 and add.free(float(station), offset, 1.0):
            _sign(add, float(station), offset, side)


def _sign(add: Furnisher, station: float, offset: float, side: int) -> None:
    """One panel, or two above each other; drivers of either way or nobody see their fronts."""
    rng = add.rng
    bottom = rng.uniform(*_FOOT_M)
    outlines = [_outline(rng) for _ in range(1 + int(rng.random() < 0.2))]
    height = bottom + sum(float(np.ptp(o[:, 1])) + 0.05 for o in outlines)
    foot = add.listed("sign", station, offset, height, 0.04)
    towards = add.heading(station) + (0.0 if side < 0 else math.pi)
    away = rng.choice([0.0, math.pi, rng.uniform(-math.pi, math.pi)], p=[0.6, 0.25, 0.15])
    heading = towards + away + rng.normal(0.0, 0.08)
    add.mesh.start("sign")
    # One post behind the middle, or two behind a wide panel.
    wide = float(np.ptp(outlines[0][:, 0]))
    material = Material.POLE_WOOD if add.rng.random() < 0.3 else Material.STEEL_POST
    radius = add.rng.uniform(0.025, 0.06)
    across = [0.0] if wide < _WIDE_M else [-0.35 * wide, 0.35 * wide]
    for y in across:
        place = turned([[0.0, y, 0.0]], heading, foot)[0]
        add.mesh.post(place, height, (radius, radius), 6, material, add.rng.uniform())
    for outline in outlines:
        middle = raised(foot, bottom - float(outline[:, 1].min()))
        _panel(add, outline, heading, middle)
        bottom += float(np.ptp(outline[:, 1])) + 0.05


def _outline(rng: np.random.Generator) -> Floats:
    """Corners (k, 2) of a panel about its middle: across and up, m."""
    across = float(np.exp(rng.uniform(*np.log(_SIZE_M))))
    if rng.random() < 0.5:
        half = 0.5 * across * np.array([1.0, float(np.exp(rng.uniform(-0.8, 0.6)))])
        return half * [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
    corners = int(rng.choice(_CORNERS))
    start = rng.choice([-0.5, 0.5]) * math.pi if corners == 3 else 0.5 * math.pi
    start += math.pi / corners if corners in (6, 8) else 0.0
    angle = start + 2.0 * math.pi * np.arange(corners) / corners
    return 0.5 * across * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _panel(add: Furnisher, outline: Floats, heading: float, middle: Floats) -> None:
    """Front with a border and a legend of bars, and a grey back."""
    rng = add.rng
    back, front = -0.06, -0.06 - _SHEET_M

    def sheet(corners: Floats, x: float, material: Material, tint: float = 0.5) -> None:
        standing = np.column_stack([np.full(len(corners), x), corners])
        add.mesh.quad(turned(standing, heading, middle), material, tint)

    ground, ink = rng.uniform(0.0, 1.0, 2)
    sheet(outline, back, Material.SIGN_BACK)
    sheet(outline, front, Material.SIGN_PAINT, ink if rng.random() < 0.5 else ground)
    sheet(0.86 * outline, front - _SHEET_M, Material.SIGN_PAINT, ground)
    size = 0.5 * np.ptp(outline, axis=0)
    for _ in range(int(rng.integers(0, 6))):
        half = size * rng.uniform([0.05, 0.04], [0.5, 0.15])
        at = size * rng.uniform(-0.4, 0.4, 2)
        bar = at + half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        sheet(0.9 * bar, front - 2.0 * _SHEET_M, Material.SIGN_PAINT, ink)
