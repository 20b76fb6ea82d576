"""Fast point feature histograms (FPFH) of ground points, the pavement stage's descriptor.

Paper 1, section 2.2: K1 neighbours, 33 bins. The descriptor follows Rusu, Blodow and Beetz (2009,
doi:10.1109/ROBOT.2009.5152473): three angles between the normals of a pair, 11 bins each, and the
simplified histograms of the neighbours added with the weight 1 / distance squared.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

BINS = 11
FEATURES = 3 * BINS
_SAME_ANGLE = 1e-9


@njit(cache=True)
def _pair_bins(
    p: NDArray[np.float64], n: NDArray[np.float64], q: NDArray[np.float64], m: NDArray[np.float64]
) -> tuple[int, int, int]:
    """Bins of the three pair angles; -1 where the pair has none (coincident or collinear)."""
    d = q - p
    length = math.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
    if length == 0.0:
        return -1, -1, -1
    d = d / length
    along_n, along_m = np.dot(n, d), np.dot(m, d)
    # The normal closer to the line between the points is the frame's first axis. Points with the
    # same neighbours have the same normal: rounding must not choose the sign of their third angle.
    if abs(along_m) > abs(along_n) + _SAME_ANGLE:
        u, other, d, phi = m, n, -d, -along_m
    else:
        u, other, phi = n, m, along_n
    v = np.cross(d, u)
    size = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    if size == 0.0:
        return -1, -1, -1
    v = v / size
    theta = math.atan2(np.dot(np.cross(u, v), other), np.dot(u, other))
    alpha = np.dot(v, other)
    first = min(BINS - 1, max(0, int(math.floor(BINS * (theta + math.pi) / (2 * math.pi)))))
    second = min(BINS - 1, max(0, int(math.floor(BINS * (alpha + 1) * 0.5))))
    third = min(BINS - 1, max(0, int(math.floor(BINS * (phi + 1) * 0.5))))
    return first, second, third


@njit(cache=True)
def _simplified(
    xyz: NDArray[np.float64], normals: NDArray[np.float64], neighbours: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Simplified histograms (n, 33): each third sums to 100 where every pair is usable."""
    histograms = np.zeros((len(xyz), FEATURES))
    for i in range(len(xyz)):
        present = 0
        for j in neighbours[i]:
            present += j >= 0
        if present == 0 or math.isnan(normals[i, 0]):
            continue
        for j in neighbours[i]:
            if j < 0 or math.isnan(normals[j, 0]):
                continue
            a, b, c = _pair_bins(xyz[i], normals[i], xyz[j], normals[j])
            if a >= 0:
                histograms[i, a] += 100.0 / present
                histograms[i, BINS + b] += 100.0 / present
                histograms[i, 2 * BINS + c] += 100.0 / present
    return histograms


@njit(cache=True)
def _weighted(
    simplified: NDArray[np.float64],
    neighbours: NDArray[np.int64],
    distance: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Own histogram plus the neighbours' weighted mean, each third of which sums to 100."""
    out = np.zeros(simplified.shape, dtype=np.float32)
    mixed = np.zeros(FEATURES)
    for i in range(len(simplified)):
        mixed[:] = 0.0
        for k in range(neighbours.shape[1]):
            if neighbours[i, k] >= 0 and distance[i, k] > 0.0:
                mixed += simplified[neighbours[i, k]] / distance[i, k] ** 2
        for third in range(3):
            part = slice(third * BINS, (third + 1) * BINS)
            total = mixed[part].sum()
            scale = 100.0 / total if total > 0.0 else 0.0
            out[i, part] = simplified[i, part] + scale * mixed[part]
    return out


def fpfh(
    xyz_m: NDArray[np.float64],
    normals: NDArray[np.float64],
    distance_m: NDArray[np.float64],
    neighbours: NDArray[np.int64],
) -> NDArray[np.float32]:
    """FPFH of each point.

    Parameters
    ----------
    xyz_m : (n, 3) local metres.
    normals : (n, 3) unit normals, oriented alike; NaN where unknown.
    distance_m, neighbours : (n, k) from `normals.nearest_neighbours`.

    Returns
    -------
    (n, 33) float32; all zero for a point without a usable pair, which callers must not take for
    flat road.
    """
    simplified = _simplified(xyz_m, normals, neighbours)
    return _weighted(simplified, neighbours, distance_m)
