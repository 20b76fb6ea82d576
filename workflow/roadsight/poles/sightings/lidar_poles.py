"""Pole-like columns of a cloud: tall, thin, and with little around them.

They are landmarks for cameras and a second opinion about poles seen in images, never poles by
themselves: clean trunks and lamp posts look alike here.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints
from roadsight.base.sections.poles import Columns

_USUAL = Columns()  # what a column is, unless asked for another
# ASPRS classes that no return of a pole has: ground, noise, water, road, bridge deck. Producers
# file poles under anything else: 0, 1, vegetation, wires and towers, or numbers of their own.
NO_COLUMN = tuple(_USUAL.excluded_classes)
_LOWEST_M = 1.0  # returns below this may be of grass, shrubs and fences
_TRUNK_M = 4.5  # below this there are no wires and arms, so that a pole stands alone
_LAYER_M = 1.0  # height of the layers in which a column must have points
_CELL_M = 0.5  # cells in plan in which columns are looked for
_APART_M = 1.5  # of columns nearer to each other, the one with more layers stays
_THIN_M = 0.3  # cells that count as one point each, however dense the cloud
_HEAD_M = 1.2  # below the top by this much begin arms, lamps and wires, which lie beside the axis
# Chance of no return below the wires at which a column hangs in the air. Of 144 columns at true
# poles on twelve generated roads two have less, of 374 other columns 335.
_CHANCE = 0.01
# Standard deviations of a return about the surface of a stem that are tried, a factor of about 1.4
# apart: surveys and scanners differ, and so do stems, which lean and have bark.
_NOISE_M = (0.015, 0.02, 0.03, 0.045, 0.06)
# Density of a stray return at a distance from the surface, 1/m, over 2.5 (the square root of two
# pi): one in fifty at a noise of 3 cm.
_STRAY_PER_M = 0.67
_CENTRE_STEP_M = 0.02  # step of the places tried
# Places tried in either direction from the median return.
_CENTRES_M = np.arange(-0.30, 0.301, _CENTRE_STEP_M)
# Standard deviation that no place gets below: what a step of the grid leaves open.
_LEAST_SIGMA_M = _CENTRE_STEP_M / np.sqrt(12.0)
# Returns that place a stem; of more, evenly chosen ones. At 3 cm of noise they place it to 3 mm, a
# half of a grid step's sigma. A mobile map of 3.4 million points: 66 CPU s and 2.3 GB without.
_MOST_RETURNS = 250
_RADII_M = np.arange(0.03, 0.26, 0.02)  # radii tried, from a sign post's to a thick trunk's
_USUAL_RADIUS_M = 0.13  # usual radius of poles and trunks beside roads
# One standard deviation of radii; it decides where returns show one side only.
_SPREAD_OF_RADII_M = 0.05


def _nothing() -> Floats:
    return np.empty(0)


@dataclass(frozen=True)
class PoleColumns:
    """Pole-like columns.

    Parameters
    ----------
    xy_m : (n, 2) axes, local metres. top_m : (n,) height of their tops above the ground.
    sigma_m : (n,) of their places, each axis. z_ground_m : (n,) ground at their feet.
    points : (n,) returns that their places rest on. open_top : (n,) 1 where the cloud does not show
    how high they are, else 0. The last three are empty where nobody asks.
    """

    xy_m: Floats
    top_m: Floats
    sigma_m: Floats
    z_ground_m: Floats = field(default_factory=_nothing)
    points: Floats = field(default_factory=_nothing)
    open_top: Floats = field(default_factory=_nothing)

    def __len__(self) -> int:
        return len(self.xy_m)


def find_pole_columns(
    xyz_m: Floats, above_ground_m: Floats, cls: NDArray, settings: Columns = _USUAL
) -> PoleColumns:
    """Pole-like columns among returns, by falling number of layers and then by place.

    A column has points in at least three layers of 1 m, reaches ``min_top_m``, and has few points
    around it: at trunk height (below 4.5 m, under the wires) at most half as many as its own, above
    at most three times as many (wires and arms, but no crown), all counted in cells of 0.3 m, and
    unless the settings say otherwise. Its own are within ``radius_m``, a trunk wherever in its cell
    it stands; those up to ``around_m`` are of something around it, such as a crown or a wall. It
    does not hang in the air, as wires and branches do.

    Parameters
    ----------
    xyz_m : returns (n, 3), local metres. above_ground_m : (n,), NaN where unknown.
    cls : ASPRS class (n,).
    """
    with np.errstate(invalid="ignore"):
        high = ~np.isin(cls, settings.excluded_classes) & (above_ground_m > _LOWEST_M)
    points, height_m = np.asarray(xyz_m, np.float64)[high], above_ground_m[high]
    if not len(points):
        return PoleColumns(np.empty((0, 2)), *[_nothing()] * 5)
    # In order of place, so that the order of the returns does not matter.
    order = np.lexsort(points.T)
    points, height_m = points[order], height_m[order]
    thin = thinned(np.column_stack([points[:, :2], height_m]), _THIN_M)
    centres = _isolated(thin[:, :2], thin[:, 2], settings)
    return _placed(centres, points, height_m, settings.radius_m)


def thinned(points_m: Floats, cell_m: float, axes: int = 3) -> Floats:
    """Mean of the points (n, 3) in each cell, so that density does not matter; by their cells.

    Parameters
    ----------
    axes : 3 for cubes, 2 for cells in plan.
    """
    if not len(points_m):
        return points_m
    cell = np.floor(points_m[:, :axes] / cell_m).astype(np.int64)
    _, number, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    sums = [np.bincount(number.ravel(), values) for values in points_m.T]
    return np.asarray(np.column_stack(sums) / count[:, None], np.float64)


def _isolated(xy: Floats, height: Floats, settings: Columns) -> Floats:
    """Rough places (n, 2) of what is tall and thin."""
    centre, layers, top = _tall_cells(xy, height)
    good = (layers >= 3) & (top >= settings.min_top_m)
    centre, layers = centre[good], layers[good]
    # A trunk may lie across two cells: the window must hold it whichever cell's centre is taken.
    tree, trunk = cKDTree(xy), cKDTree(xy[height < _TRUNK_M])
    radii_m = settings.radius_m, settings.around_m
    inner, outer = (_count(tree, centre, r) for r in radii_m)
    inner_trunk, outer_trunk = (_count(trunk, centre, r) for r in radii_m)
    # One or two points more, so that thin columns of a sparse cloud are not lost to a stray.
    alone = outer_trunk - inner_trunk <= settings.around_trunk * inner_trunk + 1
    alone &= outer - inner <= settings.around_all * inner + 2
    centre, layers, inner = centre[alone], layers[alone], inner[alone]
    order = np.lexsort((centre[:, 1], centre[:, 0], -inner, -layers))
    return centre[_apart(centre[order], order)]


def _tall_cells(xy: Floats, height: Floats) -> tuple[Floats, Ints, Floats]:
    """Mean place (n, 2), number of occupied layers and greatest height of each plan cell."""
    cell = np.floor(xy / _CELL_M).astype(np.int64)
    layer = np.floor(height / _LAYER_M).astype(np.int64)
    _, number = np.unique(cell, axis=0, return_inverse=True)
    number = number.ravel()
    cells = int(number.max()) + 1
    weight = np.bincount(number, minlength=cells)
    mean = np.column_stack([np.bincount(number, axis) / weight for axis in xy.T])
    both = np.unique(number * 4096 + np.clip(layer, 0, 4095))
    top = np.zeros(cells)
    np.maximum.at(top, number, height)
    return mean, np.bincount(both // 4096, minlength=cells), top


def _count(tree: cKDTree, places: Floats, radius_m: float) -> Ints:
    if not len(places) or not tree.n:
        return np.zeros(len(places), np.int64)
    return np.asarray(tree.query_ball_point(places, radius_m, return_length=True), np.int64)


def _apart(ordered: Floats, order: Ints) -> Ints:
    """Which to keep, best first, so that no two are nearer than `_APART_M`."""
    if not len(ordered):
        return order
    tree = cKDTree(ordered)
    free = np.ones(len(ordered), bool)
    kept = []
    for i in range(len(ordered)):
        if free[i]:
            kept.append(order[i])
            free[tree.query_ball_point(ordered[i], _APART_M)] = False
    return np.array(kept, np.int64)


def _placed(centres: Floats, points: Floats, height: Floats, radius_m: float) -> PoleColumns:
    """Place each column on the axis of its own points below the arms and wires."""
    tree = cKDTree(points[:, :2])
    found = np.empty((len(centres), 6))
    hanging = np.zeros(len(centres), bool)
    for number, centre in enumerate(centres):
        own = np.array(sorted(tree.query_ball_point(centre, radius_m)), np.int64)
        top = float(height[own].max())
        hanging[number] = _hangs(height[own])
        stem = own[height[own] <= max(top - _HEAD_M, 0.7 * top, _TRUNK_M)]
        stem = stem if len(stem) >= 2 else own
        xy, sigma, used = stem_axis(points[stem, :2])
        ground = float(np.median(points[own, 2] - height[own]))
        found[number] = *xy, top, sigma, ground, used
    found = found[~hanging]
    rest = np.ascontiguousarray(np.column_stack([found[:, 2:], np.zeros(len(found))]).T)
    return PoleColumns(found[:, :2].copy(), *rest)


def _hangs(height_m: Floats) -> bool:
    """Whether returns of these heights above ground (n,) are too high up for a stem.

    A stem has them anywhere between its foot and its top; several wires above each other, and
    tufts of crowns, have none below.
    """
    low, top = float(height_m.min()), float(height_m.max())
    share = (top - low) / (top - _LOWEST_M)
    return low > _TRUNK_M and share ** len(height_m) < _CHANCE


def stem_axis(xy_m: Floats) -> tuple[Floats, float, int]:
    """Axis of a round stem in plan from returns on its surface.

    Returns lie on the side that faces the scanner: their mean is up to a radius off. The posterior
    of centre, radius (usually 13 cm) and noise (1.5 to 6 cm, each as likely beforehand) is summed
    on a grid, with strays that may lie anywhere; its mean and spread are given, so that a second
    place that fits counts too. They are relative to the cloud, whose own error on the ground is in
    neither.

    Parameters
    ----------
    xy_m : (n, 2) returns, n at least 1; of many, some count, evenly chosen in their order.

    Returns
    -------
    axis (2,), sigma of either coordinate, and the number of returns that agree
    """
    middle = np.median(xy_m, axis=0)
    offset = xy_m - middle
    x, y = np.meshgrid(_CENTRES_M, _CENTRES_M, indexing="ij")
    some = offset[:: -(-len(offset) // _MOST_RETURNS)]
    away = np.hypot(some[:, 0, None, None] - x, some[:, 1, None, None] - y)
    off_m = away[..., None] - _RADII_M
    fits = np.stack(
        [
            np.log(np.exp(-0.5 * (off_m / noise) ** 2) / noise + _STRAY_PER_M).sum(axis=0)
            for noise in _NOISE_M
        ]
    )
    fits -= 0.5 * ((_RADII_M - _USUAL_RADIUS_M) / _SPREAD_OF_RADII_M) ** 2
    weight = np.exp(fits - fits.max())
    centre = weight.sum(axis=(0, 3)) / weight.sum()
    mean = np.array([(centre * x).sum(), (centre * y).sum()])
    variance = 0.5 * (centre * ((x - mean[0]) ** 2 + (y - mean[1]) ** 2)).sum()
    noise, *place, radius = np.unravel_index(int(np.argmax(fits)), fits.shape)
    surface = np.hypot(*(offset - _CENTRES_M[place]).T) - _RADII_M[radius]
    agree = int(np.count_nonzero(np.abs(surface) < 3.0 * _NOISE_M[noise]))
    return middle + mean, float(np.hypot(np.sqrt(variance), _LEAST_SIGMA_M)), agree
