"""Points that stand alone: birds, dust, multipath. Radius outlier removal before surfels are built.

A point stays that has at least so many others within a radius. The test is local: it needs no
statistic of the whole cloud, so that tiles decide alike, and distant sparse ground is not judged by
the spacing beside the scanner (docs/decisions/075-engines-and-kept-libraries.md).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Numbers
from roadsight.base.engines import OWN, Engine, open3d


def in_company(
    xyz_m: Numbers, around_m: Numbers, radius_m: float, others: int, engine: Engine = OWN
) -> Bools:
    """Points (n,) with at least ``others`` other points nearer than ``radius_m``.

    Parameters
    ----------
    xyz_m : (n, 3) points to judge, local metres. around_m : (m, 3) points that count, too.
    engine : who counts.

    Raises
    ------
    InputError : the engine open3d cannot be loaded.
    """
    n = len(xyz_m)
    if n == 0:
        return np.zeros(0, bool)
    both = np.concatenate([xyz_m, around_m]).astype(np.float64)
    if engine == "own":
        if len(both) <= others:
            return np.zeros(n, bool)
        farthest = cKDTree(both).query(both[:n], k=[others + 1], distance_upper_bound=radius_m)[0]
        return np.isfinite(farthest[:, 0])
    o3d = open3d("lidar.outlier_engine")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(both))
    _, kept = cloud.remove_radius_outlier(others, radius_m)
    mask = np.zeros(len(both), bool)
    mask[np.asarray(kept, np.int64)] = True
    return mask[:n]
