"""Robust pillar ground filter (paper 1, section 2.2, made safe against missing and false returns).

The published filter takes the lowest point of each 0.2 m pillar as its ground. That fails where a
pillar has no ground return (under vehicles, canopy, bridges) and where multipath puts a point below
the road. Here a coarse ground surface, found by progressive morphological opening in the manner of
SMRF (Pingel, Clarke and McBride 2013, doi:10.1016/j.isprsjprs.2012.12.002), says which points may
be ground at all; pillars then decide to the centimetre.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from roadsight.base.arrays import Bools, Floats
from roadsight.scene.grids import Grid, fill_gaps, lowest_per_cell, sample_bilinear

# A window that grows by one cell to each side takes at most this many cells of height off a bank of
# 1 : 1.5; what loses more has walls, however wide it is.
_STEEPEST_STEP = 1.5


@dataclass(frozen=True)
class GroundSettings:
    """Settings of the ground filter.

    Parameters
    ----------
    pillar_width_m : width and length of a pillar.
    height_threshold_m : a point higher than this above its pillar's ground is off-ground.
    coarse_cell_m : cell of the coarse surface.
    max_object_width_m : widest thing that is not ground (a large building).
    slope : steepest ground, rise over run, that the opening must keep.
    coarse_tolerance_m : how far from the coarse surface a pillar's ground may lie.
    """

    pillar_width_m: float = 0.2
    height_threshold_m: float = 0.1
    coarse_cell_m: float = 1.0
    max_object_width_m: float = 30.0
    slope: float = 0.2
    coarse_tolerance_m: float = 0.35


def ground_settings_for(spacing_m: float, settings: GroundSettings) -> GroundSettings:
    """Pillars and coarse cells at least two point spacings wide."""
    return replace(
        settings,
        pillar_width_m=max(settings.pillar_width_m, 2 * spacing_m),
        coarse_cell_m=max(settings.coarse_cell_m, 2 * spacing_m),
    )


def coarse_ground(lowest_m: Floats, settings: GroundSettings) -> tuple[Floats, Floats]:
    """Coarse ground surface and its slope from the lowest height of each cell.

    Parameters
    ----------
    lowest_m : (rows, columns) lowest height per coarse cell, NaN where the cell is empty.

    Returns
    -------
    surface_m, slope : (rows, columns) without NaN; slope is rise over run.
    """
    cell = settings.coarse_cell_m
    surface = fill_gaps(_without_low_outliers(lowest_m, cell))
    ground = np.ones(surface.shape, dtype=bool)
    tallest_m = cell * max(settings.slope, _STEEPEST_STEP)
    opened = surface
    for radius in range(1, max(1, round(settings.max_object_width_m / 2 / cell)) + 1):
        previous, opened = opened, ndimage.grey_opening(surface, size=2 * radius + 1)
        ground &= previous - opened <= min(settings.slope * radius * cell, tallest_m)
    known = np.where(ground & np.isfinite(lowest_m), surface, np.nan)
    surface = fill_gaps(known)
    steps = [np.gradient(surface, cell, axis=a) for a in (0, 1) if surface.shape[a] > 1]
    return surface, np.sqrt(sum((step**2 for step in steps), np.zeros_like(surface)))


def _without_low_outliers(lowest_m: Floats, cell_m: float) -> Floats:
    """NaN where a cell lies far below everything around it (multipath below the road)."""
    filled = fill_gaps(lowest_m)
    around = ndimage.median_filter(filled, size=5, mode="nearest")
    return np.where(filled < around - max(1.0, cell_m), np.nan, lowest_m)


def pillar_ground_m(
    x: Floats, y: Floats, z: Floats, coarse_m: Floats, slope: Floats, settings: GroundSettings
) -> Floats:
    """Ground height of each point's pillar, from the points near the coarse surface.

    A pillar's ground is its lowest point within the tolerance of the coarse surface. It must also
    agree with the pillars around it: where it stands out, upwards (the underside of a car) or
    downwards (multipath), or where the pillar has no such point, the neighbours decide.

    Parameters
    ----------
    x, y, z : (n,) local metres. coarse_m, slope : (n,) coarse surface at the points.

    Returns
    -------
    (n,) height of the ground below each point, local metres.
    """
    width = settings.pillar_width_m
    grid = Grid.around(x, y, width)
    tolerance = settings.coarse_tolerance_m + slope * settings.coarse_cell_m
    near = np.abs(z - coarse_m) <= tolerance
    lowest = lowest_per_cell(grid, x[near], y[near], z[near])
    if not near.any():
        return coarse_m
    around = ndimage.percentile_filter(fill_gaps(lowest), percentile=40, size=7, mode="nearest")
    cell_slope = lowest_per_cell(grid, x, y, slope)
    allowed = settings.height_threshold_m + 3 * width * fill_gaps(cell_slope)
    agreed = np.where(np.abs(lowest - around) <= allowed, lowest, np.nan)
    column, row = grid.indices(x, y)
    return fill_gaps(agreed)[row, column]


def ground_mask(
    x: Floats, y: Floats, z: Floats, coarse_m: Floats, slope: Floats, settings: GroundSettings
) -> Bools:
    """Which points lie on the ground: within the height threshold of their pillar's ground.

    Multipath points that lie below their pillar's ground by more than the threshold are not ground.
    """
    ground = pillar_ground_m(x, y, z, coarse_m, slope, settings)
    allowed = settings.height_threshold_m + 0.5 * settings.pillar_width_m * slope
    return np.abs(z - ground) <= allowed


def coarse_at(
    grid: Grid, surface_m: Floats, slope: Floats, x: Floats, y: Floats
) -> tuple[Floats, Floats]:
    """Coarse surface and slope at points, bilinear between cell centres."""
    return sample_bilinear(grid, surface_m, x, y), sample_bilinear(grid, slope, x, y)
