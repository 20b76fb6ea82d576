"""Writes a site's cloud as one Parquet file of tiles, see `roadsight.io.tiles`."""

from __future__ import annotations

import json
import os
import tempfile
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from roadsight.errors import InputError
from roadsight.io.atomic import atomic_path, no_room
from roadsight.io.tiles import COLOUR, COLUMN_TYPES, METADATA_KEY, POSITION, Tile

_MAX_TILES = 40_000


class TileWriter:
    """Sorts a stream of points into tiles with bounded memory.

    Points go to an anonymous file beside the output as they come, each batch sorted by tile;
    `finish` then gathers one tile after the other. The result does not depend on the batches.

    Parameters
    ----------
    path : Parquet file to write.
    tile_size_m : edge of a tile.
    coloured : whether points have red, green and blue.
    """

    def __init__(self, path: str | os.PathLike[str], tile_size_m: float, coloured: bool) -> None:
        self._path = Path(path)
        self._tile_size_m = tile_size_m
        self._names = [name for name in COLUMN_TYPES if coloured or name not in COLOUR]
        self._record = np.dtype([(name, COLUMN_TYPES[name]) for name in self._names])
        self._pieces: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
        self._rows = 0
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
        columns = {name: np.asarray(points[name], self._record[name]) for name in self._names}
        ix, iy = ((columns[axis] / np.float64(self._tile_size_m)).astype(np.int64) for axis in "xy")
        tile = iy << 32 | ix
        order = _stable_order(ix, iy)
        tile = tile[order]
        records = np.empty(len(tile), self._record)
        for name, values in columns.items():
            records[name] = values[order]
        starts = np.flatnonzero(np.diff(tile, prepend=-1))
        ends = np.append(starts[1:], len(tile))
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
            key = int(tile[start])
            self._pieces[key >> 32, key & 0xFFFFFFFF].append((self._rows + start, end - start))
        self._spill_out(records.data)
        self._rows += len(records)
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
        names = self._names
        schema = pa.schema([(name, pa.from_numpy_dtype(self._record[name])) for name in names])
        tiles = []
        with (
            atomic_path(self._path) as temporary,
            pq.ParquetWriter(
                temporary,
                schema,
                write_page_checksum=True,
                **_storage(names),
            ) as writer,
        ):
            for iy, ix in sorted(self._pieces):
                records = self._gather(self._pieces[iy, ix])
                columns = {name: np.ascontiguousarray(records[name]) for name in names}
                writer.write_table(pa.table(columns, schema=schema), row_group_size=len(records))
                tiles.append(Tile(ix, iy, len(records), _bounds(columns)))
            index = {
                "tile_size_m": self._tile_size_m,
                "tiles": [asdict(tile) for tile in tiles],
            }
            writer.add_key_value_metadata(
                {METADATA_KEY: json.dumps(index, sort_keys=True).encode()}
            )
        return tiles

    def _gather(self, pieces: Sequence[tuple[int, int]]) -> NDArray:
        """Points of one tile from their places in the spill file."""
        records = np.empty(sum(count for _, count in pieces), self._record)
        done = 0
        for start, count in pieces:
            self._spill.seek(start * self._record.itemsize)
            self._spill.readinto(records[done : done + count].view(np.uint8).data)
            done += count
        return records


def _stable_order(ix: NDArray[np.int64], iy: NDArray[np.int64]) -> NDArray[np.intp]:
    """Order (n,) of points by row and column of their tiles, equal ones as they came.

    Numbers of 16 bits are sorted by radix, in a quarter of the time; a batch rarely has more tiles.
    """
    if len(ix) == 0:
        return np.empty(0, np.intp)
    wide = int(ix.max() - ix.min()) + 1
    number = (iy - iy.min()) * wide + (ix - ix.min())
    if number.max() < 2**16:
        number = number.astype(np.uint16)
    return np.argsort(number, kind="stable")


def _storage(names: Sequence[str]) -> dict[str, Any]:
    """How columns are written: bytes of a kind together, positions to be read fast, all else small.

    LZ4 takes a tenth more room for positions than zstd and half the time to read, which every step
    does. Dictionaries would take twice the time to write.
    """
    return {
        "compression": {name: "lz4" if name in POSITION else "zstd" for name in names},
        "use_dictionary": False,
        "column_encoding": dict.fromkeys(names, "BYTE_STREAM_SPLIT"),
    }


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
