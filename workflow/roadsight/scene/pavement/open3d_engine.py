"""What the pavement is found by, computed by Open3D instead: normals, FPFH, clusters.

Points are moved to their own centre first: Open3D forms covariances as E[xx] - E[x]E[x], which
loses digits far from the origin. It searches neighbours with the point itself among them, hence
K + 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from roadsight.base.arrays import Floats, Floats32, Ints
from roadsight.base.engines import open3d

# As in `fpfh.upward_normals`: a middle eigenvalue below this share of the sum is a line.
_NO_PLANE = 1e-6


def open3d_normals(xyz_m: Floats, neighbours: int) -> tuple[Floats, Floats]:
    """Upward unit normals (n, 3) and surface variation (n,), as `fpfh.upward_normals` has them.

    Parameters
    ----------
    xyz_m : (n, 3) local metres. neighbours : K1.

    Raises
    ------
    InputError : Open3D cannot be loaded.
    """
    o3d = open3d("pavement.fpfh_engine")
    if len(xyz_m) == 0:
        return np.empty((0, 3)), np.empty(0)
    cloud, search = _cloud(o3d, xyz_m), o3d.geometry.KDTreeSearchParamKNN(neighbours + 1)
    cloud.estimate_covariances(search)
    cloud.estimate_normals(search)
    normals = np.array(cloud.normals)
    normals *= np.where(normals[:, 2] < 0, -1.0, 1.0)[:, None]
    values = np.linalg.eigvalsh(np.asarray(cloud.covariances))
    total = values.sum(axis=1)
    planar = values[:, 1] > _NO_PLANE * np.maximum(total, 1e-12)
    variation = np.full(len(xyz_m), np.nan)
    np.divide(np.maximum(values[:, 0], 0.0), total, out=variation, where=planar)
    return np.where(planar[:, None], normals, np.nan), variation


def open3d_fpfh(xyz_m: Floats, normals: Floats, neighbours: int) -> Floats32:
    """FPFH (n, 33) of each point, as `fpfh.fpfh` has them; zero where there is no normal.

    The third angle of two points whose normals are as close to the line between them has no sign
    of its own: here rounding chooses it, which `fpfh.fpfh` does not leave to chance.

    Parameters
    ----------
    xyz_m : (n, 3) local metres. normals : (n, 3), NaN where unknown. neighbours : K1.

    Raises
    ------
    InputError : Open3D cannot be loaded.
    """
    o3d = open3d("pavement.fpfh_engine")
    if len(xyz_m) == 0:
        return np.empty((0, 33), np.float32)
    known = np.isfinite(normals[:, 0])
    cloud = _cloud(o3d, xyz_m)
    cloud.normals = o3d.utility.Vector3dVector(np.where(known[:, None], normals, 0.0))
    search = o3d.geometry.KDTreeSearchParamKNN(neighbours + 1)
    found = o3d.pipelines.registration.compute_fpfh_feature(cloud, search).data
    return np.where(known[:, None], np.asarray(found).T, 0.0).astype(np.float32)


def open3d_clusters(xyz_m: Floats, distance_m: float) -> Ints:
    """Cluster (n,) of each point by DBSCAN in which every point is a core point.

    With one point enough for a core, DBSCAN's clusters are chains of points closer than
    ``distance_m``, which is what `outline.euclidean_clusters` finds.

    Parameters
    ----------
    xyz_m : (n, 3) local metres, at least one.

    Raises
    ------
    InputError : Open3D cannot be loaded.
    """
    o3d = open3d("pavement.cluster_engine")
    labels = _cloud(o3d, xyz_m).cluster_dbscan(distance_m, min_points=1)
    return np.asarray(labels, np.int64)


def _cloud(o3d: Any, xyz_m: Floats) -> Any:
    centred = np.asarray(xyz_m, np.float64) - np.mean(xyz_m, axis=0, dtype=np.float64)
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(centred))
