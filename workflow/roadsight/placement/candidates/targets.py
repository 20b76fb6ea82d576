"""Pole-like targets on the pavement (paper 1, section 2.5, Figs. 13 and 14a)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from shapely import LineString, MultiPolygon

from roadsight.base.arrays import Floats, Ints
from roadsight.base.errors import InputError
from roadsight.scene.grids import Grid

_TANGENT_M = 2.0
"""The edge's direction beside a target is taken from this far behind it to this far ahead: over
about the length of a vehicle, which does not turn with every vertex."""


def place_targets(
    xyz_m: NDArray[np.floating], cell_size_m: float = 1.0, min_points: int = 25
) -> pd.DataFrame:
    """One target at the centre of every cell that holds enough pavement points.

    Cells lie on multiples of ``cell_size_m`` from the local origin, half open, so that a target
    keeps its name when the pavement grows or shrinks elsewhere. A target stands on the median
    height of its cell's points, which stray points do not move.

    Parameters
    ----------
    xyz_m : (n, 3) pavement points, local metres.

    Returns
    -------
    columns target (name ``t{column}_{row}`` of the cell), x, y, z (foot, local metres, float64) and
    points (int32), row by row from the south-west; no rows if no cell has enough points.

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
    dense = points >= min_points
    row, column = np.divmod(numbers[dense], max(grid.columns, 1))
    centre_x, centre_y = grid.centres(column, row)
    return pd.DataFrame(
        {
            "target": _names(column + grid.west, row + grid.south),
            "x": centre_x,
            "y": centre_y,
            "z": median[dense],
            "points": points[dense].astype(np.int32),
        }
    )


def standing_inside(targets: pd.DataFrame, outline: MultiPolygon, inset_m: float) -> pd.DataFrame:
    """Targets that stand inside the pavement's outline by at least ``inset_m``.

    A cell on the outline may hold enough points with its centre beyond the kerb, where nothing
    drives and what stands on the verge hides it. A negative inset lets targets stand so far out.
    """
    area = outline.buffer(-inset_m)
    return targets[shapely.intersects_xy(area, targets["x"], targets["y"])].reset_index(drop=True)


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


def _names(columns: Ints, rows: Ints) -> pd.Series:
    names = [f"t{column}_{row}" for column, row in zip(columns, rows, strict=True)]
    return pd.Series(names, dtype=str)
