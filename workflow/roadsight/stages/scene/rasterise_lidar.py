"""Voxels of the cloud by class, and the overhead view of them (paper 2, section 3.2.1)."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Iterator
from itertools import groupby
from operator import itemgetter

import numpy as np
import shapely

from roadsight.base.arrays import Bytes
from roadsight.base.errors import InputError
from roadsight.base.options import add_settings
from roadsight.config.sections.poles import Voxels
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
from roadsight.stages.command import run_stage
from roadsight.stages.progress import logged

log = logging.getLogger("rasterise_lidar")

_ROWS = 32
"""Rows of voxels that are joined across a row of tiles and written together: bounds the memory."""


def rasterise_lidar(arguments: argparse.Namespace) -> None:
    """Write the voxels and the overhead view, one row of tiles in memory at a time."""
    frame = Frame.from_dict(read_json(arguments.frame))
    cloud = CloudTiles(arguments.cloud)
    table = class_table(arguments.road_classes, arguments.bridge_classes)
    paved = _paved_area(arguments, cloud, table, frame)
    bounds = np.array([tile.bounds_m for tile in cloud.tiles])
    corners = [*bounds[:, :3].min(axis=0), *bounds[:, 3:].max(axis=0)]
    grid = VoxelGrid.over(frame, arguments.voxel_size_m, corners)
    about = {"cell_size_m": grid.cell_size_m, "anchor": list(grid.anchor_m)}
    road = 0
    with (
        VoxelTableWriter(arguments.voxels, about) as voxels,
        TopRasterWriter(arguments.top, frame, grid) as top,
    ):
        for part in settled(grid, cloud, table, paved, arguments.threads):
            voxels.add(grid.indices(part.voxel), part.cls)
            top.add(part.columns)
            road += int(np.count_nonzero(is_road(part.cls)))
    log.info("%d points, %d voxels, %d of road or bridge", cloud.points, voxels.rows, road)
    if road == 0:
        raise InputError(
            "no point of the cloud lies on the pavement",
            where=arguments.pavement,
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
    cls = table[points["classification"]]
    if paved is not None:
        cls[paved.holds(points["x"], points["y"], points["z"])] = ROAD
    return cls


def _paved_area(
    arguments: argparse.Namespace, cloud: CloudTiles, table: Bytes, frame: Frame
) -> PavedArea | None:
    """Nothing for a cloud that knows its roads, else the pavement found in it or given."""
    log.info("points by class: %s", cloud.classes)
    on_road = sum(count for cls, count in cloud.classes.items() if table[cls] == ROAD)
    share = on_road / max(cloud.points, 1)
    use_class = arguments.road_source == "class" or (
        arguments.road_source == "auto" and share >= arguments.least_road_share
    )
    if use_class and share > 0:
        return None
    if use_class or not (arguments.pavement and arguments.dem):
        raise InputError(
            "the cloud has no road points" if share == 0 else "the cloud has too few road points",
            where=arguments.cloud,
            found=f"{share:.3%} of classes {arguments.road_classes}",
            hint="name its road class (poles.road_classes), or have the pavement found",
        )
    from roadsight.io.vector.vectors import read_layer  # noqa: PLC0415  # slow to load, rarely needed

    outline = shapely.union_all(
        read_layer(arguments.pavement, "pavement", frame).geometry.to_numpy()
    )
    log.info("%.0f m2 of pavement stand for the road class", outline.area)
    return PavedArea(outline, read_raster(arguments.dem, frame).sample, arguments.pavement_height_m)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("cloud", "frame", "voxels", "top"):
        parser.add_argument(f"--{name}", required=True)
    for name in ("pavement", "dem"):
        parser.add_argument(f"--{name}", nargs="?", help="for a cloud without road class")
    add_settings(parser, Voxels, "voxel_size_m", "road_classes", "bridge_classes")
    parser.add_argument("--road-source", choices=("auto", "class", "pavement"), default="auto")
    parser.add_argument(
        "--least-road-share",
        type=float,
        default=1e-4,
        help="auto: with a smaller share of road points, the pavement is used",
    )
    parser.add_argument(
        "--pavement-height-m", type=float, default=0.3, help="farthest from the terrain model"
    )
    parser.add_argument("--threads", type=int, default=1)
    return run_stage(parser, rasterise_lidar, argv)


if __name__ == "__main__":
    sys.exit(main())
