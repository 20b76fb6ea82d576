"""Whether a dense alignment can be trusted, and if not, why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from roadsight.poles.alignment.dense import DenseFit, DenseTask
from roadsight.poles.alignment.pose import YAW
from roadsight.poles.alignment.verdict import Limits

TOO_LITTLE = "too little of the cloud is in view"
UNHELD = "the image does not hold the pose: its uncertainty is not finite"
AT_BOUND = "the pose is at the bound of the search"
NO_LEAD = "the best pose fits hardly better than random ones: image and cloud may be of two places"
AMBIGUOUS = "ambiguous: two poses fit about as well"
VAGUE_HEADING = "the heading is too uncertain"
VAGUE_PLACE = "the place across the road is too uncertain"


@dataclass(frozen=True)
class DenseLimits:
    """Bounds of what is accepted.

    Parameters
    ----------
    samples : of the cloud in view. bound : offset in expected standard deviations beyond which a
        pose lies outside what was searched. second : by how much more another pose must cost
        (log-likelihood); below 6 wrong poses of the five streets pass.
        lead : log-likelihood ratio beyond the best of many random poses: at right poses of five
        streets 8.7 to 37, at wrong ones and with images of other streets up to 7.0 (100 fits).
    sigma_heading_deg, sigma_lateral_m : one standard deviation.
    """

    samples: int = 300
    bound: float = 4.0
    second: float = 6.0
    lead: float = 8.0
    sigma_heading_deg: float = Limits.sigma_heading_deg
    sigma_lateral_m: float = Limits.sigma_lateral_m

    @classmethod
    def of(cls, limits: Limits) -> DenseLimits:
        """The same bounds of what a pose may be uncertain by."""
        return cls(
            sigma_heading_deg=limits.sigma_heading_deg, sigma_lateral_m=limits.sigma_lateral_m
        )


def dense_doubt(task: DenseTask, fit: DenseFit, limits: DenseLimits) -> str:
    """Why a fit cannot be trusted, or "" if it can."""
    with np.errstate(invalid="ignore"):
        sigma = fit.sigma
    doubts = (
        (fit.samples < limits.samples, TOO_LITTLE),
        (not (np.isfinite(sigma).all() and np.isfinite(fit.offsets).all()), UNHELD),
        (bool((np.abs(fit.offsets) >= limits.bound * task.sigma).any()), AT_BOUND),
        (fit.lead < limits.lead, NO_LEAD),
        (fit.second < limits.second, AMBIGUOUS),
        (sigma[YAW] > limits.sigma_heading_deg, VAGUE_HEADING),
        (sigma[1] > limits.sigma_lateral_m, VAGUE_PLACE),
    )
    return next((reason for doubtful, reason in doubts if doubtful), "")


def lost_views(reasons: Iterable[str]) -> str:
    """What a drive loses, for people: how many of its views have no pose, and why."""
    counted = Counter(reasons)
    used, total = counted.pop("", 0), counted.total()
    why = "; ".join(f"{count} x {reason}" for reason, count in sorted(counted.items()))
    return f"{total} of {total + used} views are not used" + (f": {why}" if why else "")
