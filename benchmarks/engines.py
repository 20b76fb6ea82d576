"""Each step by ourselves and by Open3D on a real cloud: ``python -m benchmarks.engines CLOUD``.

Agreement, processor seconds and memory of each, as docs/decisions/075-engines-and-kept-libraries.md
has them. Every measurement runs in a process of its own, Open3D's loading included.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable
from multiprocessing import get_context

import numpy as np

import roadsight
from roadsight.base.engines import ENGINES, open3d
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.sensors.sensors import load_sensors
from roadsight.scene.pavement.fpfh import describe_ground, fit_smoothness, is_smooth
from roadsight.scene.pavement.outline import euclidean_clusters
from roadsight.scene.surfels import build_surfels, in_company
from roadsight.scene.voxel_planes import sum_moments

_MOST = 3_000_000
"""Points at most, the first."""
_COLUMN_M = 0.1


def measured(work: Callable, *arguments: object) -> tuple[object, float, float, float]:
    """Result, CPU seconds, wall seconds and the growth of the peak in MiB, in a new process."""
    with get_context("fork").Pool(1) as pool:
        return pool.apply(_measured, (work, arguments))


def _measured(work: Callable, arguments: tuple) -> tuple[object, float, float, float]:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begun, clock = time.process_time(), time.perf_counter()
    found = work(*arguments)
    taken, wall = time.process_time() - begun, time.perf_counter() - clock
    return found, taken, wall, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024


def describe(xyz: np.ndarray, engine: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns, their variation and histograms."""
    found = describe_ground(xyz, np.zeros(len(xyz)), _COLUMN_M, 10, engine)
    return found.xyz_m, found.variation, found.histograms


def cast(surfels: object, place: np.ndarray, engine: str) -> np.ndarray:
    """Depth maps of one sensor at five heights."""
    sensor = load_sensors("config/sensors.yaml")["OS1-64"]
    lidar = SurfelLidar(surfels, engine=engine)
    up = np.array([0.0, 0.0, 1.0])
    return np.stack([lidar.depth_map(sensor, place + h * up, 0.0) for h in range(4, 9)])


def statistical(xyz: np.ndarray) -> np.ndarray:
    """Points that Open3D's statistical removal leaves, 20 neighbours and 2 sigma (its example)."""
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz))
    return np.asarray(cloud.remove_statistical_outlier(20, 2.0)[1])


def main(path: str) -> int:
    """Print a line for each step and engine."""
    cloud = roadsight.read_cloud(path)
    xyz = cloud.xyz_m[:_MOST]
    ground = np.asarray(roadsight.ground(xyz))
    describe(xyz[ground][:5000], "own")
    print(f"{len(xyz)} points, {ground.sum()} of ground")
    found = {}
    for engine in ENGINES:
        found[engine], *cost = measured(describe, xyz[ground], engine)
        print(f"fpfh {engine}: {cost[0]:.1f} CPU s, {cost[1]:.1f} s, {cost[2]:.0f} MiB")
    (at, variation, own), (_, other_variation, peer) = found.values()
    common = np.minimum(own, peer).sum(axis=1) / np.maximum(own.sum(axis=1), 1e-9)
    print(f"  {len(at)} columns; histograms overlap by {common.mean():.2%}")
    classes = [
        is_smooth(fit_smoothness(h, v, None, 1.5, 1), h, v, np.zeros(len(h)))
        for h, v in ((own, variation), (peer, other_variation))
    ]
    print(f"  same class: {(classes[0] == classes[1]).mean():.3%}")
    smooth, labels = at[classes[0]], []
    euclidean_clusters(smooth[:500], 0.25)
    for engine in ENGINES:
        label, *cost = measured(euclidean_clusters, smooth, 0.25, engine)
        labels.append(label)
        print(f"clusters {engine}: {cost[0]:.1f} CPU s, {cost[1]:.1f} s, {cost[2]:.0f} MiB")
    print(f"  {len(smooth)} points, same cluster: {(labels[0] == labels[1]).mean():.3%}")
    surfels, maps = build_surfels(sum_moments(xyz, 0.1)), []
    place = np.median(at, axis=0)
    cast(surfels, place, "own")
    for engine in ENGINES:
        depth, *cost = measured(cast, surfels, place, engine)
        maps.append(depth)
        print(f"rays {engine}: {cost[0]:.1f} CPU s, {cost[1]:.1f} s, {cost[2]:.0f} MiB")
    apart = np.abs(maps[0] - maps[1])
    print(
        f"  {len(surfels)} surfels, {apart.size} beams, same to 1 mm: {(apart < 1e-3).mean():.4%}"
    )
    kept = []
    for engine in ENGINES:
        mask, *cost = measured(in_company, xyz, np.empty((0, 3)), 0.5, 2, engine)
        kept.append(mask)
        print(f"outliers {engine}: {cost[0]:.1f} CPU s, {cost[1]:.1f} s, {cost[2]:.0f} MiB")
    print(f"  alone: {(~kept[0]).sum()}, same: {(kept[0] == kept[1]).mean():.4%}")
    rest, *cost = measured(statistical, xyz)
    gone = np.ones(len(xyz), bool)
    gone[rest] = False
    far = np.linalg.norm(xyz[:, :2] - np.median(xyz[:, :2], axis=0), axis=1)
    border = far > np.percentile(far, 80)
    print(f"statistical: {cost[0]:.1f} CPU s; takes {gone.mean():.2%}, {(gone & ground).sum()} of")
    print(f"  ground; of the fifth farthest out {gone[border].mean():.2%}, of the rest")
    print(f"  {gone[~border].mean():.2%}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
