"""How much of the pavement a set of targets examines, and what it leaves out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import shapely
from shapely import LineString, MultiPolygon

from roadsight.base.arrays import Bools, Floats, Ints

NARROWEST_ROAD_M = 2.5
"""What a digitised edge cuts off the outline and is nowhere as wide is no road: narrower than the
narrowest lanes that are built for cars (AASHTO Green Book 2018, section 4.3: 2.7 m)."""
_CUT_M = 1e-3
"""Width of the cut that a digitised edge makes."""
_BESIDE = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
"""Neighbours of a cell, those across a side first."""


def road_within(outline: MultiPolygon, edges: Sequence[LineString]) -> MultiPolygon:
    """The outline without the strips that digitised edges cut off it.

    An outline that runs over the edge leaves a strip beyond it: verge, gutter, the foot of a
    barrier. A line between carriageways cuts nothing off, for both sides are wide.
    """
    if not edges:
        return outline
    cut = outline.difference(shapely.union_all([line.buffer(_CUT_M) for line in edges]))
    parts = [part for part in shapely.get_parts(cut) if isinstance(part, shapely.Polygon)]
    wide = [part for part in parts if not part.buffer(-NARROWEST_ROAD_M / 2).is_empty]
    return MultiPolygon(wide)


def at_least_inside(outline: MultiPolygon, xy_m: Floats, inset_m: Floats) -> Bools:
    """Whether places (n, 2) lie inside an outline by so much each (n,); negative: so far outside.

    A cell on the outline may hold enough points with its centre beyond the kerb, where nothing
    drives and what stands on the verge hides it.
    """
    if outline.is_empty or not len(xy_m):
        return np.zeros(len(xy_m), bool)
    shapely.prepare(outline)
    points = shapely.points(xy_m)
    # Segment by segment: the distance to a whole outline looks at every vertex for every place.
    rings = [ring for part in outline.geoms for ring in (part.exterior, *part.interiors)]
    corners = [shapely.get_coordinates(ring) for ring in rings]
    sides = shapely.linestrings(
        np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in corners])
    )
    (place, _), distance_m = shapely.STRtree(sides).query_nearest(
        points, return_distance=True, all_matches=False
    )
    from_rim_m = np.empty(len(points))
    from_rim_m[place] = distance_m
    signed_m = np.where(shapely.intersects(outline, points), from_rim_m, -from_rim_m)
    return np.asarray(signed_m >= inset_m - 1e-9)


def examined_areas_m2(
    targets: pd.DataFrame,
    cells: tuple[Ints, Ints],
    road: MultiPolygon,
    cell_size_m: float,
    rim_m: float = 0.0,
) -> tuple[Floats, MultiPolygon]:
    """Pavement that each target stands for (n,), and the pavement that none stands for.

    A target stands for the pavement in its own cell, and for that in cells beside it whose middle
    lies off the road or on its rim, where no target may stand: slivers along the rim, of which none
    is further than a cell from it.

    Parameters
    ----------
    targets : rows in the order of the result. cells : column and row of each target's cell, in
        cells from the local origin.
    road : the pavement's outline, in which the areas count.
    rim_m : targets keep this far inside it.
    """
    column, row = cells
    if not len(targets):
        return np.zeros(0), road
    own = {(int(c), int(r)): k for k, (c, r) in enumerate(zip(column, row, strict=True))}
    slivers: dict[tuple[int, int], int] = {}
    for step in _BESIDE:
        for (c, r), k in own.items():
            beside = (c + step[0], r + step[1])
            if beside not in own:
                slivers.setdefault(beside, k)
    beside_cells = np.array(list(slivers), np.int64).reshape(-1, 2)
    middles = np.asarray((beside_cells + 0.5) * cell_size_m, np.float64)
    shapely.prepare(road)
    off = ~at_least_inside(road, middles, np.full(len(middles), rim_m))
    beside_cells, owner = beside_cells[off], np.array(list(slivers.values()), np.int64)[off]
    whole = np.concatenate([np.column_stack([column, row]), beside_cells])
    boxes = shapely.box(*(whole * cell_size_m).T, *((whole + 1) * cell_size_m).T)
    area = np.full(len(boxes), cell_size_m**2)
    partly = ~shapely.contains(road, boxes)
    area[partly] = shapely.area(shapely.intersection(boxes[partly], road))
    stands_for = np.concatenate([np.arange(len(targets)), owner])
    left = road.difference(shapely.union_all(boxes))
    parts = [part for part in shapely.get_parts(left) if isinstance(part, shapely.Polygon)]
    examined_m2 = np.bincount(stands_for, area, minlength=len(targets)).astype(np.float64)
    return examined_m2, MultiPolygon(parts)
