"""Scanned scenes with exact truth, and sensors in them, to train and judge depth networks on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roadsight.base.arrays import Floats, Floats32
from roadsight.evidence.exact_highway import exact_ranges
from roadsight.placement.depth.unet import HEIGHTS_M
from roadsight.placement.sensors.sensors import Sensor
from roadsight_worlds.casting.alignment import heading_at, to_plan
from roadsight_worlds.casting.scene import Scene
from roadsight_worlds.casting.simple_scenes import (
    box_scene,
    cylinder_scene,
    ellipsoid_scene,
    hill_scene,
    tunnel_scene,
    wall_scene,
)
from roadsight_worlds.casting.terrain import height_at
from roadsight_worlds.highway.highway import build_highway
from roadsight_worlds.highway.mobile_scanner import scan

_LENGTH_M = 80.0  # Of each generated highway.
_BESIDE_M = 0.5  # Sensors stand so far beside the pavement.
_NOISE_M = 0.01  # Range noise of the clouds of analytic scenes, one sigma.
_STOPS = 160  # Places that analytic scenes are scanned from.


@dataclass(frozen=True)
class ScannedScene:
    """A scene as a cloud and as it is.

    Parameters
    ----------
    cloud_m : (n, 3) scanned points. scene : exact surfaces, same frame.
    positions_m : (k, 3) of sensors. yaws_deg : (k,) where they face.
    """

    cloud_m: Floats32
    scene: Scene
    positions_m: Floats
    yaws_deg: Floats

    def exact(self, sensor: Sensor, number: int) -> Floats32:
        """True range (rows, columns) of a sensor's beams at a position, 0 for none."""
        yaw_deg = float(self.yaws_deg[number])
        return exact_ranges(self.scene, sensor, self.positions_m[number], yaw_deg)


def highway_site(seed: int, poses: int) -> ScannedScene:
    """A generated highway with a curve, grade, density and tunnel of its own."""
    rng = np.random.default_rng([seed, 1])
    radius_m, grade = float(rng.uniform(150, 2000)), float(rng.uniform(-0.05, 0.05))
    highway = build_highway(seed, _LENGTH_M, radius_m, grade, tunnel=bool(rng.random() < 0.5))
    points = int(10 ** rng.uniform(5.6, 6.3))
    cloud = np.concatenate([part.xyz_m for part in scan(highway, points, rng)])
    # Beside either edge of the pavement, facing it.
    side = rng.choice([-1.0, 1.0], poses)
    station = rng.uniform(2.0, _LENGTH_M - 2.0, poses)
    offset = side * (highway.section.pavement_m[1] + _BESIDE_M)
    plan = to_plan(highway.alignment, np.column_stack([station, offset]))
    height = height_at(highway.terrain, plan) + rng.uniform(*HEIGHTS_M, poses)
    yaws = np.degrees(heading_at(highway.alignment, station)) - 90.0 * side
    positions = np.column_stack([plan, height])
    return ScannedScene(cloud.astype(np.float32), highway.scene, positions, yaws)


def simple_site(seed: int, poses: int) -> ScannedScene:
    """An analytic scene of random kind and size, scanned from a line of stops through it."""
    rng = np.random.default_rng([seed, 2])
    scene = _simple_scene(rng)
    # 1 cm noise, seen from stops along x, 2.5 m up: the rest is in shadow.
    points = int(10 ** rng.uniform(5.5, 6.1))
    stops_m = np.column_stack(
        [rng.uniform(-40, 40, _STOPS), rng.uniform(-1, 1, _STOPS), np.full(_STOPS, 2.5)]
    )
    origins = stops_m[rng.integers(_STOPS, size=3 * points)]
    away = rng.normal(size=(len(origins), 3)) * (1.0, 1.0, 0.4)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    range_m, _, _ = scene.cast(origins, away, 100.0)
    hit = np.flatnonzero(np.isfinite(range_m))[:points]
    measured_m = range_m[hit] + rng.normal(0.0, _NOISE_M, len(hit))
    cloud = (origins[hit] + measured_m[:, None] * away[hit]).astype(np.float32)
    plan = np.column_stack([rng.uniform(-15, 5, poses), rng.uniform(-12, 12, poses)])
    positions = np.column_stack([plan, rng.uniform(*HEIGHTS_M, poses)])
    return ScannedScene(cloud, scene, positions, rng.uniform(-180, 180, poses))


def _simple_scene(rng: np.random.Generator) -> Scene:
    kind = int(rng.integers(6))
    x_m, y_m = float(rng.uniform(8, 30)), float(rng.uniform(-10, 10))
    if kind == 0:
        return wall_scene(x_m, rng.uniform(2, 12), rng.uniform(10, 60))
    if kind == 1:
        size_m = rng.uniform((2, 2, 1), (12, 4, 4))
        return box_scene((x_m, y_m, size_m[2] / 2), size_m.tolist(), rng.uniform(0, 180))
    if kind == 2:
        return cylinder_scene(x_m, y_m, rng.uniform(0.08, 0.6), rng.uniform(3, 12))
    if kind == 3:
        return ellipsoid_scene((x_m, y_m, 4.0), rng.uniform(1, 4, 3).tolist())
    if kind == 4:
        return tunnel_scene(rng.uniform(20, 60), rng.uniform(5, 8))
    return hill_scene(rng.uniform(1, 4), rng.uniform(10, 30))
