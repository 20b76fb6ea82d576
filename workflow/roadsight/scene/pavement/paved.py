"""Points on a paved area that is known by its outline."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats

_CLIP_MARGIN_M = 1.0
"""How far around points the outline is cut out."""


class PavedArea:
    """Surface of a road whose outline is known in plan.

    Parameters
    ----------
    outline : Polygon or MultiPolygon, local metres.
    height_at : function of x, y (n,) that gives the terrain's height, NaN where unknown.
    reach_m : a point counts when it is no farther than this above or below the terrain.
    """

    def __init__(
        self,
        outline: shapely.Geometry,
        height_at: Callable[[ArrayLike, ArrayLike], Floats],
        reach_m: float = 0.3,
    ) -> None:
        self._outline, self._height_at, self._reach_m = outline, height_at, reach_m

    def holds(self, x_m: ArrayLike, y_m: ArrayLike, z_m: ArrayLike) -> Bools:
        """Whether points (n,) lie on the pavement; a point on its outline does not."""
        x, y, z = (np.asarray(axis, np.float64) for axis in (x_m, y_m, z_m))
        on = np.zeros(len(x), bool)
        if not len(x):
            return on
        # Without a margin the box's own sides would be an outline on which points lie.
        west, south = x.min() - _CLIP_MARGIN_M, y.min() - _CLIP_MARGIN_M
        east, north = x.max() + _CLIP_MARGIN_M, y.max() + _CLIP_MARGIN_M
        near = shapely.intersection(self._outline, shapely.box(west, south, east, north))
        if near.is_empty:
            return on
        shapely.prepare(near)
        inside = np.flatnonzero(shapely.contains_xy(near, x, y))
        gap_m = np.abs(z[inside] - self._height_at(x[inside], y[inside]))
        on[inside[gap_m <= self._reach_m]] = True
        return on
