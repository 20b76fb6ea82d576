"""Coarse ground surface: progressive opening of the lowest heights, without pits.

Progressive morphological opening in the manner of SMRF (Pingel, Clarke and McBride 2013,
doi:10.1016/j.isprsjprs.2012.12.002), with a lower slope than theirs; what that cuts off terrace
edges and ridges comes back where the ground at one side continues into it (`recovery`).

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
from roadsight.scene.terrain.recovery import recover

_PIT_SHARE = 0.2
"""A cell is multipath if it lies below four fifths of those around, by more than ground departs
from a plane."""
_PIT_PASSES = 2
"""Pits beside pits are found once those are gone."""
_PIT_HALVES = (2, 4, 8, 16)
"""Windows that tell a pit, half widths in cells: the first that holds so many known cells."""
_PIT_CELLS = 8
"""As many as surround a cell; fewer may be a pit's own neighbours."""
_PIT_ABYSS_M = 3.0
"""Little drops so far within two cells, so that what is as deep gets a second look in wider
windows: pits come in clusters. Airborne scans of a generated valley have some of 4 m: at 6 m of
depth, its ridges were cut off between them. Cliffs of an ISPRS sample cost 0.1 points."""
_PIT_WIDEST = 8
"""... but no wider, half width in cells: courtyards and streets between roofs are wider."""
_PIT_ROUGH = 1 / 15
"""Ground above a pit may be as rough as this share of its depth; crowns above the ground of a wood
are rougher."""
_GAP_SPACINGS = 3.0
"""Sparse random points leave gaps of about two spacings; a wider one is a shadow or a footprint."""
_GAP_WIDENS = 1.5
"""A cell in it takes the lowest height of a window 1.5 times as wide as its way to a known cell."""
_GAP_HALVES = (5, 7, 10, 14, 20, 28)
_SPACING_HALF = 5
"""Half width of the window that counts known cells for their spacing, cells."""
_RELAXATIONS = 30
"""Jacobi passes that smooth filled gaps."""


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


def cell_spacing(known: Bools) -> Floats:
    """Spacing of the known cells around each cell, in cells, at least one."""
    full = (2 * _SPACING_HALF + 1) ** 2
    count = box_sum(known.astype(np.float64), _SPACING_HALF)
    return np.sqrt(full / np.maximum(count, 1.0))


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
