"""Voxels of the cloud by class, and the overhead view of them (paper 2, section 3.2.1)."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import shapely

from roadsight.base.arrays import Bytes
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Voxels
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, Points, Tile
from roadsight.io.cloud.voxel_tables import VoxelTableWriter
from roadsight.io.raster.rasters import read_raster
from roadsight.io.raster.top_rasters import TopRasterWriter
from roadsight.io.records.atomic import read_json
from roadsight.scene.classes import ROAD, class_table, is_road
from roadsight.scene.pavement.paved import PavedArea
from roadsight.scene.voxels.settled_voxels import Settled, join, settle_area
from roadsight.scene.voxels.voxel_classes import ClassRuns, VoxelGrid, add_runs, count_classes
from roadsight.stages.ahead import in_order
from roadsight.stages.command import Command
from roadsight.stages.progress import logged

log = logging.getLogger("rasterise_lidar")

_ROWS = 32
"""Rows of voxels that are joined across a row of tiles and written together: bounds the memory."""


@dataclass(frozen=True)
class RoadSource:
    """What says where the cloud's road is."""

    road_source: Literal["auto", "class", "pavement"] = "auto"
    least_road_share: Annotated[
        float, "auto: with a smaller share of road points, the pavement is used"
    ] = 1e-4
    pavement: Annotated[Path | None, "for a cloud without road class"] = None
    dem: Annotated[Path | None, "for a cloud without road class"] = None
    pavement_height_m: Annotated[float, "farthest from the terrain model"] = 0.3


def rasterise_lidar(
    cloud_path: Path,
    frame_path: Path,
    settings: Voxels,
    source: RoadSource,
    threads: int = 1,
    *,
    voxels_path: Path,
    top_path: Path,
) -> None:
    """Write the voxels and the overhead view, one row of tiles in memory at a time."""
    frame = Frame.from_dict(read_json(frame_path))
    cloud = CloudTiles(cloud_path)
    table = class_table(settings.road_classes, settings.bridge_classes)
    paved = _paved_area(source, cloud, cloud_path, settings, frame)
    bounds = np.array([tile.bounds_m for tile in cloud.tiles])
    corners = [*bounds[:, :3].min(axis=0), *bounds[:, 3:].max(axis=0)]
    grid = VoxelGrid.over(frame, settings.voxel_size_m, corners)
    about = {"cell_size_m": grid.cell_size_m, "anchor": list(grid.anchor_m)}
    road = 0
    with (
        VoxelTableWriter(voxels_path, about) as voxels,
        TopRasterWriter(top_path, frame, grid) as top,
    ):
        for part in settled(grid, cloud, table, paved, threads):
            voxels.add(grid.indices(part.voxel), part.cls)
            top.add(part.columns)
            road += int(np.count_nonzero(is_road(part.cls)))
    log.info("%d points, %d voxels, %d of road or bridge", cloud.points, voxels.rows, road)
    if road == 0:
        raise InputError(
            "no point of the cloud lies on the pavement",
            where=str(source.pavement),
            hint="check that pavement, terrain model and cloud belong together",
        )


def settled(
    grid: VoxelGrid,
    cloud: CloudTiles,
    table: Bytes,
    paved: PavedArea | None,
    threads: int,
) -> Iterator[Settled]:
    """Voxels of the cloud from south to north, each once, whatever the tiles are.

    What tiles share waits until all of them are read.
    """
    size_m = cloud.tile_size_m

    def work(read: tuple[Tile, Points]) -> tuple[int, Settled, ClassRuns]:
        tile, points = read
        cls = _classes(points, table, paved)
        runs = count_classes(grid, [points[axis] for axis in "xyz"], cls)
        own = grid.within(runs.voxel, tile.ix * size_m, tile.iy * size_m, size_m)
        return tile.iy, settle_area(grid, runs.part(own)), runs.part(~own)

    shared: list[ClassRuns] = []
    done = 0
    for iy, row in groupby(in_order(work, _points_of_tiles(cloud), threads), key=itemgetter(0)):
        parts = []
        for _, part, open_runs in row:
            parts.append(part)
            shared.append(open_runs)
        open_row = grid.first_open_row((iy + 1) * size_m)
        south, north = add_runs(shared).split(grid.row_start(open_row))
        yield from _in_rows(grid, [*parts, settle_area(grid, south)], range(done, open_row, _ROWS))
        shared, done = [north], open_row
    yield from (settle_area(grid, part) for part in shared)


def _points_of_tiles(cloud: CloudTiles) -> Iterator[tuple[Tile, Points]]:
    for number in logged(range(len(cloud.tiles)), len(cloud.tiles), log, "tiles"):
        columns = ("x", "y", "z", "classification")
        yield cloud.tiles[number], cloud.read(columns, [number])


def _in_rows(grid: VoxelGrid, parts: list[Settled], starts: range) -> Iterator[Settled]:
    """Parts beside each other, some rows of all of them at a time."""
    for start in starts:
        halves = [part.split(grid, start + starts.step) for part in parts]
        yield join([south for south, _ in halves])
        parts = [north for _, north in halves]


def _classes(points: Points, table: Bytes, paved: PavedArea | None) -> Bytes:
    cls: Bytes = table[points["classification"]]
    if paved is not None:
        cls[paved.holds(points["x"], points["y"], points["z"])] = ROAD
    return cls


def _paved_area(
    source: RoadSource, cloud: CloudTiles, cloud_path: Path, settings: Voxels, frame: Frame
) -> PavedArea | None:
    """Nothing for a cloud that knows its roads, else the pavement found in it or given."""
    log.info("points by class: %s", cloud.classes)
    table = class_table(settings.road_classes, settings.bridge_classes)
    on_road = sum(count for cls, count in cloud.classes.items() if table[cls] == ROAD)
    share = on_road / max(cloud.points, 1)
    use_class = source.road_source == "class" or (
        source.road_source == "auto" and share >= source.least_road_share
    )
    if use_class and share > 0:
        return None
    if use_class or not (source.pavement and source.dem):
        raise InputError(
            "the cloud has no road points" if share == 0 else "the cloud has too few road points",
            where=str(cloud_path),
            found=f"{share:.3%} of classes {settings.road_classes}",
            hint="name its road class (poles.road_classes), or have the pavement found"
            " (poles.road: pavement)",
        )
    from roadsight.io.vector.vectors import read_layer  # noqa: PLC0415  # slow to load, rarely needed

    layer = read_layer(source.pavement, "pavement", frame)
    outline = shapely.union_all(layer.geometry.to_numpy())
    log.info("%.0f m2 of pavement stand for the road class", outline.area)
    heights = read_raster(source.dem, frame)
    return PavedArea(outline, heights.sample, source.pavement_height_m)


main = Command(rasterise_lidar)


if __name__ == "__main__":
    sys.exit(main())
