"""Where points of a tile wait that are too few to be written.

See `roadsight.io.cloud.tile_writer`.
"""

from __future__ import annotations

import os
import tempfile
from array import array
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from roadsight.io.records.atomic import no_room

_WRITTEN_POINTS = 1 << 15
"""Points packed at once, few enough that their records stay in the processor's cache."""

TileKey = tuple[int, int]
"""Row and column of a tile."""


class TileSpill:
    """Points by tile in an anonymous file, record after record.

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
                self._file.write(self._packed(points, start).data)
            self._file.flush()
        except OSError as error:
            raise no_room(self._target) from error
        for tile, count in rows.items():
            self._places.setdefault(tile, array("q")).extend((place, count))
            self._rows[tile] = self.rows(tile) + count
            place += count * self._record.itemsize

    def _packed(self, points: Mapping[str, NDArray], start: int) -> NDArray[np.void]:
        """Records of some points, few enough to stay in the processor's cache."""
        columns = {name: points[name][start : start + _WRITTEN_POINTS] for name in points}
        records = np.empty(len(columns["x"]), self._record)
        for name, values in columns.items():
            records[name] = values
        return records

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
