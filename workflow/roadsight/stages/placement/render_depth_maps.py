"""Depth maps of one sensor at the candidates of one shard."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats, Floats32
from roadsight.base.shards import shard_of
from roadsight.io.cloud.standing import StandingCloud
from roadsight.io.images.depth_networks import network_for
from roadsight.io.records.depth_maps import DepthMapInfo, DepthMapWriter, range_step_m
from roadsight.io.records.poses import read_poses, read_tilts
from roadsight.io.records.surfels import read_surfels
from roadsight.placement.depth.models import MODELS, model_of_points
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.sensors.rays import as_seen_from
from roadsight.placement.sensors.sensors import Sensor, load_sensor
from roadsight.stages.command import run_stage
from roadsight.stages.progress import logged

log = logging.getLogger("render_depth_maps")

Tilt = Floats | None
Render = Callable[[Sensor, ArrayLike, float, Tilt], Floats32]


def render_depth_maps(arguments: argparse.Namespace) -> None:
    """Write the depth maps of the shard's candidates, in their order."""
    sensor = load_sensor(arguments.sensors, arguments.sensor).thinned(arguments.azimuth_stride)
    poses = {
        name: pose
        for name, pose in read_poses(arguments.candidates).items()
        if shard_of(name, arguments.shards) == arguments.shard
    }
    info = DepthMapInfo(
        arguments.sensor, arguments.model, *sensor.shape, range_step_m(sensor.range_m)
    )
    with DepthMapWriter(arguments.out, info) as writer:
        if not poses:
            log.info("no candidate in shard %d of %d", arguments.shard, arguments.shards)
            return
        render = _renderer(arguments, sensor, np.stack(list(poses.values())))
        tilts = read_tilts(arguments.tilts)
        what = f"{arguments.sensor} depth maps"
        for name, (*position_m, yaw_deg) in logged(poses.items(), len(poses), log, what):
            writer.append(name, render(sensor, position_m, yaw_deg, tilts.get(name)))


def _renderer(arguments: argparse.Namespace, sensor: Sensor, poses: Floats) -> Render:
    """The chosen model, ready to render."""
    curved = arguments.curvature == "simulate"
    if arguments.model == "surfel":
        return partial(SurfelLidar(read_surfels(arguments.surfels)).depth_map, curved=curved)
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

    def render(sensor: Sensor, position_m: ArrayLike, yaw_deg: float, tilt: Tilt) -> Floats32:
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
    parser.add_argument("--model", choices=MODELS, default="surfel")
    parser.add_argument("--surfels", required=True, help="used by the model surfel")
    parser.add_argument("--cloud", required=True, help="used by the other models")
    parser.add_argument("--network", nargs="?", help="ONNX file of the models unet and unet_mask")
    parser.add_argument("--traffic", nargs="?", help="mask of points to leave out")
    parser.add_argument("--azimuth-stride", type=int, default=1, help="simulate every n-th azimuth")
    parser.add_argument("--min-cell-points", type=int, default=5)
    parser.add_argument("--neighbours", type=int, default=10)
    parser.add_argument("--tilts", nargs="*", default=[], help="how mounts lean")
    parser.add_argument("--curvature", choices=["simulate", "skip"], default="skip")
    parser.add_argument("--out", required=True)
    return run_stage(parser, render_depth_maps, argv)


if __name__ == "__main__":
    sys.exit(main())
