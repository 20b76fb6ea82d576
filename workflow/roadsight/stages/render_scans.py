"""What the chosen sensors would see: one LAZ scan of all of them."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from roadsight.geometry.frames import Frame
from roadsight.io.atomic import read_json
from roadsight.io.clouds import write_laz
from roadsight.io.poses import read_tilts
from roadsight.io.surfels import read_surfels
from roadsight.io.tables import read_table
from roadsight.placement.light import range_in_air_m, reflectivity_range_m
from roadsight.placement.rays import returns_xyz_m
from roadsight.placement.sensors import Sensor, load_sensors
from roadsight.placement.surfel_lidar import SurfelLidar
from roadsight.stages.command import run_stage

log = logging.getLogger("render_scans")

Hearing = Callable[[str, Sensor, NDArray[np.float64], ArrayLike], NDArray[np.bool_]]

_ROUNDING_M = 1e-3


def render_scans(arguments: argparse.Namespace) -> None:
    """Write the returns of all chosen sensors; point_source_id numbers the sensor from 1."""
    frame = Frame.from_dict(read_json(arguments.frame))
    chosen = read_json(arguments.solution)["sensors"]
    sensors = load_sensors(arguments.sensors)
    lidar = SurfelLidar(read_surfels(arguments.surfels))
    tilts, heard = read_tilts(arguments.tilts), _hearing(arguments)
    parts = [np.empty((0, 3))]
    for place in chosen:
        sensor, position = sensors[place["sensor"]], (place["x"], place["y"], place["z"])
        tilt = tilts.get(place["candidate"])
        range_m = lidar.depth_map(sensor, position, place["yaw_deg"], tilt)
        returns = returns_xyz_m(range_m, sensor, position, place["yaw_deg"], tilt)
        parts.append(returns[heard(place["sensor"], sensor, returns, position)])
        log.info("%s at %s: %d returns", place["sensor"], place["candidate"], len(parts[-1]))
    source = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    dims = {"point_source_id": source.astype(np.uint16)}
    write_laz(arguments.out, np.concatenate(parts), frame, dims)


def _hearing(arguments: argparse.Namespace) -> Hearing:
    """Which returns are strong enough, by the air and by the reflectivity of surfaces."""
    air = [read_json(path)["extinction_per_m"] for path in arguments.air]
    surfaces = [read_table(path) for path in arguments.surfaces]
    trees = [cKDTree(table[["x", "y", "z"]].to_numpy()) for table in surfaces]

    def heard(
        name: str, sensor: Sensor, returns: NDArray[np.float64], position_m: ArrayLike
    ) -> NDArray[np.bool_]:
        reach_m = np.full(len(returns), sensor.range_m)
        for tree, table in zip(trees, surfaces, strict=True):
            nearest = tree.query(returns)[1]
            reflectivity = table["reflectivity"].to_numpy()[nearest]
            reach_m = reflectivity_range_m(sensor, reflectivity)
        reach_m = range_in_air_m(reach_m, sum(entry[name] for entry in air))
        return np.asarray(
            np.linalg.norm(returns - np.asarray(position_m), axis=1) <= reach_m + _ROUNDING_M
        )

    return heard


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("solution", "surfels", "frame", "sensors", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--tilts", nargs="*", default=[], help="how mounts lean, all rounds")
    parser.add_argument("--air", nargs="*", default=[], help="what rain and fog take out of beams")
    parser.add_argument("--surfaces", nargs="*", default=[], help="reflectivity of surfaces")
    return run_stage(parser, render_scans, argv)


if __name__ == "__main__":
    sys.exit(main())
