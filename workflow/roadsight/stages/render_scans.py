"""What the chosen sensors would see: one LAZ scan of all of them."""

from __future__ import annotations

import argparse
import logging
import sys

import numpy as np

from roadsight.geometry.frames import Frame
from roadsight.io.atomic import read_json
from roadsight.io.clouds import write_laz
from roadsight.io.surfels import read_surfels
from roadsight.placement.rays import returns_xyz_m
from roadsight.placement.sensors import load_sensors
from roadsight.placement.surfel_lidar import SurfelLidar
from roadsight.stages.command import run_stage

log = logging.getLogger("render_scans")


def render_scans(arguments: argparse.Namespace) -> None:
    """Write the returns of all chosen sensors; point_source_id numbers the sensor from 1."""
    frame = Frame.from_dict(read_json(arguments.frame))
    chosen = read_json(arguments.solution)["sensors"]
    sensors = load_sensors(arguments.sensors)
    lidar = SurfelLidar(read_surfels(arguments.surfels))
    parts = [np.empty((0, 3))]
    for place in chosen:
        sensor, position = sensors[place["sensor"]], (place["x"], place["y"], place["z"])
        range_m = lidar.depth_map(sensor, position, place["yaw_deg"])
        parts.append(returns_xyz_m(range_m, sensor, position, place["yaw_deg"]))
        log.info("%s at %s: %d returns", place["sensor"], place["candidate"], len(parts[-1]))
    source = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    dims = {"point_source_id": source.astype(np.uint16)}
    write_laz(arguments.out, np.concatenate(parts), frame, dims)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("solution", "surfels", "frame", "sensors", "out"):
        parser.add_argument(f"--{name}", required=True)
    return run_stage(parser, render_scans, argv)


if __name__ == "__main__":
    sys.exit(main())
