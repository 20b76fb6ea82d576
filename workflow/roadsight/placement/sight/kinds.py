"""What targets are: their shapes and usual sizes, and the room that one takes.

Each list of jobs asks for them, so that nothing here loads what looks at them (`shapes`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Packed = tuple[int, float, float, float]
CYLINDER, BOX = 0, 1  # numbers of the shapes, by which kernels know them
# Rooms are whole steps, so that a target that grows a little needs no other beams. Targets stand a
# metre apart: half a metre about each is the road itself.
_RADIUS_STEP_M, _HEIGHT_STEP_M = 0.5, 1.0


@dataclass(frozen=True)
class Cylinder:
    """An upright, solid, capped cylinder.

    Parameters
    ----------
    radius_m, height_m : its size.
    """

    radius_m: float
    height_m: float

    @property
    def packed(self) -> Packed:
        """Number of the shape and its size."""
        return CYLINDER, float(self.radius_m), float(self.radius_m), float(self.height_m)

    @property
    def mean_width_m(self) -> float:
        """Width that one sees from the side."""
        return 2 * self.radius_m


@dataclass(frozen=True)
class Box:
    """An upright, solid box.

    Parameters
    ----------
    length_m, width_m, height_m : its size; the length lies along its heading.
    """

    length_m: float
    width_m: float
    height_m: float

    @property
    def packed(self) -> Packed:
        """Number of the shape and its size."""
        return BOX, float(self.length_m), float(self.width_m), float(self.height_m)

    @property
    def mean_width_m(self) -> float:
        """Width that one sees from the side, the mean over all headings.

        Of any convex outline it is the perimeter over pi (Cauchy), as of a circle.
        """
        return float(2 * (self.length_m + self.width_m) / np.pi)


Shape = Cylinder | Box
# Usual boxes. Car: AASHTO Green Book (2018), design vehicle P, with the height of cars in passing
# sight; truck: its design vehicle SU-30, 30 ft long, 8 ft wide, 11 ft high. Pedestrian and deer (a
# white-tailed doe to its back) are round figures of ours.
KINDS = {
    "pedestrian": Box(0.5, 0.5, 1.7),
    "car": Box(5.79, 2.13, 1.30),
    "truck": Box(9.14, 2.44, 3.35),
    "deer": Box(1.6, 0.45, 1.0),
}


def shape_of(targets: Mapping[str, Any]) -> Shape:
    """The shape that settings of targets ask for.

    Parameters
    ----------
    targets : section ``targets`` of the settings: kind, radius_m, height_m, length_m, width_m.
    """
    if targets["kind"] == "cylinder":
        return Cylinder(targets["radius_m"], targets["height_m"])
    if targets["kind"] == "box":
        return Box(targets["length_m"], targets["width_m"], targets["height_m"])
    return KINDS[targets["kind"]]


def room_for(shape: Shape) -> tuple[float, float]:
    """Radius and height of an upright cylinder that holds a target, m, in whole steps."""
    around_m = shape.mean_width_m / 2
    if isinstance(shape, Box):
        around_m = float(np.hypot(shape.length_m, shape.width_m) / 2)
    return (
        float(np.ceil(around_m / _RADIUS_STEP_M) * _RADIUS_STEP_M),
        float(np.ceil(shape.height_m / _HEIGHT_STEP_M) * _HEIGHT_STEP_M),
    )
