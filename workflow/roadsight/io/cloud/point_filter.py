"""Which points of a cloud take no part: one filter for the workflow and the verbs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats

NOISE_CLASSES = (7, 18)  # ASPRS classes of low and high noise
# Class of points of overlapping flight lines in point formats 0 to 5, which have no such flag.
OVERLAP_CLASS = 12
# Odd numbers without structure (golden ratio; primes of xxHash), as factors of a hash.
_ODD = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)


def noisy(classification: NDArray) -> Bools:
    """Points (n,) of a class of noise."""
    found = np.zeros(len(classification), bool)
    for cls in NOISE_CLASSES:
        found |= classification == cls
    return found


def point_keys(
    xyz: Floats, steps: Floats, time: NDArray | None, returns: NDArray, intensity: NDArray
) -> NDArray[np.uint64]:
    """A number (n,) of each point that equal points share: same place, time and return.

    Points without a time are told apart by their intensity. Different points share a number once
    in 2**64 pairs.

    Parameters
    ----------
    xyz : native coordinates (n, 3). steps : what they are rounded to (3,).
    time : GPS time (n,), or None. returns : number of the return (n,). intensity : (n,).
    """
    parts = [np.rint(xyz[:, axis] / steps[axis]).astype(np.int64) for axis in range(3)]
    timed = time is not None and bool(np.any(time))
    last = np.asarray(time, np.float64).view(np.int64) if timed else intensity.astype(np.int64)
    found = np.zeros(len(xyz), np.uint64)
    for number, part in enumerate([*parts, last, returns.astype(np.int64)]):
        found += part.view(np.uint64)
        found *= np.uint64(_ODD[number % len(_ODD)])
        found ^= found >> np.uint64(31)
    return found


def in_share(xyz: Floats, steps: Floats, time: NDArray | None, share: float) -> Bools:
    """Points (n,) that a survey with a share of the pulses would have measured.

    Whole pulses are left out where the file tells them by their times, else single returns.

    Parameters
    ----------
    xyz, steps, time : as of `point_keys`. share : of the pulses, 0 to 1.
    """
    timed = time is not None and bool(np.any(time))
    nothing = np.zeros(len(xyz), np.int64)
    keys = point_keys(np.zeros_like(xyz) if timed else xyz, steps, time, nothing, nothing)
    return keys.astype(np.float64) < share * 2.0**64


def key_steps(scales: Floats) -> Floats:
    """A tenth of the finest decimal step (3,) of some clouds, whose scales are (clouds, 3)."""
    return np.asarray(10.0 ** (np.floor(np.log10(np.atleast_2d(scales).min(axis=0)) + 1e-9) - 1))
