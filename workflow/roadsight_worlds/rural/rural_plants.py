"""Trees and bushes of the rural site: crowns of many small leaf triangles."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from roadsight.base.arrays import Floats
from roadsight_worlds.rural.rural_furniture import Furnisher
from roadsight_worlds.rural.rural_materials import Material

# Tried places by length of road; those on open land or too near to something else stay empty.
_TREES_PER_M = 1.15
_BUSHES_PER_M = 0.9  # As of trees.
# Farthest offset, leaves of a tree 10 m high, their size in metres.
_DETAIL = ((17.0, 3600, 0.26), (34.0, 1400, 0.42), (math.inf, 480, 0.8))


def add_plants(add: Furnisher, houses: list[Floats], detail: float = 1.0) -> None:
    """Trees in groves, pasture between them, bushes along the ditch."""
    rng, line = add.rng, add.ground.line
    first, last = line.station_m[0] + 3.0, line.station_m[-1] - 3.0
    grove = _groves(first, last, rng)
    poles = [p.xyz_m[:2] for p in add.poles if p.kind == "utility"]
    places = round(_TREES_PER_M * (last - first))
    taken = np.full((len(poles) + places, 2), np.inf)
    taken[: len(poles)] = np.reshape(poles, (-1, 2))
    for number in range(len(poles), len(taken)):
        side = rng.choice([-1.0, 1.0])
        station = rng.uniform(first, last)
        offset = add.ground.section.beside(side * (10.0 + 92.0 * rng.uniform() ** 1.6))
        if not grove(station, offset, side) or not add.free(station, offset, 3.0):
            continue
        xy = line.plan(station, offset)
        near_house = any(np.hypot(*(xy - h)) < 13.0 for h in houses)
        if near_house or (np.hypot(*(xy - taken[:number]).T) < 2.6).any():
            continue
        taken[number] = xy
        _tree(add, station, offset, detail)
    for _ in range(round(_BUSHES_PER_M * (last - first))):
        station = rng.uniform(first, last)
        side = rng.choice([-1.0, 1.0])
        offset = add.ground.section.beside(side * (8.8 + 30.0 * rng.uniform() ** 1.5))
        if add.free(station, offset, 1.5):
            _bush(add, station, offset, detail)


def _groves(
    first: float, last: float, rng: np.random.Generator
) -> Callable[[float, float, float], bool]:
    """Where trees stand: by side, stretches of wood with an edge of its own, and open land."""
    breaks = np.arange(first, last + 60.0, 55.0)
    edge = rng.choice([10.0, 14.0, 22.0, 45.0, 70.0], (2, len(breaks)), p=[0.3, 0.2, 0.2, 0.2, 0.1])
    lone = rng.uniform(size=4096) < 0.06
    count = iter(range(10**9))

    def wooded(station: float, offset: float, side: float) -> bool:
        start = np.interp(station, breaks, edge[int(side > 0)])
        return bool(abs(offset) >= start or lone[next(count) % len(lone)])

    return wooded


def _tree(add: Furnisher, station: float, offset: float, detail: float) -> None:
    """Broad-leaved tree or conifer."""
    rng = add.rng
    height = rng.uniform(6.0, 17.0)
    radius = 0.014 * height + 0.03
    foot = add.listed("tree", station, offset, height, radius)
    conifer = rng.uniform() < 0.3
    add.mesh.start("tree")
    trunk = (0.3 if not conifer else 0.7) * height
    add.mesh.post(
        foot, trunk + 0.2 * height, (radius, 0.4 * radius), 7, Material.BARK, rng.uniform()
    )
    count, size = next((n, m) for far, n, m in _DETAIL if abs(offset) <= far)
    count = round(detail * count * (height / 10.0) ** 1.3)
    if conifer:
        middle, outward = _cone(count, height, rng)
    else:
        middle, outward = _crown(count, height, rng)
    tint = np.clip(rng.uniform() + rng.normal(0.0, 0.07, count), 0.0, 1.0)
    if conifer:
        tint *= 0.25
    _leaves(add, foot + middle, outward, size / math.sqrt(detail), tint, Material.LEAVES)


def _crown(count: int, height: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Leaf places and outward directions (n, 3): a few big lobes around a tall ellipsoid."""
    lobes = 14
    way = rng.normal(size=(lobes, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    reach = height * np.array([0.22, 0.22, 0.27])
    centre = way * reach * rng.uniform(0.5, 1.0, (lobes, 1)) + [0.0, 0.0, 0.58 * height]
    lobe = rng.integers(0, lobes, count)
    out = rng.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    depth = rng.uniform(0.25, 1.0, (count, 1)) ** 0.4
    middle = centre[lobe] + out * depth * height * np.array([0.15, 0.15, 0.13])
    from_axis = (middle - [0.0, 0.0, 0.55 * height]) / reach
    outward = 0.6 * out + 0.4 * from_axis / np.linalg.norm(from_axis, axis=1, keepdims=True)
    return middle, outward


def _cone(count: int, height: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Leaf places and outward directions (n, 3) of a conifer with whorls."""
    up = 1.0 - np.sqrt(rng.uniform(0.0, 1.0, count))
    up = np.round(up * 14.0) / 14.0 + rng.normal(0.0, 0.012, count)
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    out = np.sqrt(rng.uniform(0.05, 1.0, count)) * (1.0 - up) * 0.2 * height
    z = (0.12 + 0.88 * up) * height - 0.25 * out
    way = np.column_stack([np.cos(angle), np.sin(angle), np.full(count, 0.45)])
    return np.column_stack([way[:, :2] * out[:, None], z]), way


def _bush(add: Furnisher, station: float, offset: float, detail: float) -> None:
    """Low round bush or tall weeds."""
    rng = add.rng
    size = rng.uniform(0.35, 1.2)
    foot = add.place(station, offset)
    count = round(detail * 330 * size)
    out = rng.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    middle = out * rng.uniform(0.3, 1.0, (count, 1)) ** 0.5 * size * np.array([1.0, 1.0, 0.75])
    middle += [0.0, 0.0, 0.5 * size]
    tint = np.clip(rng.uniform() + rng.normal(0.0, 0.08, count), 0.0, 1.0)
    add.mesh.start("bush")
    _leaves(add, foot + middle, out, 0.17 / math.sqrt(detail), tint, Material.BUSH)


def _leaves(
    add: Furnisher, middle: Floats, outward: Floats, size: float, tint: Floats, material: int
) -> None:
    """One triangle of any attitude for each leaf clump, lit by where it is in the crown."""
    rng = add.rng
    count = len(middle)
    corners = middle[:, None] + rng.normal(0.0, 0.55 * size, (count, 3, 3))
    normal = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    normal = normal + rng.normal(0.0, 0.3, normal.shape)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    faces = np.arange(3 * count).reshape(-1, 3)
    add.mesh.add(corners.reshape(-1, 3), faces, material, tint, normal)
