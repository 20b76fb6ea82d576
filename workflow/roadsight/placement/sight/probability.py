"""How likely a detector finds a target by the points that it has of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats, Numbers
from roadsight.placement.sensors.sensors import AnySensor, Camera, Rosette, Sensor

# Logarithm of the most points that are asked for; a flat curve would ask for more than a number
# holds.
_MOST_LOG = np.log(1e9)


@dataclass(frozen=True)
class Curve:
    """p = a ln(n) + b within 0 and 1, for n points or pixels on a target; none are never found.

    The form, and the numbers in the default settings, are those of Ma, Liu, Li, "Perception
    Entropy" (arXiv 2104.06615, 2021), who fitted average precision of detectors
    (docs/placement/targets.md).

    Parameters
    ----------
    slope, offset : a, greater than 0, and b.
    """

    slope: float
    offset: float

    def probability(self, number: ArrayLike) -> Floats:
        """Probability by the number of points or pixels; of any shape."""
        number = np.asarray(number, np.float64)
        some = number > 0
        raw = self.slope * np.log(np.where(some, number, 1.0)) + self.offset
        return np.where(some, np.clip(raw, 0.0, 1.0), 0.0)

    def needed(self, probability: float) -> int:
        """The fewest points or pixels, at least 1, that give a probability in (0, 1]."""
        rough = np.exp(min((probability - self.offset) / self.slope, _MOST_LOG))
        number = max(int(np.ceil(rough)), 1)
        # Rounding of the exponential must not cost or give a point.
        while number > 1 and self.probability(number - 1) >= probability:
            number -= 1
        return number if self.probability(number) >= probability else number + 1


@dataclass(frozen=True)
class Curves:
    """Curves by what a sensor measures.

    Parameters
    ----------
    lidar : by points. camera : by pixels.
    """

    lidar: Curve
    camera: Curve

    def of(self, sensor: AnySensor) -> Curve | None:
        """The curve of a sensor; None for radars, which measure neither."""
        if isinstance(sensor, Camera):
            return self.camera
        return self.lidar if isinstance(sensor, Sensor | Rosette) else None


def found_by_plan(hits: Numbers, curves: list[Curve | None]) -> dict[str, Any] | None:
    """How likely the targets that a plan sees are found; None where no sensor has a curve.

    Parameters
    ----------
    hits : (sensors, targets) points or pixels, 0 where a sensor does not see a target.

    Returns
    -------
    targets (that a sensor with a curve sees); least and mean of them by their best sensor; and
    independent: the same by all sensors, if they miss independently of each other
    """
    known = [k for k, curve in enumerate(curves) if curve is not None]
    if not known:
        return None
    share = np.stack([curves[k].probability(hits[k]) for k in known])  # type: ignore[union-attr]
    share = share[:, (hits[known] > 0).any(axis=0)]
    best, together = share.max(axis=0), 1 - np.prod(1 - share, axis=0)
    if not len(best):
        return {"targets": 0}
    return {
        "targets": len(best),
        "least": float(best.min()),
        "mean": float(best.mean()),
        "independent": {"least": float(together.min()), "mean": float(together.mean())},
    }
