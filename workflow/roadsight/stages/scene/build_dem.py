"""Ground labels and terrain model: ``python -m roadsight.stages.scene.build_dem --help``."""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bools, Bytes, Floats, Floats32
from roadsight.base.doubts import Doubt
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Ground
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import write_table
from roadsight.scene.grids import Grid
from roadsight.scene.profile import plan_spacing_m
from roadsight.scene.terrain.ground_settings import ground_settings_for
from roadsight.scene.terrain.registration import Registration
from roadsight.scene.terrain.terrain import TerrainModel, label_ground
from roadsight.stages.command import Command, tell

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
    about = read_json(frame_path)
    frame = Frame.from_dict(about)
    spacing_m = plan_spacing_m(read_json(profile)["density_per_m2"]["median"])
    corners = np.array([tile.bounds_m for tile in cloud.tiles])
    west, south = corners[:, :2].min(axis=0).tolist()
    east, north = corners[:, 3:5].max(axis=0).tolist()
    bounds = (west, south, east, north)
    settings = ground_settings_for(spacing_m, asked)
    terrain = TerrainModel(bounds, max(asked.dem_cell_m, spacing_m))
    labels: list[Bools] = []
    files = [Path(name).name for name in about["inputs"]]
    registration = Registration(about["input_boxes_m"], files)
    for points, mask in label_ground(
        lambda halo: (
            (core, stack_xyz(part).astype(np.float64))
            for core, part in cloud.iter_tiles(halo, ("x", "y", "z"))
        ),
        bounds,
        settings,
    ):
        terrain.add(points[mask])
        if doubts_path and "scan" in cloud.columns:
            registration.add(points, mask, cloud.read(("scan",), [len(labels)])["scan"])
        labels.append(mask)
        log.info("tile %d of %d: %d points", len(labels), len(cloud.tiles), len(points))
    ground = np.concatenate(labels)
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
    write_table(ground_path, pd.DataFrame({"ground": ground}), {"settings": settings.model_dump()})
    heights_m = terrain.heights_m(asked.dem_fill_m)
    if doubts_path:
        doubts = ground_doubts(
            share,
            terrain.filled_share(),
            terrain.noise_m(),
            _agreement(cloud, ground, terrain.grid, heights_m),
        )
        doubts += registration.doubts()
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


# What limits the worth of ground labels and of the terrain model made from them.

_LEAST_GROUND = 0.2
"""Share of ground below which streets and corridors are unusual: dense forest, or a lost road."""

_MOST_FILLED = 0.3
"""Share of filled cells in the scanned area beyond which heights rest on what lies around."""

_MOST_NOISE_M = 0.05
"""Thickest layer of ground; on flat planes with more noise, the filter was not held to 3 %."""

_HIGH_M = 2.0
"""No ground stands this high above the terrain model."""

_MOST_HIGH = 0.03
"""Share of a file's ground points that stand so high from which its classes mean nothing: published
ones have 0 to 0.06 %; where all points were of class 2, streets had 7 to 8 %, tiles 12 to 60."""

_MOST_DISAGREE = 0.15
"""Published classifications disagree with the filter on 0.5 to 1.5 % of the points, generated ones
with tall grass on 6 %."""

_GROUND_CLASSES = (2, 11)

_UNCLASSIFIED = (0, 1)


@dataclass
class ClassAgreement:
    """The file's ground classes beside ours, counted tile by tile."""

    points: int = 0
    disagree: int = 0
    own_ground: int = 0
    high: int = 0

    def add(self, classes: Bytes, ground: Bools, above_m: Floats) -> None:
        """Count points.

        Parameters
        ----------
        classes : (n,) of the file. ground : (n,) ours. above_m : (n,) above the terrain model, NaN
            where it has no height.
        """
        own = np.isin(classes, _GROUND_CLASSES)
        told = ~np.isin(classes, _UNCLASSIFIED)
        self.points += int(told.sum())
        self.disagree += int((own != ground)[told].sum())
        self.own_ground += int(own.sum())
        self.high += int((own & (above_m > _HIGH_M)).sum())


def ground_doubts(
    ground_share: float, filled_share: float, noise_m: float, classes: ClassAgreement
) -> list[Doubt]:
    """Doubts about a site's ground.

    Parameters
    ----------
    ground_share : of the points. filled_share : of the cells of the terrain model inside the
        scanned area. noise_m : median thickness (one sigma) of the ground's layer, NaN if unknown.
    """
    found = [
        Doubt("ground_share", "note", "share of points on the ground", round(ground_share, 4)),
        Doubt("dem_filled", "note", "share of filled cells of the DEM", round(filled_share, 4)),
    ]
    if ground_share < _LEAST_GROUND:
        found[0] = Doubt(
            "ground_share",
            "doubt",
            "few points lie on the ground: look whether the road is among them",
            round(ground_share, 4),
            _LEAST_GROUND,
        )
    if filled_share > _MOST_FILLED:
        found[1] = Doubt(
            "dem_filled",
            "doubt",
            "much of the terrain model is filled from around, not measured",
            round(filled_share, 4),
            _MOST_FILLED,
        )
    if noise_m > _MOST_NOISE_M:
        text = "the ground is a thick layer (registration?): kerbs and low objects drown in it, m"
        found.append(Doubt("layer_noise", "doubt", text, round(noise_m, 4), _MOST_NOISE_M))
    return found + _class_doubts(classes)


def _class_doubts(classes: ClassAgreement) -> list[Doubt]:
    """Doubts about the classes of the file; one without ground classes says nothing."""
    if not classes.own_ground:
        return []
    high = classes.high / classes.own_ground
    if high > _MOST_HIGH:
        text = f"points that the file calls ground stand over {_HIGH_M:g} m above the terrain"
        return [Doubt("classes_contradict", "doubt", text, round(high, 4), _MOST_HIGH)]
    disagree = classes.disagree / classes.points
    if disagree > _MOST_DISAGREE:
        text = "the file's ground classes disagree with the ground that was found"
        return [Doubt("classes_disagree", "doubt", text, round(disagree, 4), _MOST_DISAGREE)]
    return []


def raised_settings(asked: Mapping[str, float], used: Mapping[str, float]) -> list[Doubt]:
    """A note for each setting that was raised because the points are too far apart for it."""
    return [
        Doubt(
            f"raised_{name}",
            "note",
            f"{name} was raised from {value:g} to {used[name]:.3g}: the points are sparser",
            used[name],
            value,
        )
        for name, value in asked.items()
        if used[name] > value
    ]


main = Command(build_dem)


if __name__ == "__main__":
    sys.exit(main())
