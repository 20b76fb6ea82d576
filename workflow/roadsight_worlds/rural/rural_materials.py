"""What the rural site's surfaces are: how they look, and their classes in images and clouds."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from roadsight.base.arrays import Bytes, Floats
from roadsight.poles.images.kinds import PixelClass


class Material(IntEnum):
    """Material of a triangle; `Ground` says more about those of GROUND."""

    GROUND = 0
    LEAVES = 1
    BARK = 2
    POLE_WOOD = 3
    WIRE = 4
    STEEL_POST = 5
    FENCE = 6
    SIGN_YELLOW = 7
    SIGN_WHITE = 8
    SIGN_RED = 9
    SIGN_BLACK = 10
    SIGN_BACK = 11
    WALL = 12
    ROOF = 13
    WINDOW = 14
    PAINT = 15
    GLASS = 16
    TYRE = 17
    RAIL = 18
    CONCRETE = 19
    DELINEATOR = 20
    FAR_FOREST = 21
    BUSH = 22
    SIGN_GREEN = 23
    FITTING = 24
    SIGN_PAINT = 25


class Ground(IntEnum):
    """What the ground is at a place."""

    GRASS = 0
    SHOULDER = 1
    ROAD = 2
    SIDE_ROAD = 3
    GRAVEL_DRIVE = 4
    PAVED_DRIVE = 5
    WHITE_LINE = 6
    YELLOW_LINE = 7
    BRIDGE = 8


_PIXEL = {
    Material.LEAVES: PixelClass.TREE,
    Material.BARK: PixelClass.TREE,
    Material.FAR_FOREST: PixelClass.TREE,
    Material.BUSH: PixelClass.VEGETATION,
    Material.POLE_WOOD: PixelClass.POLE,
    Material.FITTING: PixelClass.POLE,
    Material.STEEL_POST: PixelClass.POLE,
    Material.WIRE: PixelClass.WIRE,
    Material.WALL: PixelClass.BUILDING,
    Material.ROOF: PixelClass.BUILDING,
    Material.WINDOW: PixelClass.BUILDING,
    Material.PAINT: PixelClass.VEHICLE,
    Material.GLASS: PixelClass.VEHICLE,
    Material.TYRE: PixelClass.VEHICLE,
    Material.RAIL: PixelClass.GUARDRAIL,
} | {m: PixelClass.SIGN for m in Material if m.name.startswith("SIGN_")}
_GROUND_PIXEL = {
    Ground.GRASS: PixelClass.VEGETATION,
    Ground.SHOULDER: PixelClass.OTHER,
    Ground.GRAVEL_DRIVE: PixelClass.OTHER,
    Ground.WHITE_LINE: PixelClass.MARKING,
    Ground.YELLOW_LINE: PixelClass.MARKING,
}
_GROUND_CLOUD = {
    Ground.ROAD: 11,
    Ground.SIDE_ROAD: 11,
    Ground.WHITE_LINE: 11,
    Ground.YELLOW_LINE: 11,
    Ground.BRIDGE: 17,
}
_PLANTS = (Material.LEAVES, Material.BARK, Material.BUSH, Material.FAR_FOREST)
_POLES = (Material.POLE_WOOD, Material.WIRE, Material.FITTING)
_BUILDING = (Material.WALL, Material.ROOF, Material.WINDOW)
# Of the scanner's light; others have 0.35.
_REFLECTANCE = {
    Material.LEAVES: 0.42,
    Material.BUSH: 0.42,
    Material.BARK: 0.3,
    Material.FAR_FOREST: 0.42,
    Material.POLE_WOOD: 0.25,
    Material.WIRE: 0.15,
    Material.ROOF: 0.2,
    Material.PAINT: 0.4,
    Material.RAIL: 0.5,
    Material.TYRE: 0.05,
}
# Of the scanner's light.
_GROUND_REFLECTANCE = {
    Ground.GRASS: 0.45,
    Ground.SHOULDER: 0.3,
    Ground.ROAD: 0.12,
    Ground.SIDE_ROAD: 0.15,
    Ground.GRAVEL_DRIVE: 0.33,
    Ground.PAVED_DRIVE: 0.14,
    Ground.WHITE_LINE: 0.6,
    Ground.YELLOW_LINE: 0.5,
    Ground.BRIDGE: 0.2,
}
# Pixel class by `Material`; GROUND's comes from `PIXEL_OF_GROUND`.
PIXEL_OF_MATERIAL: Bytes = np.array([_PIXEL.get(m, PixelClass.OTHER) for m in Material], np.uint8)
# Pixel class by `Ground`; a paved driveway looks like road and is.
PIXEL_OF_GROUND: Bytes = np.array([_GROUND_PIXEL.get(g, PixelClass.ROAD) for g in Ground], np.uint8)
# ASPRS class by `Ground`; driveways are ground.
CLOUD_OF_GROUND: Bytes = np.array([_GROUND_CLOUD.get(g, 2) for g in Ground], np.uint8)
# ASPRS class by `Material`; 5 is vegetation of any height, with poles and wires in it.
CLOUD_OF_MATERIAL: Bytes = np.array(
    [5 if m in _PLANTS or m in _POLES else 6 if m in _BUILDING else 1 for m in Material], np.uint8
)
REFLECTANCE_OF_MATERIAL: Floats = np.array([_REFLECTANCE.get(m, 0.35) for m in Material])
REFLECTANCE_OF_GROUND: Floats = np.array([_GROUND_REFLECTANCE[g] for g in Ground])
