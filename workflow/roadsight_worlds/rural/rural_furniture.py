"""Poles, wires, signs, fences, guardrails along the rural road."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from roadsight.base.arrays import Floats
from roadsight_worlds.rural.rural_ground import SIDE_ROAD, RuralGround
from roadsight_worlds.rural.rural_materials import Material
from roadsight_worlds.rural.rural_mesh import MeshBuilder, raised, turned

_SPAN_M = (35.0, 50.0)  # Least and greatest distance between utility poles.
_SIDES = 12  # Of a post, enough to look round.
_WIRE_PIECES = 10  # Straight pieces of a sagging wire.


@dataclass(frozen=True)
class RuralPole:
    """Upright post or trunk; ``xyz_m`` is its foot on the ground, local metres.

    ``kind`` is "utility", "sign", "delineator", "fence", "mailbox" or "tree".
    """

    kind: str
    station_m: float
    offset_m: float
    xyz_m: tuple[float, float, float]
    height_m: float
    radius_m: float


@dataclass
class Furnisher:
    """Adds things by station and offset; keeps lists of poles, trees, guardrails and buildings."""

    ground: RuralGround
    mesh: MeshBuilder
    rng: np.random.Generator
    poles: list[RuralPole]
    trees: list[RuralPole] = field(default_factory=list)
    guardrails: list[Floats] = field(default_factory=list)
    buildings: list[Floats] = field(default_factory=list)

    def place(self, station_m: float, offset_m: float) -> Floats:
        """Place (3,) of the ground."""
        xy = self.ground.line.plan(station_m, offset_m)
        return np.array([*xy, float(self.ground.height(station_m, offset_m))])

    def heading(self, station_m: float) -> float:
        """Direction of the road, radians anticlockwise from x."""
        return float(self.ground.line.heading(station_m))

    def listed(
        self, kind: str, station_m: float, offset_m: float, height_m: float, radius_m: float
    ) -> Floats:
        """List a pole and return its foot (3,)."""
        foot = self.place(station_m, offset_m)
        x, y, z = foot.tolist()
        own = self.trees if kind == "tree" else self.poles
        own.append(RuralPole(kind, station_m, offset_m, (x, y, z), height_m, radius_m))
        return foot

    def free(self, station_m: float, offset_m: float, margin_m: float) -> bool:
        """Whether a place keeps off every side road and driveway."""
        xy = self.ground.line.plan(station_m, offset_m)
        for branch in self.ground.branches:
            along, across = branch.along_across(xy)
            wide = branch.half_m + margin_m + branch.radius_m * (along < branch.radius_m)
            beside = offset_m * branch.side > 0.0 and along < branch.length_m + margin_m
            if beside and abs(across) < wide:
                return False
        return True


def add_utility_line(add: Furnisher, side: int) -> None:
    """Poles every 35 m to 50 m on one side with wires, and a few on the other side."""
    rng, line = add.rng, add.ground.line
    station = line.station_m[0] + 25.0
    tops: list[Floats] = []
    bridge = add.ground.gully_m
    while station < line.station_m[-1] - 10.0:
        offset = add.ground.section.beside(side * rng.uniform(6.4, 10.5))
        while not add.free(station, offset, 1.0) or abs(station - bridge) < 9.0:
            station += 2.0
        tops.append(_utility_pole(add, station, offset, add.heading(station)))
        if len(tops) % 4 == 2 and add.free(station + 6.0, -0.9 * offset, 1.0):
            other = _utility_pole(
                add, station + rng.uniform(-5.0, 5.0), -rng.uniform(0.8, 1.3) * offset, None
            )
            _wire(add, tops[-1][3], other[0], 0.014)
        station += rng.uniform(*_SPAN_M)
    for here, there in pairwise(tops):
        for number, radius in enumerate((0.013, 0.013, 0.013, 0.016, 0.028)):
            _wire(add, here[number], there[number], radius)


def _utility_pole(add: Furnisher, station: float, offset: float, heading: float | None) -> Floats:
    """Wooden pole, with a cross-arm where the line follows the road; attachments (5, 3)."""
    rng = add.rng
    height = rng.uniform(9.0, 12.0) - (2.0 if heading is None else 0.0)
    foot = add.listed("utility", station, offset, height, 0.15)
    add.mesh.start("utility pole")
    tint = rng.uniform()
    add.mesh.post(foot, height, (0.155, 0.125), _SIDES, Material.POLE_WOOD, tint)
    top = raised(foot, height)
    if heading is None:
        return np.stack([raised(top, -0.2)] * 5)
    arm = raised(top, -0.45)
    add.mesh.box(arm, [0.06, 1.15, 0.06], heading, Material.POLE_WOOD, tint)
    for across in (-1.0, 1.0):
        place = turned([[0.0, across, 0.13]], heading, arm)[0]
        add.mesh.box(place, [0.05, 0.05, 0.09], heading, Material.FITTING, 0.3)
    if rng.uniform() < 0.3:
        can = turned([[0.0, 0.38, -1.6]], heading, top)[0]
        add.mesh.tube([can, raised(can, 0.95)], (0.23, 0.23), 10, Material.FITTING, 0.6)
    ends = turned([[0.0, -1.0, 0.22], [0.0, 1.0, 0.22]], heading, arm)
    return np.stack([top, *ends, raised(top, -2.0), raised(top, -0.3 * height)])


def _wire(add: Furnisher, start: Floats, end: Floats, radius: float) -> None:
    """Wire that sags by about 1.2 % of its span."""
    share = np.linspace(0.0, 1.0, _WIRE_PIECES + 1)[:, None]
    span = float(np.linalg.norm(end - start))
    sag = 4.0 * share * (1.0 - share) * add.rng.uniform(0.009, 0.015) * span
    add.mesh.start("wire")
    line = start + share * (end - start) - sag * np.array([0.0, 0.0, 1.0])
    add.mesh.tube(line, (radius, radius), 4, Material.WIRE, add.rng.uniform())


def add_signs(add: Furnisher) -> None:
    """Curve warnings, speed limits, route markers, and STOP on the side road."""
    rng, line = add.rng, add.ground.line
    for number, start in enumerate(np.arange(60.0, line.station_m[-1] - 70.0, 105.0)):
        side = int(rng.choice([-1, 1]))
        station = float(start + rng.uniform(0.0, 60.0))
        offset = add.ground.section.beside(side * rng.uniform(5.4, 6.4))
        if abs(station - add.ground.gully_m) < 10.0 or not add.free(station, offset, 1.5):
            continue
        _sign(add, station, offset, number % 3, side)
    for branch in add.ground.branches:
        if branch.kind == SIDE_ROAD:
            station = branch.station_m + branch.half_m + branch.radius_m + 2.5
            _sign(add, station, add.ground.section.beside(branch.side * 8.2), 3, branch.side)


def _sign(add: Furnisher, station: float, offset: float, design: int, side: int) -> None:
    """Panel on a steel post; drivers on their right-hand side see its front."""
    rng = add.rng
    height = rng.uniform(2.5, 2.9)
    foot = add.listed("sign", station, offset, height, 0.035)
    add.mesh.start("sign")
    add.mesh.post(foot, height, (0.035, 0.035), 6, Material.STEEL_POST, 0.5)
    heading = add.heading(station) + (0.0 if side < 0 else math.pi) + rng.normal(0.0, 0.05)
    if design == 3:  # drivers on the side road see it
        heading = add.heading(station) + (1.0 + 0.5 * side) * math.pi
    shape, material, mark = _SIGNS[design]
    middle = raised(foot, height - 0.32)
    front = np.array([[-0.045, y, z] for y, z in shape])
    add.mesh.quad(turned(front, heading, middle), material)
    add.mesh.quad(turned(np.add(front, [0.006, 0.0, 0.0]), heading, middle), Material.SIGN_BACK)
    for piece, colour in mark:
        add.mesh.quad(turned([[-0.055, y, z] for y, z in piece], heading, middle), colour)


def _rectangle(y0: float, z0: float, y1: float, z1: float) -> list[tuple[float, float]]:
    return [(y0, z0), (y1, z0), (y1, z1), (y0, z1)]


# Corners of the STOP sign, m; its sides are level and upright.
_OCTAGON = [
    (0.41 * math.cos(math.radians(a)), 0.41 * math.sin(math.radians(a)))
    for a in np.arange(22.5, 360.0, 45.0)
]
_BLACK = Material.SIGN_BLACK
_WHITE = Material.SIGN_WHITE
_SIGNS = (
    (
        [(0.0, -0.54), (-0.54, 0.0), (0.0, 0.54), (0.54, 0.0)],
        Material.SIGN_YELLOW,
        [
            (_rectangle(-0.05, -0.25, 0.05, 0.12), _BLACK),
            (_rectangle(-0.05, 0.02, 0.25, 0.12), _BLACK),
        ],
    ),
    (
        _rectangle(-0.31, -0.38, 0.31, 0.38),
        Material.SIGN_WHITE,
        [
            (_rectangle(-0.22, 0.18, 0.22, 0.26), _BLACK),
            (_rectangle(-0.22, 0.06, 0.22, 0.12), _BLACK),
            (_rectangle(-0.2, -0.28, -0.05, -0.02), _BLACK),
            (_rectangle(0.05, -0.28, 0.2, -0.02), _BLACK),
        ],
    ),
    (
        _rectangle(-0.45, -0.2, 0.45, 0.2),
        Material.SIGN_GREEN,
        [(_rectangle(-0.36, -0.06, 0.34, 0.07), _WHITE)],
    ),
    (_OCTAGON, Material.SIGN_RED, [(_rectangle(-0.27, -0.1, 0.27, 0.1), _WHITE)]),
)


def add_delineators(add: Furnisher) -> None:
    """Slender marker posts on the outside of the bends."""
    line, bridge = add.ground.line, add.ground.gully_m
    for station in np.arange(10.0, line.station_m[-1] - 20.0, 32.0):
        bend = float(line.heading(station + 10.0) - line.heading(station - 10.0)) / 20.0
        if abs(bend) < 1.0 / 420.0 or abs(station - bridge) < 12.0:
            continue
        offset = add.ground.section.beside(-math.copysign(5.2, bend))
        if add.free(station, offset, 1.0):
            foot = add.listed("delineator", float(station), offset, 1.1, 0.05)
            add.mesh.start("delineator")
            add.mesh.post(foot, 1.1, (0.05, 0.05), 6, Material.DELINEATOR, 0.5)


def add_fence(add: Furnisher, start_m: float, end_m: float, offset_m: float) -> None:
    """Wooden posts every 4 m with three wires."""
    tops = []
    for station in np.arange(start_m, end_m, 4.0):
        if not add.free(station, offset_m, 2.0):
            continue
        foot = add.listed("fence", float(station), offset_m, 1.3, 0.06)
        add.mesh.start("fence post")
        add.mesh.post(foot, 1.3, (0.065, 0.055), 6, Material.FENCE, add.rng.uniform())
        tops.append(raised(foot, 1.3))
    for here, there in pairwise(tops):
        if np.linalg.norm(there - here) < 6.0:
            for down in (0.1, 0.5, 0.9):
                add.mesh.start("fence wire")
                ends = np.stack([here, there]) - [0.0, 0.0, down]
                add.mesh.tube(ends, (0.006, 0.006), 3, Material.FENCE, 0.4)


def add_guardrail(add: Furnisher, start_m: float, end_m: float, offset_m: float) -> None:
    """W-beam on short posts."""
    stations = np.arange(start_m, end_m + 0.1, 2.0)
    add.guardrails.append(np.array([add.place(station, offset_m) for station in stations]))
    outward = math.copysign(1.0, offset_m)
    levels = [(0.42, 0.0), (0.5, -0.08), (0.585, -0.01), (0.67, -0.08), (0.75, 0.0)]
    rows = []
    for station in stations:
        feet = add.place(station, offset_m)
        rows.append(
            [
                [*add.ground.line.plan(station, offset_m + outward * o), feet[2] + z]
                for z, o in levels
            ]
        )
        if int(station - start_m) % 4 == 0:
            add.mesh.start("guardrail post")
            place = raised(add.place(station, offset_m + outward * 0.14), 0.2)
            add.mesh.box(place, [0.08, 0.08, 0.6], add.heading(station), Material.FENCE, 0.5)
    add.mesh.start("guardrail")
    k, n = len(levels), len(stations)
    a = (np.arange(n - 1)[:, None] * k + np.arange(k - 1)).ravel()
    faces = np.concatenate(
        [np.column_stack([a, a + 1, a + k]), np.column_stack([a + 1, a + k + 1, a + k])]
    )
    add.mesh.add(np.reshape(rows, (-1, 3)), faces, Material.RAIL)
