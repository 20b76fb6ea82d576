"""Pole-like targets on the pavement (paper 1, section 2.5, Figs. 13 and 14a)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from shapely import LineString, MultiPolygon

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.errors import InputError
from roadsight.base.sections.sensing import Targets
from roadsight.geometry.areas import depth_inside_m
from roadsight.scene.grids import Grid

_USUAL = Targets()
PUBLISHED_POINTS = 25  # pavement points of a cell of 1 m that carries a target in paper 1
# The edge's direction beside a target is taken from this far behind it to this far ahead: over
# about the length of a vehicle, which does not turn with every vertex.
_TANGENT_M = 2.0
# A target is to be so many point spacings wide. For the cylinder of 0.5 m these are 9 points/m2:
# decisions on an OS-128's targets were wrong for 2.1 % at 9 points/m2, 8.7 % at 4 and 1.5 % at 71
# (`docs/placement/depth-maps.md`).
_SPACINGS_WIDE = 1.5
_FEWEST_POINTS = 3  # of a cell, however wide targets are: their median is no single stray point
# Of the points that cells nearby have, the least that a cell must have. Fewer are a hole in the
# scan, a shadow behind a parked car or a cell that the pavement hardly enters.
_LOCAL_SHARE = 0.25
_BLOCK_M = 10.0  # side of the blocks over whose cells the density is taken: a few lanes wide


def points_needed(width_m: float, cell_size_m: float) -> int:
    """Pavement points of a cell that a target of a width needs, wherever it stands.

    Its spacing decides on what hides targets of that width: the scene is as coarse as its points.
    """
    return max(int(np.ceil((_SPACINGS_WIDE * cell_size_m / width_m) ** 2 - 1e-9)), _FEWEST_POINTS)


def local_points(column: Ints, row: Ints, points: Ints, cell_size_m: float) -> Floats:
    """Median of the points (n,) of the cells with points in the block of 10 m around each."""
    per_block = max(int(round(_BLOCK_M / cell_size_m)), 1)
    block = pd.MultiIndex.from_arrays([column // per_block, row // per_block])
    return pd.Series(points).groupby(block.to_flat_index()).transform("median").to_numpy(np.float64)


def place_targets(
    xyz_m: NDArray[np.floating],
    cell_size_m: float = _USUAL.cell_size_m,
    min_points: int = PUBLISHED_POINTS,
    local: bool = False,
) -> pd.DataFrame:
    """One target at the centre of every cell that holds enough pavement points.

    Cells lie on multiples of ``cell_size_m`` from the local origin, half open, so that a target
    keeps its name when the pavement grows or shrinks elsewhere. A target stands on the median
    height of its cell's points, which stray points do not move.

    Parameters
    ----------
    xyz_m : (n, 3) pavement points, local metres.
    min_points : points that a cell needs.
    local : whether a cell needs a quarter of the points of those nearby as well, so that a hole in
        a dense cloud carries none.

    Returns
    -------
    columns target (name ``t{column}_{row}`` of the cell), x, y, z (foot, local metres, float64),
    points (int32) and spacing_m (of the points nearby), row by row from the south-west; no rows if
    no cell has enough points.

    Raises
    ------
    InputError : the cell size is not positive, or a coordinate is not finite.
    """
    if not (np.isfinite(cell_size_m) and cell_size_m > 0):
        raise InputError("must be positive", where="targets.cell_size_m", found=cell_size_m)
    if not np.isfinite(xyz_m).all():
        raise InputError("a coordinate is not finite", where="pavement points")
    x, y, z = np.asarray(xyz_m, np.float64).reshape(-1, 3).T
    grid = Grid.around(x, y, cell_size_m)
    cell = grid.flat(x, y) if len(x) else np.empty(0, np.int64)
    order = np.lexsort((z, cell))
    numbers, first, points = np.unique(cell[order], return_index=True, return_counts=True)
    below, above = (z[order][first + (points - odd) // 2] for odd in (1, 0))
    median = (below + above) / 2
    row, column = np.divmod(numbers, max(grid.columns, 1))
    around = local_points(column + grid.west, row + grid.south, points, cell_size_m)
    dense = points >= np.maximum(min_points, _LOCAL_SHARE * around if local else 0)
    row, column = row[dense], column[dense]
    centre_x, centre_y = grid.centres(column, row)
    names = [f"t{c}_{r}" for c, r in zip(column + grid.west, row + grid.south, strict=True)]
    return pd.DataFrame(
        {
            "target": pd.Series(names, dtype=str),
            "x": centre_x,
            "y": centre_y,
            "z": median[dense],
            "points": points[dense].astype(np.int32),
            "spacing_m": cell_size_m / np.sqrt(around[dense]),
        }
    )


def headings_along(edges: Sequence[LineString], xy_m: Floats) -> Floats:
    """Heading (n,) of the nearest edge beside each target, rad from local x, in (-pi/2, pi/2]."""
    lines = np.array(list(edges), dtype=object)
    points = shapely.points(xy_m)
    nearest = shapely.STRtree(lines).nearest(points)
    along = shapely.line_locate_point(lines[nearest], points)
    length = shapely.length(lines[nearest])
    before = shapely.line_interpolate_point(lines[nearest], np.maximum(along - _TANGENT_M, 0.0))
    after = shapely.line_interpolate_point(lines[nearest], np.minimum(along + _TANGENT_M, length))
    way = shapely.get_coordinates(after) - shapely.get_coordinates(before)
    heading = np.arctan2(way[:, 1], way[:, 0])
    # A box has no front: the same road read backwards gives the same heading.
    half = np.pi / 2
    return np.asarray(half - (half - heading) % np.pi)


# What a digitised edge cuts off the outline and is nowhere as wide is no road: narrower than the
# narrowest lanes that are built for cars (AASHTO Green Book 2018, section 4.3: 2.7 m).
NARROWEST_ROAD_M = 2.5
_CUT_M = 1e-3  # width of the cut that a digitised edge makes
# Neighbours of a cell, those across a side first.
_BESIDE = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))


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
    return np.asarray(depth_inside_m(outline, xy_m) >= inset_m - 1e-9)


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
