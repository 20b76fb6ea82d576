"""Trees and bushes of the sample: crowns of many leaf clumps, so that rays get in between."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Floats
from roadsight_worlds.casting.materials import TruthClass
from roadsight_worlds.highway.furniture import BUILDING_OFFSET_M, BUILDING_SHARE
from roadsight_worlds.highway.roadside import Roadside

_TREES_PER_M = 0.24  # Tried places by length of road; those too near to something else stay empty.
_BUSHES_PER_M = 0.36  # As of trees.
_KEEP_OFF_M = 6.0  # Between a tree and anything else, about the width of a crown.


def add_vegetation(road: Roadside, open_m: float, rng: np.random.Generator) -> None:
    """Plant both slopes along the open road; every plant keeps off the poles and off the others."""
    taken = [(pole.station_m, pole.offset_m) for pole in road.poles]
    taken.append((BUILDING_SHARE * open_m, BUILDING_OFFSET_M))
    for plant, per_m, gap_m in ((_tree, _TREES_PER_M, _KEEP_OFF_M), (_bush, _BUSHES_PER_M, 2.0)):
        for _ in range(round(per_m * open_m)):
            side = rng.choice([-1.0, 1.0])
            at = rng.uniform(2.0, open_m - 4.0), side * rng.uniform(16.0, 40.0)
            if all(np.hypot(at[0] - s, at[1] - o) > gap_m for s, o in taken):
                taken.append(at)
                plant(road, at, rng)


def _tree(road: Roadside, at: tuple[float, float], rng: np.random.Generator) -> None:
    """Trunk and an egg-shaped crown of leaf clumps."""
    height = rng.uniform(5.5, 10.5)
    trunk = road.new("trunk", "wood", TruthClass.HIGH_VEGETATION)
    ground = road.post(trunk, *at, 0.55 * height, 0.018 * height)
    crown = road.new("tree", "leaves", TruthClass.HIGH_VEGETATION)
    x, y, _ = road.point(*at)
    middle = np.array([x, y, ground + 0.66 * height])
    half = height * np.array([0.24, 0.24, 0.33])
    _leaves(road, crown, middle, half, round(12.0 * height), (0.14, 0.42), rng)


def _bush(road: Roadside, at: tuple[float, float], rng: np.random.Generator) -> None:
    """Low round bush without a trunk."""
    bush = road.new("bush", "leaves", TruthClass.LOW_VEGETATION)
    size = rng.uniform(0.5, 1.1)
    x, y, ground = road.point(*at)
    middle = np.array([x, y, ground + 0.6 * size])
    _leaves(road, bush, middle, size * np.array([1.0, 1.0, 0.7]), 24, (0.08, 0.25), rng)


def _leaves(
    road: Roadside,
    object_id: int,
    middle: Floats,
    half: Floats,
    count: int,
    radii_m: tuple[float, float],
    rng: np.random.Generator,
) -> None:
    """Fill an ellipsoid with clumps, denser towards its shell as light makes real crowns."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    depth = rng.uniform(0.15, 1.0, (count, 1)) ** 0.5
    size = rng.uniform(*radii_m, (count, 1)) * rng.uniform(0.6, 1.0, (count, 3))
    road.clumps(object_id, middle + direction * depth * half, size)
