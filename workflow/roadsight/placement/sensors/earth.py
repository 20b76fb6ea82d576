"""Curvature of the Earth and refraction of the air along a beam."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats

EARTH_RADIUS_M = 6_371_000.0
"""Mean radius (IUGG)."""

REFRACTION = 0.13
"""Coefficient of refraction, Gauss' mean value of geodetic practice."""


def rise_m(distance_m: ArrayLike) -> Floats:
    """How far a level beam has risen above the level surface through its start.

    d^2 (1 - k) / (2 R): the Earth curves away below it and refraction bends it back by a part k.

    Parameters
    ----------
    distance_m : horizontal distance, any shape.
    """
    distance = np.asarray(distance_m, np.float64)
    return np.asarray((1 - REFRACTION) * distance**2 / (2 * EARTH_RADIUS_M))
