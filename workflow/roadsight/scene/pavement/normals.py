"""Neighbourhoods and oriented normals of ground points."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints
from roadsight.base.kernels import compiled


def nearest_neighbours(
    xyz_m: Floats, k: int, max_distance_m: float = np.inf
) -> tuple[Floats, Ints]:
    """Distances and indices of the ``k`` nearest other points.

    A point with fewer than ``k`` others (within reach) has index -1 and infinite distance there.

    Parameters
    ----------
    xyz_m : (n, 3) local metres.

    Returns
    -------
    distance_m, index : (n, k), nearest first; the point itself is left out.
    """
    n = len(xyz_m)
    if n == 0:
        return np.empty((0, k)), np.empty((0, k), np.int64)
    reach = cKDTree(xyz_m).query(xyz_m, k=min(k + 1, n), distance_upper_bound=max_distance_m)
    distance, index = (np.asarray(part).reshape(n, -1) for part in reach)
    own = index == np.arange(n)[:, None]
    # Among exact duplicates a point may not be its own nearest: then the last neighbour makes room.
    own[~own.any(axis=1), -1] = True
    distance, index = (part[~own].reshape(n, -1) for part in (distance, index))
    short = ((0, 0), (0, k - index.shape[1]))
    distance = np.pad(distance, short, constant_values=np.inf)
    index = np.pad(index, short, constant_values=-1)
    return distance, np.where(np.isfinite(distance), index, -1)


def upward_normals(xyz_m: Floats, neighbours: Ints) -> tuple[Floats, Floats]:
    """Unit normals that point up, and surface variation, by principal components.

    The covariance is formed around each neighbourhood's own centroid, so large coordinates lose
    nothing. A point with fewer than two neighbours, or whose neighbourhood is a line, has no plane:
    its normal is NaN and its variation is NaN, so that it cannot pass for flat road.

    Parameters
    ----------
    xyz_m : (n, 3) local metres.
    neighbours : (n, k) indices, -1 where missing.

    Returns
    -------
    normals : (n, 3); variation : (n,) smallest eigenvalue over the sum, 0 (plane) to 1/3.
    """
    values, vectors = np.linalg.eigh(_covariances(xyz_m, neighbours))
    normals = vectors[:, :, 0] * np.where(vectors[:, 2, 0] < 0, -1.0, 1.0)[:, None]
    total = values.sum(axis=1)
    planar = values[:, 1] > 1e-6 * np.maximum(total, 1e-12)
    normals = np.where(planar[:, None], normals, np.nan)
    variation = np.full(len(xyz_m), np.nan)
    np.divide(np.maximum(values[:, 0], 0.0), total, out=variation, where=planar)
    return normals, variation


def plane_residuals_m(xyz_m: Floats, neighbours: Ints) -> Floats:
    """Root mean square distance of each neighbourhood from its own plane, metres; shape (n,).

    Parameters
    ----------
    xyz_m : (n, 3) local metres.
    neighbours : (n, k) indices, -1 where missing; the point itself is added.
    """
    least = np.linalg.eigvalsh(_covariances(xyz_m, neighbours))[:, 0]
    return np.sqrt(np.maximum(least, 0.0))


@compiled()
def _covariances(xyz_m: Floats, neighbours: Ints) -> Floats:
    """Covariance (n, 3, 3) of each point and its neighbours, about their own centroid."""
    out = np.empty((len(xyz_m), 3, 3))
    group = np.empty((neighbours.shape[1] + 1, 3))
    for i in range(len(xyz_m)):
        count = 0
        for j in range(-1, neighbours.shape[1]):
            member = neighbours[i, j] if j >= 0 else i
            if member >= 0:
                for axis in range(3):
                    group[count, axis] = xyz_m[member, axis]
                count += 1
        for axis in range(3):
            centre = group[:count, axis].sum() / count
            for k in range(count):
                group[k, axis] -= centre
        for a in range(3):
            for b in range(a + 1):
                total = 0.0
                for k in range(count):
                    total += group[k, a] * group[k, b]
                out[i, a, b] = out[i, b, a] = total / count
    return out
