"""``roadsight depthmap``: what one sensor at one place would measure in a cloud."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np

from roadsight.api.sight import CATALOGUE, in_company_of, points_in_reach
from roadsight.base.engines import Engine
from roadsight.base.errors import InputError
from roadsight.base.sections.sensing import DepthModel, Lidar
from roadsight.commands.verb import CloudPath, Reading, Verb, check_output, load_cloud
from roadsight.io.images.models import network_for
from roadsight.io.records.atomic import atomic_path
from roadsight.placement.depth.surfel_lidar import lidar_of_points
from roadsight.placement.depth.unet import model_of_points
from roadsight.placement.sensors.sensors import load_sensor

_NETWORK = Path(__file__).parents[3] / Lidar().network


def run(
    cloud_path: CloudPath,
    /,
    reading: Reading,
    sensor_: Annotated[str, "name of a sensor of --sensors"],
    at: Annotated[
        tuple[float, float, float], "position of the sensor in the cloud's coordinates and units"
    ],
    engine: Annotated[Engine, Lidar],
    outlier_radius_m: Annotated[float, Lidar],
    model: Annotated[DepthModel, Lidar],
    sensors: Annotated[Path, "sensors file"] = CATALOGUE,
    azimuth_deg: Annotated[
        float, "direction of the sensor's x axis, counter-clockwise from the cloud's x axis"
    ] = 0.0,
    network: Annotated[Path, "ONNX file of the models unet and unet_mask"] = _NETWORK,
    *,
    out: Annotated[Path, "NPZ file to write"],
) -> None:
    """Write ``range_m`` (rows, columns; 0 = no return), ``azimuth_deg`` and ``elevation_deg``."""
    check_output(out, cloud_path, ".npz")
    if not np.all(np.isfinite([*at, azimuth_deg])):
        raise InputError("--at and --azimuth-deg must be finite", found=at)
    sensor = load_sensor(sensors, sensor_)
    cloud = load_cloud(cloud_path, reading)
    position = cloud.frame.to_local(at)
    xyz_m = in_company_of(cloud.xyz_m, outlier_radius_m, engine)
    near_m = points_in_reach(xyz_m, sensor, position, "--at")
    if model == "surfel":
        range_m = lidar_of_points(near_m, engine=engine).depth_map(sensor, position, azimuth_deg)
    else:
        render = model_of_points(model, network_for(model, network))
        range_m = render(xyz_m, sensor, position, azimuth_deg)
    with atomic_path(out) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(
            stream,
            range_m=range_m,
            azimuth_deg=sensor.azimuth_deg,
            elevation_deg=sensor.elevation_deg,
        )
    print(f"{(range_m > 0).sum()} of {range_m.size} beams return: {out}")


VERB = Verb("depthmap", "depth map of a virtual LiDAR in a cloud", run)
