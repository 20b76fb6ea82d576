"""How much the images of a drive differ from its mean, from the images themselves.

A smooth road and a stiff vehicle leave a camera's height and roll almost as they are, a worn road
does not. What images may differ by decides how much each of them can lean on the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roadsight.poles.alignment.pose import HEIGHT, INSETS, PITCH, ROLL, YAW, Spread
from roadsight.poles.alignment.solve import Fit
from roadsight.poles.calibration.calibration import Mount

_NUMBERS = {
    "height_m": [HEIGHT],
    "yaw_deg": [YAW],
    "pitch_deg": [PITCH],
    "roll_deg": [ROLL],
    "lane_inset_m": [INSETS, INSETS + 1],
    "border_inset_m": [INSETS + 2, INSETS + 3],
}
"""Unknowns that share a value of `Spread`, by its name: those that are estimated."""
_LEAST = {
    "height_m": 0.01,
    "yaw_deg": 0.05,
    "pitch_deg": 0.05,
    "roll_deg": 0.05,
    "lane_inset_m": 0.01,
    "border_inset_m": 0.01,
}
"""Least spread of each, metres and degrees: with none, images could not differ at all."""
_STEPS = 30
"""Steps of expectation maximisation."""
_KNOWN_IMAGES = 10.0
"""How many images the expected spread counts as."""
_FAR = 4.0
"""An image further from the mean than this, in standard deviations, does not widen the spread."""


def estimated_spread(fits: Sequence[Fit], mount: Mount, expected: Spread) -> Spread:
    """Spread under which the images are likeliest, by expectation maximisation.

    variance = mean over the images of (posterior deviation from the mean)^2 + posterior variance,
    repeated until it stays (Dempster, Laird and Rubin 1977). What no image tells keeps the
    expected value, which counts as much as ten images. The place on the road is left out: its error
    is the track's.

    Parameters
    ----------
    fits : of the images. expected : the spread of any drive.
    """
    normal = np.stack([fit.normal for fit in fits])
    towards = np.stack([fit.normal @ (fit.unknowns - mount.mean) - fit.gradient for fit in fits])
    before = expected.vector() ** 2
    variance = before.copy()
    for _ in range(_STEPS):
        covariance = np.linalg.inv(normal + np.diag(1.0 / variance))
        apart = np.einsum("nij,nj->ni", covariance, towards)
        usual = apart**2 <= _FAR**2 * variance
        second = np.where(usual, apart**2 + np.diagonal(covariance, axis1=1, axis2=2), 0.0)
        for numbers in _NUMBERS.values():
            total = second[:, numbers].sum() + _KNOWN_IMAGES * before[numbers].sum()
            count = usual[:, numbers].sum() + _KNOWN_IMAGES * len(numbers)
            variance[numbers] = total / count
    found = {
        name: max(float(np.sqrt(variance[numbers[0]])), _LEAST[name])
        for name, numbers in _NUMBERS.items()
    }
    return replace(expected, **found)
