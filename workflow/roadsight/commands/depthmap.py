"""``roadsight depthmap``: what one sensor at one place would measure in a cloud."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from roadsight.api.sight import CATALOGUE, points_in_reach
from roadsight.base.errors import InputError
from roadsight.commands.cloud_arguments import add_cloud_arguments, check_output, load_cloud
from roadsight.io.images.depth_networks import network_for
from roadsight.io.records.atomic import atomic_path
from roadsight.placement.depth.models import MODELS, model_of_points
from roadsight.placement.depth.surfel_lidar import lidar_of_points
from roadsight.placement.sensors.sensors import load_sensor

_NETWORK = Path(__file__).parents[3] / "resources" / "models" / "depth_unet.onnx"


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("depthmap", help="depth map of a virtual LiDAR in a cloud")
    add_cloud_arguments(parser)
    parser.add_argument("--sensor", required=True, metavar="NAME", help="sensor of --sensors")
    parser.add_argument("--sensors", default=str(CATALOGUE), help="sensors file")
    parser.add_argument(
        "--at",
        required=True,
        nargs=3,
        type=float,
        metavar=("X", "Y", "Z"),
        help="position of the sensor in the cloud's own coordinates and units",
    )
    parser.add_argument(
        "--azimuth-deg",
        type=float,
        default=0.0,
        help="direction of the sensor's x axis, counter-clockwise from the cloud's x axis",
    )
    parser.add_argument("--model", choices=MODELS, default="surfel")
    parser.add_argument(
        "--network", default=str(_NETWORK), help="ONNX file of the models unet and unet_mask"
    )
    parser.add_argument("-o", "--out", required=True, help="NPZ file to write")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Write ``range_m`` (rows, columns; 0 = no return), ``azimuth_deg`` and ``elevation_deg``."""
    check_output(arguments, ".npz")
    if not np.all(np.isfinite([*arguments.at, arguments.azimuth_deg])):
        raise InputError("--at and --azimuth-deg must be finite", found=arguments.at)
    sensor = load_sensor(arguments.sensors, arguments.sensor)
    cloud = load_cloud(arguments)
    position = cloud.frame.to_local(arguments.at)
    near_m = points_in_reach(cloud.xyz_m, sensor, position, "--at")
    if arguments.model == "surfel":
        range_m = lidar_of_points(near_m).depth_map(sensor, position, arguments.azimuth_deg)
    else:
        model = model_of_points(arguments.model, network_for(arguments.model, arguments.network))
        range_m = model(cloud.xyz_m, sensor, position, arguments.azimuth_deg)
    with atomic_path(arguments.out) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(
            stream,
            range_m=range_m,
            azimuth_deg=sensor.azimuth_deg,
            elevation_deg=sensor.elevation_deg,
        )
    print(f"{(range_m > 0).sum()} of {range_m.size} beams return: {arguments.out}")
