"""Classes of a cloud's points that matter here (ASPRS LAS 1.4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roadsight.base.arrays import Bools, Bytes

NEVER_CLASSIFIED = 0  # Created, never classified.
UNCLASSIFIED = 1  # Unclassified.
GROUND = 2  # Ground.
ROAD = 11  # Road surface.
BRIDGE = 17  # Bridge deck.
ROADS = (ROAD, BRIDGE)
WATER = 9
VEGETATION = (3, 4, 5)  # Low, medium and high vegetation.
# Common classes as people call them.
CLASS_NAMES = {
    0: "never classified",
    1: "unclassified",
    2: "ground",
    3: "low vegetation",
    4: "medium vegetation",
    5: "high vegetation",
    6: "building",
    9: "water",
    10: "rail",
    11: "road surface",
    14: "wire conductor",
    15: "transmission tower",
    17: "bridge deck",
}


def class_table(road_classes: Sequence[int], bridge_classes: Sequence[int]) -> Bytes:
    """Class (256,) that each class of a cloud stands for, road and bridge being 11 and 17.

    Points that were never classified (0) are unclassified (1): a cell of the top view whose class
    is 0 has no points.
    """
    table = np.arange(256, dtype=np.uint8)
    table[NEVER_CLASSIFIED] = UNCLASSIFIED
    table[list(bridge_classes)] = BRIDGE
    table[list(road_classes)] = ROAD
    return table


def is_road(cls: Bytes) -> Bools:
    """Whether classes, of any shape, are road or bridge."""
    return (cls == ROAD) | (cls == BRIDGE)
