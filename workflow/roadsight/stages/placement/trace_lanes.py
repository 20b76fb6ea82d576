"""Lanes on the pavement and the traffic that they carry."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import numpy as np

from roadsight.base.errors import InputError
from roadsight.base.sections.placement import Traffic
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import write_table
from roadsight.placement.sight.lanes import lanes_abreast
from roadsight.placement.sight.lanes import trace_lanes as trace
from roadsight.placement.sight.passing import vehicles_per_m
from roadsight.stages.command import Command
from roadsight.stages.placement.place_candidates import read_road

log = logging.getLogger("trace_lanes")


def trace_lanes(
    site: str,
    edges_path: Path,
    pavement_path: Path,
    dem_path: Path,
    frame_path: Path,
    traffic: Traffic,
    *,
    out: Path,
) -> None:
    """Write points of the lanes' middle lines with the vehicles on a metre of them."""
    frame = Frame.from_dict(read_json(frame_path))
    edges, pavement = read_road(edges_path, pavement_path, frame)
    lanes = trace(list(edges.geometry), pavement, traffic.lane_width_m)
    if lanes.empty:
        raise InputError(
            "the pavement is too narrow for a lane wherever an edge runs beside it",
            where=f"site {site}",
            hint="lower conditions.lane_width_m, or set effects.moving_vehicles to skip",
        )
    dem = read_raster(dem_path, frame)
    ground = dem.sample(lanes["x"].to_numpy(), lanes["y"].to_numpy())
    lanes["z"] = np.where(np.isfinite(ground), ground, np.nanmedian(ground))
    for road, count in lanes_abreast(lanes).items():
        cars, trucks = vehicles_per_m(
            traffic.aadt, traffic.truck_share, traffic.speed_kmh, traffic.peak_share, count
        )
        lanes.loc[lanes["road"] == road, ["cars_per_m", "trucks_per_m"]] = (cars, trucks)
        log.info(
            "road %d: %d lanes abreast, %.1f vehicles a km and lane",
            road,
            count,
            1000 * (cars + trucks),
        )
    write_table(out, lanes, {"availability": traffic.availability})


main = Command(trace_lanes)


if __name__ == "__main__":
    sys.exit(main())
