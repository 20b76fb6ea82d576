"""Ground labels and terrain model: ``python -m roadsight.stages.scene.build_dem --help``."""

from __future__ import annotations

import argparse
import logging
import sys
from dataclasses import fields

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bools, Floats32
from roadsight.base.errors import InputError
from roadsight.base.options import add_settings
from roadsight.config.sections.scene import Ground
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import write_table
from roadsight.scene.grids import Grid
from roadsight.scene.spacing import plan_spacing_m
from roadsight.scene.terrain.ground_doubts import ClassAgreement, ground_doubts, raised_settings
from roadsight.scene.terrain.ground_settings import GroundSettings, ground_settings_for
from roadsight.scene.terrain.terrain import TerrainModel, label_ground
from roadsight.stages.command import run_stage
from roadsight.stages.doubts import tell

log = logging.getLogger("build_dem")


def build_dem(arguments: argparse.Namespace) -> None:
    """Label the ground and write the terrain model."""
    cloud = CloudTiles(arguments.cloud)
    frame = Frame.from_dict(read_json(arguments.frame))
    spacing_m = plan_spacing_m(read_json(arguments.profile)["density_per_m2"]["median"])
    corners = np.array([tile.bounds_m for tile in cloud.tiles])
    west, south = corners[:, :2].min(axis=0).tolist()
    east, north = corners[:, 3:5].max(axis=0).tolist()
    bounds = (west, south, east, north)
    asked = ground_settings_of(arguments)
    settings = ground_settings_for(spacing_m, asked)
    terrain = TerrainModel(bounds, max(arguments.dem_cell_m, spacing_m))
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
    _check(ground, arguments.site)
    write_table(arguments.ground, pd.DataFrame({"ground": ground}), {"settings": vars(settings)})
    heights_m = terrain.heights_m(arguments.dem_fill_m)
    if arguments.doubts:
        doubts = ground_doubts(
            float(ground.mean()),
            terrain.filled_share(),
            terrain.noise_m(),
            _agreement(cloud, ground, terrain.grid, heights_m),
        )
        doubts += raised_settings(
            {"coarse_cell_m": asked.coarse_cell_m, "dem_cell_m": arguments.dem_cell_m},
            {"coarse_cell_m": settings.coarse_cell_m, "dem_cell_m": terrain.grid.cell_size_m},
        )
        tell(doubts, arguments.doubts, f"site {arguments.site}", log)
    write_raster(
        arguments.dem,
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


_FILTER = tuple(field.name for field in fields(GroundSettings))
"""Settings of the ground filter, as options of the stage and of the verb ``ground``."""


def add_ground_arguments(parser: argparse.ArgumentParser) -> None:
    """All settings of the ground filter as options."""
    add_settings(parser, Ground, *_FILTER)


def ground_settings_of(arguments: argparse.Namespace) -> GroundSettings:
    """Settings of the ground filter from parsed options.

    Raises
    ------
    InputError : one of them is not above zero.
    """
    given = {name: getattr(arguments, name) for name in _FILTER}
    for name, value in given.items():
        if not 0 < value < float("inf"):
            raise InputError(
                "is no setting of the ground filter",
                where=f"--{name.replace('_', '-')}",
                found=value,
                allowed="a number above 0",
            )
    return GroundSettings(**given)


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


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("site", "cloud", "frame", "profile", "dem", "ground"):
        parser.add_argument(f"--{name}", required=True)
    add_ground_arguments(parser)
    add_settings(parser, Ground, "dem_cell_m", "dem_fill_m")
    parser.add_argument("--doubts", help="JSON with what the ground rests on")
    return run_stage(parser, build_dem, argv)


if __name__ == "__main__":
    sys.exit(main())
