"""Coarse ground surface: progressive opening of the lowest heights, without pits.

Progressive morphological opening in the manner of SMRF (Pingel, Clarke and McBride 2013,
doi:10.1016/j.isprsjprs.2012.12.002), with a lower slope than theirs; what that cuts off terrace
edges and ridges comes back where the ground at one side continues into it (`recover`).

The constants were measured on seven ISPRS filter samples and five labelled street scans.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from roadsight.base.arrays import Bools, Floats, Floats32, Ints
from roadsight.base.kernels import compiled, compiled_part
from roadsight.base.sections.scene import GroundFilter
from roadsight.scene.grids import Grid
from roadsight.scene.terrain.ground_settings import ROUGHNESS_PER_SPACING


@dataclass(frozen=True)
class CoarseGround:
    """Coarse ground surface on a grid.

    Parameters
    ----------
    grid : the cells.
    surface_m : (rows, columns) height, local metres; NaN only where no cell is known at all.
    slope : (rows, columns) rise over run.
    spacing_m : (rows, columns) spacing of cells with points, at least one cell.
    """

    grid: Grid
    surface_m: Floats
    slope: Floats
    spacing_m: Floats


def coarse_ground(grid: Grid, lowest_m: Floats, settings: GroundFilter) -> CoarseGround:
    """Coarse ground surface from the lowest height of each cell.

    Parameters
    ----------
    grid : cells of `GroundFilter.coarse_cell_m`.
    lowest_m : (rows, columns) lowest height per coarse cell, NaN where the cell is empty.
    """
    cell = settings.coarse_cell_m
    known = np.isfinite(lowest_m)
    if not known.any():
        nothing = np.zeros_like(lowest_m)
        return CoarseGround(grid, np.full_like(lowest_m, np.nan), nothing, nothing + cell)
    spacing = cell_spacing(known) * cell
    deep = settings.height_threshold_m + ROUGHNESS_PER_SPACING * spacing
    known &= ~low_outliers(lowest_m, deep)
    filled = _without_unseen_rises(fill_smoothly(lowest_m, known), lowest_m, known, spacing, cell)
    ground = known & _keeps_its_height(filled, settings)
    ground = recover(np.where(known, lowest_m, 0.0), ground, known, spacing, cell)
    if not ground.any():
        ground = known
    surface = fill_smoothly(lowest_m, ground)
    steps = [np.gradient(surface, cell, axis=a) for a in (0, 1) if surface.shape[a] > 1]
    slope = np.sqrt(sum((step**2 for step in steps), np.zeros_like(surface)))
    return CoarseGround(grid, surface, slope, spacing)


# A cell is multipath if it lies below four fifths of those around, by more than ground departs from
# a plane.
_PIT_SHARE = 0.2
_PIT_PASSES = 2  # Pits beside pits are found once those are gone.
# Windows that tell a pit, half widths in cells: the first that holds so many known cells.
_PIT_HALVES = (2, 4, 8, 16)
_PIT_CELLS = 8  # As many as surround a cell; fewer may be a pit's own neighbours.
# Little drops so far within two cells, so that what is as deep gets a second look in wider windows:
# pits come in clusters. Airborne scans of a generated valley have some of 4 m: at 6 m of depth, its
# ridges were cut off between them. Cliffs of an ISPRS sample cost 0.1 points.
_PIT_ABYSS_M = 3.0
# ... but no wider, half width in cells: courtyards and streets between roofs are wider.
_PIT_WIDEST = 8
# Ground above a pit may be as rough as this share of its depth; crowns above the ground of a wood
# are rougher.
_PIT_ROUGH = 1 / 15


def low_outliers(lowest_m: Floats, deep_m: Floats) -> Bools:
    """Cells far below what lies around them (multipath below the road).

    The foot of a wall or a ditch is no pit: it goes on, so that a fifth of a window is as low.
    Cells without company in the widest window say nothing, unless all are such.

    Parameters
    ----------
    lowest_m : (rows, columns), NaN where empty. deep_m : (rows, columns) depth of a pit.
    """
    pits = np.zeros(lowest_m.shape, bool)
    for _ in range(_PIT_PASSES):
        height = np.where(pits, np.nan, lowest_m)
        pits |= pits_of(height, deep_m, np.array(_PIT_HALVES), _PIT_CELLS, _PIT_SHARE)
    return pits & (pits != np.isfinite(lowest_m)).any()


@compiled()
def pits_of(height: Floats, deep: Floats, halves: Ints, enough: int, share: float) -> Bools:
    """Cells with fewer than a share of the known cells around nearly as low or lower.

    The middle half of the others must lie within the depth of a pit, as they are or about their
    plane: the ground that is seen between trees or roofs is no pit, but one on a slope is. A cell
    far below the others is compared in wider windows, too.

    Parameters
    ----------
    height, deep : (rows, columns), height NaN where unknown. halves : half widths of windows,
        growing: the first that holds ``enough`` known cells decides; without any, it is a pit.
    """
    rows, columns = height.shape
    out = np.zeros((rows, columns), np.bool_)
    others = np.empty((3, (2 * halves[-1] + 1) ** 2))
    for i in range(rows):
        for j in range(columns):
            if np.isnan(height[i, j]):
                continue
            out[i, j] = True
            limit = height[i, j] + deep[i, j]
            for half in halves:
                low = n = 0
                for a in range(max(0, i - half), min(rows, i + half + 1)):
                    for b in range(max(0, j - half), min(columns, j + half + 1)):
                        if height[a, b] <= limit:
                            low += 1
                        elif height[a, b] > limit:
                            others[0, n], others[1, n], others[2, n] = b - j, a - i, height[a, b]
                            n += 1
                if low + n < enough:
                    continue
                few, depth, rough = low < share * (low + n), 0.0, deep[i, j]
                order = np.sort(others[2, :n])
                if n > 0:
                    depth = 0.5 * (order[(n - 1) // 2] + order[n // 2]) - height[i, j]
                    rough = max(rough, _PIT_ROUGH * depth)
                out[i, j] = few and (
                    _middle_half(order) <= rough
                    or _middle_half(np.sort(_off_plane(others[:, :n]))) <= rough
                )
                if out[i, j] or depth < _PIT_ABYSS_M or half >= _PIT_WIDEST:
                    break
    return out


@compiled_part()
def _middle_half(order: Floats) -> float:
    """Width of the middle half of sorted values."""
    n = len(order)
    return order[(3 * n) // 4] - order[n // 4]


@compiled_part()
def _off_plane(points: Floats) -> Floats:
    """Heights (n,) of points (3, n) above their plane of least squares."""
    n = points.shape[1]
    centred = points.copy()
    for axis in range(3):
        middle = points[axis].mean()
        for k in range(n):
            centred[axis, k] -= middle
    x, y, z = centred[0], centred[1], centred[2]
    # Cells in a line give no cross slope.
    xx, xy, yy = (x * x).sum() + 0.1 * n, (x * y).sum(), (y * y).sum() + 0.1 * n
    xz, yz = (x * z).sum(), (y * z).sum()
    det = xx * yy - xy * xy
    return z - (xz * yy - yz * xy) / det * x - (yz * xx - xz * xy) / det * y


_RELAXATIONS = 30  # Jacobi passes that smooth filled gaps.


def fill_smoothly(values: Floats, known: Bools) -> Floats:
    """Gaps take the mean of the smallest window that knows anything, then are relaxed.

    Each gap depends on what lies around it and not on where the grid begins.

    Parameters
    ----------
    values : (rows, columns). known : (rows, columns) which of them hold; at least one.
    """
    if known.all():
        return values.copy()
    base = float(values[known][0])
    source = np.where(known, values - base, 0.0)
    out, done, half = source.copy(), known.copy(), 1
    while not done.all():
        share = ndimage.uniform_filter(known.astype(np.float64), 2 * half + 1, mode="constant")
        new = ~done & (share > 0.5 / (2 * half + 1) ** 2)
        mean = ndimage.uniform_filter(source, 2 * half + 1, mode="constant")
        out[new] = mean[new] / share[new]
        done |= new
        half = -(-3 * half // 2)
    _relax(out, known, _RELAXATIONS)
    return out + base


@compiled()
def _relax(values: Floats, known: Bools, passes: int) -> None:
    """Move each unknown cell to the mean of its four neighbours, all at once, several times."""
    rows, columns = values.shape
    last = values.copy()
    for _ in range(passes):
        for i in range(rows):
            for j in range(columns):
                if not known[i, j]:
                    values[i, j] = 0.25 * (
                        last[max(i - 1, 0), j]
                        + last[min(i + 1, rows - 1), j]
                        + last[i, max(j - 1, 0)]
                        + last[i, min(j + 1, columns - 1)]
                    )
        for i in range(rows):
            for j in range(columns):
                last[i, j] = values[i, j]


def box_sum(values: Floats, half: int) -> Floats:
    """Sum over a square of ``2 * half + 1`` cells; what lies outside counts nothing."""
    weights = np.ones(2 * min(half, max(values.shape)) + 1)
    once = ndimage.correlate1d(values, weights, axis=0, mode="constant")
    return ndimage.correlate1d(once, weights, axis=1, mode="constant")


_SPACING_HALF = 5  # Half width of the window that counts known cells for their spacing, cells.


def cell_spacing(known: Bools) -> Floats:
    """Spacing of the known cells around each cell, in cells, at least one."""
    full = (2 * _SPACING_HALF + 1) ** 2
    count = box_sum(known.astype(np.float64), _SPACING_HALF)
    return np.sqrt(full / np.maximum(count, 1.0))


# Sparse random points leave gaps of about two spacings; a wider one is a shadow or a footprint.
_GAP_SPACINGS = 3.0
# A cell in it takes the lowest height of a window 1.5 times as wide as its way to a known cell.
_GAP_WIDENS = 1.5
_GAP_HALVES = (5, 7, 10, 14, 20, 28)


def _without_unseen_rises(
    filled_m: Floats, lowest_m: Floats, known: Bools, spacing_m: Floats, cell_m: float
) -> Floats:
    """Filled heights, but nothing rises in a wide gap: an object beyond it must stand out."""
    gap_m = ndimage.distance_transform_edt(~known) * cell_m
    near_m = ndimage.minimum_filter(spacing_m, 2 * _SPACING_HALF + 1, mode="nearest")
    far = gap_m > _GAP_SPACINGS * near_m
    out, inner = filled_m.copy(), 0.0
    height = np.where(known, lowest_m, np.inf)
    for half in _GAP_HALVES:
        ring = far & (gap_m > inner) & (gap_m <= half * cell_m / _GAP_WIDENS)
        inner = half * cell_m / _GAP_WIDENS
        if ring.any():
            lowest = ndimage.minimum_filter(height, 2 * half + 1, mode="nearest")
            out[ring] = np.minimum(out, lowest)[ring]
    return out


def _keeps_its_height(filled_m: Floats, settings: GroundFilter) -> Bools:
    """Cells that no opening lowers by more than its slope allows, from one cell to the widest.

    The structuring elements are octagons: each is the last one, grown by a square or a cross.
    """
    cell = settings.coarse_cell_m
    # Single precision relative to one height: a tenth of a millimetre over 500 m of relief.
    eroded = last = (filled_m - filled_m.flat[0]).astype(np.float32)
    kept = np.ones(filled_m.shape, bool)
    for radius in range(1, max(1, round(settings.max_object_width_m / 2 / cell)) + 1):
        eroded = _three_by_three(cv2.erode, eroded, radius)
        opened = eroded
        for step in range(radius, 0, -1):
            opened = _three_by_three(cv2.dilate, opened, step)
        kept &= last - opened <= settings.slope * radius * cell
        last = opened
    return kept


def _three_by_three(operation: Callable[..., Any], heights: Floats32, step: int) -> Floats32:
    """Erode or dilate by a cross in odd steps and by a square in even ones."""
    shape = cv2.MORPH_CROSS if step % 2 else cv2.MORPH_RECT
    element = cv2.getStructuringElement(shape, (3, 3))
    grown: Floats32 = operation(heights, element, borderType=cv2.BORDER_REPLICATE)
    return grown


# Ground that an opening cut off comes back where the ground at one side continues into it.

_RECOVERY_SPACINGS = 3.5  # Cut ground comes back from a half-disc of this many spacings.
_RECOVERY_CELLS = 12  # ... but no wider than this: it bounds the time in clouds with few cells.
# ... in which this share of the known cells is ground: a plateau and not a lawn beside a house.
_RECOVERY_SHARE = 0.7
_RECOVERY_CELLS_MIN = 6  # ... and at least so many, twice what a plane needs.
# A cell may lie this far from the plane of that half-disc, and further on a slope (per unit).
_RECOVERY_M = 0.3
# On 45 degrees twice the distance: heights within a cell differ by as much as it is wide.
_RECOVERY_PER_SLOPE_M = 0.3
_RECOVERY_STEEPEST = 1.0  # Steeper planes (45 degrees) say nothing about the cell beside them.
_RECOVERY_PASSES = 5  # Recovered strips grow inwards so many times.


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


# Lowest height of each coarse cell that other points of the cell support.
#
# Wet and shiny roads mirror: a scanner then sees points metres below them, in whole patches of
# cells, which no comparison with neighbouring cells can tell from a pit. In a dense cell they are
# few beside the points of the road, and a gap without points lies between.

# Height without points that parts mirror images from the road; kerbs and ditches have less.
_GAP_M = 1.0
# Points below a gap that are a smaller share of their cell are no ground; a mirrored road was up to
# so much of it on a mobile scan of a junction.
_SUPPORT = 0.1
# Cells with fewer points keep their lowest one: one point is no small share there.
_LEAST_POINTS = 50


def lowest_supported(grid: Grid, x: Floats, y: Floats, z: Floats) -> Floats:
    """Lowest supported height per cell (rows, columns); NaN where the cell is empty.

    Parameters
    ----------
    x, y, z : (n,) all points of the cells in question; points without a height do not count.
    """
    cell = flat_cells(grid, x, y)
    return _lowest(cell, z, grid.rows * grid.columns).reshape(grid.shape)


@compiled()
def _lowest(cell: Ints, z: Floats, cells: int) -> Floats:
    """Lowest supported height of each cell, NaN for none."""
    start = np.zeros(cells + 1, np.int64)
    for i in range(len(z)):
        if np.isfinite(z[i]):
            start[cell[i] + 1] += 1
    for c in range(cells):
        start[c + 1] += start[c]
    fill = start[:-1].copy()
    heights = np.empty(start[-1])
    for i in range(len(z)):
        if np.isfinite(z[i]):
            heights[fill[cell[i]]] = z[i]
            fill[cell[i]] += 1
    out = np.full(cells, np.nan)
    for c in range(cells):
        own = heights[start[c] : start[c + 1]]
        n = len(own)
        if n == 0:
            continue
        own.sort()
        out[c] = own[0]
        if n < _LEAST_POINTS:
            continue
        few = int(_SUPPORT * n) + 1
        for k in range(few - 1, 0, -1):
            if own[k] - own[k - 1] > _GAP_M:
                out[c] = own[k]
                break
    return out


# Points and the cells of a grid, in one pass over the points each.
#
# What `grids` does with arrays takes half the time of the ground filter; these give the same.


def flat_cells(grid: Grid, x: Floats, y: Floats) -> Ints:
    """Row-major cell number (n,) of points, as `Grid.flat`."""
    return _flat(x, y, grid.west, grid.south, grid.columns, grid.rows, grid.cell_size_m)


@compiled()
def _flat(
    x: Floats, y: Floats, west: int, south: int, columns: int, rows: int, cell_m: float
) -> Ints:
    out = np.empty(len(x), np.int64)
    for k in range(len(x)):
        column = min(max(int(np.floor(x[k] / cell_m)) - west, 0), columns - 1)
        row = min(max(int(np.floor(y[k] / cell_m)) - south, 0), rows - 1)
        out[k] = row * columns + column
    return out


def sample_three(
    grid: Grid, values: tuple[Floats, Floats, Floats], x: Floats, y: Floats
) -> tuple[Floats, Floats, Floats]:
    """Three arrays (rows, columns) at points, each (n,), as `sample_bilinear`."""
    out = _sample(x, y, *values, grid.west, grid.south, grid.cell_size_m)
    return out[0], out[1], out[2]


@compiled()
def _sample(
    x: Floats,
    y: Floats,
    first: Floats,
    second: Floats,
    third: Floats,
    west: int,
    south: int,
    cell_m: float,
) -> Floats:
    """Three grids at points, (3, n), bilinear between cell centres and constant outside."""
    rows, columns = first.shape
    out = np.empty((3, len(x)))
    for k in range(len(x)):
        column = min(max(x[k] / cell_m - west - 0.5, 0.0), columns - 1.0)
        row = min(max(y[k] / cell_m - south - 0.5, 0.0), rows - 1.0)
        j, i = int(column), int(row)
        v, u = column - j, row - i
        b, a = min(j + 1, columns - 1), min(i + 1, rows - 1)
        w00, w01, w10, w11 = (1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v
        out[0, k] = w00 * first[i, j] + w01 * first[i, b] + w10 * first[a, j] + w11 * first[a, b]
        out[1, k] = (
            w00 * second[i, j] + w01 * second[i, b] + w10 * second[a, j] + w11 * second[a, b]
        )
        out[2, k] = w00 * third[i, j] + w01 * third[i, b] + w10 * third[a, j] + w11 * third[a, b]
    return out
