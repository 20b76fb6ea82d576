"""Ground labels and terrain model: ``python -m roadsight.stages.scene.build_dem --help``."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bools, Floats32
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Ground
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import write_table
from roadsight.scene.grids import Grid
from roadsight.scene.spacing import plan_spacing_m
from roadsight.scene.terrain.ground_doubts import ClassAgreement, ground_doubts, raised_settings
from roadsight.scene.terrain.ground_settings import ground_settings_for
from roadsight.scene.terrain.terrain import TerrainModel, label_ground
from roadsight.stages.command import Command
from roadsight.stages.doubts import tell

log = logging.getLogger("build_dem")


def build_dem(
    site: str,
    cloud_path: Path,
    frame_path: Path,
    profile: Path,
    asked: Ground,
    *,
    dem: Path,
    ground_path: Path,
    doubts_path: Annotated[Path | None, "what the ground rests on"] = None,
) -> None:
    """Label the ground and write the terrain model."""
    cloud = CloudTiles(cloud_path)
    frame = Frame.from_dict(read_json(frame_path))
    spacing_m = plan_spacing_m(read_json(profile)["density_per_m2"]["median"])
    corners = np.array([tile.bounds_m for tile in cloud.tiles])
    west, south = corners[:, :2].min(axis=0).tolist()
    east, north = corners[:, 3:5].max(axis=0).tolist()
    bounds = (west, south, east, north)
    settings = ground_settings_for(spacing_m, asked)
    terrain = TerrainModel(bounds, max(asked.dem_cell_m, spacing_m))
    labels = []
    for points, mask in label_ground(
        lambda halo: (
            (core, stack_xyz(part).astype(np.float64))
            for core, part in cloud.iter_tiles(halo, ("x", "y", "z"))
        ),
        bounds,
        settings,
    ):
        terrain.add(points[mask])
        labels.append(mask)
        log.info("tile %d of %d: %d points", len(labels), len(cloud.tiles), len(points))
    ground = np.concatenate(labels)
    _check(ground, site)
    write_table(ground_path, pd.DataFrame({"ground": ground}), {"settings": settings.model_dump()})
    heights_m = terrain.heights_m(asked.dem_fill_m)
    if doubts_path:
        doubts = ground_doubts(
            float(ground.mean()),
            terrain.filled_share(),
            terrain.noise_m(),
            _agreement(cloud, ground, terrain.grid, heights_m),
        )
        used = settings.model_copy(update={"dem_cell_m": terrain.grid.cell_size_m}).model_dump()
        own = "pillar_width_m" if asked.method == "pillars" else "coarse_cell_m"
        names = own, "dem_cell_m"
        doubts += raised_settings({name: getattr(asked, name) for name in names}, used)
        tell(doubts, doubts_path, f"site {site}", log)
    write_raster(
        dem,
        heights_m[::-1],
        frame,
        west_m=terrain.grid.west_m,
        north_m=terrain.grid.north_m,
        cell_size_m=terrain.grid.cell_size_m,
        measured=terrain.measured[::-1],
    )


def _agreement(cloud: CloudTiles, ground: Bools, grid: Grid, heights_m: Floats32) -> ClassAgreement:
    """The file's classes beside ours, tile by tile; heights from the south row on."""
    found, start = ClassAgreement(), 0
    if "classification" not in cloud.columns:
        return found
    for _, part in cloud.iter_tiles(0.0, ("x", "y", "z", "classification")):
        end = start + len(part["z"])
        below_m = heights_m.ravel()[grid.flat(part["x"], part["y"])]
        found.add(part["classification"], ground[start:end], part["z"] - below_m)
        start = end
    return found


def _check(ground: np.ndarray, site: str) -> None:
    share = float(ground.mean())
    log.info("%.1f %% of %d points are ground", 100 * share, len(ground))
    if share < 0.01:
        raise InputError(
            "no ground found",
            where=f"site {site}",
            found=f"{share:.2%} of the points near a plausible ground surface",
            allowed="at least 1 %",
            hint="check the units of z (vertical_units), or raise ground.max_object_width_m",
        )


main = Command(build_dem)


if __name__ == "__main__":
    sys.exit(main())
