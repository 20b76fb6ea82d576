"""Points and areas in plan."""

from __future__ import annotations

import numpy as np
import shapely
from shapely import MultiPolygon

from roadsight.base.arrays import Bools, Floats


def inside(area: MultiPolygon, x: Floats, y: Floats) -> Bools:
    """Points (n,) inside the area."""
    shapely.prepare(area)
    return shapely.contains_xy(area, x, y)


def depth_inside_m(area: MultiPolygon, xy_m: Floats) -> Floats:
    """Distance (n,) of places (n, 2) from the area's rim, m: negative outside.

    Where there is no area, all places lie infinitely far outside.
    """
    if area.is_empty or not len(xy_m):
        return np.full(len(xy_m), -np.inf)
    shapely.prepare(area)
    points = shapely.points(xy_m)
    # Segment by segment: the distance to a whole outline looks at every vertex for every place.
    rings = [ring for part in area.geoms for ring in (part.exterior, *part.interiors)]
    corners = [shapely.get_coordinates(ring) for ring in rings]
    sides = shapely.linestrings(
        np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in corners])
    )
    (place, _), distance_m = shapely.STRtree(sides).query_nearest(
        points, return_distance=True, all_matches=False
    )
    from_rim_m = np.empty(len(points))
    from_rim_m[place] = distance_m
    return np.where(shapely.intersects(area, points), from_rim_m, -from_rim_m)
