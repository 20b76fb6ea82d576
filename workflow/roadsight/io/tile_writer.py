"""Writes a site's cloud as one Parquet file of tiles, see `roadsight.io.tiles`."""

from __future__ import annotations

import json
import os
import tempfile
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from roadsight.errors import InputError
from roadsight.io.arrow import as_table, schema_of
from roadsight.io.atomic import atomic_path, no_room
from roadsight.io.tiles import COLOUR, COLUMN_TYPES, METADATA_KEY, POSITION, Tile

_MAX_TILES = 40_000


class _Batch(NamedTuple):
    """Points that came together: where their first column lies in the spill file, and how many."""

    at: int
    rows: int


class _Piece(NamedTuple):
    """Points of a tile in a batch: ``rows`` of them from the ``start`` of each column."""

    batch: _Batch
    start: int
    rows: int


class TileWriter:
    """Sorts a stream of points into tiles with bounded memory.

    Tiles are made to be read fast, which most steps do: in LZ4, with bytes of a kind together. It
    takes a fifth more room than zstd; dictionaries would take twice the time to write.

    Points go to an anonymous file beside the output as they come, each batch sorted by tile and
    column after column; `finish` then gathers one tile after the other. The result does not depend
    on the batches.

    Parameters
    ----------
    path : Parquet file to write.
    tile_size_m : edge of a tile.
    coloured : whether points have red, green and blue.
    """

    def __init__(self, path: str | os.PathLike[str], tile_size_m: float, coloured: bool) -> None:
        self._path = Path(path)
        self._tile_size_m = tile_size_m
        names = [name for name in COLUMN_TYPES if coloured or name not in COLOUR]
        self._types = {name: np.dtype(COLUMN_TYPES[name]) for name in names}
        self._pieces: dict[tuple[int, int], list[_Piece]] = defaultdict(list)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._spill = tempfile.TemporaryFile(dir=self._path.parent)  # noqa: SIM115  # see close

    def __enter__(self) -> TileWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Drop what was not written by `finish`."""
        with suppress(OSError):  # it cannot write out what a full disk did not take
            self._spill.close()

    def append(self, points: Mapping[str, NDArray]) -> None:
        """Add points.

        Parameters
        ----------
        points : every column of the cloud, each of shape (n,); x and y at least 0.

        Raises
        ------
        InputError : the points fill too many tiles.
        """
        columns = {name: np.asarray(points[name], kind) for name, kind in self._types.items()}
        ix, iy = (_numbers(columns[axis], self._tile_size_m) for axis in "xy")
        order, starts = _by_tile(ix, iy)
        ends = [*starts[1:], len(order)]
        batch = _Batch(self._spill.tell(), len(order))
        for start, end in zip(starts, ends, strict=True):
            first = order[start]
            piece = _Piece(batch, start, end - start)
            self._pieces[int(iy[first]), int(ix[first])].append(piece)
        for values in columns.values():
            self._spill_out(values.take(order).data)
        if len(self._pieces) > _MAX_TILES:
            raise InputError(
                "the cloud fills too many tiles",
                where="tile_size_m",
                found=f"{self._tile_size_m:g} m",
                allowed=f"at most {_MAX_TILES} tiles",
                hint="choose larger tiles, or remove stray points",
            )

    def _spill_out(self, content: memoryview) -> None:
        try:
            self._spill.write(content)
            self._spill.flush()
        except OSError as error:
            raise no_room(self._path) from error

    def finish(self) -> list[Tile]:
        """Write the file and return its tiles."""
        schema = schema_of(self._types)
        tiles = []
        classes: Counter[int] = Counter()
        with (
            atomic_path(self._path) as temporary,
            pq.ParquetWriter(
                temporary,
                schema,
                compression="lz4",
                use_dictionary=False,
                column_encoding=dict.fromkeys(schema.names, "BYTE_STREAM_SPLIT"),
                write_statistics=list(POSITION),
                write_page_checksum=True,
            ) as writer,
        ):
            for iy, ix in sorted(self._pieces):
                columns = self._gather(self._pieces[iy, ix])
                rows = len(columns["x"])
                writer.write_table(as_table(columns, schema), row_group_size=rows)
                tiles.append(Tile(ix, iy, rows, _bounds(columns)))
                classes.update(dict(enumerate(np.bincount(columns["classification"]).tolist())))
            index = {
                "tile_size_m": self._tile_size_m,
                "tiles": [asdict(tile) for tile in tiles],
                "classes": {cls: count for cls, count in sorted(classes.items()) if count},
            }
            writer.add_key_value_metadata({METADATA_KEY: json.dumps(index).encode()})
        return tiles

    def _gather(self, pieces: Sequence[_Piece]) -> dict[str, NDArray]:
        """Points of one tile from their places in the spill file."""
        rows = sum(piece.rows for piece in pieces)
        columns = {name: np.empty(rows, kind) for name, kind in self._types.items()}
        done = 0
        for piece in pieces:
            column_at = piece.batch.at
            for values in columns.values():
                self._spill.seek(column_at + piece.start * values.itemsize)
                self._spill.readinto(values[done : done + piece.rows].data)
                column_at += piece.batch.rows * values.itemsize
            done += piece.rows
        return columns


def _numbers(at_m: NDArray[np.float32], tile_size_m: float) -> NDArray[np.signedinteger]:
    """Number (n,) of the tile's column or row; 32 bits take a quarter of the time of 64."""
    number = at_m / np.float64(tile_size_m)
    return number.astype(np.int32 if number.max(initial=0.0) < 2**31 else np.int64)


def _by_tile(
    ix: NDArray[np.signedinteger], iy: NDArray[np.signedinteger]
) -> tuple[NDArray[np.intp], list[int]]:
    """Order (n,) of points by row and column of their tiles, and where in it each tile starts.

    Points of a tile stay as they came. Numbers of 16 bits are sorted by radix, in a quarter of the
    time; a batch rarely has more tiles.
    """
    if len(ix) == 0:
        return np.empty(0, np.intp), []
    wide, high = (int(index.max() - index.min()) + 1 for index in (ix, iy))
    if wide * high <= 2**16:
        number = ((iy - iy.min()) * wide + (ix - ix.min())).astype(np.uint16)
    else:
        number = (iy - iy.min()).astype(np.int64) * wide + (ix - ix.min())
    order = np.argsort(number, kind="stable")
    number = number[order]
    return order, [0, *(np.flatnonzero(number[1:] != number[:-1]) + 1).tolist()]


def _bounds(columns: Mapping[str, NDArray]) -> tuple[float, float, float, float, float, float]:
    x, y, z = (columns[axis] for axis in POSITION)
    return (
        float(x.min()),
        float(y.min()),
        float(z.min()),
        float(x.max()),
        float(y.max()),
        float(z.max()),
    )
