"""What the chosen sensors would see: one LAZ scan of all of them."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats
from roadsight.base.engines import Engine
from roadsight.base.sections.sensing import Lidar
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.clouds import write_laz
from roadsight.io.records.atomic import read_json
from roadsight.io.records.placement_tables import read_tilts
from roadsight.io.records.scene_tables import read_surfels
from roadsight.io.records.tables import read_table
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.sensors.light import contrast_range_m, range_in_air_m, reflectivity_range_m
from roadsight.placement.sensors.poses import AS_MOUNTED, Turn, local_from_sensor
from roadsight.placement.sensors.rays import returns_xyz_m
from roadsight.placement.sensors.sensors import (
    AimedSensor,
    AnySensor,
    Camera,
    Radar,
    Rosette,
    Sensor,
    load_sensors,
)
from roadsight.stages.command import Command

log = logging.getLogger("render_scans")

Hearing = Callable[[str, AnySensor, Floats, ArrayLike], Bools]

_ROUNDING_M = 1e-3
"""Rounding of ranges, which are single precision: a return at the very limit stays."""


def render_scans(
    solution: Path,
    surfels: Path,
    frame_path: Path,
    sensors_path: str,
    engine: Annotated[Engine, Lidar],
    tilts_paths: Annotated[Sequence[Path], "how mounts lean, all rounds"] = (),
    air: Annotated[Sequence[Path], "what rain and fog take out of beams"] = (),
    surfaces: Annotated[Sequence[Path], "reflectivity of surfaces"] = (),
    *,
    out: Path,
) -> None:
    """Write the returns of all chosen sensors; point_source_id numbers the sensor from 1."""
    frame = Frame.from_dict(read_json(frame_path))
    chosen = read_json(solution)["sensors"]
    sensors = load_sensors(sensors_path)
    lidar = SurfelLidar(read_surfels(surfels), engine=engine)
    tilts, heard = read_tilts(tilts_paths), _hearing(air, surfaces)
    parts = [np.empty((0, 3))]
    for place in chosen:
        sensor, position = sensors[place["sensor"]], np.array([place[axis] for axis in "xyz"])
        tilt = tilts.get(place.get("position", place["candidate"]))
        returns = _scan(lidar, sensor, position, place, tilt)
        if isinstance(sensor, Sensor):
            returns = returns[np.linalg.norm(returns - position, axis=1) >= sensor.range_min_m]
        parts.append(returns[heard(place["sensor"], sensor, returns, position)])
        log.info("%s at %s: %d returns", place["sensor"], place["candidate"], len(parts[-1]))
    source = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    dims = {"point_source_id": source.astype(np.uint16)}
    write_laz(out, np.concatenate(parts), frame, dims)


def _scan(
    lidar: SurfelLidar,
    sensor: AnySensor,
    position_m: Floats,
    place: dict[str, Any],
    tilt: Floats | None,
) -> Floats:
    """Points (n, 3) that a chosen sensor meets in its pose, local metres."""
    yaw_deg = float(place["yaw_deg"])
    turn = Turn(0.0, float(place.get("pitch_deg", 0.0)), float(place.get("roll_deg", 0.0)))
    if isinstance(sensor, AimedSensor):
        rays = scan_directions(sensor) @ local_from_sensor(yaw_deg, turn, tilt).T
        range_m = lidar.cast(position_m, rays, sensor.range_m).astype(np.float64)
        found = np.isfinite(range_m)
        return np.asarray(position_m + range_m[found, None] * rays[found])
    if turn != AS_MOUNTED:
        tilt = local_from_sensor(yaw_deg, turn, tilt) @ local_from_sensor(yaw_deg, AS_MOUNTED).T
    depth_m = lidar.depth_map(sensor, position_m, yaw_deg, tilt)
    return returns_xyz_m(depth_m, sensor, position_m, yaw_deg, tilt)


def _hearing(air_paths: Sequence[Path], surfaces_paths: Sequence[Path]) -> Hearing:
    """Which returns are strong enough, by the air and by the reflectivity of surfaces."""
    air = [read_json(path)["extinction_per_m"] for path in air_paths]
    surfaces = [read_table(path) for path in surfaces_paths]
    trees = [cKDTree(table[["x", "y", "z"]].to_numpy()) for table in surfaces]

    def heard(name: str, sensor: AnySensor, returns: Floats, position_m: ArrayLike) -> Bools:
        reach_m = np.full(len(returns), sensor.range_m)
        if isinstance(sensor, Radar) or not len(returns):
            return np.ones(len(returns), bool)
        if isinstance(sensor, Camera):
            far_m = contrast_range_m(sum(entry[name] for entry in air))
            return np.asarray(np.linalg.norm(returns - np.asarray(position_m), axis=1) <= far_m)
        for tree, table in zip(trees, surfaces, strict=True):
            nearest = tree.query(returns)[1]
            reflectivity = table["reflectivity"].to_numpy()[nearest]
            if isinstance(sensor, Sensor | Rosette):
                reach_m = reflectivity_range_m(sensor, reflectivity)
        reach_m = range_in_air_m(reach_m, sum(entry[name] for entry in air))
        return np.asarray(
            np.linalg.norm(returns - np.asarray(position_m), axis=1) <= reach_m + _ROUNDING_M
        )

    return heard


# What a sensor in a pose would record of the scene: the scan of each kind.
#
# A solid-state LiDAR records one frame from phase zero. A camera records no ranges: its scan is
# the surface that its pixels show, thinned to what a report can draw. A radar's is what each cell
# of its angular resolution meets first.

_MOST_PIXELS = 200_000
"""Pixels of a camera's scan: what a report can draw."""


def scan_directions(sensor: AimedSensor) -> Floats:
    """Unit vectors (n, 3) in the sensor frame along which a scan looks."""
    if isinstance(sensor, Rosette):
        return rosette_directions(sensor)
    if isinstance(sensor, Camera):
        return _pixel_directions(sensor)
    if isinstance(sensor, Radar):
        return _cell_directions(sensor)
    raise TypeError(f"no scan of {type(sensor).__name__}")


def rosette_directions(
    sensor: Rosette, phases_rad: tuple[float, float] | Floats = (0.0, 0.0)
) -> Floats:
    """The points of one frame in their order, lasers in turn.

    Parameters
    ----------
    phases_rad : angles of both prisms as the frame begins.
    """
    number = np.arange(int(sensor.points))
    time_s = number / sensor.points_per_s
    one, two = (
        2 * np.pi * hertz * time_s + phase
        for hertz, phase in zip(sensor.rotors_hz, phases_rad, strict=True)
    )
    arrow = sensor.field_deg / 4
    u = arrow * (np.cos(one) + np.cos(two))
    v = arrow * (np.sin(one) + np.sin(two)) + sensor.laser_offsets_deg[number % sensor.lasers]
    angle = np.radians(np.hypot(u, v))
    share = np.radians(np.sinc(angle / np.pi))  # sine over angle, of degrees
    return np.column_stack([np.cos(angle), share * u, share * v])


def _pixel_directions(camera: Camera) -> Floats:
    """Pixels, every n-th in both directions."""
    pixels = camera.columns_px * camera.rows_px
    step = max(int(np.ceil(np.sqrt(pixels / _MOST_PIXELS))), 1)
    u, v = (
        (np.arange(step // 2, count, step) + 0.5 - count / 2) / camera.focal_px
        for count in (camera.columns_px, camera.rows_px)
    )
    left, up = (part.ravel() for part in np.meshgrid(u, v))
    rays = np.column_stack([np.ones(len(left)), left, up])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _cell_directions(radar: Radar) -> Floats:
    """Middles of cells: the resolution of the zone that each azimuth lies in, both ways."""
    parts, inner = [], 0.0
    low, high = radar.elevation_min_deg, radar.elevation_max_deg
    for zone in radar.zones:
        count = max(round((zone.half_angle_deg - inner) / zone.resolution_deg), 1)
        side = inner + (np.arange(count) + 0.5) * (zone.half_angle_deg - inner) / count
        rows = max(round((high - low) / zone.resolution_deg), 1)
        up = low + (np.arange(rows) + 0.5) * (high - low) / rows
        parts.append(np.stack(np.meshgrid(np.concatenate([-side[::-1], side]), up), -1))
        inner = zone.half_angle_deg
    azimuth, elevation = np.radians(np.concatenate([part.reshape(-1, 2) for part in parts])).T
    flat = np.cos(elevation)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


main = Command(render_scans)


if __name__ == "__main__":
    sys.exit(main())
