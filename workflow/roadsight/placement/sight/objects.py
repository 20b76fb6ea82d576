"""Things beside the road as objects: connected, and named by what they are like."""

from __future__ import annotations

import re
from itertools import product

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from roadsight.base.arrays import Bools, Floats, Floats32, Ints

LOWEST_M = 0.3
"""Surfels lower than this above the ground are ground: a kerb, grass, a bank."""
_CELL_M = 0.4
"""Surfels in the same or in touching cubes of this edge belong together: more than the spacing of
leaves and rails in a scan of 20 points/m2, less than the gap between two posts."""
_FEWEST = 4
"""Places of surfels of an object; fewer are stray. One return has three surfels at its place."""
_TOGETHER = 3
"""Surfels in a cube of 0.8 m whose normals are compared."""
_POLE_WIDE_M = 0.5
"""Nine tenths of a pole's surfels lie so near its axis."""
_POLE_M = 2.5
"""A pole is so high at least."""
_SIGN_THICK_M = 0.15
"""Standard deviation of a sign's points across its panel, at most."""
_SIGN_LONG_M = 5.0
"""A sign is so long at most, post and panel."""
_BARRIER_M = 1.6
"""A barrier is so high at most: walls against noise are buildings here."""
_BARRIER_LONG_M = 4.0
"""A barrier is so long at least, and four times as long as wide."""
_LEAFY = 0.8
"""Agreement of normals within a cube below which it is foliage: walls have 0.9 and more, crowns of
the generated roads 0.5 to 0.75."""
_TREE_M = 1.5
"""A tree is so high at least; what is leafy and lower is a bush. Signs are as high."""
_BUILDING_M2 = 4.0
"""Footprint of a building or another structure, at least."""


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


def kind_of_object(xyz_m: Floats, normal: Floats, height_m: Floats) -> str:
    """What an object is like: pole, sign, barrier, tree, bush, building, or object.

    Parameters
    ----------
    xyz_m, normal : (n, 3) of its surfels. height_m : (n,) above the ground.
    """
    top = float(np.percentile(height_m, 98))
    xy = xyz_m[:, :2] - np.median(xyz_m[:, :2], axis=0)
    away = np.hypot(*xy.T)
    across, along = np.sqrt(np.maximum(np.linalg.eigvalsh(np.atleast_2d(np.cov(xy.T))), 0.0))
    length = 3.5 * along  # of an even line
    if top >= _POLE_M and np.percentile(away, 90) <= _POLE_WIDE_M:
        return "pole"
    if top <= _BARRIER_M and length >= _BARRIER_LONG_M and along >= 4 * across:
        return "barrier"
    leafy = _agreement(xyz_m, normal) < _LEAFY
    if leafy:
        return "tree" if top >= _TREE_M else "bush"
    if top >= _TREE_M and across <= _SIGN_THICK_M and length <= _SIGN_LONG_M:
        return "sign"
    footprint = len(np.unique(np.floor(xyz_m[:, :2]).astype(np.int64), axis=0))
    if top >= _POLE_M and footprint >= _BUILDING_M2:
        return "building"
    return "object"


def _agreement(xyz_m: Floats, normal: Floats) -> float:
    """How far normals agree within cubes of 0.8 m, 1/3 (any) to 1 (all the same), their mean."""
    cells = np.floor(xyz_m / (2 * _CELL_M)).astype(np.int64)
    _, cube, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    tensor = np.zeros((len(count), 3, 3))
    np.add.at(tensor, cube.ravel(), normal[:, :, None] * normal[:, None, :])
    many = count >= _TOGETHER
    if not many.any():
        return 1.0
    largest = np.linalg.eigvalsh(tensor[many] / count[many, None, None])[:, -1]
    return float(np.average(largest, weights=count[many]))


def kind_of_name(name: str) -> str:
    """Kind of an object by its name."""
    return re.split(r"[+-]", name, maxsplit=1)[0]


def place_of_name(name: str) -> tuple[float, float] | None:
    """Local x, y of an object by its name, to half a metre; None where it tells none."""
    found = re.search(r"([+-]\d+)([+-]\d+)(-\d+)?$", name)
    return None if found is None else (float(found[1]), float(found[2]))


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
    high = np.flatnonzero(height_m >= LOWEST_M)
    row_of = np.full(len(centre_m), -1, np.int64)
    places = centre_m[high].astype(np.float64)
    groups = connected(places, stands_low(places, height_m[high]))
    order = np.argsort(groups, kind="stable")
    members = np.split(high[order], np.cumsum(np.bincount(groups))[:-1]) if len(high) else []
    rows: list[dict[str, object]] = []
    used: dict[str, int] = {}
    for member in members:
        xyz = centre_m[member].astype(np.float64)
        if len(np.unique(xyz, axis=0)) < _FEWEST:
            continue
        kind = kind_of_object(xyz, normal[member].astype(np.float64), height_m[member])
        x, y, z = np.median(xyz, axis=0)
        name = f"{kind}{round(x):+d}{round(y):+d}"
        used[name] = used.get(name, 0) + 1
        if used[name] > 1:
            name = f"{name}-{used[name]}"
        row_of[member] = len(rows)
        span = np.ptp(xyz[:, :2], axis=0)
        rows.append(
            {
                "name": name,
                "kind": kind,
                "x": float(x),
                "y": float(y),
                "z": float(z),
                "height_m": float(np.percentile(height_m[member], 98)),
                "length_m": float(np.hypot(*span)),
                "surfels": len(member),
            }
        )
    names = ["name", "kind", "x", "y", "z", "height_m", "length_m", "surfels"]
    return row_of, pd.DataFrame(rows, columns=names)
