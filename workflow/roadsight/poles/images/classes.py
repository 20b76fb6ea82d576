"""Classes of mask pixels, whatever the network's own labels are."""

from __future__ import annotations

from enum import IntEnum


class PixelClass(IntEnum):
    """What a pixel shows."""

    OTHER = 0
    ROAD = 1
    MARKING = 2
    KERB = 3
    POLE = 4
    SIGN = 5
    VEGETATION = 6
    BUILDING = 7
    VEHICLE = 8
    SKY = 9
    GUARDRAIL = 10
    TREE = 11
    WIRE = 12
