"""Euclidean clustering: points closer than a distance belong together (paper 1, section 2.2)."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.base.engines import OWN, Engine
from roadsight.base.kernels import compiled, compiled_part
from roadsight.scene.pavement.open3d_engine import open3d_clusters


@compiled_part()
def _root(parent: Ints, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@compiled()
def _roots(parent: Ints) -> Ints:
    return np.array([_root(parent, i) for i in range(len(parent))])


@compiled()
def _link(
    xyz: Floats,
    first: Ints,
    keys: Ints,
    stride: Ints,
    distance: float,
    parent: Ints,
) -> None:
    """Union all pairs within ``distance``; cells are as wide as it, so 27 cells hold them all."""
    for c in range(len(keys)):
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                for dz in range(-1, 2):
                    key = keys[c] + dx * stride[0] + dy * stride[1] + dz * stride[2]
                    if key < keys[c]:
                        continue  # each pair of cells once
                    other = np.searchsorted(keys, key)
                    if other == len(keys) or keys[other] != key:
                        continue
                    for i in range(first[c], first[c + 1]):
                        root = _root(parent, i)
                        for j in range(first[other], first[other + 1]):
                            d = xyz[i] - xyz[j]
                            if d[0] ** 2 + d[1] ** 2 + d[2] ** 2 < distance**2:
                                parent[_root(parent, j)] = root


def euclidean_clusters(xyz_m: Floats, distance_m: float, engine: Engine = OWN) -> Ints:
    """Cluster number of each point, 0 for the largest cluster.

    Two points share a cluster when a chain of points links them whose steps are shorter than
    ``distance_m``. Clusters of equal size are numbered by their first point.

    Parameters
    ----------
    xyz_m : (n, 3) local metres.
    engine : who links the points.

    Returns
    -------
    (n,) int64, 0 to clusters - 1.

    Raises
    ------
    InputError : the engine open3d cannot be loaded.
    """
    if len(xyz_m) == 0:
        return np.empty(0, np.int64)
    if engine == "open3d":
        return _by_size(open3d_clusters(xyz_m, distance_m))
    # An empty cell all around, so that no key beside a cell is that of a cell elsewhere.
    index = np.floor((xyz_m - xyz_m.min(axis=0)) / distance_m).astype(np.int64) + 1
    spans = index.max(axis=0) + 2
    stride = np.array([spans[1] * spans[2], spans[2], 1])
    cell = index @ stride
    order = np.argsort(cell, kind="stable")
    keys, first = np.unique(cell[order], return_index=True)
    parent = np.arange(len(xyz_m))
    points = np.ascontiguousarray(xyz_m[order], dtype=np.float64)
    _link(points, np.append(first, len(xyz_m)), keys, stride, distance_m, parent)
    roots = np.empty(len(xyz_m), np.int64)
    roots[order] = _roots(parent)
    return _by_size(roots)


def _by_size(labels: Ints) -> Ints:
    """Renumber labels so that 0 is the most frequent; ties by first appearance."""
    _, first, inverse, count = np.unique(
        labels, return_index=True, return_inverse=True, return_counts=True
    )
    rank = np.empty(len(count), np.int64)
    rank[np.lexsort((first, -count))] = np.arange(len(count))
    return rank[inverse]
