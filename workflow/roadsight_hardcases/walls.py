"""Solid walls in coarse clouds: beams that pass where a street's barrier stands."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Numbers
from roadsight.placement.depth.hybrid import hybrid_depth
from roadsight.placement.depth.surfel_lidar import lidar_of_points
from roadsight.placement.sensors.rays import sensor_from_spherical
from roadsight.placement.sensors.sensors import Sensor
from roadsight_hardcases.case import Errors, hard_case

_NEAR_M = 10.0  # Way to the barrier's face.
_SIZE_M = 0.6, 0.9  # Thickness and height of the barrier.
_AT = np.array([0.0, 0.0, 5.0])  # Where the sensor stands, on a mast.
# A sensor with the resolution of an OS1-128 that looks at the barrier.
_SENSOR = {
    **{"elevation_min_deg": -30, "elevation_max_deg": -15, "channels": 43, "range_m": 120},
    **{"azimuth_min_deg": 58.32, "azimuth_max_deg": 121.68, "azimuth_step_deg": 0.352},
}


def _barrier(density: float, rng: np.random.Generator) -> Numbers:
    """A barrier of 24 m on level ground, as a scan of so many points a square metre shows it."""
    thick, high = _SIZE_M

    def plane(a: float, b: float) -> Numbers:
        return rng.uniform(0, 1, (rng.poisson(density * a * b), 2)) * [a, b] - [a / 2, 0]

    ground, front, back, top = (
        plane(*size) for size in ((40.0, 40.0), (24.0, high), (24.0, high), (24.0, thick))
    )
    under = (np.abs(ground[:, 0]) < 12) & (np.abs(ground[:, 1] - 10.3) < thick / 2)
    ground = ground[~under]
    parts = [
        np.column_stack([ground, np.zeros(len(ground))]),
        np.insert(front, 1, _NEAR_M, axis=1),
        np.insert(back, 1, _NEAR_M + thick, axis=1),
        np.column_stack([np.add(top, [0, _NEAR_M]), np.full(len(top), high)]),
    ]
    xyz = np.concatenate(parts)
    return xyz + rng.normal(0, 0.01, xyz.shape)


def _passing(density: float, rng: np.random.Generator) -> Errors:
    """Shares of the beams on the barrier's face that pass it, by the published map and by ours."""
    sensor = Sensor.model_validate(_SENSOR)
    ways = sensor_from_spherical(sensor.azimuth_deg, sensor.elevation_deg[:, None], 1.0)
    face_m = _NEAR_M / ways[..., 1]
    height_m = _AT[2] + face_m * ways[..., 2]
    on = (height_m > 0) & (height_m < _SIZE_M[1])
    xyz = _barrier(density, rng)
    maps = hybrid_depth(xyz, sensor, _AT, 0.0), lidar_of_points(xyz).depth_map(sensor, _AT, 0.0)
    naive, ours = (((part == 0) | (part > face_m + _SIZE_M[0]))[on].mean() for part in maps)
    return naive, ours


@hard_case("render_depth_maps", bound=0.02, unit="share of beams that pass")
def barrier_of_100_points_per_m2(rng: np.random.Generator) -> Errors:
    """A solid barrier that is scanned with 100 points a square metre lets beams pass."""
    return _passing(100.0, rng)


@hard_case("render_depth_maps", bound=0.02, unit="share of beams that pass")
def barrier_of_30_points_per_m2(rng: np.random.Generator) -> Errors:
    """A solid barrier scanned with 30 points a square metre."""
    return _passing(30.0, rng)


@hard_case("render_depth_maps", bound=0.02, unit="share of beams that pass")
def barrier_of_25_points_per_m2(rng: np.random.Generator) -> Errors:
    """A solid barrier scanned with 25 points a square metre."""
    return _passing(25.0, rng)


@hard_case("render_depth_maps", bound=0.02, unit="share of beams that pass")
def barrier_of_20_points_per_m2(rng: np.random.Generator) -> Errors:
    """A solid barrier scanned with 20 points a square metre."""
    return _passing(20.0, rng)


@hard_case("render_depth_maps", bound=0.02, unit="share of beams that pass")
def barrier_of_12_points_per_m2(rng: np.random.Generator) -> Errors:
    """A solid barrier scanned with 12 points a square metre."""
    return _passing(12.0, rng)
