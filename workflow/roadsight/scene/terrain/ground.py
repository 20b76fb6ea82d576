"""Ground filter: a coarse surface says where the ground can be, pillars decide to the centimetre.

The published filter takes the lowest point of each 0.2 m pillar as its ground (paper 1, section
2.2). That fails where a pillar has no ground return (under vehicles, canopy, bridges, behind
walls), where multipath lies below the road, and where the points are too far apart for 0.2 m.

1. Coarse surface: progressive morphological opening in the manner of SMRF (Pingel, Clarke and
   McBride 2013, doi:10.1016/j.isprsjprs.2012.12.002), with a lower slope than theirs; what that
   cuts off terrace edges and ridges comes back where the ground at one side continues into it.
2. Pillars as wide as the local spacing of ground points asks for: the lowest point that its
   neighbours confirm. Points within a height threshold of it are ground. The threshold is the
   set one, wider where the layer of ground points is thick (registration noise) and narrow where
   an object stands in the pillar.
3. Where not even a coarse cell holds several points: the distance from the coarse surface, with a
   tolerance that grows with spacing and slope.

Spacing and noise are local: nothing depends on points further than `reach_m`, except through
the coarse surface, which knows `GroundSettings.max_object_width_m` around and gaps.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numba import njit
from scipy import ndimage

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.scene.grids import Grid, lowest_per_cell, sample_bilinear
from roadsight.scene.terrain.coarse import CoarseGround, box_sum
from roadsight.scene.terrain.ground_settings import (
    ROUGHNESS_PER_SPACING,
    GroundSettings,
    around_pillars,
    pillar_reach_m,
    pillar_widths_m,
)
from roadsight.scene.terrain.repeats import first_of_each

_SLOPE_SCALAR = 1.25
"""SMRF's elevation scalar, per coarse cell: the surface is the lowest point of a cell."""
_KERB_M = 0.15
"""A usual kerb (they are 3 to 25 cm): less than this above the lowest point proves no object."""
_OBJECT_TOP_M = 0.75
"""Points from the kerb's height up to this prove an object that stands in the pillar."""
_ENOUGH_POINTS = 10
"""Counts per pillar beyond this say no more: a wall has thousands of points."""
_CLEAN_SHARE = 0.2
"""Share of points above from which a pillar is no pattern for its neighbours."""
_OBJECT_SHARE = 0.4
"""Share of points above from which the narrow threshold holds alone."""
_NARROW_SIGMAS = 1.0
"""A point within so many sigmas of the ground layer is of it where an object stands."""
_NARROW_LEAST_M = 0.02
_WIDE_SIGMAS = 3.0
"""... and elsewhere."""
_LAYER_M = 0.25
"""Thickest layer whose noise is measured: five sigmas of 5 cm."""
_AROUND_PERCENTILE = 25
"""Percentile of the lowest points around: below the middle, since objects are above the ground."""
_SPREAD_PERCENTILE = 15
"""Grass and objects only add to a spread: the low ones show the noise itself."""
_SPREAD_POINTS = 4
"""Points in a pillar that can tell its spread."""


def ground_mask(
    x: Floats, y: Floats, z: Floats, coarse: CoarseGround, settings: GroundSettings
) -> Bools:
    """Which points lie on the ground.

    Parameters
    ----------
    x, y, z : (n,) local metres; points without a finite height are not ground.
    """
    if len(x) == 0 or np.isnan(coarse.surface_m).all():
        return np.zeros(len(x), bool)
    first = first_of_each(x, y, z)
    once = np.flatnonzero(first == np.arange(len(x)))
    if len(once) < len(x):
        # Shares and spreads count points: a repeated one must not weigh twice.
        out = np.zeros(len(x), bool)
        out[once] = ground_mask(x[once], y[once], z[once], coarse, settings)
        return out[first]
    rise = z - sample_bilinear(coarse.grid, coarse.surface_m, x, y)
    slope = sample_bilinear(coarse.grid, coarse.slope, x, y)
    spacing = sample_bilinear(coarse.grid, coarse.spacing_m, x, y)
    allowed = settings.height_threshold_m + ROUGHNESS_PER_SPACING * spacing
    allowed += _SLOPE_SCALAR * settings.coarse_cell_m * slope
    mask = np.abs(rise) <= allowed
    rise = np.where(np.isfinite(rise), rise, np.inf)
    widths = pillar_widths_m(settings)
    for width, own, part in _by_pillar_width(x, y, np.abs(rise) <= allowed, settings):
        base = settings.height_threshold_m
        base += ROUGHNESS_PER_SPACING * (width - widths[0]) / 2
        found = pillar_mask(x[part], y[part], rise[part], slope[part], width, base, settings)
        mask[own] = found[own[part]]
    return mask


def _by_pillar_width(
    x: Floats, y: Floats, near: Bools, settings: GroundSettings
) -> Iterator[tuple[float, Bools, Bools]]:
    """Each width of pillars, the points it decides, and these with what is near enough to matter.

    A pillar is two spacings of the ground points wide, measured over three by three coarse cells.
    """
    cell = settings.coarse_cell_m
    grid = Grid.around(x, y, cell)
    flat = grid.flat(x, y)
    cells = grid.rows * grid.columns
    count = np.bincount(flat[near], minlength=cells).reshape(grid.shape).astype(np.float64)
    area = box_sum((count > 0).astype(np.float64), 1) * cell**2
    spacing = np.sqrt(area / np.maximum(box_sum(count, 1), 1e-9))
    widths = np.array(pillar_widths_m(settings))
    level = np.searchsorted(widths, 2 * spacing * (1 - 1e-12))
    level[area == 0] = len(widths)
    for number, width in enumerate(widths):
        chosen = level == number
        if not chosen.any():
            continue
        grown = int(np.ceil(pillar_reach_m(float(width)) / cell))
        around = ndimage.maximum_filter(chosen, 2 * grown + 1, mode="constant")
        yield float(width), chosen.ravel()[flat], around.ravel()[flat]


def pillar_mask(
    x: Floats,
    y: Floats,
    rise_m: Floats,
    slope: Floats,
    width_m: float,
    base_m: float,
    settings: GroundSettings,
) -> Bools:
    """Ground points by pillars of one width.

    Parameters
    ----------
    x, y : (n,) local metres. rise_m : (n,) height above the coarse surface, infinite for none.
    slope : (n,) of the coarse surface. base_m : height threshold at this width.
    """
    grid = Grid.around(x, y, width_m)
    flat = grid.flat(x, y)
    tilt = 0.5 * width_m * slope
    near = np.abs(rise_m) <= settings.coarse_tolerance_m + settings.coarse_cell_m * slope
    if not near.any():
        return np.zeros(len(x), bool)
    lowest = lowest_per_cell(grid, x[near], y[near], rise_m[near])
    half = around_pillars(width_m)
    around = window_percentile(lowest, half, _AROUND_PERCENTILE)
    around = np.where(np.isnan(around), 0.0, around)
    sigma = _layer_sigma_m(grid, flat, rise_m, tilt, lowest, half)
    tilt_of = _largest(grid, flat, tilt)
    agrees = np.abs(lowest - around) <= base_m + 3 * sigma + 2 * tilt_of
    level = np.where(agrees, lowest, around)
    share = _object_share(grid, flat, rise_m, level, tilt, np.maximum(base_m, 4 * sigma))
    clean = agrees & (share < _CLEAN_SHARE)
    pattern = _mean_around(level, clean, 1)
    pattern = np.where(np.isnan(pattern), level, pattern)
    middle, highest = _layer_middle_m(grid, flat, rise_m, tilt, pattern, level, clean, sigma)
    wide = np.maximum(base_m, _WIDE_SIGMAS * sigma)
    narrow = np.minimum(wide, np.maximum(_NARROW_LEAST_M, _NARROW_SIGMAS * sigma))
    allowed = wide + (narrow - wide) * np.clip(share / _OBJECT_SHARE, 0, 1)
    centre, top = (pattern + middle).ravel()[flat], (highest + middle).ravel()[flat]
    allowed = allowed.ravel()[flat] + tilt
    # The face of a kerb lies between the levels at its two sides.
    return (rise_m >= centre - allowed) & (rise_m <= np.maximum(centre, top) + allowed)


def _layer_sigma_m(
    grid: Grid, flat: Ints, rise: Floats, tilt: Floats, lowest: Floats, half: int
) -> Floats:
    """Noise of the ground's layer: the lower quartile of the pillars' spreads around.

    Grass and objects only add to a pillar's spread, so that the low ones show the noise itself.
    """
    above = rise - lowest.ravel()[flat]
    layer = (above >= 0) & (above <= _LAYER_M + tilt)
    count, total, square = _moments(grid, flat[layer], above[layer])
    mean = total / np.maximum(count, 1)
    # The largest of a few points is no outlier here: the plain sigma, with n - 1.
    variance = (square - count * mean**2) / np.maximum(count - 1, 1)
    spread = np.where(count >= _SPREAD_POINTS, np.sqrt(np.maximum(variance, 0)), np.nan)
    sigma = window_percentile(spread, half, _SPREAD_PERCENTILE)
    return np.where(np.isnan(sigma), 0.0, sigma)


def _moments(grid: Grid, flat: Ints, values: Floats) -> tuple[Floats, Floats, Floats]:
    """Number, sum and sum of squares of values per cell, each (rows, columns)."""
    cells = grid.rows * grid.columns
    sums = [np.bincount(flat, w, minlength=cells) for w in (None, values, values**2)]
    count, total, square = (s.astype(np.float64).reshape(grid.shape) for s in sums)
    return count, total, square


def _largest(grid: Grid, flat: Ints, values: Floats) -> Floats:
    """Largest value per cell, zero in empty ones."""
    out = np.zeros(grid.rows * grid.columns)
    np.maximum.at(out, flat, values)
    return out.reshape(grid.shape)


def _object_share(
    grid: Grid,
    flat: Ints,
    rise: Floats,
    level: Floats,
    tilt: Floats,
    layer_m: Floats,
) -> Floats:
    """Share of the low points of a pillar and its eight neighbours that stand above a kerb."""
    above = rise - level.ravel()[flat]
    thick = layer_m.ravel()[flat]
    cells = grid.rows * grid.columns
    inside = np.abs(above) <= thick + tilt
    higher = (above > np.maximum(_KERB_M, thick) + tilt) & (above <= _OBJECT_TOP_M)
    count = [np.bincount(flat[m], minlength=cells).reshape(grid.shape) for m in (inside, higher)]
    low, high = (box_sum(np.minimum(c, _ENOUGH_POINTS).astype(np.float64), 1) for c in count)
    return high / np.maximum(low + high, 1)


def _mean_around(values: Floats, chosen: Bools, half: int) -> Floats:
    """Mean of the chosen cells of a window; NaN where there is none."""
    count = box_sum(chosen.astype(np.float64), half)
    total = box_sum(np.where(chosen, values, 0.0), half)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _layer_middle_m(
    grid: Grid,
    flat: Ints,
    rise: Floats,
    tilt: Floats,
    pattern: Floats,
    level: Floats,
    clean: Bools,
    sigma: Floats,
) -> tuple[Floats, Floats]:
    """Middle of the layer above the pattern of lowest points, and the highest level beside."""
    above = rise - pattern.ravel()[flat]
    thick = np.maximum(0.1, 4 * sigma).ravel()[flat] + tilt
    layer = clean.ravel()[flat] & (np.abs(above) <= thick)
    count, total, _ = _moments(grid, flat[layer], above[layer])
    count, total = box_sum(count, 2), box_sum(total, 2)
    middle = total / np.maximum(count, 1)
    highest = ndimage.maximum_filter(np.where(clean, level, -np.inf), 3, mode="nearest")
    return middle, highest


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


@njit(cache=True)
def _line_percentile(values: Floats, half: int, share: float) -> Floats:
    """Percentile (the nearest rank) of the known values around, along each row."""
    rows, columns = values.shape
    out = np.full((rows, columns), np.nan)
    near = np.empty(2 * half + 1)
    for i in range(rows):
        for j in range(columns):
            n = 0
            for k in range(max(0, j - half), min(columns, j + half + 1)):
                value = values[i, k]
                if np.isnan(value):
                    continue
                m = n
                while m > 0 and near[m - 1] > value:
                    near[m] = near[m - 1]
                    m -= 1
                near[m] = value
                n += 1
            if n > 0:
                out[i, j] = near[int(share * (n - 1) + 0.5)]
    return out
