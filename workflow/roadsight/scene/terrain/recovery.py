"""Ground that an opening cut off comes back where the ground at one side continues into it."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.kernels import compiled, compiled_part

_RECOVERY_SPACINGS = 3.5
"""Cut ground comes back from a half-disc of this many spacings."""
_RECOVERY_CELLS = 12
"""... but no wider than this: it bounds the time in clouds with few cells."""
_RECOVERY_SHARE = 0.7
"""... in which this share of the known cells is ground: a plateau and not a lawn beside a house."""
_RECOVERY_CELLS_MIN = 6
"""... and at least so many, twice what a plane needs."""
_RECOVERY_M = 0.3
"""A cell may lie this far from the plane of that half-disc, and further on a slope (per unit)."""
_RECOVERY_PER_SLOPE_M = 0.3
"""On 45 degrees twice the distance: heights within a cell differ by as much as it is wide."""
_RECOVERY_STEEPEST = 1.0
"""Steeper planes (45 degrees) say nothing about the cell beside them."""
_RECOVERY_PASSES = 5
"""Recovered strips grow inwards so many times."""


def recover(
    height_m: Floats, ground: Bools, known: Bools, spacing_m: Floats, cell_m: float
) -> Bools:
    """Ground cells with those that come back, strip by strip.

    Parameters
    ----------
    height_m : (rows, columns), zero where unknown. ground, known : (rows, columns).
    spacing_m : (rows, columns) spacing of the known cells.
    """
    reach = np.ceil(_RECOVERY_SPACINGS * spacing_m / cell_m).astype(np.int64)
    reach = np.minimum(reach, _RECOVERY_CELLS)
    for _ in range(_RECOVERY_PASSES):
        ground = recovered(height_m, ground, known, reach, cell_m)
    return ground


@compiled()
def recovered(height_m: Floats, ground: Bools, known: Bools, reach: Ints, cell_m: float) -> Bools:
    """Ground cells and those cut ones into which the ground on one side continues.

    Terrace edges and ridges are convex, as objects are, so that an opening cuts them. But ground
    fills a half-disc on one side of such a cell and its plane meets the cell; around an object,
    the ground is lower on all sides.

    Parameters
    ----------
    height_m : (rows, columns) lowest heights. ground, known : (rows, columns).
    reach : (rows, columns) radius of the half-disc, cells.
    """
    rows, columns = height_m.shape
    out = ground.copy()
    east = np.array([1.0, 0.5**0.5, 0.0, -(0.5**0.5), -1.0, -(0.5**0.5), 0.0, 0.5**0.5])
    north = np.array([0.0, 0.5**0.5, 1.0, 0.5**0.5, 0.0, -(0.5**0.5), -1.0, -(0.5**0.5)])
    sums = np.zeros((8, 10))
    for i in range(rows):
        for j in range(columns):
            if ground[i, j] or not known[i, j]:
                continue
            r = reach[i, j]
            sums[:] = 0.0
            for a in range(max(0, i - r), min(rows, i + r + 1)):
                for b in range(max(0, j - r), min(columns, j + r + 1)):
                    y, x = float(a - i), float(b - j)
                    q = x * x + y * y
                    if q == 0.0 or q > r * r or not known[a, b]:
                        continue
                    side = 0.38 * q**0.5  # within 67.5 degrees
                    z = height_m[a, b] - height_m[i, j]
                    for d in range(8):
                        if x * east[d] + y * north[d] < side:
                            continue
                        sums[d, 9] += 1.0
                        if ground[a, b]:
                            s = sums[d]
                            s[0] += 1.0
                            s[1] += x
                            s[2] += y
                            s[3] += z
                            s[4] += x * x
                            s[5] += x * y
                            s[6] += y * y
                            s[7] += x * z
                            s[8] += y * z
            for d in range(8):
                if _plane_meets(sums[d], cell_m):
                    out[i, j] = True
                    break
    return out


@compiled_part()
def _plane_meets(s: Floats, cell_m: float) -> bool:
    """Whether the plane of a half-disc's sums passes through the cell at its centre."""
    n = s[0]
    if n < _RECOVERY_CELLS_MIN or n < _RECOVERY_SHARE * s[9]:
        return False
    mx, my, mz = s[1] / n, s[2] / n, s[3] / n
    # 0.3 cells squared: cells in a line give no cross slope.
    xx, xy, yy = s[4] / n - mx * mx + 0.3, s[5] / n - mx * my, s[6] / n - my * my + 0.3
    xz, yz = s[7] / n - mx * mz, s[8] / n - my * mz
    det = xx * yy - xy * xy
    gx, gy = (xz * yy - yz * xy) / det, (xx * yz - xy * xz) / det
    slope = (gx * gx + gy * gy) ** 0.5 / cell_m
    if slope > _RECOVERY_STEEPEST:
        gx, gy = gx * _RECOVERY_STEEPEST / slope, gy * _RECOVERY_STEEPEST / slope
        slope = _RECOVERY_STEEPEST
    return abs(mz - gx * mx - gy * my) <= _RECOVERY_M + _RECOVERY_PER_SLOPE_M * slope
