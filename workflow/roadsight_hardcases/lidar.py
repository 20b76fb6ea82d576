"""Virtual LiDAR: angles, ranges, surfels, beams on targets."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from roadsight.base.arrays import Numbers
from roadsight.geometry.frames import Frame
from roadsight.geometry.ray_casting import RayScene
from roadsight.io.cloud.clouds import read_laz, write_laz
from roadsight.placement.depth.hybrid import hybrid_depth, preliminary_depth
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.sensors.rays import sensor_from_spherical, spherical_from_sensor
from roadsight.placement.sensors.sensors import Camera, Sensor
from roadsight.placement.sight.detection import count_hits
from roadsight.placement.sight.detectors import Criteria, detector_of
from roadsight.placement.sight.kinds import Cylinder
from roadsight.placement.sight.obstacles import blocked_sight_lines
from roadsight.placement.sight.posed import Panorama
from roadsight.placement.sight.sight import Sight
from roadsight.scene.surfels import build_surfels
from roadsight.scene.voxel_planes import sum_moments
from roadsight_hardcases.case import Errors, hard_case

_AT = (0.0, 0.0, 0.0)  # Where the sensor stands, local metres.


def _sensor(**more: float) -> Sensor:
    """Sixteen channels over 30 degrees, half a degree around."""
    about: dict[str, Any] = {"elevation_min_deg": -15, "elevation_max_deg": 15, "channels": 16}
    return Sensor(**about | {"range_m": 100, "azimuth_step_deg": 0.5} | more)


def _textbook_map(xyz: Numbers, sensor: Sensor) -> Numbers:
    """Least range per cell by arctangent, arcsine and division; what falls outside is left out."""
    distance = np.linalg.norm(xyz, axis=1)
    column = ((np.degrees(np.arctan2(xyz[:, 1], xyz[:, 0])) + 180) / 0.5).astype(int)
    elevation = np.degrees(np.arcsin(xyz[:, 2] / distance))
    row = np.searchsorted(sensor.elevation_edges_deg, elevation, side="right") - 1
    least = np.full(sensor.shape, np.inf)
    inside = (row >= 0) & (row < sensor.rows) & (column >= 0) & (column < sensor.columns)
    np.minimum.at(least, (row[inside], column[inside]), distance[inside])
    return np.where(np.isfinite(least), least, 0.0)


def _wall(distance_m: float, points: int, rng: np.random.Generator) -> Numbers:
    """Wall square to x at -distance, behind the sensor, where azimuths jump from 180 to -180."""
    y, z = rng.uniform(-6, 6, points), rng.uniform(-3, 3, points)
    return np.column_stack([np.full(points, -distance_m), y, z])


@hard_case("render_depth_maps", bound=0.5, unit="returns lost")
def azimuth_of_plus_180(rng: np.random.Generator) -> Errors:
    """A point straight behind the sensor falls into column n of n."""
    sensor = _sensor()
    xyz = np.column_stack([np.full(16, -20.0), np.zeros(16), 20 * np.tan(_up(sensor))])
    naive, ours = _textbook_map(xyz, sensor), preliminary_depth(xyz, sensor, _AT, 0.0)
    return 16 - np.count_nonzero(naive), 16 - np.count_nonzero(ours)


def _up(sensor: Sensor) -> Numbers:
    return np.radians(sensor.elevation_deg)


@hard_case("render_depth_maps", bound=0.05, unit="m")
def neighbours_across_the_seam(rng: np.random.Generator) -> Errors:
    """The nearest point of a beam at 179.9 degrees may lie at -179.9, 360 degrees away."""
    sensor, wall = _sensor(elevation_min_deg=-8, elevation_max_deg=8), _wall(20.0, 40_000, rng)
    # On the left of the seam the wall is hidden by a nearer thing that ends 0.3 m beside it.
    beside = wall[:, 1] > 0.3
    xyz = np.concatenate([wall[wall[:, 1] <= 0], wall[beside] * 0.5])
    azimuth, elevation, distance = spherical_from_sensor(xyz)
    column = int(np.argmax(sensor.azimuth_deg))
    beam_deg = sensor.azimuth_deg[column]
    beams = np.column_stack([np.full(sensor.rows, beam_deg), sensor.elevation_deg])
    nearest = cKDTree(np.column_stack([azimuth, elevation])).query(beams, 10)[1]
    ours = hybrid_depth(xyz, sensor, _AT, 0.0)[:, column]
    true = 20 / np.abs(np.cos(np.radians(beam_deg))) / np.cos(_up(sensor))
    return np.abs(distance[nearest].mean(axis=1) - true).max(), np.abs(ours - true).max()


@hard_case("render_depth_maps", bound=0.05, unit="m")
def points_that_are_no_numbers(rng: np.random.Generator) -> Errors:
    """NaN and a point at the sensor's centre become cell numbers of minus nine trillion."""
    sensor = _sensor()
    wall = _wall(20.0, 60_000, rng)
    bad = np.array([[np.nan, 1, 1], [np.inf, 0, 0], [0, 0, 0], [-np.inf, np.nan, 2]])
    xyz = np.concatenate([wall, bad])
    distance = np.linalg.norm(xyz, axis=1)
    azimuth = np.degrees(np.arctan2(xyz[:, 1], xyz[:, 0]))
    elevation = np.degrees(np.arcsin(xyz[:, 2] / distance))
    column = ((azimuth + 180) / 0.5).astype(int) % sensor.columns
    row = np.clip(((elevation + 16) / 2).astype(int), 0, sensor.rows - 1)
    naive = np.full(sensor.shape, np.inf)
    np.minimum.at(naive, (row, column), distance)
    naive[np.isinf(naive)] = 0.0
    clean = preliminary_depth(wall, sensor, _AT, 0.0)
    ours = preliminary_depth(xyz, sensor, _AT, 0.0)
    off = np.nan_to_num(np.abs(naive - clean), nan=sensor.range_m)
    return off.max(), np.abs(ours - clean).max()


@hard_case("render_depth_maps", bound=0.5, unit="m")
def grazing_road(rng: np.random.Generator) -> Errors:
    """The least range in a cell of 2 degrees is that of its nearest end, metres short on a road."""
    step = np.arange(-60, 60, 0.08)
    x, y = np.meshgrid(step, step[np.abs(step) < 4])
    xyz = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    sensor, at = _sensor(range_m=60), (0.0, 0.0, 5.0)
    lidar = SurfelLidar(build_surfels(sum_moments(xyz, 0.1)))
    maps = preliminary_depth(xyz, sensor, at, 0.0), lidar.depth_map(sensor, at, 0.0)
    down = -np.sin(_up(sensor))[:, None]
    true = np.where(down > 0, 5.0 / np.where(down > 0, down, 1.0), np.inf)
    where = true * np.cos(_up(sensor))[:, None] * np.sin(np.radians(sensor.azimuth_deg))
    on = (true < 55) & (np.abs(where) < 3)
    true = np.broadcast_to(true, on.shape)[on]
    naive, ours = (np.percentile(np.abs(part[on] - true), 95) for part in maps)
    return naive, ours


@hard_case("render_depth_maps", bound=0.01, unit="m")
def rays_far_from_the_origin(rng: np.random.Generator) -> Errors:
    """A ray caster in single precision sees a scene at map coordinates in steps of half a metre."""
    step = np.arange(-5, 5, 0.1) + 0.05
    y, z = (part.ravel() for part in np.meshgrid(step, step))
    wall = np.column_stack([np.full(y.size, 20.02), y, z])
    far = np.array([409_600.0, 5_242_880.0, 0.0])
    surfels = build_surfels(sum_moments(wall, 0.1))
    centre = surfels.centre_m.astype(np.float64) + far
    lidar = SurfelLidar(replace(surfels, centre_m=centre))
    sensor = _sensor(
        azimuth_min_deg=-10, azimuth_max_deg=10, elevation_min_deg=-8, elevation_max_deg=8
    )
    ways = sensor_from_spherical(sensor.azimuth_deg, sensor.elevation_deg[:, None], 1.0)
    true = 20.02 / ways[..., 0]
    ours = lidar.depth_map(sensor, far, 0.0)
    corners = wall[:, None] + 0.05 * np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]])
    triangles = (corners + far)[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
    scene = RayScene(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
    found = scene.first_hits(far, ways).range_m
    naive = np.minimum(found, sensor.range_m) - true.ravel()
    return np.abs(naive).max(), np.abs(ours - true).max()


@hard_case("build_surfels", bound=0.002, unit="m")
def roughness_at_map_coordinates(rng: np.random.Generator) -> Errors:
    """Mean of squares less square of mean loses the millimetres of a wall at its UTM northing."""
    frame = Frame((500_000.0, 6_543_000.0, 200.0))
    wall = np.column_stack([rng.uniform(0, 0.1, (500, 2)), 0.05 + rng.normal(0, 0.003, 500)])
    native = frame.to_native(wall[:, [0, 2, 1]])
    variance = np.mean(native[:, 1] ** 2) - np.mean(native[:, 1]) ** 2
    voxels = sum_moments(frame.to_local(native), 0.1)
    count, mean = voxels.moments[:, 0], voxels.moments[:, 2] / voxels.moments[:, 0]
    own = (voxels.moments[:, 7] / count - mean**2)[np.argmax(count)]
    true = wall[:, 2].std()
    return abs(np.sqrt(abs(variance)) - true), abs(0.1 * np.sqrt(own) - true)


@hard_case("build_surfels", bound=0.05, unit="m")
def walls_are_no_height_functions(rng: np.random.Generator) -> Errors:
    """A plane fitted as height over x and y cannot stand upright."""
    y, z = rng.uniform(-4, 4, (2, 20_000))
    xyz = np.column_stack([20 + rng.normal(0, 0.005, 20_000), y, z])
    terms = np.column_stack([xyz[:, :2], np.ones(len(xyz))])
    a, b, c = np.linalg.lstsq(terms, xyz[:, 2], rcond=None)[0]
    ways = sensor_from_spherical(rng.uniform(-8, 8, 200), rng.uniform(-8, 8, 200), np.ones(200))
    true = 20 / ways[:, 0]
    naive = np.clip(c / (ways[:, 2] - a * ways[:, 0] - b * ways[:, 1]), 0, 1e4)
    lidar = SurfelLidar(build_surfels(sum_moments(xyz, 0.1)))
    ours = np.minimum(lidar.cast(np.zeros(3), ways), 1e4)
    return np.median(np.abs(naive - true)), np.percentile(np.abs(ours - true), 95)


@hard_case("build_detection_shard", bound=0.5, unit="beams")
def target_across_the_seam(rng: np.random.Generator) -> Errors:
    """A target straight behind the sensor spans all columns from -179 to 179 degrees, or none."""
    sensor, target = _sensor(channels=64), np.array([[-15.0, 0.0, -0.3]])
    nothing = np.zeros(sensor.shape, np.float32)
    true = count_hits(nothing, sensor, _AT, 180.0, target)[0]
    half = np.degrees(np.arcsin(0.25 / 15))
    left, right = 180 - half, -180 + half
    columns = np.count_nonzero((sensor.azimuth_deg >= left) & (sensor.azimuth_deg <= right))
    slope = np.tan(_up(sensor))
    naive = columns * np.count_nonzero((slope > -0.3 / 14.75) & (slope < 0.3 / 14.75))
    return abs(naive - true), abs(count_hits(nothing, sensor, _AT, 0.0, target)[0] - true)


@hard_case("build_detection_shard", bound=0.5, unit="targets lost")
def sensor_above_a_target(rng: np.random.Generator) -> Errors:
    """Right above a target its half angle is the arcsine of more than one."""
    sensor = _sensor(elevation_min_deg=-90, elevation_max_deg=0, channels=91)
    feet = np.array([[0.1, 0.05, -5.0], [0.0, 0.0, -5.0], [-0.2, 0.1, -5.0]])
    half = np.degrees(np.arcsin(0.25 / np.hypot(*feet[:, :2].T)))
    nothing = np.zeros(sensor.shape, np.float32)
    ours = count_hits(nothing, sensor, _AT, 0.0, feet)
    return np.count_nonzero(np.isnan(half)), np.count_nonzero(ours <= 8)


@hard_case("build_detection_shard", bound=0.5, unit="targets lost, or seen beyond the range")
def target_before_nothing(rng: np.random.Generator) -> Errors:
    """Where nothing returns a depth map holds 0, and no target at maximum range is before that."""
    sensor = _sensor(elevation_min_deg=-5, elevation_max_deg=5, channels=128, azimuth_step_deg=0.1)
    away_m = np.append(np.arange(90.0, 97.0, 0.5), [101.0, 105.0])
    feet = np.column_stack([away_m, np.zeros((len(away_m), 1)), np.full(len(away_m), -1.0)])
    nothing = np.zeros(sensor.shape, np.float32)
    true = away_m < 100.0
    middle = (abs(sensor.elevation_deg).argmin(), abs(sensor.azimuth_deg).argmin())
    naive = (away_m < sensor.range_m) & (away_m < nothing[middle])
    ours = count_hits(nothing, sensor, _AT, 0.0, feet) > 8
    return np.count_nonzero(naive != true), np.count_nonzero(ours != true)


@hard_case("detect_poses", bound=0.5, unit="targets behind the camera that it sees")
def targets_behind_a_camera(rng: np.random.Generator) -> Errors:
    """A pinhole shows what lies behind it upside down, as if it stood in front."""
    size = {"columns_px": 800, "rows_px": 600, "hfov_deg": 60, "min_pixels": 20}
    camera = Camera.model_validate({"kind": "camera", "range_m": 100} | size)
    away_m, across = rng.uniform(10, 40, 200), np.tan(np.radians(rng.uniform(-20, 20, 200)))
    feet = np.column_stack([-away_m, away_m * across, np.full(200, -0.3)])
    u = camera.focal_px * feet[:, 1] / feet[:, 0]
    naive = (np.abs(u) < 400) & (np.abs(camera.focal_px * 0.3 / feet[:, 0]) < 300)
    sensor = _sensor()
    empty = Panorama(np.zeros(sensor.shape, np.float32), sensor, np.zeros(3), 0.0)
    detector = detector_of(camera, Criteria(8, 0.16))
    shape, sight = Cylinder(0.25, 0.6), Sight(100.0)
    behind, ahead = (
        detector.sees(detector.measure(empty, np.eye(3), turned, shape, sight))
        for turned in (feet, feet * [-1, -1, 1])
    )
    return np.count_nonzero(naive), np.count_nonzero(behind) + np.count_nonzero(~ahead)


@hard_case("render_scans", bound=0.001, unit="m")
def scans_in_steps_of_a_centimetre(rng: np.random.Generator) -> Errors:
    """With its defaults, laspy writes LAS files in steps of 1 cm."""
    xyz = np.round(rng.uniform(0, 80, (4000, 3)), 3)
    frame = Frame((500_000.0, 5_412_000.0, 100.0))
    native = frame.to_native(xyz)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "scan.laz")
        write_laz(path, xyz, frame)
        ours = read_laz(path).xyz
        cloud = laspy.create(point_format=6, file_version="1.4")
        cloud.x, cloud.y, cloud.z = native.T
        cloud.write(path)
        naive = laspy.read(path).xyz
    return np.abs(naive - native).max(), np.abs(ours - native).max()


@hard_case("find_obstacles", bound=0.5, unit="sight lines without an answer")
def target_at_the_sensor(rng: np.random.Generator) -> Errors:
    """A sight line of no length has no direction: zero over zero."""
    pairs = pd.DataFrame({"candidate": ["a"] * 3, "x": [0.0, 5.0, 9.0], "y": 0.0, "z": 0.0})
    pairs[["sensor_x", "sensor_y", "sensor_z"]] = 0.0, 0.0, 0.0
    way = pairs[["x", "y", "z"]].to_numpy()
    naive = way / np.linalg.norm(way, axis=1, keepdims=True)
    lines = blocked_sight_lines(pairs, 0.6, lambda at, ways: np.full(len(ways), np.inf))
    return np.isnan(naive).any(axis=1).sum(), lines["blocked_share"].isna().sum()
