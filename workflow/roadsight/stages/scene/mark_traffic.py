"""Points of vehicles that were passing while the cloud was recorded."""

from __future__ import annotations

import argparse
import logging
import sys

import numpy as np
import pandas as pd
import shapely

from roadsight.base.options import add_settings
from roadsight.config.sections.sensing import Lidar
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import POSITION, CloudTiles, stack_xyz
from roadsight.io.raster.rasters import Raster, read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import write_table
from roadsight.io.vector.vectors import read_layer
from roadsight.scene.grids import Grid
from roadsight.scene.pavement.outline import inside
from roadsight.scene.traffic import Columns, is_traffic
from roadsight.stages.command import run_stage
from roadsight.stages.progress import logged

log = logging.getLogger("mark_traffic")

_RIM_M = 0.5
"""Kerbs, islands' rims and the foot of what stands beside the road are this near to the outline."""
_COLUMN_M = 0.5
"""Edge of the columns whose greatest height tells vehicles from what stays."""
_LOWEST_M = 0.2
"""What is lower above the ground is pavement."""


def mark_traffic(arguments: argparse.Namespace) -> None:
    """Write which points of the cloud are traffic, in the cloud's order."""
    cloud = CloudTiles(arguments.cloud)
    frame = Frame.from_dict(read_json(arguments.frame))
    dem = read_raster(arguments.dem, frame)
    outline = shapely.union_all(read_layer(arguments.pavement, "pavement", frame).geometry)
    inner = shapely.multipolygons(shapely.get_parts(outline.buffer(-_RIM_M)))
    columns = _columns(cloud, dem)
    parts = [np.empty(0, bool)]
    for number in logged(range(len(cloud.tiles)), len(cloud.tiles), log, "tiles"):
        xyz, height_m = _tile(cloud, dem, number)
        on_pavement = inside(inner, xyz[:, 0], xyz[:, 1])
        top_m = columns.top_m(xyz[:, :2])
        parts.append(is_traffic(height_m, top_m, on_pavement, _LOWEST_M, arguments.clear_below_m))
    traffic = np.concatenate(parts)
    log.info("%d of %d points are traffic", traffic.sum(), len(traffic))
    about = {
        "points": len(traffic),
        "cleared_points": int(traffic.sum()),
        "clear_below_m": arguments.clear_below_m,
    }
    write_table(arguments.out, pd.DataFrame({"traffic": traffic}), about)


def _columns(cloud: CloudTiles, dem: Raster) -> Columns:
    bounds = np.array([tile.bounds_m for tile in cloud.tiles])
    corners = np.concatenate([bounds[:, :2], bounds[:, 3:5]])
    columns = Columns(Grid.around(corners[:, 0], corners[:, 1], _COLUMN_M))
    for number in range(len(cloud.tiles)):
        xyz, height_m = _tile(cloud, dem, number)
        columns.add(xyz[:, :2], height_m)
    return columns


def _tile(cloud: CloudTiles, dem: Raster, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) and heights above the ground (n,) of a tile's points."""
    xyz = stack_xyz(cloud.read(POSITION, [number])).astype(np.float64)
    return xyz, xyz[:, 2] - dem.sample(xyz[:, 0], xyz[:, 1])


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("cloud", "frame", "dem", "pavement", "out"):
        parser.add_argument(f"--{name}", required=True)
    add_settings(parser, Lidar, "clear_below_m")
    return run_stage(parser, mark_traffic, argv)


if __name__ == "__main__":
    sys.exit(main())
