"""Depth maps of one sensor at the candidates of one shard."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats, Floats32
from roadsight.base.engines import Engine
from roadsight.base.sections.sensing import CellFilling, DepthModel, Lidar
from roadsight.base.shards import Shard
from roadsight.io.cloud.tiles import StandingCloud
from roadsight.io.images.models import network_for
from roadsight.io.records.depth_maps import DepthMapInfo, DepthMaps, DepthMapWriter, range_step_m
from roadsight.io.records.kept import Kept, key_of, key_of_step
from roadsight.io.records.placement_tables import read_poses, read_tilts
from roadsight.io.records.scene_tables import read_surfels
from roadsight.io.records.tables import read_table
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.depth.unet import model_of_points
from roadsight.placement.sensors.rays import NOT_CAST_M, as_seen_from
from roadsight.placement.sensors.sensors import Sensor, load_sensor, what_it_sees
from roadsight.placement.sight.sight import beams_wanted
from roadsight.stages.command import Command, logged

log = logging.getLogger("render_depth_maps")

Tilt = Floats | None
Render = Callable[[Sensor, ArrayLike, float, Tilt, Bools], Floats32]


@dataclass(frozen=True, kw_only=True)
class DepthFiles(Shard):
    """What a shard of depth maps is rendered of."""

    candidates: Path
    sensor: Annotated[str, "name in the sensors file"]
    sensors: Annotated[Path, "sensors file"]
    surfels: Annotated[Path, "used by the model surfel"]
    cloud: Annotated[Path, "used by the other models"]
    model: Annotated[DepthModel, Lidar]
    engine: Annotated[Engine, Lidar]
    azimuth_stride: Annotated[int, Lidar]
    filling: CellFilling
    targets: Annotated[Path | None, "only beams that may meet one of them are cast"] = None
    room_m: Annotated[tuple[float, float], "radius and height of a target"] = (0.5, 1.0)
    network: Annotated[Path | None, "ONNX file of the models unet and unet_mask"] = None
    traffic: Annotated[Path | None, "mask of points to leave out"] = None
    tilts: Annotated[Sequence[Path], "how mounts lean"] = ()
    panorama: Annotated[bool, "it serves all sensors"] = False
    kept: Annotated[Path | None, "maps of an earlier run, taken over where nothing changed"] = None
    curvature: Literal["simulate", "skip"] = "skip"


def render_depth_maps(given: DepthFiles, *, out: Path) -> None:
    """Write the depth maps of the shard's candidates, in their order."""
    sensor = load_sensor(given.sensors, given.sensor).thinned(given.azimuth_stride)
    # A panorama serves all sensors in poses, so that no candidate is for it alone.
    only = None if given.panorama else given.sensor
    poses = {
        name: pose for name, pose in read_poses(given.candidates, only).items() if given.has(name)
    }
    tilts = read_tilts(given.tilts)
    keys = {
        name: key_of(pose.tolist(), None if (tilt := tilts.get(name)) is None else tilt.tolist())
        for name, pose in poses.items()
    }
    kept = Kept(given.kept, _step(given, sensor) if given.kept else "")
    info = DepthMapInfo(given.sensor, given.model, *sensor.shape, range_step_m(sensor.range_m))
    with DepthMapWriter(out, info) as writer:
        if not poses:
            log.info("no candidate in shard %d of %d", given.shard, given.shards)
        else:
            _write(given, sensor, poses, tilts, writer, kept, kept.names(keys))
    kept.keep(out, keys)


def _write(
    given: DepthFiles,
    sensor: Sensor,
    poses: dict[str, Floats],
    tilts: dict[str, Floats],
    writer: DepthMapWriter,
    kept: Kept,
    known: set[str],
) -> None:
    """Maps in the order of their candidates: those that an earlier run made, and new ones."""
    earlier = DepthMaps(kept.path) if known else None
    stored = earlier.stored(known) if earlier else iter(())
    waiting: dict[str, bytes] = {}
    render = None
    what = f"{given.sensor} depth maps"
    taken, feet_m = 0, None
    if given.targets and given.model == "surfel":  # else beams are cast for all that there is
        feet_m = read_table(given.targets, ["x", "y", "z"]).to_numpy(np.float64)
    curved = given.curvature == "simulate"
    for name, (*position_m, yaw_deg) in logged(poses.items(), len(poses), log, what):
        tilt = tilts.get(name)
        wanted = np.ones(sensor.shape, bool)
        if feet_m is not None:
            pose = (position_m, yaw_deg)
            wanted = beams_wanted(sensor, *pose, feet_m, given.room_m, tilt, curved)
        if earlier is not None and name in known:
            while name not in waiting:
                found, content = next(stored)
                waiting[found] = content
            range_m = earlier.decode(waiting.pop(name))
            if np.all(range_m[wanted] != NOT_CAST_M):
                range_m[~wanted] = NOT_CAST_M
                writer.append(name, range_m)
                taken += 1
                continue
        if render is None:
            missing = [pose for other, pose in poses.items() if other not in known]
            render = _renderer(given, sensor, np.array(missing).reshape(-1, 4))
        writer.append(name, render(sensor, position_m, yaw_deg, tilt, wanted))
    log.info("%d of %d maps are those of an earlier run", taken, len(poses))


def _step(given: DepthFiles, sensor: Sensor) -> str:
    """Key of all that the maps of a shard rest on, beside where each candidate stands."""
    cloud = [given.surfels]
    if given.model != "surfel":
        cloud = [given.cloud, *filter(None, (given.traffic, given.network))]
    names = ("model", "engine", "azimuth_stride", "curvature")
    said = [getattr(given, name) for name in names] + list(given.filling.model_dump().values())
    return key_of_step(cloud, what_it_sees(sensor), said)


def _renderer(given: DepthFiles, sensor: Sensor, poses: Floats) -> Render:
    """The chosen model, ready to render."""
    curved = given.curvature == "simulate"
    if given.model == "surfel":
        lidar = SurfelLidar(read_surfels(given.surfels), engine=given.engine)

        def cast(
            sensor: Sensor, position_m: ArrayLike, yaw_deg: float, tilt: Tilt, wanted: Bools
        ) -> Floats32:
            return lidar.depth_map(sensor, position_m, yaw_deg, tilt, curved, wanted)

        return cast
    west, south = poses[:, :2].min(axis=0) - sensor.range_m
    east, north = poses[:, :2].max(axis=0) + sensor.range_m
    cloud = StandingCloud(given.cloud, given.traffic)
    xyz_m = cloud.xyz_within((west, south, east, north))
    log.info("%d points within range", len(xyz_m))
    network = network_for(given.model, given.network)
    model = model_of_points(given.model, network, filling=given.filling)

    def render(
        sensor: Sensor, position_m: ArrayLike, yaw_deg: float, tilt: Tilt, _: Bools
    ) -> Floats32:
        seen = as_seen_from(xyz_m, position_m, tilt, curved)
        return model(seen, sensor, position_m, yaw_deg)

    return render


main = Command(render_depth_maps)


if __name__ == "__main__":
    sys.exit(main())
