"""Small scenes with one thing in them, for tests and side-by-side checks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roadsight.base.arrays import Floats
from roadsight_worlds.casting.alignment import Alignment
from roadsight_worlds.casting.materials import TruthClass
from roadsight_worlds.casting.primitives import BOX, CYLINDER, ELLIPSOID, RECTANGLE, TUBE
from roadsight_worlds.casting.scene import Scene, SceneBuilder, rotation_zyx
from roadsight_worlds.casting.terrain import Terrain


def plane_scene(size_m: float = 400.0, slope: float = 0.0) -> Scene:
    """A square of ``size_m`` through the origin that rises along x by ``slope``."""
    builder = SceneBuilder()
    ground = builder.add_object("ground", "asphalt", TruthClass.ROAD)
    half = 0.5 * size_m
    builder.add_body(
        ground, RECTANGLE, [0, 0, 0], [half, half, 0], rotation_zyx(0.0, np.arctan(slope))
    )
    return builder.build(cell_m=4.0)


def _furnished(
    kind: int,
    centre_m: Sequence[float],
    half_m: Sequence[float],
    rotation: Floats | None,
    name: str,
) -> Scene:
    """One body on a horizontal plane at z = 0."""
    builder = SceneBuilder()
    ground = builder.add_object("ground", "asphalt", TruthClass.ROAD)
    builder.add_body(ground, RECTANGLE, [0, 0, 0], [200, 200, 0])
    thing = builder.add_object(name, "concrete", TruthClass.STRUCTURE)
    builder.add_body(thing, kind, centre_m, half_m, rotation)
    return builder.build()


def wall_scene(distance_m: float = 20.0, height_m: float = 5.0, width_m: float = 40.0) -> Scene:
    """A plane and, square to x at ``distance_m``, an upright wall without thickness."""
    upright = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    half = [0.5 * width_m, 0.5 * height_m, 0.0]
    return _furnished(RECTANGLE, [distance_m, 0, 0.5 * height_m], half, upright, "wall")


def box_scene(
    centre_m: Sequence[float] = (12.0, 3.0, 1.0),
    size_m: Sequence[float] = (4.0, 2.0, 2.0),
    yaw_deg: float = 30.0,
) -> Scene:
    """A plane and a box turned about the vertical."""
    half = [0.5 * size for size in size_m]
    return _furnished(BOX, centre_m, half, rotation_zyx(np.radians(yaw_deg)), "box")


def cylinder_scene(
    x_m: float = 10.0, y_m: float = 0.0, radius_m: float = 0.25, height_m: float = 6.0
) -> Scene:
    """A plane and an upright cylinder with caps, standing on it."""
    half = [radius_m, radius_m, 0.5 * height_m]
    return _furnished(CYLINDER, [x_m, y_m, 0.5 * height_m], half, None, "pole")


def ellipsoid_scene(
    centre_m: Sequence[float] = (10.0, 0.0, 4.0), half_m: Sequence[float] = (2.0, 1.5, 3.0)
) -> Scene:
    """A plane and an upright ellipsoid."""
    return _furnished(ELLIPSOID, centre_m, half_m, None, "crown")


def tunnel_scene(length_m: float = 60.0, radius_m: float = 6.0) -> Scene:
    """A half-pipe along x, centred on the origin: a horizontal tube cut by the plane."""
    along_x = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    half = [radius_m, radius_m, 0.5 * length_m]
    return _furnished(TUBE, [0, 0, 0], half, along_x, "tunnel")


def hill_scene(height_m: float = 6.0, width_m: float = 20.0, size_m: float = 160.0) -> Scene:
    """Smooth ground around the origin with one bell-shaped hill."""
    step = 1.0
    node = np.arange(-0.5 * size_m - 2 * step, 0.5 * size_m + 3 * step, step)
    squared = node[:, None] ** 2 + node[None, :] ** 2
    half = 0.5 * size_m
    terrain = Terrain(
        Alignment(0.0, 0.0, 1.0, 0.0, 0.0),
        0.0,
        0.0,
        np.array([-half, half]),
        np.zeros(2),
        height_m * np.exp(-0.5 * squared / width_m**2),
        float(node[0]),
        float(node[0]),
        step,
        step,
        -half,
        half,
        -half,
        half,
        0,
    )
    builder = SceneBuilder()
    builder.add_ground(terrain, "grass")
    return builder.build()
