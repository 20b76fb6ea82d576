"""Depth maps of scans from dense to sparse, to see where a network is worth its time.

A generated highway without a tunnel that no network was trained on, scanned once and thinned. Every
model gets the same points; surfels are as large as the workflow would make them.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench_lidar_scene import exact_depth, mobile_cloud, pavement_targets, sensor_poses
from bench_measure import Cost, Size, measured, row
from roadsight.evidence.exact_highway import WRONG_M, share_wrong
from roadsight.io.images.models import network_for
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.depth.unet import model_of_points
from roadsight.placement.sensors.sensors import Sensor, load_sensors
from roadsight.placement.sight.detection import MIN_BEAMS, count_hits
from roadsight.scene.profile import count_cells, density, plan_spacing_m
from roadsight.scene.surfels import build_surfels
from roadsight.scene.voxel_planes import sum_moments
from roadsight_worlds.highway.highway import build_highway

ROOT = Path(__file__).parents[1]
NETWORKS = {"": "depth_unet.onnx", ", 33 layers": "depth_unet_33.onnx"}
SENSORS = ("OS-128", "VLP-16")
SEED, LENGTH_M, POINTS = 7010, 80.0, 1_600_000
SURFEL = "surfel"

Pose = tuple[np.ndarray, float]


def rows(size: Size) -> list[dict[str, Any]]:
    """All comparisons; quick ones use a thin cloud and one sensor."""
    quick = size == "quick"
    highway = build_highway(SEED, LENGTH_M, tunnel=False)
    cloud = mobile_cloud(highway, 100_000 if quick else POINTS)
    order = np.random.default_rng(SEED).permutation(len(cloud))
    poses = sensor_poses(highway, 1 if quick else 4)
    targets = pavement_targets(highway)
    sensors = load_sensors(ROOT / "config" / "sensors.yaml")
    found = []
    for name in SENSORS[:1] if quick else SENSORS:
        sensor = sensors[name]
        exact = np.stack([exact_depth(highway, sensor, *pose) for pose in poses])
        truth = _seen(exact, sensor, poses, targets)
        for part in (1,) if quick else (1, 4, 16, 64):
            thinned = cloud[order[: len(cloud) // part]]
            work = f"{name}, {_density(thinned):.0f} points/m2"
            found += _compared(work, thinned, sensor, poses, targets, exact, truth)
    return found


def _compared(
    work: str,
    cloud: np.ndarray,
    sensor: Sensor,
    poses: list[Pose],
    targets: np.ndarray,
    exact: np.ndarray,
    truth: np.ndarray,
) -> list[dict[str, Any]]:
    """Surfels beside each other way."""
    edge_m = max(0.1, plan_spacing_m(_density(cloud)))
    lidar = SurfelLidar(build_surfels(sum_moments(cloud, edge_m)))
    ways = {SURFEL: lidar.depth_map, "bound: an empty map": _empty}
    for way in ("preliminary", "hybrid"):
        ways[way] = partial(model_of_points(way), cloud)
    for title, file in NETWORKS.items():
        for way, model in (("U-Net", "unet"), ("U-Net, mask", "unet_mask")):
            network = str(ROOT / "resources" / "models" / file)
            ways[way + title] = partial(model_of_points(model, network_for(model, network)), cloud)
    costs: dict[str, Cost] = {}
    texts, right = {}, {}
    for way, render in ways.items():
        render(sensor, *poses[0])  # compiled, and Embree's tree built
        maps, cpu_s, peak = measured(
            lambda render=render: np.stack([render(sensor, *pose) for pose in poses])
        )
        costs[way] = way, cpu_s / len(poses), peak
        right[way], rmse_m = _agreement(maps, exact)
        decided = _seen(maps, sensor, poses, targets)
        lost = (decided != truth).sum() / max(truth.sum(), 1)
        texts[way] = f"{right[way]:.4f}, RMSE {rmse_m:.2f} m, decisions wrong {lost:.3f}"
    return [
        row(
            f"depth maps {work}", costs[SURFEL], costs[way],
            (right[SURFEL], f"beams within {WRONG_M} m ({texts[SURFEL]}; theirs {texts[way]})"),
            f"{sensor.rows * sensor.columns} beams, {len(poses)} poses",
        )
        for way in ways
        if way != SURFEL
    ]  # fmt: skip


def _empty(sensor: Sensor, position_m: np.ndarray, yaw_deg: float) -> np.ndarray:
    """A map in which nothing returns: what decisions on targets owe to the open road alone."""
    return np.zeros(sensor.shape, np.float32)


def _density(cloud: np.ndarray) -> float:
    """Median points per square metre, as the workflow measures it."""
    cells = count_cells(cloud, np.zeros(len(cloud), np.uint8))
    return density(cells.column, cells.row, cells.count)["median"]


def _agreement(maps: np.ndarray, exact: np.ndarray) -> tuple[float, float]:
    """Share of the beams that are right, and error of the ranges where both return."""
    both = (maps > 0) & (exact > 0)
    error_m = (maps - exact)[both].astype(np.float64)
    return 1 - share_wrong(maps, exact), float(np.sqrt(np.mean(error_m**2))) if both.any() else 0.0


def _seen(maps: np.ndarray, sensor: Sensor, poses: list[Pose], targets: np.ndarray) -> np.ndarray:
    """Which targets each sensor sees."""
    return np.stack(
        [
            count_hits(depth, sensor, *pose, targets) > MIN_BEAMS
            for depth, pose in zip(maps, poses, strict=True)
        ]
    )
