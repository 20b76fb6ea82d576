"""Things beside the road as objects: connected, and named by what they are like."""

from __future__ import annotations

import re
from itertools import combinations_with_replacement, product

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from roadsight.base.arrays import Bools, Floats, Floats32, Ints

LOWEST_M = 0.3  # surfels lower than this above the ground are ground: a kerb, grass, a bank
# Surfels in the same or in touching cubes of this edge belong together: more than the spacing of
# leaves and rails in a scan of 20 points/m2, less than the gap between two posts.
_CELL_M = 0.4
_FEWEST = 4  # places of surfels of an object; fewer are stray. One return has three at its place.
_TOGETHER = 3  # surfels in a cube of 0.8 m whose normals are compared
_POLE_WIDE_M = 0.5  # nine tenths of a pole's surfels lie so near its axis
_POLE_M = 2.5  # a pole is so high at least
_SIGN_THICK_M = 0.15  # standard deviation of a sign's points across its panel, at most
_SIGN_LONG_M = 5.0  # a sign is so long at most, post and panel
_BARRIER_M = 1.6  # a barrier is so high at most: walls against noise are buildings here
_BARRIER_LONG_M = 4.0  # a barrier is so long at least, and four times as long as wide
# Agreement of normals within a cube below which it is foliage: walls have 0.9 and more, crowns of
# the generated roads 0.5 to 0.75.
_LEAFY = 0.8
_TREE_M = 1.5  # a tree is so high at least; what is leafy and lower is a bush. Signs are as high.
_BUILDING_M2 = 4.0  # footprint of a building or another structure, at least
# What is told of an object.
_OBJECT = ["name", "kind", "x", "y", "z", "height_m", "length_m", "surfels"]


def objects_of(
    centre_m: Floats | Floats32, normal: Floats | Floats32, height_m: Floats
) -> tuple[Ints, pd.DataFrame]:
    """Objects of a scene.

    Parameters
    ----------
    centre_m, normal : (n, 3) of the surfels, local metres. height_m : (n,) above the ground; NaN
        where that is not known, which belongs to no object.

    Returns
    -------
    (n,) row of each surfel's object, -1 for the ground and stray ones; and the objects: name (kind
    and place in metres, so that others coming or going do not rename it), kind, x, y, z, height_m
    (of its top), length_m and surfels.
    """
    row_of = np.full(len(centre_m), -1, np.int64)
    high = np.flatnonzero(height_m >= LOWEST_M)
    places = centre_m[high].astype(np.float64)
    groups = connected(places, stands_low(places, height_m[high]))
    distinct = _first_of(_numbered(groups, *places.T), groups)
    large = np.bincount(distinct) >= _FEWEST
    if not large.any():
        return row_of, pd.DataFrame({name: [] for name in _OBJECT})
    kept = large[groups]
    group = (np.cumsum(large) - 1)[groups[kept]]
    high, places = high[kept], places[kept]
    row_of[high] = group
    by_object = pd.DataFrame(places, columns=[*"xyz"]).groupby(group)
    table = by_object.median()
    table["kind"] = kinds_of_objects(places, normal[high].astype(np.float64), height_m[high], group)
    table["height_m"] = pd.Series(height_m[high]).groupby(group).quantile(0.98)
    extent = by_object[["x", "y"]].max() - by_object[["x", "y"]].min()
    table["length_m"] = np.hypot(extent["x"], extent["y"])
    table["surfels"] = np.bincount(group)
    # A number tells those apart that share kind and place.
    names = [
        f"{kind}{round(x):+d}{round(y):+d}"
        for kind, x, y in zip(table["kind"], table["x"], table["y"], strict=True)
    ]
    times = pd.Series(names).groupby(names).cumcount() + 1
    table["name"] = [f"{name}-{n}" if n > 1 else name for name, n in zip(names, times, strict=True)]
    return row_of, table[_OBJECT]


def connected(centre_m: Floats, part: Ints | Bools | None = None) -> Ints:
    """Number of the object (n,) that each point belongs to: cubes of 0.4 m that touch.

    Parameters
    ----------
    part : (n,) points of different parts do not belong together.
    """
    if not len(centre_m):
        return np.empty(0, np.int64)
    cells = np.floor(centre_m / _CELL_M).astype(np.int64)
    cells -= cells.min(axis=0) - 1
    if part is not None:
        cells[:, 0] += np.asarray(part, np.int64) * (cells[:, 0].max() + 2)
    size = cells.max(axis=0) + 2
    keys = (cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2]
    unique, cube = np.unique(keys, return_inverse=True)
    pairs = []
    for step in product((-1, 0, 1), repeat=3):
        if step <= (0, 0, 0):
            continue
        shifted = unique + (step[0] * size[1] + step[1]) * size[2] + step[2]
        at = np.minimum(np.searchsorted(unique, shifted), len(unique) - 1)
        found = np.flatnonzero(unique[at] == shifted)
        pairs.append(np.column_stack([found, at[found]]))
    rows, columns = np.concatenate(pairs).T
    graph = sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(unique),) * 2)
    return np.asarray(connected_components(graph, directed=False)[1][cube], np.int64)


def stands_low(centre_m: Floats, height_m: Floats) -> Bools:
    """Whether what stands at each point (n,) is no higher than a barrier, without a gap above it.

    A barrier that meets a portal, or a rail that touches a lamp, is an object of its own.
    """
    cells = np.floor(centre_m / _CELL_M).astype(np.int64)
    order = np.lexsort((cells[:, 2], cells[:, 1], cells[:, 0]))
    before, after = cells[order][:-1], cells[order][1:]
    parted = (before[:, :2] != after[:, :2]).any(axis=1) | (after[:, 2] - before[:, 2] > 1)
    run = np.concatenate([[0], np.cumsum(parted)])[: len(order)]
    top_m = np.full(len(order), -np.inf)
    np.maximum.at(top_m, run, height_m[order])
    low = np.empty(len(order), bool)
    low[order] = top_m[run] <= _BARRIER_M
    return low


def kinds_of_objects(xyz_m: Floats, normal: Floats, height_m: Floats, group: Ints) -> list[str]:
    """What each object is like: pole, sign, barrier, tree, bush, building, or object.

    Parameters
    ----------
    xyz_m, normal : (n, 3) of surfels. height_m : (n,) above the ground. group : (n,) their objects,
        from 0, none without a surfel.
    """
    shapes = _shapes(xyz_m, height_m, group)
    top, length = shapes["top_m"], 3.5 * shapes["along_m"]  # of an even line
    slender = (top >= _POLE_M) & (shapes["away_m"] <= _POLE_WIDE_M)
    low = (top <= _BARRIER_M) & (length >= _BARRIER_LONG_M)
    leafy = _agreement(xyz_m, normal, group) < _LEAFY
    flat = (shapes["across_m"] <= _SIGN_THICK_M) & (length <= _SIGN_LONG_M)
    large = (top >= _POLE_M) & (shapes["footprint_m2"] >= _BUILDING_M2)
    rules: dict[str, Bools] = {
        "pole": slender,
        "barrier": low & (shapes["along_m"] >= 4 * shapes["across_m"]),
        "tree": leafy & (top >= _TREE_M),
        "bush": leafy,
        "sign": flat & (top >= _TREE_M),
        "building": large,
    }
    first = np.select(list(rules.values()), list(range(len(rules))), len(rules))
    return [[*rules, "object"][number] for number in first]


def _shapes(xyz_m: Floats, height_m: Floats, group: Ints) -> dict[str, Floats]:
    """Measures of each object.

    Returns
    -------
    top_m; away_m, nine tenths are so near its axis; along_m and across_m, standard deviations along
    the axes of its footprint; footprint_m2, square metres that it meets
    """
    count = np.bincount(group)
    table = pd.DataFrame({"x": xyz_m[:, 0], "y": xyz_m[:, 1], "height_m": height_m})
    axis = table[["x", "y"]].groupby(group).median().to_numpy()
    table["away_m"] = np.hypot(*(xyz_m[:, :2] - axis[group]).T)
    x, y = (xyz_m[:, k] - (np.bincount(group, xyz_m[:, k]) / count)[group] for k in range(2))
    xx, yy, xy = (
        np.bincount(group, part) / np.maximum(count - 1, 1) for part in (x * x, y * y, x * y)
    )
    middle, apart = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    square = _numbered(group, *np.floor(xyz_m[:, :2]).T)
    return {
        "top_m": table["height_m"].groupby(group).quantile(0.98).to_numpy(),
        "away_m": table["away_m"].groupby(group).quantile(0.9).to_numpy(),
        "along_m": np.sqrt(middle + apart),
        "across_m": np.sqrt(np.maximum(middle - apart, 0.0)),
        "footprint_m2": np.bincount(_first_of(square, group)).astype(np.float64),
    }


def _agreement(xyz_m: Floats, normal: Floats, group: Ints) -> Floats:
    """How far normals of each object agree within cubes of 0.8 m, 1/3 (any) to 1 (all the same).

    The mean over its cubes; 1 where none has enough surfels.
    """
    cube = _numbered(group, *np.floor(xyz_m / (2 * _CELL_M)).T)
    owner, count = _first_of(cube, group), np.bincount(cube)
    tensor = np.empty((len(count), 3, 3))
    for one, two in combinations_with_replacement(range(3), 2):
        tensor[:, one, two] = np.bincount(cube, normal[:, one] * normal[:, two]) / count
        tensor[:, two, one] = tensor[:, one, two]
    weight = np.where(count >= _TOGETHER, count, 0)
    total = np.bincount(owner, weight)
    agreed = np.bincount(owner, weight * np.linalg.eigvalsh(tensor)[:, -1])
    return np.divide(agreed, total, out=np.ones(len(total)), where=total > 0)


def _numbered(*columns: Ints | Floats) -> Ints:
    """Number of each row's combination of values (n,), from 0 in the order of the rows."""
    table = pd.DataFrame(dict(enumerate(columns)))
    numbers = table.groupby(list(table.columns), sort=False).ngroup()
    return np.asarray(numbers, np.int64)


def _first_of(number: Ints, value: Ints) -> Ints:
    """Value of the first row of each number (from 0, in the order of the rows)."""
    return value[np.unique(number, return_index=True)[1]]


def kind_of_name(name: str) -> str:
    """Kind of an object by its name."""
    return re.split(r"[+-]", name, maxsplit=1)[0]


def place_of_name(name: str) -> tuple[float, float] | None:
    """Local x, y of an object by its name, to half a metre; None where it tells none."""
    found = re.search(r"([+-]\d+)([+-]\d+)(-\d+)?$", name)
    return None if found is None else (float(found[1]), float(found[2]))
