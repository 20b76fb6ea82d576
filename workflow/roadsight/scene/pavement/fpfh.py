"""Fast point feature histograms (FPFH) of ground points, the pavement stage's descriptor.

Paper 1, section 2.2: K1 neighbours, 33 bins. The descriptor follows Rusu, Blodow and Beetz (2009,
doi:10.1109/ROBOT.2009.5152473): three angles between the normals of a pair, 11 bins each, and the
simplified histograms of the neighbours added with the weight 1 / distance squared.
"""

from __future__ import annotations

import math

import numpy as np

from roadsight.base.arrays import Floats, Floats32, Ints
from roadsight.base.kernels import compiled, compiled_part

BINS = 11
"""Bins of each of the three angles."""
FEATURES = 3 * BINS
"""Numbers of a histogram."""
_SAME_ANGLE = 1e-9
"""Cosines that differ by less differ by rounding."""


@compiled_part()
def _pair_bins(xyz: Floats, normals: Floats, i: int, j: int) -> tuple[int, int, int]:
    """Bins of the three pair angles; -1 where the pair has none (coincident or collinear)."""
    dx, dy, dz = xyz[j, 0] - xyz[i, 0], xyz[j, 1] - xyz[i, 1], xyz[j, 2] - xyz[i, 2]
    length = math.sqrt(dx**2 + dy**2 + dz**2)
    if length == 0.0:
        return -1, -1, -1
    dx, dy, dz = dx / length, dy / length, dz / length
    along_i = normals[i, 0] * dx + normals[i, 1] * dy + normals[i, 2] * dz
    along_j = normals[j, 0] * dx + normals[j, 1] * dy + normals[j, 2] * dz
    first, second, phi = i, j, along_i
    # The normal closer to the line between the points is the frame's first axis. Points with the
    # same neighbours have the same normal: rounding must not choose the sign of their third angle.
    if abs(along_j) > abs(along_i) + _SAME_ANGLE:
        first, second, phi = j, i, -along_j
        dx, dy, dz = -dx, -dy, -dz
    ux, uy, uz = normals[first, 0], normals[first, 1], normals[first, 2]
    ox, oy, oz = normals[second, 0], normals[second, 1], normals[second, 2]
    vx, vy, vz = dy * uz - dz * uy, dz * ux - dx * uz, dx * uy - dy * ux
    size = math.sqrt(vx**2 + vy**2 + vz**2)
    if size == 0.0:
        return -1, -1, -1
    vx, vy, vz = vx / size, vy / size, vz / size
    wx, wy, wz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    theta = math.atan2(wx * ox + wy * oy + wz * oz, ux * ox + uy * oy + uz * oz)
    alpha = vx * ox + vy * oy + vz * oz
    return _bin((theta + math.pi) / math.pi), _bin(alpha + 1), _bin(phi + 1)


@compiled_part()
def _bin(value: float) -> int:
    """Bin of a value from 0 to 2."""
    return min(BINS - 1, max(0, int(math.floor(BINS * value * 0.5))))


@compiled()
def _simplified(xyz: Floats, normals: Floats, neighbours: Ints) -> Floats:
    """Simplified histograms (n, 33): each third sums to 100 where every pair is usable."""
    histograms = np.zeros((len(xyz), FEATURES))
    for i in range(len(xyz)):
        present = 0
        for j in neighbours[i]:
            present += j >= 0
        if present == 0 or math.isnan(normals[i, 0]):
            continue
        share = 100.0 / present
        for j in neighbours[i]:
            if j < 0 or math.isnan(normals[j, 0]):
                continue
            a, b, c = _pair_bins(xyz, normals, i, j)
            if a >= 0:
                histograms[i, a] += share
                histograms[i, BINS + b] += share
                histograms[i, 2 * BINS + c] += share
    return histograms


@compiled()
def _weighted(
    simplified: Floats,
    neighbours: Ints,
    distance: Floats,
) -> Floats32:
    """Own histogram plus the neighbours' weighted mean, each third of which sums to 100."""
    out = np.zeros(simplified.shape, dtype=np.float32)
    mixed = np.zeros(FEATURES)
    for i in range(len(simplified)):
        mixed[:] = 0.0
        for k in range(neighbours.shape[1]):
            j, apart = neighbours[i, k], distance[i, k]
            if j >= 0 and apart > 0.0:
                weight = 1.0 / apart**2
                for f in range(FEATURES):
                    mixed[f] += simplified[j, f] * weight
        for start in range(0, FEATURES, BINS):
            total = 0.0
            for f in range(start, start + BINS):
                total += mixed[f]
            scale = 100.0 / total if total > 0.0 else 0.0
            for f in range(start, start + BINS):
                out[i, f] = simplified[i, f] + scale * mixed[f]
    return out


def fpfh(
    xyz_m: Floats,
    normals: Floats,
    distance_m: Floats,
    neighbours: Ints,
) -> Floats32:
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
