"""Lanes on the pavement and the traffic that they carry."""

from __future__ import annotations

import argparse
import logging
import sys

import numpy as np

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import write_table
from roadsight.placement.sight.carriageways import lanes_abreast
from roadsight.placement.sight.lanes import trace_lanes as trace
from roadsight.placement.sight.passing import vehicles_per_m
from roadsight.stages.command import run_stage
from roadsight.stages.placement.place_candidates import read_road

log = logging.getLogger("trace_lanes")


def trace_lanes(arguments: argparse.Namespace) -> None:
    """Write points of the lanes' middle lines with the vehicles on a metre of them."""
    frame = Frame.from_dict(read_json(arguments.frame))
    edges, pavement = read_road(arguments, frame)
    lanes = trace(list(edges.geometry), pavement, arguments.lane_width_m)
    if lanes.empty:
        raise InputError(
            "the pavement is too narrow for a lane wherever an edge runs beside it",
            where=f"site {arguments.site}",
            hint="lower conditions.lane_width_m, or set effects.moving_vehicles to skip",
        )
    dem = read_raster(arguments.dem, frame)
    ground = dem.sample(lanes["x"].to_numpy(), lanes["y"].to_numpy())
    lanes["z"] = np.where(np.isfinite(ground), ground, np.nanmedian(ground))
    for road, count in lanes_abreast(lanes).items():
        cars, trucks = vehicles_per_m(
            arguments.aadt,
            arguments.truck_share,
            arguments.speed_kmh,
            arguments.peak_share,
            count,
        )
        lanes.loc[lanes["road"] == road, ["cars_per_m", "trucks_per_m"]] = (cars, trucks)
        log.info(
            "road %d: %d lanes abreast, %.1f vehicles a km and lane",
            road,
            count,
            1000 * (cars + trucks),
        )
    write_table(arguments.out, lanes, {"availability": arguments.availability})


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("site", "edges", "pavement", "dem", "frame", "out"):
        parser.add_argument(f"--{name}", required=True)
    for name in ("aadt", "truck-share", "speed-kmh", "peak-share", "lane-width-m", "availability"):
        parser.add_argument(f"--{name}", type=float, required=True)
    return run_stage(parser, trace_lanes, argv)


if __name__ == "__main__":
    sys.exit(main())
