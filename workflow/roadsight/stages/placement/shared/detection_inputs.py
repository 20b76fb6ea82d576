"""What detection stages take alike: targets with their shape, and effects."""

from __future__ import annotations

import argparse

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.options import add_settings
from roadsight.config.sections.sensing import Targets
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from roadsight.placement.sensors.aimed import Camera, Radar, Rosette
from roadsight.placement.sensors.light import contrast_range_m, range_in_air_m
from roadsight.placement.sensors.sensors import AnySensor, Sensor
from roadsight.placement.sight.detection import MIN_BEAMS
from roadsight.placement.sight.shapes import Box, Cylinder, Shape
from roadsight.placement.sight.sight import Sight


def add_detection_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of every stage that asks which targets a sensor sees."""
    for name in ("depth", "candidates", "targets", "sensor", "sensors", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--min-beams", type=int, default=MIN_BEAMS)
    parser.add_argument("--lanes", nargs="*", default=[], help="lanes and their traffic")
    add_sight_arguments(parser)


def add_sight_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of every stage that asks what a sensor measures of targets."""
    add_settings(parser, Targets, "radius_m", "height_m")
    parser.add_argument("--box", type=float, nargs=3, help="length, width, height instead, m")
    parser.add_argument("--tilts", nargs="*", default=[], help="how mounts lean")
    parser.add_argument("--air", nargs="*", default=[], help="what rain and fog take out of beams")
    parser.add_argument("--reflectivity", nargs="*", default=[], help="ranges to dark targets")
    for name in ("partial-hits", "curvature"):
        parser.add_argument(f"--{name}", choices=["simulate", "skip"], default="skip")


def sight_of(arguments: argparse.Namespace, name: str, sensor: AnySensor) -> Sight:
    """How far and how a sensor sees targets under the effects that are simulated."""
    curved = arguments.curvature == "simulate"
    if isinstance(sensor, Radar):
        return Sight(sensor.range_m, curved=curved)
    air = sum(read_json(path)["extinction_per_m"][name] for path in arguments.air)
    if isinstance(sensor, Camera):
        return Sight(min(sensor.range_m, contrast_range_m(air)), curved=curved)
    clear_m = sensor.range_m
    for path in arguments.reflectivity:
        clear_m = read_json(path)["target_range_m"][name]
    wide = isinstance(sensor, Sensor | Rosette) and sensor.divergence_mrad is not None
    wide = wide and arguments.partial_hits == "simulate"
    near_m = sensor.range_min_m if isinstance(sensor, Sensor) else 0.0
    return Sight(float(range_in_air_m(clear_m, air)), wide, curved, near_m)


def read_shaped_targets(
    arguments: argparse.Namespace,
) -> tuple[pd.DataFrame, Floats, Shape]:
    """Targets, their feet and their shape; feet of boxes have headings, (n, 4).

    Raises
    ------
    InputError : boxes without headings.
    """
    targets = read_table(arguments.targets)
    names = ["x", "y", "z"]
    if not arguments.box:
        feet_m = targets[names].to_numpy(np.float64)
        return targets, feet_m, Cylinder(arguments.radius_m, arguments.height_m)
    if "heading_rad" not in targets:
        raise InputError(
            "has no headings of targets that are boxes",
            where=arguments.targets,
            hint="run the workflow again",
        )
    feet_m = targets[[*names, "heading_rad"]].to_numpy(np.float64)
    return targets, feet_m, Box(*arguments.box)


def said_of_shape(arguments: argparse.Namespace, shape: Shape) -> dict[str, float]:
    """What a table of detections says of its targets."""
    about = {"height_m": shape.height_m, "min_beams": arguments.min_beams}
    if isinstance(shape, Box):
        return about | {"length_m": shape.length_m, "width_m": shape.width_m}
    return {"radius_m": shape.radius_m} | about
