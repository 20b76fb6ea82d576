"""Points that stand more than once in a cloud, as overlapping exports leave them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from roadsight.base.arrays import Floats, Ints


def first_of_each(x: Floats, y: Floats, z: Floats) -> Ints:
    """Index (n,) of the first point with the very same coordinates; a point's own where it is it.

    Parameters
    ----------
    x, y, z : (n,); a NaN equals a NaN of the same bits.
    """
    # Adding zero makes -0.0 and 0.0 the same bits.
    bits = [(np.asarray(axis, np.float64) + 0.0).view(np.uint64) for axis in (x, y, z)]
    return _first(*bits)


@njit(cache=True)
def _first(x: NDArray[np.uint64], y: NDArray[np.uint64], z: NDArray[np.uint64]) -> Ints:
    """Index of the first equal triple, by a table of open addresses."""
    n = len(x)
    size = 16
    while size < 2 * n:
        size *= 2
    # A power of two, so that the remainder is a mask.
    mask = np.uint64(size - 1)
    table = np.full(size, -1, np.int64)
    out = np.empty(n, np.int64)
    for i in range(n):
        key = x[i] * np.uint64(0x9E3779B97F4A7C15)
        key = (key ^ (key >> np.uint64(29)) ^ y[i]) * np.uint64(0xBF58476D1CE4E5B9)
        key = (key ^ (key >> np.uint64(32)) ^ z[i]) * np.uint64(0x94D049BB133111EB)
        place = (key ^ (key >> np.uint64(31))) & mask
        while True:
            j = table[place]
            if j < 0:
                table[place] = i
                out[i] = i
                break
            if x[j] == x[i] and y[j] == y[i] and z[j] == z[i]:
                out[i] = j
                break
            place = (place + np.uint64(1)) & mask
    return out
