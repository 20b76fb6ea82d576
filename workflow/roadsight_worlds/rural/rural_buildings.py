"""Houses, mailboxes and parked vehicles of the rural site."""

from __future__ import annotations

import math

import numpy as np

from roadsight.base.arrays import Floats
from roadsight_worlds.rural.rural_furniture import Furnisher
from roadsight_worlds.rural.rural_ground import Branch
from roadsight_worlds.rural.rural_materials import Material
from roadsight_worlds.rural.rural_mesh import raised, turned

_OVERHANG_M = 0.4  # Of a roof over its walls.


def add_house(add: Furnisher, branch: Branch) -> Floats:
    """House beside the end of a driveway; returns its plan place (2,)."""
    rng = add.rng
    along, aside = branch.length_m - 4.0, rng.choice([-1.0, 1.0]) * rng.uniform(8.0, 10.0)
    ax, ay = branch.ahead
    xy = branch.start_m + along * branch.ahead + aside * np.array([-ay, ax])
    station, offset = add.ground.line.road(xy)[0]
    floor = float(add.ground.height(station, offset)) + 0.3
    heading = math.atan2(ay, ax) + 0.5 * math.pi
    half = np.array([rng.uniform(5.5, 7.5), rng.uniform(3.8, 4.8)])
    wall = rng.uniform(2.7, 3.4)
    add.mesh.start("house")
    tint = rng.uniform()
    place = np.array([*xy, floor])
    add.mesh.box(
        raised(place, 0.5 * wall - 1.0), [*half, 0.5 * wall + 1.0], heading, Material.WALL, tint
    )
    eaves = half + _OVERHANG_M
    corners = np.column_stack([eaves * [[-1, -1], [1, -1], [1, 1], [-1, 1]], np.zeros(4)])
    add.buildings.append(turned(corners, heading, raised(place, wall)))
    # Gable roof with its overhang.
    x, y = eaves
    rise = 0.55 * y
    gable = [[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0], [-x, 0, rise], [x, 0, rise]]
    outer = turned(np.array(gable) - [0.0, 0.0, 0.1], heading, raised(place, wall))
    add.mesh.add(outer, [[0, 1, 5], [0, 5, 4], [2, 3, 4], [2, 4, 5]], Material.ROOF, tint)
    inner = np.array(gable) * [half[0] / x, 1.0, 1.0] - [0.0, 0.0, 0.12]
    inner = turned(inner, heading, raised(place, wall))
    add.mesh.add(inner, [[0, 4, 3], [1, 2, 5]], Material.WALL, tint)
    _windows(add, place, half, heading)
    return xy


def _windows(add: Furnisher, place: Floats, half: Floats, heading: float) -> None:
    """Windows on all four walls, a door on the long ones."""
    for turn, reach, width in ((0, half[1], half[0]), (1, half[0], half[1])):
        for face in (0.0, math.pi):
            way = heading + face + turn * 0.5 * math.pi
            for number, x in enumerate(np.linspace(-0.65, 0.65, 4 if turn == 0 else 2) * width):
                door = turn == 0 and number == 1
                low, high = (0.0, 2.05) if door else (0.95, 2.1)
                pane = [
                    [x - 0.5, -reach - 0.03, low],
                    [x + 0.5, -reach - 0.03, low],
                    [x + 0.5, -reach - 0.03, high],
                    [x - 0.5, -reach - 0.03, high],
                ]
                add.mesh.quad(turned(pane, way, place), Material.WINDOW, 0.9 if door else 0.2)


def add_mailbox(add: Furnisher, branch: Branch) -> None:
    """Mailbox on a short post beside a driveway's mouth."""
    station = branch.station_m + branch.half_m + branch.radius_m + 0.8
    offset = add.ground.section.beside(branch.side * 4.6)
    foot = add.listed("mailbox", station, offset, 1.05, 0.05)
    add.mesh.start("mailbox")
    heading = add.heading(station)
    add.mesh.post(foot, 1.05, (0.05, 0.05), 6, Material.FENCE, 0.5)
    add.mesh.box(raised(foot, 1.15), [0.1, 0.25, 0.12], heading, Material.FENCE, 0.9)


def add_vehicle(add: Furnisher, station_m: float, offset_m: float, turn_rad: float) -> None:
    """Parked car: body, cabin, four wheels."""
    place = add.place(station_m, offset_m)
    heading = add.heading(station_m) + turn_rad
    tint = add.rng.uniform()
    add.mesh.start("vehicle")
    profile = [
        (-2.25, 0.32),
        (2.25, 0.32),
        (2.3, 0.6),
        (2.1, 0.82),
        (1.0, 0.95),
        (-1.9, 1.0),
        (-2.3, 0.85),
    ]
    _extruded(add, profile, 0.88, place, heading, Material.PAINT, tint)
    cabin = [(0.95, 0.94), (0.25, 1.46), (-1.2, 1.5), (-1.85, 0.98)]
    _extruded(add, cabin, 0.76, place, heading, Material.GLASS, tint)
    roof = [(0.3, 1.45), (0.2, 1.5), (-1.15, 1.54), (-1.25, 1.49)]
    _extruded(add, roof, 0.74, place, heading, Material.PAINT, tint)
    for x in (-1.4, 1.4):
        for y in (-0.8, 0.8):
            ends = turned([[x, y - 0.11, 0.33], [x, y + 0.11, 0.33]], heading, place)
            add.mesh.tube(ends, (0.33, 0.33), 14, Material.TYRE, 0.5)
            add.mesh.tube(ends[::-1], (0.33, 0.33), 14, Material.TYRE, 0.5)


def _extruded(
    add: Furnisher,
    profile: list[tuple[float, float]],
    half_m: float,
    place: Floats,
    heading: float,
    material: int,
    tint: float,
) -> None:
    """Body whose side view is a convex ``profile`` of (x, z), ``half_m`` to both sides."""
    n = len(profile)
    corners = [[x, y, z] for y in (-half_m, half_m) for x, z in profile]
    side = [[0, i, i + 1] for i in range(1, n - 1)]
    faces = side + [[a + n, b + n, c + n] for a, b, c in side]
    for i in range(n):
        j = (i + 1) % n
        faces += [[i, j, j + n], [i, j + n, i + n]]
    add.mesh.add(turned(corners, heading, place), faces, material, tint)
