"""Depth maps of one sensor at the candidates of one shard."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats, Floats32
from roadsight.base.options import add_settings
from roadsight.base.shards import shard_of
from roadsight.config.sections.sensing import Lidar
from roadsight.io.cloud.standing import StandingCloud
from roadsight.io.images.depth_networks import network_for
from roadsight.io.records.depth_maps import (
    DepthMapInfo,
    DepthMaps,
    DepthMapWriter,
    range_step_m,
)
from roadsight.io.records.kept import Kept, key_of, key_of_step
from roadsight.io.records.poses import read_poses, read_tilts
from roadsight.io.records.surfels import read_surfels
from roadsight.io.records.tables import read_table
from roadsight.placement.depth.models import model_of_points
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.sensors.rays import NOT_CAST_M, as_seen_from
from roadsight.placement.sensors.sensors import Sensor, load_sensor, what_it_sees
from roadsight.placement.sight.wanted import beams_wanted
from roadsight.stages.command import run_stage
from roadsight.stages.progress import logged

log = logging.getLogger("render_depth_maps")

Tilt = Floats | None
Render = Callable[[Sensor, ArrayLike, float, Tilt, Bools], Floats32]


def render_depth_maps(arguments: argparse.Namespace) -> None:
    """Write the depth maps of the shard's candidates, in their order."""
    sensor = load_sensor(arguments.sensors, arguments.sensor).thinned(arguments.azimuth_stride)
    # A panorama serves all sensors in poses, so that no candidate is for it alone.
    only = None if arguments.panorama else arguments.sensor
    poses = {
        name: pose
        for name, pose in read_poses(arguments.candidates, only).items()
        if shard_of(name, arguments.shards) == arguments.shard
    }
    tilts = read_tilts(arguments.tilts)
    keys = {
        name: key_of(pose.tolist(), None if (tilt := tilts.get(name)) is None else tilt.tolist())
        for name, pose in poses.items()
    }
    kept = Kept(arguments.kept, _step(arguments, sensor) if arguments.kept else "")
    info = DepthMapInfo(
        arguments.sensor, arguments.model, *sensor.shape, range_step_m(sensor.range_m)
    )
    with DepthMapWriter(arguments.out, info) as writer:
        if not poses:
            log.info("no candidate in shard %d of %d", arguments.shard, arguments.shards)
        else:
            _write(arguments, sensor, poses, tilts, writer, kept, kept.names(keys))
    kept.keep(arguments.out, keys)


def _write(
    arguments: argparse.Namespace,
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
    what = f"{arguments.sensor} depth maps"
    taken, feet_m = 0, _feet_m(arguments)
    for name, (*position_m, yaw_deg) in logged(poses.items(), len(poses), log, what):
        tilt = tilts.get(name)
        wanted = _wanted(arguments, sensor, (position_m, yaw_deg), feet_m, tilt)
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
            render = _renderer(arguments, sensor, np.stack([*poses.values()]))
        writer.append(name, render(sensor, position_m, yaw_deg, tilt, wanted))
    log.info("%d of %d maps are those of an earlier run", taken, len(poses))


def _feet_m(arguments: argparse.Namespace) -> Floats | None:
    """Feet (n, 3) of the targets for which beams are cast; None: for all that there is."""
    if not arguments.targets or arguments.model != "surfel":
        return None
    return read_table(arguments.targets, ["x", "y", "z"]).to_numpy(np.float64)


def _wanted(
    arguments: argparse.Namespace,
    sensor: Sensor,
    pose: tuple[ArrayLike, float],
    feet_m: Floats | None,
    tilt: Tilt,
) -> Bools:
    """Beams (rows, columns) to cast from a pose."""
    if feet_m is None:
        return np.ones(sensor.shape, bool)
    curved = arguments.curvature == "simulate"
    return beams_wanted(sensor, *pose, feet_m, tuple(arguments.room_m), tilt, curved)


def _step(arguments: argparse.Namespace, sensor: Sensor) -> str:
    """Key of all that the maps of a shard rest on, beside where each candidate stands."""
    cloud = [arguments.surfels]
    if arguments.model != "surfel":
        cloud = [arguments.cloud, *filter(None, (arguments.traffic, arguments.network))]
    names = ("model", "engine", "azimuth_stride", "min_cell_points", "neighbours", "curvature")
    return key_of_step(cloud, what_it_sees(sensor), [getattr(arguments, name) for name in names])


def _renderer(arguments: argparse.Namespace, sensor: Sensor, poses: Floats) -> Render:
    """The chosen model, ready to render."""
    curved = arguments.curvature == "simulate"
    if arguments.model == "surfel":
        lidar = SurfelLidar(read_surfels(arguments.surfels), engine=arguments.engine)

        def cast(
            sensor: Sensor, position_m: ArrayLike, yaw_deg: float, tilt: Tilt, wanted: Bools
        ) -> Floats32:
            return lidar.depth_map(sensor, position_m, yaw_deg, tilt, curved, wanted)

        return cast
    west, south = poses[:, :2].min(axis=0) - sensor.range_m
    east, north = poses[:, :2].max(axis=0) + sensor.range_m
    cloud = StandingCloud(arguments.cloud, arguments.traffic)
    xyz_m = cloud.xyz_within((west, south, east, north))
    log.info("%d points within range", len(xyz_m))
    model = model_of_points(
        arguments.model,
        network_for(arguments.model, arguments.network),
        min_cell_points=arguments.min_cell_points,
        neighbours=arguments.neighbours,
    )

    def render(
        sensor: Sensor, position_m: ArrayLike, yaw_deg: float, tilt: Tilt, _: Bools
    ) -> Floats32:
        seen = as_seen_from(xyz_m, position_m, tilt, curved)
        return model(seen, sensor, position_m, yaw_deg)

    return render


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--candidates", required=True)
    parser.add_argument("--shard", type=int, default=0)
    parser.add_argument("--shards", type=int, default=1)
    parser.add_argument("--sensor", required=True, help="name in the sensors file")
    parser.add_argument("--sensors", required=True, help="sensors file")
    add_settings(
        parser, Lidar, "model", "engine", "azimuth_stride", "min_cell_points", "neighbours"
    )
    parser.add_argument("--surfels", required=True, help="used by the model surfel")
    parser.add_argument("--cloud", required=True, help="used by the other models")
    parser.add_argument("--targets", help="only beams that may meet one of them are cast")
    parser.add_argument(
        "--room-m", type=float, nargs=2, default=[0.5, 1.0], help="radius and height of a target"
    )
    parser.add_argument("--network", nargs="?", help="ONNX file of the models unet and unet_mask")
    parser.add_argument("--traffic", nargs="?", help="mask of points to leave out")
    parser.add_argument("--tilts", nargs="*", default=[], help="how mounts lean")
    parser.add_argument("--panorama", action="store_true", help="it serves all sensors")
    parser.add_argument("--kept", help="maps of an earlier run, taken over where nothing changed")
    parser.add_argument("--curvature", choices=["simulate", "skip"], default="skip")
    parser.add_argument("--out", required=True)
    return run_stage(parser, render_depth_maps, argv)


if __name__ == "__main__":
    sys.exit(main())
