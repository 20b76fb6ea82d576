"""Closed lines: places that follow each other, and the first the last.

NumPy alone: the filters of larger libraries take longer to load than to run.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats, Ints

_DEVIATIONS = 4.0
"""Half width of a Gaussian window in standard deviations, as SciPy cuts it; 6e-5 lies outside."""


def smoothed(ring: Floats, sigma: float) -> Floats:
    """Ring (n, 2) smoothed by a Gaussian window that does not shrink arcs.

    Parameters
    ----------
    sigma : standard deviation of the window in places of the ring; 0 leaves it as it is.
    """
    if sigma <= 0:
        return ring
    reach = int(_DEVIATIONS * sigma + 0.5)
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    once = _convolved(ring, weight / weight.sum())
    return 2 * once - _convolved(once, weight / weight.sum())


def resampled(ring: Floats, spacing: float) -> Floats:
    """Ring (n, 2) at equal steps of about ``spacing``, eight of them at least."""
    closed = np.vstack([ring, ring[:1]])
    station = np.append(0.0, np.cumsum(np.hypot(*np.diff(closed, axis=0).T)))
    count = max(8, round(station[-1] / spacing))
    at = np.arange(count) * station[-1] / count
    return np.column_stack([np.interp(at, station, closed[:, axis]) for axis in (0, 1)])


def trimmed(keep: Bools, places: int) -> Bools:
    """Mask (n,) of the places on a ring that have none to drop within so many places."""
    lost = np.convolve(_wrapped((~keep).astype(int), places), np.ones(2 * places + 1, int), "valid")
    return lost == 0


def runs_of(keep: Bools) -> list[Ints]:
    """Indices of the runs of kept places on a ring; a ring that is kept whole is one run."""
    if keep.all():
        return [np.arange(len(keep))]
    if not keep.any():
        return []
    first = int(np.flatnonzero(~keep)[0])
    index = (np.arange(len(keep)) + first) % len(keep)
    kept = keep[index]
    starts = np.flatnonzero(np.diff(kept.astype(np.int8), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(kept.astype(np.int8), append=0) == -1) + 1
    return [index[a:b] for a, b in zip(starts, ends, strict=True)]


def _convolved(ring: Floats, weight: Floats) -> Floats:
    reach = len(weight) // 2
    return np.column_stack([np.convolve(_wrapped(at, reach), weight, "valid") for at in ring.T])


def _wrapped(values: NDArray, reach: int) -> NDArray:
    """Values (n,) with so many of the other end before and after them."""
    return values[np.arange(-reach, len(values) + reach) % len(values)]
