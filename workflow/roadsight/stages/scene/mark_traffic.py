"""Points of vehicles that were passing while the cloud was recorded."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import shapely

from roadsight.base.sections.sensing import Lidar
from roadsight.geometry.areas import inside
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import POSITION, CloudTiles, stack_xyz
from roadsight.io.raster.rasters import Raster, read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import write_table
from roadsight.io.vector.vectors import read_layer
from roadsight.scene.grids import Grid
from roadsight.scene.traffic import Columns, is_traffic
from roadsight.stages.command import Command, logged

log = logging.getLogger("mark_traffic")

_RIM_M = 0.5
"""Kerbs, islands' rims and the foot of what stands beside the road are this near to the outline."""
_COLUMN_M = 0.5
"""Edge of the columns whose greatest height tells vehicles from what stays."""
_LOWEST_M = 0.2
"""What is lower above the ground is pavement."""


def mark_traffic(
    cloud_path: Path,
    frame_path: Path,
    dem_path: Path,
    pavement: Path,
    clear_below_m: Annotated[float, Lidar],
    *,
    out: Path,
) -> None:
    """Write which points of the cloud are traffic, in the cloud's order."""
    cloud = CloudTiles(cloud_path)
    frame = Frame.from_dict(read_json(frame_path))
    dem = read_raster(dem_path, frame)
    outline = shapely.union_all(read_layer(pavement, "pavement", frame).geometry)
    inner = shapely.multipolygons(shapely.get_parts(outline.buffer(-_RIM_M)))
    bounds = np.array([tile.bounds_m for tile in cloud.tiles])
    corners = np.concatenate([bounds[:, :2], bounds[:, 3:5]])
    columns = Columns(Grid.around(corners[:, 0], corners[:, 1], _COLUMN_M))
    for number in range(len(cloud.tiles)):
        xyz, height_m = _tile(cloud, dem, number)
        columns.add(xyz[:, :2], height_m)
    parts = [np.empty(0, bool)]
    for number in logged(range(len(cloud.tiles)), len(cloud.tiles), log, "tiles"):
        xyz, height_m = _tile(cloud, dem, number)
        on_pavement = inside(inner, xyz[:, 0], xyz[:, 1])
        top_m = columns.top_m(xyz[:, :2])
        parts.append(is_traffic(height_m, top_m, on_pavement, _LOWEST_M, clear_below_m))
    traffic = np.concatenate(parts)
    log.info("%d of %d points are traffic", traffic.sum(), len(traffic))
    about = {
        "points": len(traffic),
        "cleared_points": int(traffic.sum()),
        "clear_below_m": clear_below_m,
    }
    write_table(out, pd.DataFrame({"traffic": traffic}), about)


def _tile(cloud: CloudTiles, dem: Raster, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) and heights above the ground (n,) of a tile's points."""
    xyz = stack_xyz(cloud.read(POSITION, [number])).astype(np.float64)
    return xyz, xyz[:, 2] - dem.sample(xyz[:, 0], xyz[:, 1])


main = Command(mark_traffic)


if __name__ == "__main__":
    sys.exit(main())
