"""How mounts lean: not at all, or as the road before them."""

from __future__ import annotations

import argparse
import logging
import sys

import numpy as np
import pandas as pd

from roadsight.base.options import add_settings
from roadsight.config.sections.sensing import Lidar
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.placement.candidates.tilt import road_normals
from roadsight.stages.command import run_stage

log = logging.getLogger("tilt_mounts")


def tilt_mounts(arguments: argparse.Namespace) -> None:
    """Write the direction of each candidate's axis: up, or normal to the road before it."""
    dem = read_raster(arguments.dem, Frame.from_dict(read_json(arguments.frame)))
    candidates = read_table(arguments.candidates, ["candidate", "x", "y", "yaw_deg"])
    normals = np.tile([0.0, 0.0, 1.0], (len(candidates), 1))
    if arguments.mounting == "normal":
        places = candidates[["x", "y"]].to_numpy(np.float64)
        normals = road_normals(places, candidates["yaw_deg"].to_numpy(), dem.sample)
    table = pd.DataFrame(normals, columns=["normal_x", "normal_y", "normal_z"])
    table.insert(0, "candidate", candidates["candidate"])
    if len(normals):
        leaning = np.degrees(np.arccos(np.clip(normals[:, 2], -1, 1)))
        log.info("mounts lean %.2f deg on average, %.2f at most", leaning.mean(), leaning.max())
    write_table(arguments.out, table)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("candidates", "dem", "frame", "out"):
        parser.add_argument(f"--{name}", required=True)
    add_settings(parser, Lidar, "mounting")
    return run_stage(parser, tilt_mounts, argv)


if __name__ == "__main__":
    sys.exit(main())
