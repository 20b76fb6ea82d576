"""What a scene is like: density, spacing, relief, cover; the numbers that later choices hang on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Bytes, Floats, Ints
from roadsight.base.errors import InputError

CELL_M = 1.0  # Edge of the cells that are counted; tiles are made of whole ones.
# Points that cells hold on average before density is told, see `density`.
_POINTS_PER_DENSITY_CELL = 4
# Points up to this above the lowest of their cell are ground and what lies on it.
_GROUND_BAND_M = 1.0
# What is higher above the lowest point of a cell, with nothing between, spans it overhead.
_CLEARANCE_M = 3.0
_WINDOWS = 50  # Windows in which spacing is measured, at even steps through the cloud.
_WINDOW_POINTS = 400  # Points of a window at the cloud's median density, which sets its size.
# Distances taken of each window, so that dense windows do not outvote the others.
_WINDOW_SAMPLE = 200
# Margin of a window, in spacings of the cloud: neighbours of its points lie within.
_HALO_SPACINGS = 5.0
Bounds = tuple[float, float, float, float]


@dataclass(frozen=True)
class Cells:
    """Occupied cells of 1 m, each of shape (n,) in row-major order.

    Parameters
    ----------
    column, row : place, in cells from the local origin.
    count : points.
    lowest_m : least height, local metres.
    covered : whether something spans the cell overhead, see `count_cells`.
    class_cells : number of cells that hold a point of each class.
    """

    column: Ints
    row: Ints
    count: Ints
    lowest_m: Floats
    covered: Bools
    class_cells: Counter[int]


def count_cells(xyz: NDArray[np.floating], classification: Bytes) -> Cells:
    """Sort points into cells of 1 m.

    A cell counts as covered when points lie more than 3 m above its lowest one and none between
    1 m and 3 m: a deck, a tunnel, wires or a crown, but no wall and no bush.

    Parameters
    ----------
    xyz : local metres, shape (n, 3).
    classification : shape (n,).
    """
    place = np.floor(xyz[:, :2].astype(np.float64) / CELL_M).astype(np.int64)
    order = np.lexsort((place[:, 0], place[:, 1]))
    place, z = place[order], xyz[order, 2].astype(np.float64)
    new = np.ones(len(place), bool)
    new[1:] = (place[1:] != place[:-1]).any(axis=1)
    starts, cell = np.flatnonzero(new), np.cumsum(new) - 1
    lowest_m = np.minimum.reduceat(z, starts) if len(z) else z
    rise_m = z - lowest_m[cell]
    cells = len(starts)
    high = np.bincount(cell[rise_m > _CLEARANCE_M], minlength=cells) > 0
    between = (rise_m > _GROUND_BAND_M) & (rise_m <= _CLEARANCE_M)
    covered = high & (np.bincount(cell[between], minlength=cells) == 0)
    pairs = np.unique(cell * 256 + classification[order])
    classes, counts = np.unique(pairs % 256, return_counts=True)
    return Cells(
        column=place[starts, 0],
        row=place[starts, 1],
        count=np.bincount(cell, minlength=cells),
        lowest_m=lowest_m,
        covered=covered,
        class_cells=Counter(dict(zip(classes.tolist(), counts.tolist(), strict=True))),
    )


def join_cells(parts: Sequence[Cells]) -> Cells:
    """Cells of several tiles that share none."""
    classes: Counter[int] = Counter()
    for part in parts:
        classes.update(part.class_cells)
    return Cells(
        np.concatenate([part.column for part in parts]),
        np.concatenate([part.row for part in parts]),
        np.concatenate([part.count for part in parts]),
        np.concatenate([part.lowest_m for part in parts]),
        np.concatenate([part.covered for part in parts]),
        classes,
    )


def density(column: Ints, row: Ints, count: Ints) -> dict[str, float]:
    """Points per square metre over occupied ground.

    The cells are coarsened by twos until they hold four points on average: in cells that hold one
    or none, a sparse cloud would look denser than it is.

    Parameters
    ----------
    column, row, count : place and points of each occupied cell of 1 m, at least one.

    Returns
    -------
    median, p05, p95 per m2 over the cells; cell_m, their edge; area_m2, what they cover
    """
    cell_m = CELL_M
    while count.mean() < _POINTS_PER_DENSITY_CELL and len(count) > 1:
        cell_m *= 2
        (row, column), count = merge_counts(np.stack([row // 2, column // 2]), count)
    p05, median, p95 = np.percentile(count / cell_m**2, [5, 50, 95])
    return {
        "median": float(median),
        "p05": float(p05),
        "p95": float(p95),
        "cell_m": cell_m,
        "area_m2": len(count) * cell_m**2,
    }


def merge_counts(places: Ints, count: Ints) -> tuple[Ints, Ints]:
    """Distinct places, columns of ``places`` of shape (2, n), and the sum of their counts."""
    order = np.lexsort(places[::-1])
    places, count = places[:, order], count[order]
    new = np.ones(len(count), bool)
    new[1:] = (places[:, 1:] != places[:, :-1]).any(axis=0)
    starts = np.flatnonzero(new)
    return places[:, starts], np.add.reduceat(count, starts) if len(count) else count


def neighbour_distances(xyz: NDArray[np.floating], core: Bools) -> Floats:
    """Distance in space from each core place to the nearest other place.

    Duplicates count as one place, so that they do not make a cloud look denser than it is.

    Parameters
    ----------
    xyz : local metres, shape (n, 3).
    core : points that are asked for, shape (n,); the others are only neighbours.

    Returns
    -------
    distances in metres; none where all points are at one place
    """
    places, first = np.unique(xyz.astype(np.float64), axis=0, return_index=True)
    if len(places) < 2:
        return np.empty(0)
    distances, _ = cKDTree(places).query(places[core[first]], k=2)
    return distances[:, 1]


def sample_distances(
    points: int,
    points_per_m2: float,
    place: Callable[[int], tuple[float, float]],
    within: Callable[[Bounds], NDArray[np.floating]],
) -> Floats:
    """Neighbour distances in windows around points at even steps through a cloud.

    Every window gives as many distances, if it can, so that every point of the cloud has the same
    chance to be asked, wherever the cloud is dense.

    Parameters
    ----------
    points : number of points of the cloud.
    points_per_m2 : its density, which sets the size of the windows.
    place : x, y of a point by its rank.
    within : x, y, z, shape (n, 3), of the points in a box west, south, east, north.

    Returns
    -------
    distances in metres; none where all points are at one place
    """
    spacing_m = points_per_m2**-0.5
    half_m = spacing_m * _WINDOW_POINTS**0.5 / 2
    reach_m = half_m + _HALO_SPACINGS * spacing_m
    distances = []
    for step in range(_WINDOWS):
        x, y = place((2 * step + 1) * points // (2 * _WINDOWS))
        xyz = within((x - reach_m, y - reach_m, x + reach_m, y + reach_m))
        core = (np.abs(xyz[:, :2] - (x, y)) <= half_m).all(axis=1)
        found = neighbour_distances(xyz, core)
        distances.append(found[:: max(1, len(found) // _WINDOW_SAMPLE)][:_WINDOW_SAMPLE])
    return np.concatenate(distances)


def mean_spacing_m(xyz: NDArray[np.floating]) -> float:
    """Median distance from a point to its nearest neighbour, sampled as for the profile.

    Parameters
    ----------
    xyz : a whole cloud, local metres, shape (n, 3).

    Raises
    ------
    InputError : no two points lie at different places.
    """
    cells = count_cells(xyz, np.zeros(len(xyz), np.uint8))
    distances = sample_distances(
        len(xyz),
        density(cells.column, cells.row, cells.count)["median"],
        lambda rank: (float(xyz[rank, 0]), float(xyz[rank, 1])),
        lambda box: xyz[
            (xyz[:, 0] >= box[0])
            & (xyz[:, 1] >= box[1])
            & (xyz[:, 0] < box[2])
            & (xyz[:, 1] < box[3])
        ],
    )
    return _median_spacing_m(distances)


def _median_spacing_m(distances_m: Floats) -> float:
    if len(distances_m) == 0:
        raise InputError("no two points of the cloud lie at different places")
    return float(np.median(distances_m))


def describe_scene(
    cells: Cells, distances_m: Floats, bounds_m: Sequence[float], intensity: Ints, has_colour: bool
) -> dict[str, Any]:
    """Profile of a scene.

    Parameters
    ----------
    cells : all occupied cells, at least one.
    distances_m : of a sample of points to their nearest neighbours.
    bounds_m : least x, y, z and greatest x, y, z.
    intensity : points of each intensity from 0, shape (65536,).

    Returns
    -------
    points; area_m2; density_per_m2 (see `density`); spacing_m, the median of `distances_m`, as
    Table 2 of the paper gives it; extent_m; relief_m, between the 5th and the 95th percentile of
    the lowest heights; slope_deg, percentiles of the slopes of smooth ground;
    overhead_cover_share and class_shares, of the occupied cells; cover_core_m2, covered ground
    that is not at the border of the cover; intensity, its percentiles

    Raises
    ------
    InputError : no two points lie at different places.
    """
    per_m2 = density(cells.column, cells.row, cells.count)
    low, high = np.percentile(cells.lowest_m, [5, 95])
    slopes = slopes_deg(cells.column * CELL_M, cells.row * CELL_M, cells.lowest_m)
    # Level where no ground is smooth enough to tell.
    slope, steep = np.percentile(slopes, [50, 95]) if len(slopes) else (0.0, 0.0)
    below = np.cumsum(intensity)
    tones = np.searchsorted(below, np.array([0.05, 0.5, 0.95]) * below[-1])
    shares = {str(c): n / len(cells.count) for c, n in sorted(cells.class_cells.items())}
    return {
        "points": int(cells.count.sum()),
        "area_m2": per_m2.pop("area_m2"),
        "density_per_m2": per_m2,
        "spacing_m": _median_spacing_m(distances_m),
        "extent_m": [bounds_m[i + 3] - bounds_m[i] for i in range(3)],
        "relief_m": float(high - low),
        "slope_deg": {"median": float(slope), "p95": float(steep)},
        "overhead_cover_share": float(cells.covered.mean()),
        "cover_core_m2": cover_core(cells.column, cells.row, cells.covered) * CELL_M**2,
        "class_shares": shares,
        "has_intensity": int((intensity > 0).sum()) > 1,
        "intensity": dict(zip(("p05", "median", "p95"), map(int, tones), strict=True)),
        "has_colour": has_colour,
    }


# Slope of the ground and what covers it, from occupied cells of 1 m.

_BLOCK_M = 8.0  # Edge of the blocks whose slope is measured: about two lanes wide.
# Known cells of the 64 of a block; fewer may lie in a strip, across which the slope is a guess.
_LEAST_CELLS = 24
# Root mean square distance of smooth ground from its plane; more is a wall, a hedge or forest.
_ROUGHEST_M = 0.15


def slopes_deg(
    x_m: NDArray[np.floating], y_m: NDArray[np.floating], z_m: NDArray[np.floating]
) -> Floats:
    """Slope (k,) of the plane through each block of 8 m of smooth ground, degrees.

    A block counts where 24 of its cells are known and they lie within 0.15 m of their plane, root
    mean square: roads, verges and embankments, but no walls, hedges or forest.

    Parameters
    ----------
    x_m, y_m, z_m : (n,) places and lowest heights of cells.
    """
    if len(x_m) == 0:
        return np.empty(0)
    block = np.floor(np.column_stack([x_m, y_m]) / _BLOCK_M).astype(np.int64)
    _, of, count = np.unique(block, axis=0, return_inverse=True, return_counts=True)
    of = of.reshape(-1)

    def mean(values: NDArray[np.floating]) -> Floats:
        return np.bincount(of, values) / count

    dx, dy, dz = (axis - mean(axis)[of] for axis in (x_m, y_m, z_m))
    xx, yy, xy = mean(dx * dx), mean(dy * dy), mean(dx * dy)
    xz, yz, zz = mean(dx * dz), mean(dy * dz), mean(dz * dz)
    area = xx * yy - xy * xy
    # Cells on one line have no area, and their plane no slope across it.
    flat = (count >= _LEAST_CELLS) & (area > 1e-6 * (xx + yy) ** 2)
    xx, yy, xy, xz, yz, zz, area = (v[flat] for v in (xx, yy, xy, xz, yz, zz, area))
    east, north = (xz * yy - yz * xy) / area, (yz * xx - xz * xy) / area
    smooth = zz - east * xz - north * yz <= _ROUGHEST_M**2
    return np.degrees(np.arctan(np.hypot(east, north)[smooth]))


def cover_core(column: Ints, row: Ints, covered: Bools) -> int:
    """Number of covered cells whose eight neighbours are covered too: no wire and no gantry.

    Parameters
    ----------
    column, row : (n,) place of each cell. covered : (n,) whether something spans it.
    """
    column, row = column[covered], row[covered]
    if len(column) == 0:
        return 0
    wide = np.int64(column.max() - column.min() + 3)
    key = (row - row.min() + 1) * wide + column - column.min() + 1
    core = np.ones(len(key), bool)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            core &= np.isin(key + down * wide + right, key)
    return int(core.sum())


# Settings follow the cloud: nothing finer than the points can resolve (paper 1, Table 2 note).

# Above this spacing K1 neighbours reach over the roughness that tells a lawn from asphalt.
COARSE_SPACING_M = 0.15


def plan_spacing_m(points_per_m2: float) -> float:
    """Spacing of evenly spread points of a density; scan lines make the nearest ones closer."""
    return points_per_m2**-0.5


def uses_intensity(choice: str, spacing_m: float) -> bool:
    """Whether intensity is a cue: "use", "ignore", or "auto" by the spacing."""
    return choice == "use" or (choice == "auto" and spacing_m > COARSE_SPACING_M)
