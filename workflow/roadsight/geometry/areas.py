"""Points and areas in plan."""

from __future__ import annotations

import shapely
from shapely import MultiPolygon

from roadsight.base.arrays import Bools, Floats


def inside(area: MultiPolygon, x: Floats, y: Floats) -> Bools:
    """Points (n,) inside the area."""
    shapely.prepare(area)
    return shapely.contains_xy(area, x, y)
