"""Ground, FPFH and clustering beside Open3D on a rough slope with a smooth road."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench_measure import Size, measured, row
from roadsight.base.sections.scene import GroundFilter
from roadsight.scene.pavement.fpfh import describe_ground
from roadsight.scene.pavement.outline import euclidean_clusters
from roadsight.scene.terrain.ground import published_ground
from roadsight.scene.terrain.terrain import label_ground

NEIGHBOURS = 10


def ground_cloud(points: int, seed: int = 1) -> NDArray[np.float64]:
    """A 12 m road (1 cm noise) along rough ground (5 cm), about 400 points a square metre."""
    rng = np.random.default_rng(seed)
    length_m = points / 400 / 40
    x, y = rng.uniform(0, length_m, points), rng.uniform(-20, 20, points)
    sigma = np.where(np.abs(y) < 6, 0.01, 0.05)
    return np.column_stack([x, y, 0.02 * x + rng.normal(0, sigma)])


def rows(size: Size) -> list[dict[str, Any]]:
    """Benchmarks of the scene stages; peers that are not installed are left out."""
    cloud = ground_cloud(100_000 if size == "quick" else 1_000_000)
    found = [_ground(cloud)]
    try:
        import open3d  # noqa: F401, PLC0415
    except (ImportError, OSError) as error:
        print(f"Open3D cannot be loaded, its rows are left out: {error}")
        return found
    return [*found, _fpfh(cloud), _clusters(cloud)]


def _ground(cloud: NDArray[np.float64]) -> dict[str, Any]:
    """The robust filter against the published one (lowest point of each pillar)."""
    bounds = (0.0, -20.0, float(cloud[:, 0].max()) + 1e-3, 20.0)

    def ours() -> NDArray[np.bool_]:
        tiles = label_ground(lambda halo: iter([(bounds, cloud)]), bounds, GroundFilter())
        return next(tiles)[1]

    def published() -> NDArray[np.bool_]:
        return published_ground(*cloud.T, GroundFilter())

    ours(), published()
    mask, cpu_s, mib = measured(ours)
    other, other_cpu_s, other_mib = measured(published)
    return row(
        "ground filter",
        ("robust pillars", cpu_s, mib),
        ("lowest point of each pillar", other_cpu_s, other_mib),
        (float((mask == other).mean()), "share of equal labels (all points are ground)"),
        f"{len(cloud)} points",
    )


def _fpfh(cloud: NDArray[np.float64]) -> dict[str, Any]:
    import open3d as o3d  # noqa: PLC0415

    intensity = np.zeros(len(cloud))
    describe_ground(cloud[:2000], intensity[:2000], 0.01, NEIGHBOURS)
    column_m = 0.001  # every point is its own column: both sides describe the same points
    ours, cpu_s, mib = measured(lambda: describe_ground(cloud, intensity, column_m, NEIGHBOURS))

    def peer() -> NDArray[np.float64]:
        points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(ours.xyz_m))
        search = o3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS + 1)
        points.estimate_normals(search)
        points.orient_normals_to_align_with_direction(np.array([0.0, 0.0, 1.0]))
        return np.asarray(o3d.pipelines.registration.compute_fpfh_feature(points, search).data).T

    theirs, peer_cpu_s, peer_mib = measured(peer)
    difference = float(np.abs(ours.histograms - theirs).sum(axis=1).mean() / 600)
    return row(
        "normals and FPFH",
        ("roadsight", cpu_s, mib),
        ("Open3D", peer_cpu_s, peer_mib),
        (1 - difference, "mean overlap of histograms"),
        f"{len(ours.xyz_m)} points, K = {NEIGHBOURS}",
    )


def _clusters(cloud: NDArray[np.float64]) -> dict[str, Any]:
    import open3d as o3d  # noqa: PLC0415

    part = cloud[np.abs(cloud[:, 1]) < 6][::4]
    euclidean_clusters(part[:100], 0.2)
    ours, cpu_s, mib = measured(lambda: euclidean_clusters(part, 0.2))

    def peer() -> NDArray[np.int64]:
        points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(part))
        return np.asarray(points.cluster_dbscan(eps=0.2, min_points=1))

    theirs, peer_cpu_s, peer_mib = measured(peer)
    pairs = len(np.unique(np.stack([ours, theirs]), axis=1).T)
    same = pairs == ours.max() + 1 == theirs.max() + 1
    return row(
        "Euclidean clustering",
        ("voxel union-find", cpu_s, mib),
        ("Open3D DBSCAN", peer_cpu_s, peer_mib),
        (float(same), "same partition"),
        f"{len(part)} points, 0.2 m",
    )
