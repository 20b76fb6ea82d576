"""How dangerous poles are to vehicles that leave the road."""

from __future__ import annotations

import argparse
import logging
import sys

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.sighting_tables import in_native, write_csv
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.risk.clear_zone import SOURCE
from roadsight.poles.risk.hazard import RULE, HazardSettings, Height, rate_poles
from roadsight.poles.risk.scenarios import RouteTracks
from roadsight.stages.command import run_stage

log = logging.getLogger("rate_hazard")

_NONE = ("clear_zone_m", "runout_length_m")
"""Settings that 0 leaves to the guide's tables."""


def rate_hazard(arguments: argparse.Namespace) -> None:
    """Write offset, clear zone, side slope, density and rating of each kept pole."""
    settings = HazardSettings(**{name: getattr(arguments, name) for name in vars(HazardSettings())})
    _check(settings)
    frame = Frame.from_dict(read_json(arguments.frame))
    poles = read_table(arguments.poles)
    poles = poles[poles["kept"].to_numpy(bool)].reset_index(drop=True)
    edges_m = read_table(arguments.edges, ["x", "y"]).to_numpy(np.float64)
    frames = read_table(arguments.frames, ["route", "sequence", "x", "y"])
    height = read_raster(arguments.dem, frame).sample if arguments.dem else None
    scale = grid_scale(poles, frame) if arguments.scale_factor == "simulate" else 1.0
    rated = rate_on_ground(poles, edges_m, frames, height, settings, scale)
    table = pd.concat([poles[["id", "kind", "x", "y", "latitude", "longitude"]], rated], axis=1)
    log.info("%d poles: %s", len(table), table["rating"].value_counts().to_dict())
    about = {"clear_zone": SOURCE, "rule": RULE, "settings": vars(settings)}
    write_table(arguments.out, table, about)
    write_csv(arguments.csv, in_native(table, frame))


def grid_scale(poles: pd.DataFrame, frame: Frame) -> float:
    """Metres of the grid for each metre on the ellipsoid, mean over the poles; 1 without any."""
    if frame.crs_wkt is None or poles.empty:
        return 1.0
    return float(SiteNorth(frame).scale(poles[["x", "y"]].to_numpy(np.float64)).mean())


def rate_on_ground(
    poles: pd.DataFrame,
    edges_m: Floats,
    frames: pd.DataFrame,
    height: Height | None,
    settings: HazardSettings,
    scale: float,
) -> pd.DataFrame:
    """Hazard with distances on the ground: `rate_poles` in a grid without its scale.

    Parameters
    ----------
    scale : metres of the grid for each metre on the ground.
    """
    plan = ["x", "y"]
    ground = None if height is None else lambda x, y: height(scale * x, scale * y)
    lengths = [*plan, "sigma_major_m"]
    return rate_poles(
        poles.assign(**{name: poles[name] / scale for name in lengths}),
        edges_m / scale,
        RouteTracks(frames.assign(**{name: frames[name] / scale for name in plan})),
        ground,
        settings,
    )


def _check(settings: HazardSettings) -> None:
    for name, value in vars(settings).items():
        least = 0.0 if name in _NONE else np.nextafter(0.0, 1.0)
        if not (np.isfinite(value) and value >= least):
            raise InputError("is not positive", where=name, found=value, allowed="more than 0")


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("poles", "frame", "frames", "edges", "out", "csv"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--dem", nargs="?", help="ground heights, for side slopes")
    parser.add_argument("--scale-factor", choices=("simulate", "skip"), default="skip")
    for name, default in vars(HazardSettings()).items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, default=default)
    return run_stage(parser, rate_hazard, argv)


if __name__ == "__main__":
    sys.exit(main())
