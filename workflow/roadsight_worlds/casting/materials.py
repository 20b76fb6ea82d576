"""What surfaces are made of and which truth class their points have."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class TruthClass(IntEnum):
    """True class of a synthetic point: ASPRS codes, and user codes from 64 for what ASPRS lacks."""

    GROUND = 2
    LOW_VEGETATION = 3
    HIGH_VEGETATION = 5
    STRUCTURE = 6
    LOW_NOISE = 7
    ROAD = 11
    HIGH_NOISE = 18
    POLE = 64
    BARRIER = 65
    VEHICLE = 66


@dataclass(frozen=True)
class Material:
    """How a surface answers a laser.

    Parameters
    ----------
    reflectance : share of the light that returns at right angles.
    roughness_m : sigma of the range noise that the surface itself adds.
    """

    reflectance: float
    roughness_m: float


# By name; arrays by material have their rows in this order.
MATERIALS = {
    "asphalt": Material(0.12, 0.0),
    "marking": Material(0.65, 0.0),
    "soil": Material(0.28, 0.010),
    "grass": Material(0.45, 0.020),
    "concrete": Material(0.35, 0.002),
    "steel": Material(0.50, 0.001),
    "sign": Material(0.95, 0.0),
    "paint": Material(0.30, 0.0),
    "wood": Material(0.30, 0.003),
    "leaves": Material(0.55, 0.030),
}
MATERIAL_NAMES = tuple(MATERIALS)
