"""Writes a site's cloud as one Parquet file of tiles, see `roadsight.io.cloud.tiles`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats32
from roadsight.base.errors import InputError
from roadsight.io.cloud.tile_file import TileFile
from roadsight.io.cloud.tile_spill import TileKey, TileSpill
from roadsight.io.cloud.tiles import COLOUR, COLUMN_TYPES, Tile
from roadsight.io.records.atomic import Incomplete, WholeFile

_MAX_TILES = 40_000
"""More tiles than this come of stray points or of a wrong unit; each costs memory and an entry of
the index."""
_HELD_POINTS = 1_000_000
"""Points held in memory. Fewer would send more of them through the file where points wait."""
_LEAST_POINTS = 1 << 15
"""Points of a tile that are worth a row group of their own, before the last."""


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

    def __init__(self, path: str | os.PathLike[str], tile_size_m: float, coloured: bool) -> None:
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
        ix, iy = (_numbers(self._held[axis][: self._count], self._tile_size_m) for axis in "xy")
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


def _numbers(at_m: Floats32, tile_size_m: float) -> NDArray[np.signedinteger]:
    """Number (n,) of the tile's column or row; 32 bits take a quarter of the time of 64."""
    size_m = np.float64(tile_size_m)
    kind = np.int32 if at_m.max() / size_m < 2**31 else np.int64
    return np.divide(at_m, size_m, out=np.empty(len(at_m), kind), casting="unsafe")


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
