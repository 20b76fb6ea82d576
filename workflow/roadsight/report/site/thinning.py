"""Few points that still show the whole scene, chosen the same way every time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats, Ints

_STEPS = 10  # Halvings of the search for the cell that leaves so many points
_MOST = 250_000  # Most points that may be asked for; a page holds them all


def sample_mask(start: int, count: int, share: float) -> Bools:
    """Which of the points ``start .. start + count`` belong to a pseudo-random sample.

    The choice depends on a point's number alone, so that it is the same tile by tile and has no
    pattern that interferes with scan lines.

    Parameters
    ----------
    share : expected share of points kept; 1 or more keeps all.
    """
    if share >= 1:
        return np.ones(count, dtype=bool)
    with np.errstate(over="ignore"):  # SplitMix64
        bits = np.arange(start + 1, start + count + 1, dtype=np.uint64)
        bits *= np.uint64(0x9E3779B97F4A7C15)
        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        bits ^= bits >> np.uint64(31)
    return (bits >> np.uint64(11)).astype(np.float64) < share * 2.0**53


def thin(xyz_m: NDArray, at_most: int) -> Ints:
    """Indices of the first point in each cube, the cubes as small as the number allows.

    Even in space, so that sparse verges stay visible beside a dense road.

    Parameters
    ----------
    xyz_m : (n, 3) finite, local metres.
    at_most : points to keep, from 8 to 250,000.

    Returns
    -------
    increasing indices; all of them if there are no more than ``at_most``
    """
    if not 8 <= at_most <= _MOST:
        raise ValueError(f"at_most is {at_most}, allowed: 8 to {_MOST}")
    if len(xyz_m) <= at_most:
        return np.arange(len(xyz_m))
    offset = np.asarray(xyz_m, np.float64) - np.min(xyz_m, axis=0)
    extent = offset.max(axis=0)
    longest = float(extent.max())
    if longest == 0:
        return np.zeros(1, dtype=np.int64)
    large = 2 * longest
    small = max(float(np.sqrt(extent[0] * extent[1] / at_most)), longest / at_most) / 8
    for _ in range(_STEPS):
        size = float(np.sqrt(small * large))
        cubes = np.sort(_cubes(offset, size))
        if 1 + np.count_nonzero(cubes[1:] != cubes[:-1]) <= at_most:
            large = size
        else:
            small = size
    # Finding the first of each takes several times as long as counting them.
    _, first = np.unique(_cubes(offset, large), return_index=True)
    return np.sort(first)


def _cubes(offset_m: Floats, size_m: float) -> Ints:
    """Number of each point's cube; at most 2 million cubes an axis."""
    column, row, layer = (offset_m / size_m).astype(np.int64).T
    return column + (column.max() + 1) * (row + (row.max() + 1) * layer)
