"""Voxels of the cloud by class, and the overhead view of them (paper 2, section 3.2.1)."""

from __future__ import annotations

import json
import logging
import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, fields
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import shapely
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Bytes, Floats, Ints, Ints32
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Voxels
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, Points, Tile
from roadsight.io.raster.rasters import read_raster
from roadsight.io.raster.top_rasters import TopRasterWriter
from roadsight.io.records.atomic import WholeFile, read_json
from roadsight.io.records.tables import as_table, schema_of
from roadsight.scene.classes import ROAD, class_table, is_road
from roadsight.scene.voxel_classes import (
    CLASS_BITS,
    ClassRuns,
    Columns,
    VoxelGrid,
    add_runs,
    count_classes,
    seen_from_above,
    settle,
)
from roadsight.stages.command import Command, logged

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
    grid: VoxelGrid, cloud: CloudTiles, table: Bytes, paved: PavedArea | None, threads: int
) -> Iterator[Settled]:
    """Voxels of the cloud from south to north, each once, whatever the tiles are.

    What tiles share waits until all of them are read.
    """
    size_m = cloud.tile_size_m

    def work(read: tuple[Tile, Points]) -> tuple[int, Settled, ClassRuns]:
        tile, points = read
        cls: Bytes = table[points["classification"]]
        if paved is not None:
            cls[paved.holds(points["x"], points["y"], points["z"])] = ROAD
        runs = count_classes(grid, [points[axis] for axis in "xyz"], cls)
        own = grid.within(runs.voxel, tile.ix * size_m, tile.iy * size_m, size_m)
        return tile.iy, settle_area(grid, runs.part(own)), runs.part(~own)

    columns = ("x", "y", "z", "classification")
    numbers = logged(range(len(cloud.tiles)), len(cloud.tiles), log, "tiles")
    tiles = ((cloud.tiles[number], cloud.read(columns, [number])) for number in numbers)
    shared: list[ClassRuns] = []
    done = 0
    for iy, row in groupby(in_order(work, tiles, threads), key=itemgetter(0)):
        parts = []
        for _, part, open_runs in row:
            parts.append(part)
            shared.append(open_runs)
        open_row = grid.first_open_row((iy + 1) * size_m)
        south, north = add_runs(shared).split(grid.row_start(open_row))
        yield from _in_rows(grid, [*parts, settle_area(grid, south)], range(done, open_row, _ROWS))
        shared, done = [north], open_row
    yield from (settle_area(grid, part) for part in shared)


def _in_rows(grid: VoxelGrid, parts: list[Settled], starts: range) -> Iterator[Settled]:
    """Parts beside each other, some rows of all of them at a time."""
    for start in starts:
        halves = [part.split(grid, start + starts.step) for part in parts]
        yield join([south for south, _ in halves])
        parts = [north for _, north in halves]


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


# Voxels that no point is still to come for, while a cloud is read tile by tile.

_COLUMNS = tuple(field.name for field in fields(Columns))


@dataclass(frozen=True)
class Settled:
    """Voxels of whole columns and what is seen of them from above, in half of their runs' room.

    Parameters
    ----------
    voxel : (n,) number in the window, rising. cls : (n,) class.
    columns : by row; where the parts of an area are joined, in any order within it.
    """

    voxel: Ints
    cls: Bytes
    columns: Columns

    def split(self, grid: VoxelGrid, row: int) -> tuple[Settled, Settled]:
        """What lies south of a row of the window, and the rest; the columns have to be by row."""
        cut = int(np.searchsorted(self.voxel, grid.row_start(row)))
        seen = int(np.searchsorted(self.columns.row, row))
        return (
            Settled(self.voxel[:cut], self.cls[:cut], _part(self.columns, slice(None, seen))),
            Settled(self.voxel[cut:], self.cls[cut:], _part(self.columns, slice(seen, None))),
        )


def settle_area(grid: VoxelGrid, runs: ClassRuns) -> Settled:
    """Classes and overhead view of runs of whole columns."""
    voxels = settle(runs)
    return Settled(voxels.voxel, voxels.cls, seen_from_above(grid, voxels))


def join(parts: Sequence[Settled]) -> Settled:
    """Parts that share no column as one, its voxels by rising number."""
    keys = np.concatenate([part.voxel for part in parts])
    keys <<= CLASS_BITS
    keys |= np.concatenate([part.cls for part in parts])
    keys.sort(kind="stable")  # fast where parts are sorted
    cls = (keys & (2**CLASS_BITS - 1)).astype(np.uint8)
    keys >>= CLASS_BITS
    columns = [np.concatenate([getattr(part.columns, name) for part in parts]) for name in _COLUMNS]
    return Settled(keys, cls, Columns(*columns))


def _part(columns: Columns, rows: slice) -> Columns:
    return Columns(*(getattr(columns, name)[rows] for name in _COLUMNS))


# Voxels of a site as a Parquet file that is written piece by piece.

_GROUP = 1 << 20
"""Rows of a row group. Groups are cut at whole multiples, so that the bytes do not depend on the
pieces in which voxels come."""

_SCHEMA = schema_of({**dict.fromkeys(("ix", "iy", "iz"), "i4"), "cls": "u1"})


class VoxelTableWriter(WholeFile):
    """Writes columns ix, iy, iz and cls; the bytes do not depend on the pieces.

    Parameters
    ----------
    path : the Parquet file. about : JSON description kept in it, read by `io.tables.read_about`.
    """

    def __init__(self, path: str | os.PathLike[str], about: dict[str, Any]) -> None:
        super().__init__(path)
        self._schema = _SCHEMA.with_metadata(
            {b"roadsight": json.dumps(about, sort_keys=True).encode()}
        )
        self._waiting: list[pa.Table] = []
        self.rows = 0

    def _open(self, temporary: Path) -> None:
        self._file = pq.ParquetWriter(
            temporary,
            self._schema,
            compression="zstd",
            write_page_checksum=True,
            use_dictionary=False,
            column_encoding=dict.fromkeys(_SCHEMA.names, "BYTE_STREAM_SPLIT"),
        )

    def _complete(self) -> None:
        self._flush(whole_groups=False)

    def _close(self) -> None:
        self._file.close()

    def add(self, indices: Ints32, cls: Bytes) -> None:
        """Add voxels: indices ix, iy, iz (n, 3) and classes (n,)."""
        columns = dict(zip(_SCHEMA.names, (*indices.T, cls), strict=True))
        self._waiting.append(as_table(columns, self._schema))
        self.rows += len(cls)
        if sum(len(part) for part in self._waiting) >= _GROUP:
            self._flush(whole_groups=True)

    def _flush(self, whole_groups: bool) -> None:
        if not self._waiting:
            return
        waiting = pa.concat_tables(self._waiting).combine_chunks()
        cut = len(waiting) // _GROUP * _GROUP if whole_groups else len(waiting)
        if cut:
            self._file.write_table(waiting.slice(0, cut), row_group_size=_GROUP)
        self._waiting = [waiting.slice(cut)]


# Points on a paved area that is known by its outline.

_CLIP_MARGIN_M = 1.0
"""How far around points the outline is cut out."""


class PavedArea:
    """Surface of a road whose outline is known in plan.

    Parameters
    ----------
    outline : Polygon or MultiPolygon, local metres.
    height_at : function of x, y (n,) that gives the terrain's height, NaN where unknown.
    reach_m : a point counts when it is no farther than this above or below the terrain.
    """

    def __init__(
        self,
        outline: shapely.Geometry,
        height_at: Callable[[ArrayLike, ArrayLike], Floats],
        reach_m: float = 0.3,
    ) -> None:
        self._outline, self._height_at, self._reach_m = outline, height_at, reach_m

    def holds(self, x_m: ArrayLike, y_m: ArrayLike, z_m: ArrayLike) -> Bools:
        """Whether points (n,) lie on the pavement; a point on its outline does not."""
        x, y, z = (np.asarray(axis, np.float64) for axis in (x_m, y_m, z_m))
        on = np.zeros(len(x), bool)
        if not len(x):
            return on
        # Without a margin the box's own sides would be an outline on which points lie.
        west, south = x.min() - _CLIP_MARGIN_M, y.min() - _CLIP_MARGIN_M
        east, north = x.max() + _CLIP_MARGIN_M, y.max() + _CLIP_MARGIN_M
        near = shapely.intersection(self._outline, shapely.box(west, south, east, north))
        if near.is_empty:
            return on
        shapely.prepare(near)
        inside = np.flatnonzero(shapely.contains_xy(near, x, y))
        gap_m = np.abs(z[inside] - self._height_at(x[inside], y[inside]))
        on[inside[gap_m <= self._reach_m]] = True
        return on


# Items worked on in other threads while the results before them are used.

Item = TypeVar("Item")

Result = TypeVar("Result")


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], threads: int
) -> Iterator[Result]:
    """Results of ``work`` in the order of the items, whatever the number of threads.

    The caller's thread takes the items and uses the results; the others work, at most one item each
    and one more ahead. With one thread in all, each result is made when it is asked for.

    Parameters
    ----------
    threads : in all, at least 1; ``work`` runs in parallel only where it releases the GIL.
    """
    if threads < 2:
        yield from map(work, items)
        return
    with ThreadPoolExecutor(threads - 1) as pool:
        waiting: deque[Future[Result]] = deque()
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


main = Command(rasterise_lidar)


if __name__ == "__main__":
    sys.exit(main())
