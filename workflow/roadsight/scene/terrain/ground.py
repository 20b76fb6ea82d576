"""Ground filter: a coarse surface says where the ground can be, pillars decide to the centimetre.

The published filter (paper 1, Table 3; `published_ground`, method pillars) takes heights above the
lowest point of each pillar of 0.2 m. That fails where a pillar has no ground return (under
vehicles, canopy, bridges, behind walls), where multipath lies below the road, and where the points
are too far apart for 0.2 m.

1. Coarse surface: progressive morphological opening in the manner of SMRF (Pingel, Clarke and
   McBride 2013, doi:10.1016/j.isprsjprs.2012.12.002), with a lower slope than theirs; what that
   cuts off terrace edges and ridges comes back where the ground at one side continues into it.
2. Pillars as wide as the local spacing of ground points asks for: the lowest point that its
   neighbours confirm. Points within a height threshold of it are ground. The threshold is the
   set one, wider where the layer of ground points is thick (registration noise) and narrow where
   an object stands in the pillar. Where a layer is rough, but not all around, and something wider
   than a trunk stands in it, it is the bottom of a hedge or a crown that hides the ground.
3. Where not even a coarse cell holds several points: the distance from the coarse surface, with a
   tolerance that grows with spacing and slope.

Spacing and noise are local: nothing depends on points further than `reach_m`, except through
the coarse surface, which knows `GroundFilter.max_object_width_m` around and gaps.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.special import ndtri

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.kernels import compiled
from roadsight.base.sections.scene import GroundFilter
from roadsight.scene.grids import Grid, lowest_per_cell
from roadsight.scene.terrain.coarse import CoarseGround, box_sum, flat_cells, sample_three
from roadsight.scene.terrain.ground_settings import (
    ROUGHNESS_PER_SPACING,
    around_pillars,
    hedge_pillars,
    pillar_reach_m,
    pillar_widths_m,
    steady_pillars,
)

# SMRF's elevation scalar, per coarse cell: the surface is the lowest point of a cell.
_SLOPE_SCALAR = 1.25
# A usual kerb (they are 3 to 25 cm): less than this above the lowest point proves no object.
_KERB_M = 0.15
# Points from the kerb's height up to this prove an object that stands in the pillar.
_OBJECT_TOP_M = 0.75
_ENOUGH_POINTS = 10  # Counts per pillar beyond this say no more: a wall has thousands of points.
# Share of a layer's points that its noise throws beyond its end: they prove no object.
_STRAYS = 0.02
_CLEAN_SHARE = 0.2  # Share of points above from which a pillar is no pattern for its neighbours.
_OBJECT_SHARE = 0.4  # Share of points above from which the narrow threshold holds alone.
# A point within so many sigmas of the ground layer is of it where an object stands.
_NARROW_SIGMAS = 0.5
_NARROW_LEAST_M = 0.02  # ... and never less: range noise of a scanner.
_WIDE_SIGMAS = 3.0  # ... and elsewhere.
_LAYER_M = 0.25  # Layer above the lowest point whose spread is measured first: five sigmas of 5 cm.
# Roughness of a road and grass: the middle is taken of at least so thick a layer.
_LEAST_LAYER_M = 0.1
# Noise that fills that layer is measured once more, in one so much thicker than it seems: 8 cm seem
# to be 6.
_LAYER_MARGIN = 1.3
_LAYER_SIGMAS = 4.0  # Least thickness of the layer above its lowest point.
# The layer ends so far above its middle; with 40 points to a pillar the lowest lies 2.2 below.
_ABOVE_MIDDLE_SIGMAS = 2.5
# The bottom of a hedge is so many times as rough as the smoothest layer around; streets gain as
# much F1 with 1.5, and lose 0.05 of it with 3.
_HEDGE_RATIO = 2.0
# ... and its spread at least this share of the height threshold, 2 cm in the finest pillars: grass
# has less. Streets gain 0.3 of F1 with 0.15 to 0.2.
_HEDGE_SHARE = 0.2
# In pillars wider than so many of the finest, the relief of the ground itself is as thick.
_HEDGE_WIDTHS = 2.0
# Percentile of the lowest points around: below the middle, since objects are above the ground.
_AROUND_PERCENTILE = 25
# Grass and objects only add to a spread: the low ones show the noise itself.
_SPREAD_PERCENTILE = 15
# Standard errors of a spread that this percentile lies below the noise, on flat planes.
_LOW_BY_CHANCE = 0.65
_SPREAD_POINTS = 4  # Points in a pillar that can tell its spread.


def ground_mask(
    x: Floats, y: Floats, z: Floats, coarse: CoarseGround, settings: GroundFilter
) -> Bools:
    """Which points lie on the ground.

    Parameters
    ----------
    x, y, z : (n,) local metres; points without a finite height are not ground.
    """
    if len(x) == 0 or np.isnan(coarse.surface_m).all():
        return np.zeros(len(x), bool)
    cell = settings.coarse_cell_m
    rise, slope, spacing = above_coarse(x, y, z, coarse)
    allowed = settings.height_threshold_m + ROUGHNESS_PER_SPACING * spacing
    allowed += _SLOPE_SCALAR * cell * slope
    mask = np.abs(rise) <= allowed
    grid = Grid.around(x, y, cell)
    level, flat = _pillar_level(grid, x, y, mask, settings)
    widths = pillar_widths_m(settings)
    for number, width in enumerate(widths):
        chosen = level == number
        if not chosen.any():
            continue
        base = settings.height_threshold_m + ROUGHNESS_PER_SPACING * (width - widths[0]) / 2
        grown = int(np.ceil(pillar_reach_m(width) / cell))
        around = ndimage.maximum_filter(chosen, 2 * grown + 1, mode="constant")
        part = np.flatnonzero(around.ravel()[flat])
        own = chosen.ravel()[flat[part]]
        found = pillar_mask(x[part], y[part], rise[part], slope[part], width, base, settings)
        mask[part[own]] = found[own]
    return mask


def published_ground(x: Floats, y: Floats, z: Floats, settings: GroundFilter) -> Bools:
    """Which points are ground by the published rule (paper 1, Table 3).

    Points more than the threshold above the lowest point of their pillar are not. The paper gives
    the width and the threshold; that heights count from the lowest point is a guess.

    Parameters
    ----------
    x, y, z : (n,) local metres, all points of the pillars in question; points without a finite
        height are not ground.
    """
    known = np.isfinite(z)
    grid = Grid.around(x, y, settings.pillar_width_m)
    lowest = lowest_per_cell(grid, x[known], y[known], z[known]).ravel()
    rise = np.where(known, z, np.inf) - lowest[flat_cells(grid, x, y)]
    return rise <= settings.height_threshold_m


def above_coarse(
    x: Floats, y: Floats, z: Floats, coarse: CoarseGround
) -> tuple[Floats, Floats, Floats]:
    """Height above the coarse surface (infinite for none), its slope and spacing, each (n,)."""
    surface, slope, spacing = sample_three(
        coarse.grid, (coarse.surface_m, coarse.slope, coarse.spacing_m), x, y
    )
    rise = z - surface
    return np.where(np.isfinite(rise), rise, np.inf), slope, spacing


def _pillar_level(
    grid: Grid, x: Floats, y: Floats, near: Bools, settings: GroundFilter
) -> tuple[Ints, Ints]:
    """Number (rows, columns) of the pillars' width in each cell, and the points' cells (n,).

    A pillar is two spacings of the ground points wide, measured over three by three coarse cells.
    Where none is, the number is that of the widths.
    """
    flat = flat_cells(grid, x, y)
    cells = grid.rows * grid.columns
    count = np.bincount(flat, near, minlength=cells).reshape(grid.shape)
    area = box_sum((count > 0).astype(np.float64), 1) * grid.cell_size_m**2
    near_count = box_sum(count.astype(np.float64), 1)
    spacing = np.sqrt(area / np.maximum(near_count, 1e-9))
    widths = np.array(pillar_widths_m(settings))
    level = np.searchsorted(widths, 2 * spacing * (1 - 1e-12))
    level[area == 0] = len(widths)
    return level, flat


def pillar_mask(
    x: Floats,
    y: Floats,
    rise_m: Floats,
    slope: Floats,
    width_m: float,
    base_m: float,
    settings: GroundFilter,
) -> Bools:
    """Ground points by pillars of one width.

    Parameters
    ----------
    x, y : (n,) local metres. rise_m : (n,) height above the coarse surface, infinite for none.
    slope : (n,) of the coarse surface. base_m : height threshold at this width.
    """
    grid = Grid.around(x, y, width_m)
    flat = flat_cells(grid, x, y)
    tilt, shape = 0.5 * width_m * slope, grid.shape
    near_m = settings.coarse_tolerance_m + settings.coarse_cell_m * slope
    lowest, tilt_of = _lowest_and_tilt(flat, rise_m, near_m, tilt, *shape)
    half = around_pillars(width_m)
    around = window_percentile(lowest, half, _AROUND_PERCENTILE)
    around = np.where(np.isnan(around), 0.0, around)
    sigma, thick = _layer_sigma_m(flat, rise_m, tilt, lowest, half, steady_pillars(width_m))
    agrees = np.abs(lowest - around) <= base_m + 3 * sigma + 2 * tilt_of
    level = np.where(agrees, lowest, around)
    # Share of the low points of a pillar and its eight neighbours that stand above a kerb.
    low, high = _low_and_high(
        flat, rise_m, level, tilt, np.maximum(base_m, thick), _KERB_M, _OBJECT_TOP_M
    )
    high = np.maximum(high - _STRAYS * low, 0)
    low, high = (box_sum(np.minimum(c, _ENOUGH_POINTS), 1) for c in (low, high))
    share = high / np.maximum(low + high, 1)
    clean = agrees & (share < _CLEAN_SHARE)
    pattern = _mean_around(level, clean, 1)
    pattern = np.where(np.isnan(pattern), level, pattern)
    layer = np.where(clean, np.maximum(_LEAST_LAYER_M, thick), np.nan)
    count, total = (box_sum(c, 2) for c in _layer_mean(flat, rise_m, tilt, pattern, layer))
    middle = total / np.maximum(count, 1)
    highest = ndimage.maximum_filter(np.where(clean, level, -np.inf), 3, mode="nearest")
    wide = np.maximum(base_m, _WIDE_SIGMAS * sigma)
    narrow = np.minimum(wide, np.maximum(_NARROW_LEAST_M, _NARROW_SIGMAS * sigma))
    allowed = wide + (narrow - wide) * np.clip(share / _OBJECT_SHARE, 0, 1)
    if width_m <= _HEDGE_WIDTHS * settings.pillar_width_m:
        # Layers much rougher than the smoothest one around. Noise of registration changes slowly,
        # so that it is about the same so far away. A spread of 0 is an unknown one.
        known = np.where(sigma > 0, sigma, np.inf)
        floor = ndimage.minimum_filter(known, 2 * steady_pillars(width_m) + 1, mode="nearest")
        rough = (sigma > _HEDGE_SHARE * base_m) & (sigma > _HEDGE_RATIO * floor)
        side = hedge_pillars(width_m)
        hedge = ndimage.binary_opening(rough & (share >= _CLEAN_SHARE), np.ones((side, side)))
        allowed = np.where(hedge, -np.inf, allowed)
    # The face of a kerb lies between the levels at its two sides.
    top = np.maximum(pattern, highest) + middle + allowed
    return _between(flat, rise_m, tilt, pattern + middle - allowed, top)


@compiled()
def _lowest_and_tilt(
    flat: Ints, rise: Floats, near: Floats, tilt: Floats, rows: int, columns: int
) -> tuple[Floats, Floats]:
    """Lowest rise of the near points of a pillar, NaN for none, and the largest tilt of all."""
    lowest, largest = np.full(rows * columns, np.nan), np.zeros(rows * columns)
    for k in range(len(flat)):
        cell = flat[k]
        largest[cell] = max(largest[cell], tilt[k])
        if abs(rise[k]) <= near[k] and not rise[k] >= lowest[cell]:
            lowest[cell] = rise[k]
    return lowest.reshape(rows, columns), largest.reshape(rows, columns)


def _layer_sigma_m(
    flat: Ints, rise: Floats, tilt: Floats, lowest: Floats, half: int, far: int
) -> tuple[Floats, Floats]:
    """Noise of the ground's layer and its thickness above the lowest point, each (rows, columns).

    Grass and objects only add to a pillar's spread, so that a low percentile of those around shows
    the noise itself; but of the spreads of few points, the low ones are low by chance as well.
    A layer too thick for the first measurement is noise only where all pillars around, ``far`` of
    them, say so; a hedge ends sooner.
    """
    layer_m = np.full(lowest.shape, _LAYER_M)
    sigma, thick = _spread_m(flat, rise, tilt, lowest, layer_m, half)
    steady = ndimage.minimum_filter(np.where(sigma > 0, thick, np.inf), 2 * far + 1, mode="nearest")
    more = np.isfinite(steady) & (steady > _LAYER_M)
    if more.any():
        layer_m[more] = _LAYER_MARGIN * steady[more]
        sigma, thick = _spread_m(flat, rise, tilt, lowest, layer_m, half)
    return sigma, thick


def _spread_m(
    flat: Ints, rise: Floats, tilt: Floats, lowest: Floats, layer_m: Floats, half: int
) -> tuple[Floats, Floats]:
    """Noise and thickness of the layer, as far as it lies within one of ``layer_m``."""
    count, total, square = _layer_moments(flat, rise, tilt, lowest, layer_m)
    mean = total / np.maximum(count, 1)
    # The largest of a few points is no outlier here: the plain sigma, with n - 1.
    variance = (square - count * mean**2) / np.maximum(count - 1, 1)
    tells = count >= _SPREAD_POINTS
    spread = np.where(tells, np.sqrt(np.maximum(variance, 0)), np.nan)
    sigma = window_percentile(spread, half, _SPREAD_PERCENTILE)
    points = _mean_around(count, tells, half)
    points = np.where(np.isnan(points), np.inf, points)
    sigma /= 1 - _LOW_BY_CHANCE / np.sqrt(2 * (points - 1))
    sigma = np.where(np.isnan(sigma), 0.0, sigma)
    # Expected lowest of n normal values (Blom 1958), below their middle.
    depth = ndtri(1 - 0.625 / (np.minimum(points, 1e6) + 0.25))
    return sigma, sigma * np.maximum(_LAYER_SIGMAS, _ABOVE_MIDDLE_SIGMAS + depth)


@compiled()
def _layer_moments(
    flat: Ints, rise: Floats, tilt: Floats, lowest: Floats, layer_m: Floats
) -> tuple[Floats, Floats, Floats]:
    """Number, sum and sum of squares of heights above the lowest, each (rows, columns)."""
    count, total, square = np.zeros(lowest.shape), np.zeros(lowest.shape), np.zeros(lowest.shape)
    level, n, s, q = lowest.ravel(), count.ravel(), total.ravel(), square.ravel()
    thick = layer_m.ravel()
    for k in range(len(flat)):
        cell = flat[k]
        above = rise[k] - level[cell]
        if above >= 0 and above <= thick[cell] + tilt[k]:
            n[cell] += 1
            s[cell] += above
            q[cell] += above * above
    return count, total, square


@compiled()
def _low_and_high(
    flat: Ints,
    rise: Floats,
    level: Floats,
    tilt: Floats,
    layer_m: Floats,
    kerb_m: float,
    top_m: float,
) -> tuple[Floats, Floats]:
    """Number of points in the layer at a level, and of those above it and a kerb."""
    low, high = np.zeros(level.shape), np.zeros(level.shape)
    at, thick, inside, higher = level.ravel(), layer_m.ravel(), low.ravel(), high.ravel()
    for k in range(len(flat)):
        cell = flat[k]
        above = rise[k] - at[cell]
        if abs(above) <= thick[cell] + tilt[k]:
            inside[cell] += 1
        if above > max(kerb_m, thick[cell]) + tilt[k] and above <= top_m:
            higher[cell] += 1
    return low, high


def _mean_around(values: Floats, chosen: Bools, half: int) -> Floats:
    """Mean of the chosen cells of a window; NaN where there is none."""
    count = box_sum(chosen.astype(np.float64), half)
    total = box_sum(np.where(chosen, values, 0.0), half)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


@compiled()
def _layer_mean(
    flat: Ints, rise: Floats, tilt: Floats, pattern: Floats, thick_m: Floats
) -> tuple[Floats, Floats]:
    """Number and sum of the heights above a level, in a layer that is NaN where none counts."""
    count, total = np.zeros(pattern.shape), np.zeros(pattern.shape)
    at, thick, n, s = pattern.ravel(), thick_m.ravel(), count.ravel(), total.ravel()
    for k in range(len(flat)):
        cell = flat[k]
        above = rise[k] - at[cell]
        if abs(above) <= thick[cell] + tilt[k]:
            n[cell] += 1
            s[cell] += above
    return count, total


@compiled()
def _between(flat: Ints, rise: Floats, tilt: Floats, bottom: Floats, top: Floats) -> Bools:
    """Points between two levels, widened by the tilt."""
    low, high = bottom.ravel(), top.ravel()
    out = np.empty(len(flat), np.bool_)
    for k in range(len(flat)):
        cell = flat[k]
        out[k] = rise[k] >= low[cell] - tilt[k] and rise[k] <= high[cell] + tilt[k]
    return out


def window_percentile(values: Floats, half: int, percent: int) -> Floats:
    """Percentile of the known values of a window, first along the columns, then along the rows.

    Parameters
    ----------
    values : (rows, columns), NaN where unknown. half : the window is ``2 * half + 1`` wide.

    Returns
    -------
    (rows, columns), NaN where the window knows nothing
    """
    columns = _line_percentile(np.ascontiguousarray(values.T), half, percent / 100).T
    return _line_percentile(np.ascontiguousarray(columns), half, percent / 100)


@compiled()
def _line_percentile(values: Floats, half: int, share: float) -> Floats:
    """Percentile (the nearest rank) of the known values around, along each row."""
    rows, columns = values.shape
    out = np.full((rows, columns), np.nan)
    near = np.empty(2 * half + 1)
    for i in range(rows):
        n = 0
        for k in range(-half, columns):
            # The window's values stay in order: one leaves, one enters.
            if k > half:
                value = values[i, k - half - 1]
                if not np.isnan(value):
                    m = 0
                    while near[m] < value:
                        m += 1
                    n -= 1
                    while m < n:
                        near[m] = near[m + 1]
                        m += 1
            if k + half < columns and k + half >= 0:
                value = values[i, k + half]
                if not np.isnan(value):
                    m = n
                    while m > 0 and near[m - 1] > value:
                        near[m] = near[m - 1]
                        m -= 1
                    near[m] = value
                    n += 1
            if k >= 0 and n > 0:
                out[i, k] = near[int(share * (n - 1) + 0.5)]
    return out
