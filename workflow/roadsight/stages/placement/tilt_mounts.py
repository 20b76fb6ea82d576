"""How mounts lean: not at all, or as the road before them."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from roadsight.base.sections.sensing import Lidar
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.placement.sensors.poses import road_normals
from roadsight.stages.command import Command

log = logging.getLogger("tilt_mounts")


def tilt_mounts(
    candidates_path: Path,
    dem_path: Path,
    frame: Path,
    mounting: Annotated[str, Lidar],
    *,
    out: Path,
) -> None:
    """Write the direction of each candidate's axis: up, or normal to the road before it."""
    dem = read_raster(dem_path, Frame.from_dict(read_json(frame)))
    candidates = read_table(candidates_path, ["candidate", "x", "y", "yaw_deg"])
    normals = np.tile([0.0, 0.0, 1.0], (len(candidates), 1))
    if mounting == "normal":
        places = candidates[["x", "y"]].to_numpy(np.float64)
        normals = road_normals(places, candidates["yaw_deg"].to_numpy(), dem.sample)
    table = pd.DataFrame(normals, columns=["normal_x", "normal_y", "normal_z"])
    table.insert(0, "candidate", candidates["candidate"])
    if len(normals):
        leaning = np.degrees(np.arccos(np.clip(normals[:, 2], -1, 1)))
        log.info("mounts lean %.2f deg on average, %.2f at most", leaning.mean(), leaning.max())
    write_table(out, table)


main = Command(tilt_mounts)


if __name__ == "__main__":
    sys.exit(main())
