"""Pavement up to what hides its edge: a wall's foot, a crown; and below vehicles parked on its rim.

From the air the last metres before a wall are not seen: eaves hang over them, the wall's shadow
lies on them, and smooth ground ends where neighbours are missing. What nothing was measured of is
pavement up to what stands beyond it. A vehicle stands on pavement, whose edge is behind it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import shapely
from rasterio import features
from rasterio.transform import Affine
from scipy import ndimage
from scipy.spatial import cKDTree
from shapely import MultiPolygon

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.scene.grids import Grid
from roadsight.scene.pavement.outline import without_small_holes
from roadsight.scene.pavement.road_surface import opened
from roadsight.scene.terrain.terrain import Bounds

# Ground that is hidden farther from the pavement stays unknown; what stands farther hides none.
# Found edges of an old town lie 0.48, 0.46 and 0.46 m from surveyed ones with 2, 3 and 4 m, those
# of a street elsewhere 0.46, 0.45 and 0.44 m (median). Such figures here, and of parked vehicles,
# are of drafts, with `splines._INSIDE_M` of 1 m; those of what is chosen stand in decision 094.
REACH_M = 3.0
# What stands hides no more than so many times its height: airborne scanners look 30 degrees aside
# at most. With 0.45, edges lie 0.44 and 0.51 m from surveyed ones.
_SHADOW = 0.58
# What hides a place lies ahead on the way from the pavement: the least cosine of the angle between
# the two. Without it, edges of an old town lie 0.52 instead of 0.47 m from surveyed ones; with 0.5,
# 0.45 m there and 0.48 instead of 0.45 m in a street elsewhere.
_AHEAD = 0.0
# What rises so far above the ground hides it: cars, walls, eaves, crowns; the rest is seen.
_STANDS_M = 0.5
# Eaves hang so far beyond the wall: without it, edges along fronts lie 0.3 m before surveyed ones,
# with it 0.0 m, with 0.5 m 0.2 m behind (median of 2,300 places in an old town).
_OVERHANG_M = 0.3
_SEEN_SPACINGS = 1.2  # Ground within so many spacings of a return is seen.
_WAY_M = 4.0  # Way across hidden ground to a place that is `REACH_M` away.
_CELL_M = 0.1
# Side of the squares that are looked at one by one: 80 MB each at 15 points a square metre.
_SQUARE_M = 100.0


def to_what_stands(
    outline: MultiPolygon,
    around: Callable[[Bounds], tuple[Floats, Bools]],
    spacing_m: float,
    smallest_hole_m2: float,
) -> tuple[MultiPolygon, float]:
    """A pavement with the hidden ground beside it, and the share of its outline that lies there.

    Parameters
    ----------
    outline : local metres. around : points (n, 3) within west, south, east, north, and which of
        them are ground. spacing_m : of the ground's points. smallest_hole_m2 : smaller ones are
        pavement.
    """
    if outline.is_empty:
        return outline, 0.0
    rim, parts = outline.boundary, []
    # Squares on multiples of their side.
    low, high = np.reshape(shapely.buffer(outline, REACH_M).bounds, (2, 2)) // _SQUARE_M
    for x in np.arange(low[0], high[0] + 1) * _SQUARE_M:
        for y in np.arange(low[1], high[1] + 1) * _SQUARE_M:
            core = shapely.box(x, y, x + _SQUARE_M, y + _SQUARE_M)
            if shapely.dwithin(core, rim, REACH_M):
                hidden = _hidden_beside(outline, core, around, spacing_m)
                parts.append(shapely.intersection(hidden, core))
    if not shapely.area(parts).any():
        return outline, 0.0
    whole = shapely.union_all([outline, *parts])
    # Cells begin up to half of one off the outline.
    for step in (_CELL_M, -_CELL_M):
        whole = whole.buffer(step, join_style="mitre")
    grown = without_small_holes(whole.simplify(_CELL_M), smallest_hole_m2)
    length = grown.boundary.length
    hidden_m = length - grown.boundary.intersection(rim.buffer(2 * _CELL_M)).length
    return grown, float(hidden_m / max(length, 1e-9))


def _hidden_beside(
    outline: MultiPolygon,
    core: shapely.Polygon,
    around: Callable[[Bounds], tuple[Floats, Bools]],
    spacing_m: float,
) -> shapely.Geometry:
    """Area beside a pavement that nothing was seen of, up to what stands beyond it."""
    seen_m = _SEEN_SPACINGS * spacing_m
    # What decides about a place: the way to it, what stands near it, and what fills gaps in that.
    west, south, east, north = shapely.buffer(core, _WAY_M + REACH_M + 4 * seen_m).bounds
    xyz_m, ground = around((west, south, east, north))
    if not ground.any():
        return MultiPolygon()
    grid = Grid.around(np.array([west, east]), np.array([south, north]), _CELL_M)
    place = Affine(_CELL_M, 0, grid.west * _CELL_M, 0, _CELL_M, grid.south * _CELL_M)
    paved = features.rasterize([(outline, 1)], grid.shape, transform=place).astype(bool)
    away_m = _away(paved) * _CELL_M
    flat = grid.flat(xyz_m[:, 0], xyz_m[:, 1])
    # Beyond the pavement alone: what hangs over it or stands on it hides none of its edge.
    beside = ~paved.ravel()[flat] & (away_m.ravel()[flat] <= _WAY_M + REACH_M)
    cell, height_m = flat[beside], np.zeros(int(beside.sum()))
    if len(cell):
        floor_m = xyz_m[ground]
        _, nearest = cKDTree(floor_m[:, :2]).query(xyz_m[beside, :2])
        height_m = xyz_m[beside, 2] - floor_m[nearest, 2]
    shadow = _in_shadow(grid, paved, cell, height_m, seen_m)
    taken = paved | _reached(paved, shadow, _WAY_M)
    taken |= _below_vehicles(grid, taken, cell, height_m, spacing_m)
    # Smooth ground ends at kerbs, and up to a spacing before a vehicle: a narrow strip between
    # pavements is one of these, and a verge so narrow is not told from it.
    taken = _closed(taken, int(np.ceil(_SEEN_SPACINGS * spacing_m / _CELL_M)))
    # Slivers between the pavement and ground that was seen are no ground of their own.
    width = max(1, round(seen_m / _CELL_M))
    whole = ndimage.binary_opening(taken, iterations=width) & ~paved
    shapes = features.shapes(whole.astype(np.uint8), mask=whole, transform=place)
    return shapely.union_all([shapely.geometry.shape(found) for found, _ in shapes])


def _in_shadow(grid: Grid, paved: Bools, cell: Ints, height_m: Floats, seen_m: float) -> Bools:
    """Cells (rows, columns) that nothing was seen of, before what hides them.

    Parameters
    ----------
    paved : (rows, columns). cell, height_m : (n,) of the points beside it. seen_m : ground so near
        to a low return is seen.
    """
    high = height_m > _STANDS_M
    gap = int(np.ceil(seen_m / _CELL_M)) + 1
    # Wires and lone returns are left out.
    stands = np.asarray(
        ndimage.binary_opening(_closed(_cells(grid, cell[high]), gap), np.ones((3, 3), bool))
    )
    if not stands.any():
        return stands
    top_m = np.zeros(grid.shape)
    np.maximum.at(top_m.ravel(), cell[high], height_m[high])
    top_m = ndimage.maximum_filter(top_m, 2 * gap + 1)
    away, (from_row, from_column) = ndimage.distance_transform_edt(~paved, return_indices=True)
    away_m = away * _CELL_M
    off, (row, column) = ndimage.distance_transform_edt(~stands, return_indices=True)
    hidden = _away(_cells(grid, cell[~high])) * _CELL_M > seen_m
    reach_m = np.minimum(_SHADOW * top_m[row, column], REACH_M)
    hidden &= (away_m <= REACH_M) & (off * _CELL_M <= reach_m)
    # Water, and what lies beyond the cloud, gives no returns either: what stands must lie ahead on
    # the way from the pavement, not on this side of the place.
    to_row, to_column = np.indices(grid.shape)
    ahead = (row - to_row) * (to_row - from_row) + (column - to_column) * (to_column - from_column)
    hidden &= ahead >= _AHEAD * off * away_m / _CELL_M
    return hidden & (ndimage.distance_transform_edt(stands) * _CELL_M <= _OVERHANG_M)


def _below_vehicles(
    grid: Grid, paved: Bools, cell: Ints, height_m: Floats, spacing_m: float
) -> Bools:
    """Cells (rows, columns) below vehicles that stand on a pavement's rim."""
    high = height_m > LOWEST_M
    hit = _cells(grid, cell[high & (height_m < HIGHEST_M)])
    parked = footprints(hit, _cells(grid, cell[~high]), spacing_m, _CELL_M)
    if not parked.any():
        return parked
    # Smooth ground ends up to a spacing before a vehicle.
    gap = int(np.ceil(_SEEN_SPACINGS * spacing_m / _CELL_M))
    near = _away(paved) * _CELL_M <= gap * _CELL_M
    parked &= _reached(paved, near | parked, WIDTH_M + gap * _CELL_M)
    return parked


def _reached(paved: Bools, way: Bools, most_m: float) -> Bools:
    """Cells (rows, columns) that a way from the pavement along rows and columns reaches."""
    steps = round(most_m / _CELL_M)
    return np.asarray(ndimage.binary_dilation(paved, iterations=steps, mask=paved | way))


def _closed(cells: Bools, reach: float) -> Bools:
    """Cells and the gaps between them up to twice a reach in cells."""
    frame = int(np.ceil(reach)) + 1
    grown = ndimage.distance_transform_edt(~np.pad(cells, frame)) <= reach
    closed = ndimage.distance_transform_edt(grown) > reach
    return np.asarray(closed[frame:-frame, frame:-frame])


def _cells(grid: Grid, flat: Ints) -> Bools:
    """Cells (rows, columns) of the given numbers."""
    held = np.zeros(grid.shape, bool)
    held.ravel()[flat] = True
    return held


# Footprints of parked vehicles as seen from the air: what stands on the pavement's own rim.

LOWEST_M = 0.5  # Returns of a vehicle lie at least so high above the ground: its bonnet.
# And at most so high: cars and small vans. What is higher, such as trees above them, says nothing.
# From 2 to 2.8 m edges move by less than 0.02 m.
HIGHEST_M = 2.3
# No vehicle is wider, mirrors and the spread of its returns included; what is wider is a building,
# or planting.
WIDTH_M = 2.8
# Returns of a vehicle lie no farther apart: dark paint and glass send few back. With 1 to 2.5 m
# edges lie 0.43 to 0.46 m from surveyed ones in an old town, 0.43 to 0.49 m in a street elsewhere.
_GAP_M = 1.5
# What is narrower is no vehicle, but a hedge, a wall or a row of posts. With 0.9 and 1.5 m edges
# lie 0.48 and 0.49 m from surveyed ones in the old town, 0.44 and 0.60 m in the street.
_NARROWEST_M = 1.2
# No pulse meets the ground below a vehicle: ground within so many spacings of a low return is none.
# With 0.3 and 0.8 spacings edges lie 0.46 and 0.45 m, 0.43 and 0.50 m from surveyed ones.
_SEEN_BELOW_SPACINGS = 0.5
_RIM_M = 0.5  # The rim of what is too wide is none either: discs do not fill its corners.


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
    opaque = _closed(hit, _GAP_M / 2 / cell_m)
    opaque &= _away(low) * cell_m > _SEEN_BELOW_SPACINGS * spacing_m
    wide = opaque & opened(opaque, _NARROWEST_M / 2 / cell_m)
    too_wide = wide & opened(wide, WIDTH_M / 2 / cell_m)
    return wide & (_away(too_wide) * cell_m > _RIM_M)


def _away(area: Bools) -> Floats:
    """Distance in cells of each cell from the nearest of an area; infinite where there is none."""
    if not area.any():
        return np.full(area.shape, np.inf)
    return np.asarray(ndimage.distance_transform_edt(~area))
