"""Ground as a raster: mean height per cell, and a plane at the smallest scale with support.

Planes are weighted least squares under a Gaussian window, by normalised convolution (Knutsson and
Westin 1993, doi:10.1109/CVPR.1993.341081), so that empty cells say nothing and the scale is local:
fine where points are dense, coarse only where they are sparse or noisy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from roadsight.base.arrays import Bools, Floats
from roadsight.base.kernels import compiled, compiled_part
from roadsight.scene.grids import Grid

_MOST = 8.0  # Points of one cell that count: more share the same scan's error.
_RIDGE = 0.02  # Of the window's variance: keeps a plane along a single scan line finite.


@dataclass(frozen=True)
class CellMeans:
    """Means of the points of each cell (rows, columns); height and intensity 0 where empty.

    Parameters
    ----------
    count : points. height_m, intensity : means. variance_m2 : of height.
    across, up : mean position within the cell, in cells from its centre.
    """

    grid: Grid
    count: Floats
    height_m: Floats
    variance_m2: Floats
    intensity: Floats
    across: Floats
    up: Floats

    @property
    def weight(self) -> Floats:
        """Weight of each cell's mean."""
        return np.minimum(self.count, _MOST)


@dataclass(frozen=True)
class LocalPlanes:
    """Plane at each cell (rows, columns).

    Parameters
    ----------
    known : whether there is one. height_m : at the cell's centre. east, north : rise over run.
    residual_m : root mean square of the cells' means about it. error_m : standard error of the
    height. scale_m : standard deviation of the window.
    """

    known: Bools
    height_m: Floats
    east: Floats
    north: Floats
    residual_m: Floats
    error_m: Floats
    scale_m: Floats


def cell_means(xyz_m: Floats, intensity: Floats, cell_m: float) -> CellMeans:
    """Means per cell of ground points (n, 3) and their intensity (n,)."""
    grid = Grid.around(xyz_m[:, 0], xyz_m[:, 1], cell_m)
    cell, size = grid.flat(xyz_m[:, 0], xyz_m[:, 1]), grid.rows * grid.columns
    count = np.bincount(cell, minlength=size).astype(np.float64)
    many = np.maximum(count, 1.0)
    level = float(xyz_m[:, 2].mean()) if len(xyz_m) else 0.0

    def mean(values: Floats) -> Floats:
        return np.bincount(cell, values, minlength=size) / many

    height = mean(xyz_m[:, 2] - level) + level * (count > 0)
    column, row = (xyz_m[:, axis] / cell_m % 1.0 - 0.5 for axis in (0, 1))
    parts = (
        count,
        height,
        mean((xyz_m[:, 2] - height[cell]) ** 2),
        mean(intensity),
        mean(column),
        mean(row),
    )
    return CellMeans(grid, *(part.reshape(grid.shape) for part in parts))


def smooth(values: Floats, sigma_cells: float) -> Floats:
    """Gaussian mean that takes everything outside as 0."""
    return ndimage.gaussian_filter(values, sigma_cells, mode="constant", truncate=2.5)


def window_planes(
    weight: Floats, height_m: Floats, across: Floats, up: Floats, sigma_cells: float
) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """Weighted plane under a Gaussian window at each cell.

    Parameters
    ----------
    weight, height_m, across, up : (rows, columns) of `CellMeans`.

    Returns
    -------
    height at the centre in metres, rise per cell along columns and rows, root mean square
    residual, sum of weights under the window, distance of their mean from the centre in cells.
    """
    rows, columns = weight.shape
    row, column = np.mgrid[:rows, :columns].astype(np.float64)
    column -= columns / 2
    row -= rows / 2
    x, y = column + across, row + up
    total = np.maximum(smooth(weight, sigma_cells), 1e-12)

    def mean(values: Floats) -> Floats:
        return smooth(weight * values, sigma_cells) / total

    level = float((weight * height_m).sum() / max(weight.sum(), 1e-12))
    z = np.where(weight > 0, height_m - level, 0.0)
    mx, my, mz = mean(x), mean(y), mean(z)
    ridge = _RIDGE * sigma_cells**2
    xx, yy = mean(x * x) - mx**2 + ridge, mean(y * y) - my**2 + ridge
    xy, xz, yz = mean(x * y) - mx * my, mean(x * z) - mx * mz, mean(y * z) - my * mz
    determinant = xx * yy - xy**2
    east, north = (xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant
    left = np.maximum(mean(z * z) - mz**2 - east * xz - north * yz, 0.0)
    height = mz + east * (column - mx) + north * (row - my) + level
    off = np.hypot(mx - column, my - row)
    return height, east, north, np.sqrt(left), total * 2 * np.pi * sigma_cells**2, off


def _narrowest_spread(occupied: Floats, sigma_cells: float) -> tuple[Floats, Floats]:
    """Occupied cells under each window, and their variance along the narrowest direction."""
    rows, columns = occupied.shape
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    x, y = x - columns / 2, y - rows / 2
    total = np.maximum(smooth(occupied, sigma_cells), 1e-12)

    def mean(values: Floats) -> Floats:
        return smooth(occupied * values, sigma_cells) / total

    mx, my = mean(x), mean(y)
    xx, yy, xy = mean(x * x) - mx**2, mean(y * y) - my**2, mean(x * y) - mx * my
    narrow = (xx + yy) / 2 - np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
    return total * 2 * np.pi * sigma_cells**2, narrow


def local_planes(
    cells: CellMeans, scales_cells: tuple[float, ...], error_m: float, fewest: float = 6.0
) -> LocalPlanes:
    """Plane of each cell at the smallest scale that carries it.

    A scale carries a plane where its window holds ``fewest`` occupied cells that spread by half
    the window's width in every direction around its middle. Where that plane's height is less
    certain than ``error_m`` a larger scale is taken, if it carries.
    """
    cell_m, weight = cells.grid.cell_size_m, cells.weight
    occupied = (weight > 0).astype(np.float64)
    chosen: list[Floats] = []
    known = np.zeros(weight.shape, dtype=bool)
    fine = known.copy()
    for scale in scales_cells:
        height, east, north, residual, total, off = window_planes(
            weight, cells.height_m, cells.across, cells.up, scale
        )
        number, narrow = _narrowest_spread(occupied, scale)
        carries = (number >= fewest) & (narrow >= (0.5 * scale) ** 2) & (off < scale)
        error = residual / np.sqrt(np.maximum(total, 1.0))
        width = np.full(weight.shape, scale * cell_m)
        values = [height, east / cell_m, north / cell_m, residual, error, width]
        take = carries & ~fine
        chosen = [
            np.where(take, new, old) for new, old in zip(values, chosen or values, strict=True)
        ]
        known |= carries
        fine |= carries & (error <= error_m)
    return LocalPlanes(known, *chosen)


# A surface grown from seeds as long as its cells continue the plane of what was grown before.

_BLANK_WEIGHT = 0.25  # Of a bridged cell, whose height is itself an extrapolation.
_STRIDE = 2  # Every second cell of the window: a quarter of the time, the same plane to 1 mm.
_NEAR_CELLS_2 = 25  # Squared: measured surface within five cells needs no bridge's allowance.


@compiled_part()
def _continue(  # noqa: PLR0912
    grown: Bools,
    blank: Bools,
    height: Floats,
    looks: Floats,
    row: int,
    column: int,
    sigma: float,
    mean: Floats,
    variance: Floats,
    weights: Floats,
) -> tuple[float, float, float, float, int]:
    """Plane of the grown cells around one cell; fills mean and variance of their looks.

    Returns the sum of weights (0: nothing grown near), height at the cell, rise per cell along
    columns and rows, and the number of measured grown cells within five cells.
    """
    rows, columns = grown.shape
    mean[:], variance[:], weights[:] = 0.0, 0.0, 0.0
    reach, scale = int(2 * sigma), 1.0 / (2.0 * sigma * sigma)
    s = sx = sy = sxx = syy = sxy = sz = sxz = syz = 0.0
    near = 0
    for r in range(max(0, row - reach), min(rows, row + reach + 1)):
        if (r - row) % _STRIDE != 0:
            continue
        for c in range(max(0, column - reach), min(columns, column + reach + 1)):
            if (c - column) % _STRIDE != 0 or not grown[r, c]:
                continue
            x, y = c - column, r - row
            apart = x * x + y * y
            if apart > reach * reach:
                continue
            w, z = math.exp(-apart * scale), height[r, c]
            if blank[r, c]:
                w *= _BLANK_WEIGHT
            elif apart <= _NEAR_CELLS_2:
                near += 1
            s, sx, sy, sz = s + w, sx + w * x, sy + w * y, sz + w * z
            sxx, syy, sxy = sxx + w * x * x, syy + w * y * y, sxy + w * x * y
            sxz, syz = sxz + w * x * z, syz + w * y * z
            for k in range(len(mean)):
                look = looks[r, c, k]
                if not math.isnan(look):
                    weights[k] += w
                    mean[k] += w * look
                    variance[k] += w * look * look
    if s <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0
    for k in range(len(mean)):
        if weights[k] > 0.0:
            mean[k] /= weights[k]
            variance[k] = max(0.0, variance[k] / weights[k] - mean[k] ** 2)
        else:
            mean[k] = math.nan
    mx, my, mz = sx / s, sy / s, sz / s
    ridge = 0.02 * sigma * sigma
    xx, yy, xy = sxx / s - mx * mx + ridge, syy / s - my * my + ridge, sxy / s - mx * my
    xz, yz = sxz / s - mx * mz, syz / s - my * mz
    determinant = xx * yy - xy * xy
    east, north = (xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant
    return s, mz - east * mx - north * my, east, north, near


@compiled()
def grow(  # noqa: PLR0912, PLR0915
    seed: Bools,
    passable: Bools,
    blank: Bools,
    height_m: Floats,
    east: Floats,
    north: Floats,
    looks: Floats,
    allowed_look: Floats,
    least_look: Floats,
    most_look: Floats,
    allowed_m: Floats,
    bridge_m: Floats,
    allowed_rise: float,
    sigma: float,
    reach: int,
    radius: int,
    share: float,
) -> Bools:
    """Cells reached from the seeds (rows, columns), in synchronous rounds.

    A cell within ``reach`` of the surface is fit when the squares of its departures, each in units
    of what is allowed, add up to less than 1: height and rise from the plane of the grown cells
    under a Gaussian window of ``sigma`` cells, and each look from their mean, in units of
    their spread, up to ``most_look``, and ``least_look`` beside it. A blank cell (nothing
    measured) is fit and takes the plane's height. A fit cell joins if a disc of ``radius`` cells
    that covers it is all grown or fit, a ``share`` of it grown: nothing passes a gap narrower than
    the disc.

    Parameters
    ----------
    seed, passable, blank : (rows, columns). height_m : plane height. east, north : rise per cell.
    looks : (rows, columns, k), NaN where unknown. allowed_look, least_look, most_look : (k,).
    allowed_m : (rows, columns). bridge_m : (rows, columns) allowed in addition where no measured
    cell has been grown within five cells. allowed_rise : per cell.
    """
    rows, columns = seed.shape
    grown, fit = seed & passable, np.zeros_like(seed)
    height, east, north, looks = height_m.copy(), east.copy(), north.copy(), looks.copy()
    seen = np.zeros((rows, columns), np.int32)
    disc_at = np.zeros((rows, columns), np.int32)
    kinds = looks.shape[2]
    mean, variance, weights = np.zeros(kinds), np.zeros(kinds), np.zeros(kinds)
    disc = [
        (i, j)
        for i in range(-radius, radius + 1)
        for j in range(-radius, radius + 1)
        if i * i + j * j <= radius * radius
    ]
    front = [(r, c) for r in range(rows) for c in range(columns) if grown[r, c]]
    waiting = [(0, 0)]
    waiting.clear()
    turn = 0
    while len(front) > 0:
        turn += 1
        tried = [(0, 0)]
        tried.clear()
        for r0, c0 in front:
            for i in range(-reach, reach + 1):
                for j in range(-reach, reach + 1):
                    r, c = r0 + i, c0 + j
                    if i * i + j * j > reach * reach or r < 0 or c < 0 or r >= rows or c >= columns:
                        continue
                    if passable[r, c] and not grown[r, c] and seen[r, c] != turn:
                        seen[r, c] = turn
                        tried.append((r, c))
        for r, c in waiting:
            if seen[r, c] != turn and not grown[r, c]:
                seen[r, c] = turn
                tried.append((r, c))
        for r, c in tried:
            s, z, ge, gn, near = _continue(
                grown, blank, height, looks, r, c, sigma, mean, variance, weights
            )
            if s <= 0.0:
                continue
            if blank[r, c]:
                height[r, c], east[r, c], north[r, c] = z, ge, gn
                for k in range(kinds):
                    looks[r, c, k] = mean[k]
                fit[r, c] = True
                continue
            limit = allowed_m[r, c]
            if near == 0:
                limit += bridge_m[r, c]
            off = ((height[r, c] - z) / limit) ** 2
            off += ((ge - east[r, c]) ** 2 + (gn - north[r, c]) ** 2) / allowed_rise**2
            for k in range(kinds):
                apart = looks[r, c, k] - mean[k]
                if not math.isnan(apart):
                    off += apart**2 / (
                        allowed_look[k] ** 2
                        * (min(variance[k], most_look[k] ** 2) + least_look[k] ** 2)
                    )
            fit[r, c] = off < 1.0
        joined = [(0, 0)]
        joined.clear()
        for r0, c0 in tried:
            if not fit[r0, c0]:
                continue
            for i, j in disc:
                r, c = r0 + i, c0 + j
                if r < radius or c < radius or r >= rows - radius or c >= columns - radius:
                    continue
                if disc_at[r, c] != turn and disc_at[r, c] != -turn:
                    held, whole = 0, True
                    for k, m in disc:
                        if grown[r + k, c + m]:
                            held += 1
                        elif not fit[r + k, c + m]:
                            whole = False
                            break
                    disc_at[r, c] = turn if whole and held >= share * len(disc) else -turn
                if disc_at[r, c] == turn:
                    joined.append((r0, c0))
                    break
        waiting.clear()
        for r, c in tried:
            if fit[r, c]:
                waiting.append((r, c))
            fit[r, c] = False
        for r, c in joined:
            grown[r, c] = True
        front = joined
    return grown
