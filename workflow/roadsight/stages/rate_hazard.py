"""How dangerous poles are to vehicles that leave the road."""

from __future__ import annotations

import argparse
import logging
import sys

import numpy as np
import pandas as pd

from roadsight.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.atomic import read_json
from roadsight.io.rasters import read_raster
from roadsight.io.sighting_tables import write_csv
from roadsight.io.tables import read_table, write_table
from roadsight.poles.clear_zone import SOURCE
from roadsight.poles.hazard import RULE, HazardSettings, rate_poles
from roadsight.poles.scenarios import RouteTracks
from roadsight.stages.command import run_stage

log = logging.getLogger("rate_hazard")


def rate_hazard(arguments: argparse.Namespace) -> None:
    """Write offset, clear zone, side slope, density and rating of each kept pole."""
    settings = HazardSettings(**{name: getattr(arguments, name) for name in vars(HazardSettings())})
    _check(settings)
    frame = Frame.from_dict(read_json(arguments.frame))
    poles = read_table(arguments.poles)
    poles = poles[poles["kept"].to_numpy(bool)].reset_index(drop=True)
    edges_m = read_table(arguments.edges, ["x", "y"]).to_numpy(np.float64)
    tracks = RouteTracks(read_table(arguments.frames, ["route", "sequence", "x", "y"]))
    height = read_raster(arguments.dem, frame).sample if arguments.dem else None
    rated = rate_poles(poles, edges_m, tracks, height, settings)
    table = pd.concat([poles[["id", "kind", "x", "y", "latitude", "longitude"]], rated], axis=1)
    log.info("%d poles: %s", len(table), table["rating"].value_counts().to_dict())
    about = {"clear_zone": SOURCE, "rule": RULE, "settings": vars(settings)}
    write_table(arguments.out, table, about)
    named = {"x": "x_local_m", "y": "y_local_m", "latitude": "latitude_deg",
             "longitude": "longitude_deg"}  # fmt: skip
    write_csv(arguments.csv, table.rename(columns=named))


def _check(settings: HazardSettings) -> None:
    for name, value in vars(settings).items():
        if not (np.isfinite(value) and value > 0):
            raise InputError("is not positive", where=name, found=value, allowed="more than 0")


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("poles", "frame", "frames", "edges", "out", "csv"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--dem", nargs="?", help="ground heights, for side slopes")
    for name, default in vars(HazardSettings()).items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, default=default)
    return run_stage(parser, rate_hazard, argv)


if __name__ == "__main__":
    sys.exit(main())
