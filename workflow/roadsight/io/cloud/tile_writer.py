"""Writes a site's cloud as one Parquet file of tiles, see `roadsight.io.cloud.tiles`."""

from __future__ import annotations

import json
import os
import tempfile
from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from roadsight.base.arrays import AnyPath, Floats32
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.chunks import Chunk
from roadsight.io.cloud.cloud_scan import CloudScan
from roadsight.io.cloud.tiles import COLOUR, COLUMN_TYPES, METADATA_KEY, POSITION, Tile
from roadsight.io.records.atomic import Incomplete, WholeFile, no_room
from roadsight.io.records.tables import as_table, schema_of

TileKey = tuple[int, int]  # row and column of a tile
# More tiles than this come of stray points or of a wrong unit; each costs memory and an entry of
# the index.
_MAX_TILES = 40_000
# Points held in memory. Fewer would send more of them through the file where points wait.
_HELD_POINTS = 1_000_000
_LEAST_POINTS = 1 << 15  # points of a tile that are worth a row group of their own, before the last


class TileWriter(WholeFile):
    """Sorts a stream of points into tiles with bounded memory.

    So many points are held. When there are more, tiles with enough of them are written. Of what is
    left, tiles that still grow are held on; others wait in an anonymous file beside the output, and
    all do where they are more than half (points in no order). The result does not depend on the
    batches. The file appears when `finish` has written it.

    Parameters
    ----------
    path : Parquet file to write.
    tile_size_m : edge of a tile.
    coloured : whether points have red, green and blue.
    """

    def __init__(self, path: AnyPath, tile_size_m: float, coloured: bool) -> None:
        super().__init__(path)
        self._tile_size_m = tile_size_m
        names = [name for name in COLUMN_TYPES if coloured or name not in COLOUR]
        self._types = {name: np.dtype(COLUMN_TYPES[name]) for name in names}
        self._held = {name: np.empty(_HELD_POINTS, kind) for name, kind in self._types.items()}
        self._count = self._held_on = 0
        self._known: set[TileKey] = set()
        self._is_finished = False
        self._spill = TileSpill(Path(path), self._types)
        # Before the file is opened, so that it is closed after it: only while the spill still takes
        # its room can be told whether the disk was full.
        self._whole.callback(self._spill.close)
        # A writer may be kept longer than its block; the points that it held need not.
        self._whole.callback(self._held.clear)

    def _open(self, temporary: Path) -> None:
        self._file = TileFile(temporary, self._types)

    def _complete(self) -> None:
        if not self._is_finished:
            raise Incomplete

    def _close(self) -> None:
        self._file.close()

    def append(self, points: Mapping[str, NDArray]) -> None:
        """Add points.

        Parameters
        ----------
        points : every column of the cloud, each of shape (n,); x and y at least 0. Without ``scan``
            all points are of one.

        Raises
        ------
        InputError : the points fill too many tiles.
        """
        one_scan = np.zeros(len(points["x"]), np.uint16)
        given = {"scan": one_scan} | dict(points)
        columns = {name: np.asarray(given[name]) for name in self._held}
        rows, done = len(columns["x"]), 0
        while done < rows:
            count = min(rows - done, _HELD_POINTS - self._count)
            for name, held in self._held.items():
                held[self._count : self._count + count] = columns[name][done : done + count]
            self._count += count
            done += count
            if self._count == _HELD_POINTS:
                self._write_tiles(_LEAST_POINTS)

    def finish(self) -> list[Tile]:
        """Write the rest of the file and return its tiles.

        Raises
        ------
        InputError : the points fill too many tiles, or the disk is full.
        """
        self._write_tiles(1)
        for tile in sorted(self._spill.tiles):
            self._write(tile, np.empty(0, np.intp))
        tiles = self._file.finish(self._tile_size_m)
        self._is_finished = True
        self.keep()
        return tiles

    def _write_tiles(self, least: int) -> None:
        """Write the tiles that have at least so many points; keep the others."""
        tiles, parts = self._parts()
        left = {}
        for tile, part in zip(tiles, parts, strict=True):
            if self._spill.rows(tile) + len(part) >= least:
                self._write(tile, part)
            else:
                left[tile] = part
        self._keep(left)

    def _parts(self) -> tuple[list[TileKey], list[NDArray[np.intp]]]:
        """Tiles of the points that are held, and the points' numbers tile by tile."""
        if self._count == 0:
            return [], []
        size_m = np.float64(self._tile_size_m)
        numbers = []  # of the tile's column and row of each point
        for axis in "xy":
            at_m = self._held[axis][: self._count]
            # 32 bits take a quarter of the time of 64.
            kind = np.int32 if at_m.max() / size_m < 2**31 else np.int64
            whole = np.empty(len(at_m), kind)
            numbers.append(np.divide(at_m, size_m, out=whole, casting="unsafe"))
        ix, iy = numbers
        parts = _by_tile(ix, iy)
        first = [part[0] for part in parts]
        tiles = list(zip(iy[first].tolist(), ix[first].tolist(), strict=True))
        self._known.update(tiles)
        if len(self._known) > _MAX_TILES:
            raise InputError(
                "the cloud fills too many tiles",
                where="tile_size_m",
                found=f"{self._tile_size_m:g} m",
                allowed=f"at most {_MAX_TILES} tiles",
                hint="choose larger tiles, or remove stray points",
            )
        return tiles, parts

    def _write(self, tile: TileKey, part: NDArray[np.intp]) -> None:
        """Write a tile's points: those that wait, then those that are held."""
        points = self._taken(part)
        if self._spill.rows(tile):
            waiting = self._spill.take(tile)
            points = {name: np.concatenate([waiting[name], points[name]]) for name in points}
        self._file.write(tile, points)

    def _keep(self, left: Mapping[TileKey, NDArray[np.intp]]) -> None:
        """Hold on the points of some tiles, or let them wait."""
        many = 2 * sum(map(len, left.values())) > _HELD_POINTS
        waiting, growing = {}, [np.empty(0, np.intp)]
        for tile, part in left.items():
            if many or part[-1] < self._held_on:
                waiting[tile] = part
            else:
                growing.append(part)
        if waiting:
            points = self._taken(np.concatenate(list(waiting.values())))
            self._spill.add({tile: len(part) for tile, part in waiting.items()}, points)
        points = self._taken(np.concatenate(growing))
        self._count = self._held_on = len(points["x"])
        for name, values in points.items():
            self._held[name][: self._count] = values

    def _taken(self, part: NDArray[np.intp]) -> dict[str, NDArray]:
        """Columns of some of the points that are held."""
        return {name: held.take(part) for name, held in self._held.items()}


def _by_tile(
    ix: NDArray[np.signedinteger], iy: NDArray[np.signedinteger]
) -> list[NDArray[np.intp]]:
    """Places (n,) of the points of each tile, by row and column of the tiles; n at least 1.

    Points of a tile stay as they came. Numbers of 8 and of 16 bits are sorted by radix, in an
    eighth and a quarter of the time; points that are held together rarely have more tiles.
    """
    wide, high = (int(index.max() - index.min()) + 1 for index in (ix, iy))
    kind = np.min_scalar_type(wide * high)
    row, column = ((index - index.min()).astype(kind) for index in (iy, ix))
    number = row * kind.type(wide) + column
    order = np.argsort(number, kind="stable")
    number = number.take(order)
    return np.split(order, np.flatnonzero(number[1:] != number[:-1]) + 1)


class TileDraft(ExitStack):
    """Tiles written while a cloud is first read, in the frame that its header promises.

    They count only if the headers were right about corner and colour.

    Parameters
    ----------
    path, tile_size_m : as `TileWriter`.
    frame : what the headers promise, or None: nothing is drafted.
    coloured : whether the headers promise colour.
    """

    def __init__(
        self, path: AnyPath, tile_size_m: float, frame: Frame | None, coloured: bool
    ) -> None:
        super().__init__()
        self._frame, self._coloured = frame, coloured
        self._shift: dict[str, int] = {}
        self._writer: TileWriter | None = None
        if frame is not None:
            self._writer = self.enter_context(TileWriter(path, tile_size_m, coloured))

    def take(self, path: AnyPath, chunk: Chunk) -> None:
        """Add points of a cloud, or give up where they lie beyond the promised corner."""
        if self._writer is None or self._frame is None:
            return
        if len(chunk) and not (chunk.xyz.min(axis=0) >= self._frame.origin).all():
            self.close()
            self._writer = None
            return
        brightest = 0 if chunk.colour is None else int(chunk.colour.max(initial=0))
        shift = self._shift.setdefault(os.fspath(path), colour_shift(brightest))
        self._writer.append(tile_columns(chunk, self._frame, shift))

    def finish(self, frame: Frame, scans: Sequence[CloudScan]) -> list[Tile] | None:
        """Write the tiles, or return None where the headers were wrong.

        Parameters
        ----------
        frame, scans : what reading all points has found.
        """
        seen = {os.fspath(scan.header.path): colour_shift(scan.brightest) for scan in scans}
        right = frame == self._frame and self._coloured == is_coloured(scans)
        if self._writer is None or not right or (self._coloured and seen != self._shift):
            return None
        return self._writer.finish()


def is_coloured(scans: Sequence[CloudScan]) -> bool:
    """Whether every cloud has colour, not only room for it."""
    return all(scan.brightest > 0 for scan in scans)


def colour_shift(brightest: int) -> int:
    """Bits by which colours are cut to 8."""
    return 8 if brightest > 255 else 0


def tile_columns(chunk: Chunk, frame: Frame, shift: int) -> dict[str, NDArray]:
    """Columns of the tiled cloud; colours of 16 bits are cut to 8 by ``shift``."""
    columns: dict[str, NDArray] = dict(zip("xyz", frame.to_local(chunk.xyz).T, strict=True))
    columns |= {
        "intensity": chunk.intensity,
        "scan": chunk.scan,
        "classification": chunk.classification,
        "return_number": chunk.return_number,
        "number_of_returns": chunk.number_of_returns,
    }
    if chunk.colour is not None:
        columns |= dict(zip(COLOUR, (np.right_shift(chunk.colour, shift)).T, strict=True))
    return columns


# Buffer of the file: the system takes few large writes in less time than many small ones.
_WRITTEN_BYTES = 1 << 20


@dataclass
class _Written:
    """Row groups of a tile, their points, and least and greatest x, y, z of these, each (3,)."""

    groups: list[int] = field(default_factory=list)
    rows: int = 0
    lower: Floats32 = field(default_factory=lambda: np.full(3, np.inf, np.float32))
    upper: Floats32 = field(default_factory=lambda: np.full(3, -np.inf, np.float32))

    def add(self, group: int, points: Mapping[str, NDArray]) -> None:
        """Count a row group with the columns ``points``, each of shape (n,)."""
        xyz = [points[axis] for axis in POSITION]
        self.groups.append(group)
        self.rows += len(xyz[0])
        self.lower = np.minimum(self.lower, [axis.min() for axis in xyz])
        self.upper = np.maximum(self.upper, [axis.max() for axis in xyz])


class TileFile:
    """Writes row groups of tiles in any order, then the index of them.

    Tiles are made to be read fast, which most steps do: in LZ4, with bytes of a kind together. It
    takes a fifth more room than zstd; dictionaries would take twice the time to write.

    Parameters
    ----------
    path : the Parquet file.
    types : NumPy type of each column.
    """

    def __init__(self, path: Path, types: Mapping[str, np.dtype]) -> None:
        self._schema = schema_of(types)
        self._tiles: dict[TileKey, _Written] = {}
        self._groups = 0
        self._classes: Counter[int] = Counter()
        self._stream = pa.output_stream(path, compression=None, buffer_size=_WRITTEN_BYTES)
        self._writer = pq.ParquetWriter(
            self._stream,
            self._schema,
            compression="lz4",
            use_dictionary=False,
            column_encoding=dict.fromkeys(self._schema.names, "BYTE_STREAM_SPLIT"),
            write_statistics=list(POSITION),
            write_page_checksum=True,
        )

    def write(self, tile: TileKey, points: Mapping[str, NDArray]) -> None:
        """Add points of a tile, every column of shape (n,), n at least 1, after those before."""
        rows = len(points["x"])
        self._writer.write_table(as_table(points, self._schema), row_group_size=rows)
        self._tiles.setdefault(tile, _Written()).add(self._groups, points)
        self._groups += 1
        self._classes.update(dict(enumerate(np.bincount(points["classification"]).tolist())))

    def finish(self, tile_size_m: float) -> list[Tile]:
        """Add the index, which is written when the file is closed, and return its tiles."""
        written = sorted(self._tiles.items())
        tiles = [
            Tile(ix, iy, tile.rows, (*tile.lower.tolist(), *tile.upper.tolist()))
            for (iy, ix), tile in written
        ]
        index = {
            "tile_size_m": tile_size_m,
            "tiles": [asdict(tile) for tile in tiles],
            "groups": [tile.groups for _, tile in written],
            "classes": {cls: count for cls, count in sorted(self._classes.items()) if count},
        }
        self._writer.add_key_value_metadata({METADATA_KEY: json.dumps(index).encode()})
        return tiles

    def close(self) -> None:
        """Write the end of the file."""
        try:
            self._writer.close()
        finally:
            self._stream.close()


# Points packed at once, few enough that their records stay in the processor's cache.
_WRITTEN_POINTS = 1 << 15


class TileSpill:
    """Points of tiles that wait because they are too few, in an anonymous file.

    A tile's places in the file are packed, because points in random order leave millions of them.

    Parameters
    ----------
    target : file that the points are meant for; the anonymous one lies beside it.
    types : NumPy type of each column.
    """

    def __init__(self, target: Path, types: Mapping[str, np.dtype]) -> None:
        self._target = target
        self._record = np.dtype(list(types.items()))
        self._places: dict[TileKey, array[int]] = {}
        self._rows: dict[TileKey, int] = {}
        target.parent.mkdir(parents=True, exist_ok=True)
        self._file = tempfile.TemporaryFile(dir=target.parent)  # noqa: SIM115  # see close

    def close(self) -> None:
        """Drop what waits."""
        with suppress(OSError):  # it cannot write out what a full disk did not take
            self._file.close()

    @property
    def tiles(self) -> Iterable[TileKey]:
        """Tiles of which points wait."""
        return self._rows.keys()

    def rows(self, tile: TileKey) -> int:
        """Number of points of a tile that wait."""
        return self._rows.get(tile, 0)

    def add(self, rows: Mapping[TileKey, int], points: Mapping[str, NDArray]) -> None:
        """Let points wait.

        Parameters
        ----------
        rows : number of points of each tile, in the order of the points.
        points : every column, each of shape (n,).

        Raises
        ------
        InputError : the disk is full.
        """
        place = self._file.seek(0, os.SEEK_END)
        try:
            for start in range(0, sum(rows.values()), _WRITTEN_POINTS):
                columns = {name: points[name][start : start + _WRITTEN_POINTS] for name in points}
                records = np.empty(len(columns["x"]), self._record)
                for name, values in columns.items():
                    records[name] = values
                self._file.write(records.data)
            self._file.flush()
        except OSError as error:
            raise no_room(self._target) from error
        for tile, count in rows.items():
            self._places.setdefault(tile, array("q")).extend((place, count))
            self._rows[tile] = self.rows(tile) + count
            place += count * self._record.itemsize

    def take(self, tile: TileKey) -> NDArray[np.void]:
        """Points of a tile (n,) as records, in the order in which they came; they wait no more."""
        places = self._places.pop(tile, array("q"))
        records = np.empty(self._rows.pop(tile, 0), self._record)
        done = 0
        for place, count in zip(places[::2], places[1::2], strict=True):
            self._file.seek(place)
            self._file.readinto(records[done : done + count].data)
            done += count
        return records
