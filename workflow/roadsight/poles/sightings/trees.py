"""Trees in a cloud: tops of crowns, which are wider than wires, arms and poles are.

Images do not part crowns that touch, and a survey from the air seldom meets a trunk; the tops of a
canopy are apart. What a crown is, an image says afterwards (`cloud_objects.confirmed`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import binom

from roadsight.base.arrays import Bools, Floats, Floats32, Ints
from roadsight.poles.images.kinds import KINDS
from roadsight.poles.sightings.lidar_poles import NO_COLUMN, stem_axis

BUILDING = 6  # ASPRS class of buildings
_LOWEST_M = 2.0  # returns below this may be of bushes, rails and vehicles
_CELL_M = 0.5  # cells of the canopy; wider where the cloud is sparse
# Wider cells hold no crown. Of trees 6 m wide at 20 and 2 returns/m2 cells of 1.2 m find 100 and 58
# %, of 1.0 m 100 and 18 %, of 1.4 m 98 and 15 %, of 1.7 m 16 and 0 %.
_WIDEST_CELL_M = 1.2
_RETURNS = 4.0  # returns that a cell should have: one in fifty is then empty in a crown
# Share of the cloud's area that has as many. Where half of it has 3, 4 or 9 returns/m2 and half 6,
# 24 or 14, cells for the sparser half find 95 to 100 % of such trees in both, cells for the median
# of all 75 to 80 %, 0 to 3 % and 98 to 100 % in the sparser.
_DENSER = 0.75
# Radius of a disc that fits into every crown: of 1 m, which wires and poles, however many, do not
# fill (generated rural road: of 380 tops without this 15 are trees).
_CROWN_CELLS = 2
_FILLED = 0.9  # share of the disc's cells that a crown fills
# Returns of a cell lie this far above each other in a crown; those of wires and roofs do not.
_DEEP_M = 0.5
_DEEP = 0.5  # share of the disc's cells of which this holds
# Standard deviation by which the canopy is smoothed, so that a crown has one top. From 0.5 to 1 m
# F1 stays at 0.92 to 0.93 on the trees within 20 m of the generated road.
_SMOOTH_M = 0.7
_APART_M = 1.5  # tops nearer to each other than this are one tree's; from 1 to 2.5 m the same holds
# What is wider is of several trees that touch: so far a crown's edge is looked for.
_WIDEST_M = 12.0
# Standard deviation of a trunk about its crown's top, each axis: on that road 0.5 to 1 m.
SIGMA_M = 0.8


@dataclass(frozen=True)
class Crowns:
    """Trees by their tops.

    Parameters
    ----------
    xy_m : (n, 2) tops, local metres. top_m : (n,) above ground. width_m : (n,) across their crowns.
    """

    xy_m: Floats
    top_m: Floats
    width_m: Floats

    def __len__(self) -> int:
        return len(self.xy_m)


def measure_density(xy_m: Floats) -> tuple[float, int]:
    """Median of the returns per square metre that has any, and the number of such square metres.

    Parameters
    ----------
    xy_m : all returns of a tile (n, 2), at least one.
    """
    _, count = np.unique(np.floor(xy_m).astype(np.int64), axis=0, return_counts=True)
    return float(np.median(count)), len(count)


def canopy_cell_m(tiles: Sequence[tuple[float, int]]) -> float:
    """Edge of the cells for a cloud, one for all its tiles, so that these agree at their borders.

    Parameters
    ----------
    tiles : `measure_density` of each, at least one.
    """
    density, area_m2 = np.transpose(tiles)
    per_m2 = np.repeat(density, area_m2.astype(np.int64))
    sparse = np.quantile(per_m2, 1.0 - _DENSER, method="lower")
    return float(np.clip(np.sqrt(_RETURNS / sparse), _CELL_M, _WIDEST_CELL_M))


def reach_m(cell_m: float) -> float:
    """Distance from a tile within which returns decide about its crowns."""
    around = max((_smooth_cells(cell_m) + _apart_cells(cell_m)) * cell_m, _WIDEST_M / 2)
    return (2 * _CROWN_CELLS + 1) * cell_m + around


def find_crowns(xyz_m: Floats, above_ground_m: Floats, cls: NDArray, cell_m: float) -> Crowns:
    """Trees among returns, by place.

    Parameters
    ----------
    xyz_m : returns (n, 3), local metres. above_ground_m : (n,), NaN where unknown.
    cls : ASPRS class (n,); buildings, ground, water, road, bridges and noise hold no tree.
    cell_m : edge of the canopy's cells, `canopy_cell_m`; cells begin at whole multiples of it.
    """
    least_m, most_m = KINDS["tree"].height_m
    with np.errstate(invalid="ignore"):
        used = (above_ground_m > _LOWEST_M) & (above_ground_m < most_m)
    used &= ~np.isin(cls, (*NO_COLUMN, BUILDING))
    xy, height = np.asarray(xyz_m, np.float64)[used, :2], np.asarray(above_ground_m)[used]
    if not len(xy):
        return Crowns(np.empty((0, 2)), np.empty(0), np.empty(0))
    number = np.floor(xy / cell_m).astype(np.int64)
    corner = number.min(axis=0) - 2 * _CROWN_CELLS
    row, column = (number - corner).T
    canopy = np.zeros((row.max() + 2 * _CROWN_CELLS + 1, column.max() + 2 * _CROWN_CELLS + 1))
    np.maximum.at(canopy, (row, column), height)
    lowest = np.full(canopy.shape, np.inf)
    np.minimum.at(lowest, (row, column), height)
    # Cells of crowns: those in a disc that is nearly full, and deep.
    disc = _disc(_CROWN_CELLS)
    weight = disc.astype(np.float32) / disc.sum()
    filled, deep = (
        cv2.filter2D(cells.astype(np.float32), -1, weight, borderType=cv2.BORDER_CONSTANT)
        for cells in (canopy > 0, canopy - lowest >= _DEEP_M)
    )
    whole = (filled >= _FILLED) & (deep >= _DEEP)
    around = cv2.dilate(whole.astype(np.uint8), disc)
    crown = np.asarray((around > 0) & (canopy > 0), np.uint8)
    image = np.where(crown > 0, canopy, 0.0).astype(np.float32)
    # Tops are the highest of the smoothed canopy around them.
    size = 2 * _smooth_cells(cell_m) + 1
    smooth = cv2.GaussianBlur(
        image, (size, size), _SMOOTH_M / cell_m, borderType=cv2.BORDER_CONSTANT
    )
    highest = cv2.dilate(smooth, _disc(_apart_cells(cell_m)))
    tops = (smooth >= highest) & (smooth > 0) & (crown > 0)
    peak = cv2.dilate(image, np.ones((3, 3), np.uint8))
    row, column = np.nonzero(tops & (peak >= least_m))
    places = (np.column_stack([row, column]) + corner + 0.5) * cell_m
    width = 2.0 * cell_m * cv2.distanceTransform(crown, cv2.DIST_L2, 5)[row, column]
    width_m = np.minimum(width.astype(np.float64), _WIDEST_M)
    return Crowns(places, peak[row, column].astype(np.float64), width_m)


def _smooth_cells(cell_m: float) -> int:
    """Cells to either side over which the canopy is smoothed: four standard deviations."""
    return int(np.ceil(4 * _SMOOTH_M / cell_m))


def _apart_cells(cell_m: float) -> int:
    return max(round(_APART_M / cell_m), 1)


def _disc(cells: int) -> NDArray[np.uint8]:
    y, x = np.mgrid[-cells : cells + 1, -cells : cells + 1]
    return (x * x + y * y <= (cells + 0.5) ** 2).astype(np.uint8)


# Trunks under crowns, where a cloud is dense enough to show them or that there is none.
#
# A trunk is a column of returns between the ground and the crown with little around it, denser
# than anything else under the crown. From the air most have no return at all, which says nothing.
# What says that there is none is ground that is shown without a gap: a trunk stands on its own.

# What a cloud shows of a tree: its trunk, its crown alone, and that no trunk stands under it.
TRUNK, CROWN, NO_TRUNK = "trunk", "crown", "no trunk"
# A trunk stands this near to its crown's top: 95 of 100 with 0.8 m (one sigma, each axis).
REACH_M = 2.0
_GRASS_M = 0.6  # returns below this may be of grass
_HIGHEST_M = 4.0  # above this are crowns
_BELOW_CROWN = 0.4  # share of a tree's height below which its trunk may be free of leaves
_CUBE_M = 0.1  # edge of the cubes that count as one return each, however dense the cloud
_CORE_CELLS = 3  # radius of the disc that holds a trunk
_WIDE_CELLS = 9  # radius of the disc around it
# Share of the returns in the disc around it that a trunk holds. Of 56 trunks that people labelled
# in five real streets, with tops 0.5 m off (one sigma), 24 are found, all of them right (to 0.4 m).
# At places of open ground in those streets 8 of 277 are.
_OWN = 0.5
# Share of a trunk's returns that any disc beside it has at most: leaves that hang low are as dense
# in several places. Without it more of those 56 are found (43 with `_SPAN_M` of 0.5), but of 8 on a
# generated road (24 pulses/m2) 7 are leaves; with it, on that road and three others, 24 of 25 are
# trunks, to 0.3 m.
_OTHERS = 0.5
_CHANCE = 0.05  # probability that evenly strewn returns under a crown have such a disc anywhere
# Height between the lowest and highest return of a trunk at least. With 0.5 m four of 30 on four
# roads are none.
_SPAN_M = 1.0
# Cells of the canopy (`canopy_cell_m`) up to which a cloud may show trunks: 11 returns a square
# metre. With 8 pulses a square metre (0.7 m) 6 are found on three generated roads, all of them
# leaves; in a real survey with 16 (0.52 m) those of 2 of 8 trees, 0.2 m off.
_COARSEST_M = 0.6
# Standard deviation that no axis gets below: errors of the 24 trunks on four generated roads.
_LEAST_SIGMA_M = 0.1
_GROUND_M = 0.15  # returns this near to the ground show it
# Radius of the gap in the ground that a trunk makes. At those 56 trunks the widest gap within 2 m
# is 0.16 m and more, on open ground near the scanner 0.06 to 0.1 m. A trunk of less than 20 cm that
# stands there is overlooked.
_GAP_M = 0.1
_STEP_M = 0.1  # step of the places at which gaps are looked for


@dataclass(frozen=True)
class Trunks:
    """What a cloud shows under crowns.

    Parameters
    ----------
    shows : (n,) `TRUNK`, `CROWN` or `NO_TRUNK`. xy_m : (n, 2) axes of trunks, else NaN.
    sigma_m : (n,) of them, each axis.
    """

    shows: NDArray[np.object_]
    xy_m: Floats
    sigma_m: Floats


def find_trunks(
    crowns: Crowns, xyz_m: Floats, above_ground_m: Floats, cls: NDArray, cell_m: float
) -> Trunks:
    """Trunks of trees, each of one tree at most: the one whose top is nearest.

    Parameters
    ----------
    crowns : of `find_crowns`, with cells of cell_m. xyz_m : returns (n, 3), local metres.
    above_ground_m : (n,), NaN where unknown. cls : ASPRS class (n,).
    """
    shows = np.full(len(crowns), CROWN, object)
    axis, sigma = np.full((len(crowns), 2), np.nan), np.full(len(crowns), np.nan)
    if not len(crowns) or cell_m > _COARSEST_M:
        return Trunks(shows, axis, sigma)
    with np.errstate(invalid="ignore"):
        upright = (above_ground_m > _GRASS_M) & (above_ground_m < _HIGHEST_M)
        ground = np.abs(above_ground_m) <= _GROUND_M
    upright &= ~np.isin(cls, (*NO_COLUMN, BUILDING))
    points = np.column_stack([xyz_m[upright, :2], above_ground_m[upright]]).astype(np.float64)
    # In order of place, so that the order of the returns does not matter.
    points = points[np.lexsort(points.T)]
    cubes = np.unique(np.floor(points / _CUBE_M).astype(np.int64), axis=0)
    wide_m = _WIDE_CELLS * _CUBE_M
    plan, cells = cKDTree(points[:, :2]), cKDTree((cubes[:, :2] + 0.5) * _CUBE_M)
    low = cKDTree(np.asarray(xyz_m, np.float64)[ground, :2])
    # Places about a top at which gaps in the ground are looked for.
    step = np.arange(-REACH_M, REACH_M + _STEP_M / 2, _STEP_M)
    grid = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    grid = grid[np.hypot(*grid.T) <= REACH_M]
    for row, (top, top_m) in enumerate(zip(crowns.xy_m, crowns.top_m, strict=True)):
        around = cells.query_ball_point(top, REACH_M + wide_m, return_sorted=True)
        own = cubes[np.array(around, np.int64)]
        own = own[(own[:, 2] + 0.5) * _CUBE_M < _BELOW_CROWN * top_m]
        place = _column(own, top)
        if place is not None:
            near = np.array(plan.query_ball_point(place, _CORE_CELLS * _CUBE_M), np.int64)
            near = np.sort(near[points[near, 2] < _BELOW_CROWN * top_m])
            axis[row], told, _ = stem_axis(points[near, :2])
            sigma[row] = max(told, _LEAST_SIGMA_M)
        elif low.n and low.query(top + grid)[0].max() < _GAP_M:
            shows[row] = NO_TRUNK
    # A trunk is of the tree whose top is nearest.
    found = np.isfinite(axis[:, 0])
    rows = np.flatnonzero(found)
    if len(rows) > 1:
        away = np.hypot(*(axis[rows] - crowns.xy_m[rows]).T)
        first, second = cKDTree(axis[rows]).query_pairs(wide_m, output_type="ndarray").T
        found[rows[np.where(away[first] > away[second], first, second)]] = False
    shows[found] = TRUNK
    axis[~found], sigma[~found] = np.nan, np.nan
    return Trunks(shows, axis, sigma)


def _column(cubes: Ints, top_m: Floats) -> Floats | None:
    """Place (2,) of the disc that most speaks for a trunk, None where none does.

    The returns but one within a disc about one of them are binomial among those within the wider
    disc, if they lie evenly; as many discs are tried as there are returns.
    """
    if len(cubes) < 3:
        return None
    corner = cubes[:, :2].min(axis=0) - _WIDE_CELLS
    row, column = (cubes[:, :2] - corner).T
    size = cubes[:, :2].max(axis=0) - corner + _WIDE_CELLS + 1
    count = np.zeros(size, np.float32)
    np.add.at(count, (row, column), 1.0)
    highest, lowest = np.full(size, -1e6, np.float32), np.full(size, 1e6, np.float32)
    np.maximum.at(highest, (row, column), cubes[:, 2] * _CUBE_M)
    np.minimum.at(lowest, (row, column), cubes[:, 2] * _CUBE_M)
    core, wide = _trunk_disc(_CORE_CELLS), _trunk_disc(_WIDE_CELLS)
    row, column = np.nonzero(count)
    places = (np.column_stack([row, column]) + corner + 0.5) * _CUBE_M
    near = np.hypot(*(places - top_m).T) <= REACH_M
    row, column, places = row[near], column[near], places[near]
    sums = (cv2.filter2D(count, -1, d, borderType=cv2.BORDER_CONSTANT) for d in (core, wide))
    inner, outer = (np.rint(one[row, column]).astype(np.float64) for one in sums)
    kernel = core.astype(np.uint8)
    span = (cv2.dilate(highest, kernel) - cv2.erode(lowest, kernel))[row, column]
    tries = count[row, column].sum()
    chance = tries * binom.sf(inner - 2, outer - 1, core.sum() / wide.sum())
    good: Bools = (inner >= _OWN * outer) & (span >= _SPAN_M) & (chance < _CHANCE)
    if not good.any():
        return None
    best = int(np.argmin(np.where(good, chance, np.inf)))
    beside = np.hypot(*(places - places[best]).T) > _WIDE_CELLS * _CUBE_M
    if (inner[beside] > _OTHERS * inner[best]).any():
        return None
    return np.asarray(places[best], np.float64)


def _trunk_disc(cells: int) -> Floats32:
    y, x = np.mgrid[-cells : cells + 1, -cells : cells + 1]
    return np.asarray(x * x + y * y <= cells * cells, np.float32)
