"""Virtual LiDAR and detection beside the published algorithm and exact ray casting.

The scene is analytic, so every beam's true range is known. There are two clouds of it: one in which
every surface was scanned, so that an error is the model's, and what a mobile scanner saw (noise,
shadows, stray points), so that part of every error is what was never scanned.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench_lidar_scene import (
    Pose,
    complete_cloud,
    exact_depth,
    mobile_cloud,
    pavement_targets,
    sensor_poses,
)
from bench_measure import Cost, Size, measured, row
from roadsight.evidence.exact_highway import WRONG_M, share_wrong
from roadsight.io.images.models import network_for
from roadsight.placement.depth.hybrid import hybrid_depth, preliminary_depth
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.depth.unet import model_of_points
from roadsight.placement.sensors.rays import beam_directions
from roadsight.placement.sensors.sensors import Sensor, load_sensors
from roadsight.placement.sight.detection import MIN_BEAMS, count_hits
from roadsight.scene.surfels import Surfels, build_surfels
from roadsight.scene.voxel_planes import sum_moments
from roadsight_worlds.highway.highway import Highway, build_highway

SENSORS = ("OS-128", "VLP-16")
SURFEL, HYBRID, EXACT = "surfel", "hybrid (Algorithm 1)", "exact ray casting"
RAYS = "bound: rays alone"
SITE = (1_900, 6_239)
"""Candidates and targets of the study's second site."""

UNETS = {"U-Net, end to end": "unet", "U-Net, mask and interpolation": "unet_mask"}
NETWORK = Path(__file__).parents[1] / "resources" / "models" / "depth_unet.onnx"

Render = Callable[[Sensor, NDArray[np.float64], float], NDArray[np.float32]]


def rows(size: Size) -> list[dict[str, Any]]:
    """All comparisons; quick ones use a short road and thin clouds."""
    quick = size == "quick"
    highway = build_highway(1, 60.0 if quick else 250.0)
    points = 300_000 if quick else 3_700_000
    sensors = load_sensors(Path(__file__).parents[1] / "config" / "sensors.yaml")
    poses = sensor_poses(highway, 2 if quick else 5)
    complete = complete_cloud(highway, points)
    _compile(complete[:2_000], sensors["VLP-16"], poses[0])
    found = _complete_rows(highway, complete, sensors, poses)
    cloud = mobile_cloud(highway, points)
    surfels, surfel_rows = _surfel_rows(cloud)
    lidar = _built(surfels, poses[0])
    for name in SENSORS:
        depths, costs = _depth_maps(sensors[name], highway, cloud, lidar, poses)
        found += _depth_rows(name, sensors[name], depths, costs, "mobile scan", len(cloud))
        found += _detection_rows(name, sensors[name], highway, poses, depths, costs)
    return surfel_rows + found


def _complete_rows(
    highway: Highway, cloud: NDArray[np.float32], sensors: dict[str, Sensor], poses: list[Pose]
) -> list[dict[str, Any]]:
    """Depth maps where every surface was scanned."""
    lidar = _built(build_surfels(sum_moments(cloud, 0.1)), poses[0])
    found = []
    for name in SENSORS:
        depths, costs = _depth_maps(sensors[name], highway, cloud, lidar, poses)
        found += _depth_rows(name, sensors[name], depths, costs, "complete scan", len(cloud))
    return found


def _built(surfels: Surfels, pose: Pose) -> SurfelLidar:
    """With its tree, which Embree builds at the first ray."""
    lidar = SurfelLidar(surfels)
    lidar.cast(pose[0], [[0.0, 0.0, 1.0]])
    return lidar


def _compile(cloud: NDArray[np.float32], sensor: Sensor, pose: Pose) -> None:
    """Compilation is not what is measured."""
    lidar = SurfelLidar(build_surfels(sum_moments(cloud, 0.1)))
    depth = lidar.depth_map(sensor, *pose)
    hybrid_depth(cloud, sensor, *pose)
    for model in UNETS.values():
        model_of_points(model, network_for(model, NETWORK))(cloud, sensor, *pose)
    count_hits(depth, sensor, *pose, np.zeros((1, 3)))


def _surfel_rows(cloud: NDArray[np.float32]) -> tuple[Surfels, list[dict[str, Any]]]:
    """Surfels beside Open3D's normals, where Open3D is installed."""
    surfels, cpu_s, peak = measured(lambda: build_surfels(sum_moments(cloud, 0.1)))
    try:
        import open3d  # noqa: PLC0415
    except ImportError:
        return surfels, []
    local = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cloud.astype(np.float64)))
    nearest = open3d.geometry.KDTreeSearchParamKNN(10)
    _, theirs_s, theirs_peak = measured(lambda: local.estimate_normals(nearest))
    ours = ("surfels with normals", cpu_s, peak)
    against = ("Open3D normals alone, K = 10", theirs_s, theirs_peak)
    count = (float(len(surfels)), "surfels (nothing to agree on)")
    return surfels, [row("surfels", ours, against, count, f"{len(cloud)} points")]


def _depth_maps(
    sensor: Sensor,
    highway: Highway,
    cloud: NDArray[np.float32],
    lidar: SurfelLidar,
    poses: list[Pose],
) -> tuple[dict[str, NDArray[np.float32]], dict[str, Cost]]:
    """Depth maps (poses, rows, columns) of the three models and of the truth; cost of one map.

    The rays alone, with nothing done before or after, are what no map of surfels can undercut.
    """
    ways: dict[str, Render] = {
        SURFEL: lidar.depth_map,
        HYBRID: partial(hybrid_depth, cloud),
        "preliminary (least range)": partial(preliminary_depth, cloud),
        EXACT: partial(exact_depth, highway),
    }
    for way, model in UNETS.items():
        ways[way] = partial(model_of_points(model, network_for(model, NETWORK)), cloud)
    depths, costs = {}, {}
    for way, render in ways.items():
        maps, cpu_s, peak = measured(
            lambda render=render: [render(sensor, *pose) for pose in poses]
        )
        depths[way], costs[way] = np.stack(maps), (way, cpu_s / len(poses), peak)
    beams = [beam_directions(sensor, yaw_deg).reshape(-1, 3) for _, yaw_deg in poses]
    hits, cpu_s, peak = measured(
        lambda: [
            lidar.cast(position_m, beam, sensor.range_m)
            for (position_m, _), beam in zip(poses, beams, strict=True)
        ]
    )
    ranges = np.where(np.isfinite(hits), hits, 0).reshape(depths[SURFEL].shape)
    depths[RAYS], costs[RAYS] = ranges, (RAYS, cpu_s / len(poses), peak)
    return depths, costs


def _depth_rows(
    name: str,
    sensor: Sensor,
    depths: dict[str, NDArray[np.float32]],
    costs: dict[str, Cost],
    scan: str,
    points: int,
) -> list[dict[str, Any]]:
    """Surfels beside the other ways."""
    right = {way: _right(depth, depths[EXACT]) for way, depth in depths.items()}
    beams = sensor.rows * sensor.columns
    work = f"{beams} beams, {points} points of a {scan}, {len(depths[EXACT])} poses"
    return [
        row(
            f"depth map {name}, {scan}",
            costs[SURFEL],
            costs[way],
            (right[SURFEL], f"beams within {WRONG_M} m of the truth (theirs {right[way]:.4f})"),
            work,
        )
        for way in depths
        if way != SURFEL
    ]


def _right(depth: NDArray[np.float32], exact: NDArray[np.float32]) -> float:
    """Share of beams with the right range, or rightly without return."""
    return 1 - share_wrong(depth, exact)


def _detection_rows(
    name: str,
    sensor: Sensor,
    highway: Highway,
    poses: list[Pose],
    depths: dict[str, NDArray[np.float32]],
    costs: dict[str, Cost],
) -> list[dict[str, Any]]:
    """Footprints beside rendered targets, and the whole matrix beside the published way."""
    targets = pavement_targets(highway)
    counts, spent = {}, {}
    for way in (SURFEL, HYBRID, EXACT):
        counts[way], spent[way], peak = measured(
            lambda way=way: np.stack(
                [
                    count_hits(depth, sensor, *pose, targets)
                    for depth, pose in zip(depths[way], poses, strict=True)
                ]
            )
        )
    sample = np.linspace(0, len(targets) - 1, 12).astype(int)
    rendered, render_s, render_peak = measured(
        lambda: rendered_hits(depths[SURFEL][0], sensor, poses[0], targets[sample])
    )
    ours_s = spent[SURFEL] / (len(poses) * len(targets)) * SITE[1]
    theirs_s = render_s / len(sample) * SITE[1]
    seen = {way: hits > MIN_BEAMS for way, hits in counts.items()}
    agree = {way: float(np.mean(seen[way] == seen[EXACT])) for way in seen}
    work = f"{SITE[0]} candidates x {SITE[1]} targets, extrapolated from {len(poses)} candidates"
    return [
        row(
            f"detection {name}",
            ("footprints", SITE[0] * ours_s, peak),
            ("rendered targets", SITE[0] * theirs_s, render_peak),
            (float(np.mean(counts[SURFEL][0][sample] == rendered)), "targets with equal counts"),
            f"{work}; depth maps not included",
        ),
        row(
            f"detection matrix {name}",
            (SURFEL, SITE[0] * (costs[SURFEL][1] + ours_s), costs[SURFEL][2]),
            (HYBRID, SITE[0] * (costs[HYBRID][1] + theirs_s), costs[HYBRID][2]),
            (agree[SURFEL], f"decisions as on exact depth maps (theirs {agree[HYBRID]:.4f})"),
            f"{work}; theirs with rendered targets",
        ),
    ]


def rendered_hits(
    depth: NDArray[np.float32], sensor: Sensor, pose: Pose, targets: NDArray[np.float64]
) -> list[int]:
    """The published way: a depth map of each target alone, compared with the scene's."""
    position, yaw_deg = pose
    azimuth = np.radians(sensor.azimuth_deg + yaw_deg)
    elevation = np.radians(sensor.elevation_deg)[:, None]
    slope = np.tan(elevation)
    scene = np.where(depth > 0, depth, np.inf)
    hits = []
    for x, y, low in targets - position:
        along = x * np.cos(azimuth) + y * np.sin(azimuth)
        half = 0.25**2 - (x * np.sin(azimuth) - y * np.cos(azimuth)) ** 2
        with np.errstate(invalid="ignore", divide="ignore"):
            near, far = along - np.sqrt(half), along + np.sqrt(half)
            entry = np.maximum(near, np.where(slope < 0, (low + 0.6) / slope, low / slope))
            inside = (near > 0) & (entry <= far) & (np.abs(entry * slope - low - 0.3) <= 0.3 + 1e-9)
            alone = np.where(inside, entry / np.cos(elevation), np.inf)
        hits.append(int(((alone < scene) & (alone < sensor.range_m)).sum()))
    return hits
