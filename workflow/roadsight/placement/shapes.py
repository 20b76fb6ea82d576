"""Shapes of targets, as kernels take them; what looks at them is another matter.

A shape stands on its foot, (3,) relative to the sensor, in the local frame. A kernel knows it by
its `packed` numbers and asks `entered_at` where a ray enters it and `footprint_share` how much of a
wide beam lies on it; a further shape is a further number there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from roadsight.placement.detection import chord
from roadsight.placement.footprints import overlap, slopes_into
from roadsight.placement.mounted import entry_range_m

_FLOATS = NDArray[np.float64]
Packed = tuple[int, float, float]

CYLINDER = 0


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
        return CYLINDER, float(self.radius_m), float(self.height_m)


@njit(cache=True)
def ball_around(shape: Packed) -> tuple[float, float]:
    """Height of the middle of a ball about a shape, and its radius."""
    _, radius_m, height_m = shape
    return height_m / 2, np.sqrt(radius_m**2 + height_m**2 / 4)


@njit(cache=True)
def entered_at(shape: Packed, foot: _FLOATS, ray: tuple[float, float, float]) -> float:
    """Range at which a ray from the origin along a unit vector enters a shape; 0 if it does not."""
    _, radius_m, height_m = shape
    return entry_range_m(ray, foot, radius_m, height_m)


@njit(cache=True)
def footprint_share(
    shape: Packed,
    foot: _FLOATS,
    ray: tuple[float, float, float],
    range_m: float,
    beam: tuple[float, float, float],
) -> float:
    """Share of a beam's footprint that lies on a shape which its axis enters at a range.

    The footprint is a rectangle, level and upright, and so is the silhouette that the beam's own
    azimuth and elevation see (as in `count_shared_hits`).

    Parameters
    ----------
    beam : divergence across and upright, rad, and aperture, m.
    """
    _, radius_m, height_m = shape
    flat = np.sqrt(ray[0] * ray[0] + ray[1] * ray[1])
    if flat < 1e-9:
        return 1.0
    cosine, sine, slope = ray[0] / flat, ray[1] / flat, ray[2] / flat
    near, far = chord(foot[0], foot[1], cosine, sine, radius_m)
    if far <= 0.0:
        return 0.0
    beside = foot[0] * sine - foot[1] * cosine
    share = overlap(beside, beam[2] + beam[0] * range_m, -radius_m, radius_m)
    tall = (beam[2] / range_m + beam[1]) * (1 + slope * slope)
    low, high = slopes_into((near, far, foot[2], foot[2] + height_m))
    return share * overlap(slope, tall, low, high)
