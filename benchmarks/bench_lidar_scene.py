"""The scenes of the virtual LiDAR's benchmark: one generated highway, two clouds of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roadsight.evidence.exact_highway import exact_ranges
from roadsight.placement.candidates.targets import place_targets
from roadsight.placement.sensors.sensors import Sensor
from roadsight_worlds.casting.alignment import heading_at, to_plan
from roadsight_worlds.casting.terrain import height_at
from roadsight_worlds.highway.highway import Highway
from roadsight_worlds.highway.mobile_scanner import scan

Pose = tuple[NDArray[np.float64], float]

_NOISE_M = 0.01
_BATCH = 400_000


def mobile_cloud(highway: Highway, points: int) -> NDArray[np.float32]:
    """What a mobile scanner saw: noise, shadows and stray points, part of the scene never seen."""
    parts = [part.xyz_m for part in scan(highway, points, np.random.default_rng(1))]
    return np.concatenate(parts).astype(np.float32)


def complete_cloud(highway: Highway, points: int) -> NDArray[np.float32]:
    """The same surfaces seen from everywhere over the road, 1 cm noise: nothing left in shadow."""
    rng, found, count = np.random.default_rng(1), [], 0
    half_m = highway.section.pavement_m[1] + 6
    while count < points:
        road = rng.uniform((-5, -half_m), (highway.length_m + 5, half_m), (_BATCH, 2))
        xy = to_plan(highway.alignment, road)
        z = height_at(highway.terrain, xy) + rng.uniform(2, 12, _BATCH)
        away = rng.normal(size=(_BATCH, 3))
        away[:, 2] = -np.abs(away[:, 2]) * rng.choice([1, 0.3, -0.3], _BATCH)
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        origin, away = np.column_stack([xy, z])[np.isfinite(z)], away[np.isfinite(z)]
        range_m, _, _ = highway.scene.cast(origin, away, 120.0)
        hit = np.isfinite(range_m)
        range_m = range_m[hit] + rng.normal(0, _NOISE_M, hit.sum())
        found.append((origin[hit] + range_m[:, None] * away[hit]).astype(np.float32))
        count += hit.sum()
    return np.concatenate(found)[:points]


def sensor_poses(highway: Highway, count: int) -> list[Pose]:
    """Sensors 4 to 10 m above alternate edges of the pavement, facing it."""
    edge_m = highway.section.pavement_m[1] + 0.5
    poses = []
    for number, share in enumerate(np.linspace(0.2, 0.8, count)):
        side = 1 if number % 2 else -1
        station = share * highway.length_m
        xy = to_plan(highway.alignment, [[station, side * edge_m]])[0]
        z = height_at(highway.terrain, xy[None])[0] + 4 + 6 * number / max(count - 1, 1)
        yaw_deg = np.degrees(heading_at(highway.alignment, [station])[0]) - 90 * side
        poses.append((np.array([*xy, z]), float(yaw_deg)))
    return poses


def exact_depth(
    highway: Highway, sensor: Sensor, position_m: NDArray[np.float64], yaw_deg: float
) -> NDArray[np.float32]:
    """True range of every beam, 0 for none, shape (rows, columns)."""
    return exact_ranges(highway.scene, sensor, position_m, yaw_deg)


def pavement_targets(highway: Highway) -> NDArray[np.float64]:
    """Feet of the targets on the true pavement, a metre apart."""
    edge_m = highway.section.pavement_m[1]
    stations = np.arange(0.125, highway.length_m, 0.25)
    offsets = np.arange(-edge_m + 0.125, edge_m, 0.25)
    road = np.stack(np.meshgrid(stations, offsets), axis=-1).reshape(-1, 2)
    xy = to_plan(highway.alignment, road)
    z = height_at(highway.terrain, xy)
    paved = np.isfinite(z) & (highway.ground_classes(xy) == highway.ground_classes(xy).max())
    targets = place_targets(np.column_stack([xy, z])[paved], 1.0, 8)
    return targets[["x", "y", "z"]].to_numpy(np.float64)
