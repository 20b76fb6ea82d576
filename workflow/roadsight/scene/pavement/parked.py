"""Footprints of parked vehicles as seen from the air: what stands on the pavement's own rim."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from roadsight.base.arrays import Bools, Floats

LOWEST_M = 0.5
"""Returns of a vehicle lie at least so high above the ground: its bonnet."""
HIGHEST_M = 2.3
"""And at most so high: cars and small vans. What is higher, such as trees above them, says nothing.
From 2 to 2.8 m edges move by less than 0.02 m."""
WIDTH_M = 2.8
"""No vehicle is wider, mirrors and the spread of its returns included; what is wider is a building,
or planting."""
_GAP_M = 1.5
"""Returns of a vehicle lie no farther apart: dark paint and glass send few back. With 1 to 2.5 m
edges lie 0.43 to 0.46 m from surveyed ones in an old town, 0.43 to 0.49 m in a street elsewhere."""
_NARROWEST_M = 1.2
"""What is narrower is no vehicle, but a hedge, a wall or a row of posts. With 0.9 and 1.5 m edges
lie 0.48 and 0.49 m from surveyed ones in the old town, 0.44 and 0.60 m in the street."""
_SEEN_SPACINGS = 0.5
"""No pulse meets the ground below a vehicle: ground within so many spacings of a low return is
none. With 0.3 and 0.8 spacings edges lie 0.46 and 0.45 m, 0.43 and 0.50 m from surveyed ones."""

_RIM_M = 0.5
"""The rim of what is too wide is none either: discs do not fill its corners."""


def footprints(hit: Bools, low: Bools, spacing_m: float, cell_m: float) -> Bools:
    """Cells (rows, columns) that vehicles stand on.

    A vehicle is as wide as one, and lets no pulse through. So each cell is judged by what lies
    within a vehicle's width of it, and rows of vehicles are as good as single ones.

    Parameters
    ----------
    hit : cells with returns from `LOWEST_M` to `HIGHEST_M` above the ground. low : with returns
        from below. spacing_m : of the ground's points.
    """
    if not hit.any():
        return hit
    gap = _GAP_M / 2 / cell_m
    frame = int(np.ceil(gap)) + 1
    joined = _inside(_away(np.pad(hit, frame)) <= gap) > gap
    opaque = joined[frame:-frame, frame:-frame]
    opaque &= _away(low) * cell_m > _SEEN_SPACINGS * spacing_m
    wide = _opened(opaque, _NARROWEST_M / 2 / cell_m)
    too_wide = _opened(wide, WIDTH_M / 2 / cell_m)
    return wide & (_away(too_wide) * cell_m > _RIM_M)


def _opened(area: Bools, radius: float) -> Bools:
    """Parts of an area that hold a disc of a radius in cells; beyond the grid lies nothing."""
    core = _inside(np.pad(area, 1))[1:-1, 1:-1] > radius
    return area & (_away(core) <= radius)


def _inside(area: Bools) -> Floats:
    """Distance in cells of each cell of an area from the nearest outside of it."""
    return np.asarray(ndimage.distance_transform_edt(area))


def _away(area: Bools) -> Floats:
    """Distance in cells of each cell from the nearest of an area; infinite where there is none."""
    if not area.any():
        return np.full(area.shape, np.inf)
    return np.asarray(ndimage.distance_transform_edt(~area))
