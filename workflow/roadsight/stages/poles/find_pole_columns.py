"""Pole-like columns of the cloud: axes good to a few centimetres, landmarks for the cameras."""

from __future__ import annotations

import logging
import sys
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import pandas as pd

from roadsight.base.sections.poles import Columns
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, in_bounds
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import write_table
from roadsight.poles.sightings.lidar_poles import find_pole_columns
from roadsight.poles.sightings.stems import StemShapes, find_stems, stem_shapes, with_stems
from roadsight.stages.command import Command, logged

log = logging.getLogger("find_pole_columns")
COLUMNS = ("x", "y", "z_ground", "top_m", "sigma_m", "points", "open_top")
SHAPES = tuple(part.name for part in fields(StemShapes))
"""Columns of their lean and arms."""
_HALO_M = 6.0
"""Least margin of a tile: so far from a column wires tell its arms."""
_BEYOND_M = 4.0
"""Margin beyond what is around a column, so that its nearest neighbours are the same in each tile
and tiles do not show in the result."""


def find_columns(cloud_path: Path, frame: Path, dem: Path, settings: Columns, *, out: Path) -> None:
    """Write the columns of each tile, those of its margin left to its neighbours."""
    ground = read_raster(dem, Frame.from_dict(read_json(frame)))
    cloud = CloudTiles(cloud_path)
    halo_m = max(_HALO_M, settings.around_m + _BEYOND_M)
    tiles = cloud.iter_tiles(halo_m, ["x", "y", "z", "classification"])
    tables = [pd.DataFrame(columns=[*COLUMNS, *SHAPES], dtype=np.float64)]
    for bounds, points in logged(tiles, len(cloud.tiles), log, "tiles"):
        xyz = np.column_stack([points[name] for name in "xyz"]).astype(np.float64)
        above = xyz[:, 2] - ground.sample(xyz[:, 0], xyz[:, 1])
        cls = points["classification"]
        tall = find_pole_columns(xyz, above, cls, settings)
        found = with_stems(tall, find_stems(xyz, above, cls, settings.excluded_classes))
        x, y = found.xy_m.T
        shapes = asdict(stem_shapes(found, xyz, above, cls, settings.excluded_classes))
        values = x, y, found.z_ground_m, found.top_m, found.sigma_m, found.points, found.open_top
        table = pd.DataFrame(dict(zip(COLUMNS, values, strict=True)) | shapes)
        tables.append(table[in_bounds(x, y, bounds)])
    table = pd.concat([part for part in tables if len(part)] or tables[:1], ignore_index=True)
    table = table.sort_values(["x", "y"], kind="stable", ignore_index=True)
    median_m = table["sigma_m"].median() if len(table) else float("nan")
    tell = log.info if len(table) else log.warning
    tell("%d pole-like columns, places good to %.3f m (median)", len(table), median_m)
    write_table(out, table, {"settings": settings.model_dump()})


main = Command(find_columns)


if __name__ == "__main__":
    sys.exit(main())
