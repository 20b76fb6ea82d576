"""What hides targets from the chosen sensors, and why some targets are seen by none."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools
from roadsight.base.engines import Engine
from roadsight.base.errors import InputError
from roadsight.base.sections.sensing import Lidar
from roadsight.base.sections.sensing import Obstacles as ObstacleSettings
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import StandingCloud
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.depth_maps import DepthMaps
from roadsight.io.records.placement_tables import (
    read_detections,
    read_poses,
    read_tilts,
    read_traffic,
)
from roadsight.io.records.scene_tables import read_surfels
from roadsight.io.records.tables import read_table
from roadsight.io.vector.vectors import points, write_layers
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.sensors.light import contrast_range_m, range_in_air_m
from roadsight.placement.sensors.poses import Turn, local_from_sensor
from roadsight.placement.sensors.rays import as_seen_from
from roadsight.placement.sensors.sensors import (
    AimedSensor,
    AnySensor,
    Camera,
    Radar,
    Sensor,
    load_sensor,
    load_sensors,
)
from roadsight.placement.sight.lanes import Traffic, free_shares
from roadsight.placement.sight.objects import kind_of_name
from roadsight.placement.sight.obstacles import (
    NEAREST,
    Cast,
    blocked_sight_lines,
    by_object,
    cell_lines,
    explain_gaps,
    group_obstacles,
    object_finder,
    obstacles_of_target,
    pairs_in_range,
    points_by_cell,
)
from roadsight.stages.command import Command
from roadsight.stages.placement.shared.plan_choices import AllowedFiles, allowed_candidates

log = logging.getLogger("find_obstacles")

STRAY = "stray returns"
"""Kind of obstacles above the ground that belong to no object: too few surfels for one."""

_GROUND_M = 0.3
"""Obstacles lower than this above the terrain model are told as ground: a bank, a crest."""


@dataclass(frozen=True, kw_only=True)
class ObstacleFiles(AllowedFiles):
    """A plan and what tells why it does not see some targets."""

    solution: Path
    coverage: Path
    plan: str
    targets: Path
    surfels: Path
    dem: Path
    frame: Path
    sensors: Path
    candidates: Sequence[Path]
    detections: Sequence[Path]
    engine: Annotated[Engine, Lidar]
    air: Annotated[Sequence[Path], "what rain and fog take out of beams"] = ()
    reflectivity: Annotated[Sequence[Path], "ranges to dark targets"] = ()
    lanes: Annotated[Sequence[Path], "lanes and their traffic"] = ()
    objects: Annotated[Path | None, "surfels of the objects of the scene"] = None
    target_height_m: float = 0.6
    method: Annotated[str, ObstacleSettings]
    target_radius_m: Annotated[float, "cells: of a target, a cylinder"] = 0.25
    depth: Annotated[Sequence[Path], "cells: depth maps of the plan's sensors"] = ()
    cloud: Annotated[Path | None, "cells: the points of the scene"] = None
    traffic: Annotated[Path | None, "cells: mask of points to leave out"] = None
    tilts: Annotated[Sequence[Path], "cells: how mounts lean"] = ()
    azimuth_stride: Annotated[int, Lidar]
    curvature: Literal["simulate", "skip"] = "skip"


def find_obstacles(given: ObstacleFiles, *, out: Path) -> None:
    """Write layers ``obstacles`` (by cubic metre) and ``uncovered`` (targets and reasons)."""
    frame = Frame.from_dict(read_json(given.frame))
    targets = read_table(given.targets)
    sensors = load_sensors(given.sensors)
    lidar = SurfelLidar(read_surfels(given.surfels), engine=given.engine)

    def cast(origin_m: np.ndarray, directions: np.ndarray) -> np.ndarray:
        reach_m = lidar.cast(origin_m, directions)
        return np.where(np.isinf(reach_m), 0.0, reach_m)

    chosen = read_json(given.solution)["sensors"]
    pairs = _hidden_pairs(given, targets, chosen, sensors)
    if given.method == "cells":
        lines = _by_cells(given, pairs, chosen, sensors)
    else:
        lines = pairs.join(blocked_sight_lines(pairs, given.target_height_m, cast))
    obstacles = group_obstacles(lines)
    dem = read_raster(given.dem, frame)
    ground = dem.sample(obstacles["x"].to_numpy(), obstacles["y"].to_numpy())
    obstacles["height_m"] = obstacles["z"] - ground
    obstacles["kind"] = np.where(obstacles["height_m"] < _GROUND_M, "ground", "object")
    gaps = _gaps(given, targets, sensors, cast, frame)
    log.info("%d obstacles, %d uncovered targets", len(obstacles), len(gaps))
    objects_at = object_finder(read_table(given.objects) if given.objects else pd.DataFrame())
    objects = by_object(lines, objects_at).rename(columns={"object": "name"})
    objects["kind"] = [kind_of_name(name) for name in objects["name"]]
    objects = objects.astype(dict.fromkeys("xyz", np.float64))
    objects = objects.astype(dict.fromkeys(("sight_lines", "targets", "sensors"), np.int64))
    if given.objects:
        above = (obstacles["kind"] != "ground").to_numpy()
        names = objects_at(obstacles.loc[above, ["x", "y", "z"]].to_numpy(np.float64))
        obstacles.loc[above, "kind"] = [kind_of_name(name) if name else STRAY for name in names]
    layers = {"obstacles": points(obstacles), "uncovered": points(gaps), "objects": points(objects)}
    write_layers(out, layers, frame, dict.fromkeys(layers, "Point Z"))


def _hidden_pairs(
    given: ObstacleFiles,
    targets: pd.DataFrame,
    chosen: list[dict[str, Any]],
    sensors: dict[str, AnySensor],
) -> pd.DataFrame:
    """Chosen sensors and the targets in their range and view that they do not see."""
    places = pd.DataFrame(chosen, columns=["candidate", "sensor", "x", "y", "z"])
    ranges = np.array([sensors[name].range_m for name in places["sensor"]])
    pairs = pairs_in_range(places, targets, ranges)
    pairs = pairs[_in_view(pairs, chosen, sensors)].reset_index(drop=True)
    seen = read_detections(given.detections)
    seen = seen[seen["candidate"].isin(places["candidate"])]
    keys = pd.MultiIndex.from_frame(pairs[["candidate", "target"]])
    hidden = ~keys.isin(pd.MultiIndex.from_frame(seen[["candidate", "target"]]))
    return pairs[hidden].reset_index(drop=True)


def _by_cells(
    given: ObstacleFiles,
    pairs: pd.DataFrame,
    chosen: list[dict[str, Any]],
    sensors: dict[str, AnySensor],
) -> pd.DataFrame:
    """Obstacles of pairs as published: points of a depth map's cells before their target.

    Raises
    ------
    InputError : a chosen sensor has no cells or no depth map, or there is no cloud.
    """
    name_of = {place["candidate"]: place["sensor"] for place in chosen}
    for candidate, name in name_of.items():
        if not isinstance(sensors[name], Sensor) or "@" in candidate:
            raise InputError(
                "knows the cells of spinning LiDARs as mounted only",
                where="obstacles.method: cells",
                found=name,
                hint="set obstacles.method: sight_lines",
            )
    if given.cloud is None:
        raise InputError("needs the points of the scene", where="obstacles.method: cells, --cloud")
    poses = {name: pose for path in given.candidates for name, pose in read_poses(path).items()}
    scene_m = np.empty((0, 3), np.float32)
    if name_of:
        at_m = np.array([poses[candidate][:2] for candidate in name_of])
        reach_m = max(sensors[name].range_m for name in name_of.values())
        around = (*(at_m.min(axis=0) - reach_m), *(at_m.max(axis=0) + reach_m))
        scene_m = StandingCloud(given.cloud, given.traffic).xyz_within(around)
    tilts, curved = read_tilts(given.tilts), given.curvature == "simulate"
    size_m = (given.target_radius_m, given.target_height_m)
    lines = {}
    for maps in map(DepthMaps, given.depth):
        name = maps.info.sensor
        sensor = load_sensor(given.sensors, name).thinned(given.azimuth_stride)
        for candidate, depth_m in maps.only([one for one in name_of if name_of[one] == name]):
            *position_m, yaw_deg = poses[candidate]
            own = pairs[pairs["candidate"] == candidate]
            seen = position_m, tilts.get(candidate), curved
            cells = points_by_cell(as_seen_from(scene_m, *seen), sensor, position_m, yaw_deg)
            feet_m = as_seen_from(own[["x", "y", "z"]].to_numpy(np.float64), *seen)
            view = cells, depth_m, sensor, position_m, float(yaw_deg)
            found = [obstacles_of_target(*view, foot, size_m, maps.info.step_m) for foot in feet_m]
            lines[candidate] = cell_lines(own, scene_m, found)
            hidden = sum(len(points) > 0 for points, _ in found)
            log.info("%s: points hide %d of %d targets", candidate, hidden, len(own))
    if len(lines) < len(name_of):
        raise InputError(
            "depth maps of chosen sensors are missing",
            where=", ".join(map(str, given.depth)) or "--depth",
            found=f"{len(lines)} of {len(name_of)}",
            hint="run the workflow again",
        )
    nothing = cell_lines(pairs.iloc[:0], scene_m, [])
    return pd.concat([*lines.values(), nothing], ignore_index=True)


def _in_view(
    pairs: pd.DataFrame, places: list[dict[str, Any]], sensors: dict[str, AnySensor]
) -> np.ndarray:
    """Pairs whose target lies in the cone about the field of view of its sensor."""
    inside = np.ones(len(pairs), bool)
    for place in places:
        sensor = sensors[place["sensor"]]
        if not isinstance(sensor, AimedSensor):
            continue
        own = (pairs["candidate"] == place["candidate"]).to_numpy()
        turn = Turn(0.0, place["pitch_deg"], place["roll_deg"])
        axis = local_from_sensor(place["yaw_deg"], turn)[:, 0]
        feet = pairs.loc[own, ["x", "y", "z"]].to_numpy(np.float64)
        way = feet - np.array([place[name] for name in "xyz"])
        along = way @ axis / np.maximum(np.linalg.norm(way, axis=1), 1e-9)
        widest_deg = np.hypot(*sensor.half_view_deg)
        inside[own] = along >= np.cos(np.radians(min(widest_deg, 180.0)))
    return inside


def _gaps(
    given: ObstacleFiles,
    targets: pd.DataFrame,
    sensors: dict[str, AnySensor],
    cast: Cast,
    frame: Frame,
) -> pd.DataFrame:
    """Targets that no candidate of the plan sees."""
    uncovered = read_json(given.coverage)["plans"][given.plan]["uncovered"]
    names = read_json(given.solution)["sensor_types"]
    candidates = pd.concat([read_table(path) for path in given.candidates], ignore_index=True)
    candidates = candidates[allowed_candidates(given, candidates, given.frame, frame)[0]]
    candidates = candidates.reset_index(drop=True)
    range_m = max(sensors[name].range_m for name in names)
    gaps = targets[targets["target"].isin(uncovered)].reset_index(drop=True)
    gaps = explain_gaps(gaps, candidates, range_m, given.target_height_m, cast)
    gaps["reason"] = _with_effects(given, gaps, candidates, {n: sensors[n] for n in names})
    if any(isinstance(sensors[name], AimedSensor) for name in names):
        other = "out of view, or too few beams, pixels or echo"
        gaps["reason"] = gaps["reason"].replace("too few beams", other)
    return gaps


def _with_effects(
    given: ObstacleFiles,
    gaps: pd.DataFrame,
    candidates: pd.DataFrame,
    sensors: dict[str, AnySensor],
) -> pd.Series:
    """Reasons with those of weather, dark targets and traffic, where these are simulated."""
    air = [read_json(path)["extinction_per_m"] for path in given.air]
    dark = [read_json(path)["target_range_m"] for path in given.reflectivity]
    bright_m = max(_reach_m(n, s, s.range_m, air) for n, s in sensors.items())
    dark_m = max(
        _reach_m(n, s, min([s.range_m, *(table.get(n, np.inf) for table in dark)]), air)
        for n, s in sensors.items()
    )
    often = None
    if given.lanes and len(gaps):
        traffic = read_traffic(given.lanes[0])
        place = (gaps, candidates, traffic.lanes, traffic.availability)
        often = hidden_too_often(*place, given.target_height_m)
    return refine_reasons(gaps, bright_m, dark_m, often)


def _reach_m(name: str, sensor: AnySensor, clear_m: float, air: list[dict[str, float]]) -> float:
    """Range of a sensor in the air of the site, given that in clear air."""
    if isinstance(sensor, Radar):
        return sensor.range_m
    extinction = sum(table[name] for table in air)
    if isinstance(sensor, Camera):
        return min(sensor.range_m, contrast_range_m(extinction))
    return float(range_in_air_m(clear_m, extinction))


# Why targets stay unseen beyond what stands in the way: weather, dark targets, vehicles.

# Reasons as tables and reports name them; the first two are those of `explain_gaps`.
OUT_OF_RANGE = "out of range"

HIDDEN = "hidden"

WEATHER = "in range only without rain and fog"

DARK = "in range only of brighter targets"

VEHICLES = "hidden by vehicles too often"


def refine_reasons(
    gaps: pd.DataFrame, bright_m: float, dark_m: float, often: Bools | None
) -> pd.Series:
    """Reasons of `explain_gaps` with what effects take away.

    A target beyond a range that effects shorten is told apart from one that nothing could reach;
    what stands in the way of most lines of sight comes before vehicles.

    Parameters
    ----------
    gaps : columns reason (by the range in clear air) and nearest_m.
    bright_m : longest range of the plan's sensors in the air of the site, to targets as bright as
        those of which ranges are stated. dark_m : the same to the site's targets.
    often : (n,) whether vehicles hide the target too often from all near candidates; None: no
        traffic.
    """
    within = gaps["reason"] != OUT_OF_RANGE
    nearest_m = gaps["nearest_m"].to_numpy(np.float64)
    reason = gaps["reason"].to_numpy(dtype=object).copy()
    if often is not None:
        reason[within & (gaps["reason"] != HIDDEN) & often] = VEHICLES
    reason[within & (nearest_m > dark_m)] = DARK
    reason[within & (nearest_m > bright_m)] = WEATHER
    return pd.Series(reason, index=gaps.index)


def hidden_too_often(
    targets: pd.DataFrame,
    candidates: pd.DataFrame,
    traffic: Traffic,
    availability: float,
    target_height_m: float,
) -> Bools:
    """Whether vehicles hide each target (n,) from its nearest candidates more than is allowed.

    Parameters
    ----------
    targets : columns x, y, z (feet). candidates : x, y, z; local metres.
    availability : share of the time in which a sensor must see its targets.
    """
    place = candidates[["x", "y", "z"]].to_numpy(np.float64)
    foot = targets[["x", "y", "z"]].to_numpy(np.float64)
    count = min(NEAREST, len(place))
    near = cKDTree(place).query(foot, k=count)[1].reshape(-1, count)
    middles = foot + np.array([0.0, 0.0, target_height_m / 2])
    best = np.zeros(len(foot))
    for candidate in np.unique(near):
        rows = np.flatnonzero((near == candidate).any(axis=1))
        best[rows] = np.maximum(best[rows], free_shares(traffic, place[candidate], middles[rows]))
    return np.asarray(best < availability)


main = Command(find_obstacles)


if __name__ == "__main__":
    sys.exit(main())
