"""A site's cloud as one Parquet file: row groups of occupied square tiles, and an index of them.

Tiles are squares of the local frame, half open (``ix * size <= x < (ix + 1) * size``), in row-major
order from the south-west; inside a tile the points keep the order in which they came. Row groups
lie in the file as they were written: a tile has one, or more where its points came far apart.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from roadsight.base.arrays import AnyPath, Bools, Floats32
from roadsight.base.errors import InputError, unreadable
from roadsight.io.records.tables import as_numpy, open_parquet, read_table

POSITION = ("x", "y", "z")
COLOUR = ("red", "green", "blue")
# NumPy types of the columns; the colours are absent from a cloud without them. ``scan`` is the
# file's ``point_source_id``: the number of a scan, a strip or a drive.
COLUMN_TYPES: dict[str, str] = {
    **dict.fromkeys(POSITION, "f4"),
    **dict.fromkeys(("intensity", "scan"), "u2"),
    **dict.fromkeys(("classification", "return_number", "number_of_returns", *COLOUR), "u1"),
}
METADATA_KEY = b"roadsight"
Points = dict[str, NDArray]
Bounds = tuple[float, float, float, float]


@dataclass(frozen=True)
class Tile:
    """One occupied tile.

    Parameters
    ----------
    ix, iy : column and row of the tile; its south-west corner is (ix, iy) times the tile size.
    rows : number of points.
    bounds_m : least x, y, z and greatest x, y, z of its points, local metres.
    """

    ix: int
    iy: int
    rows: int
    bounds_m: tuple[float, float, float, float, float, float]


class CloudTiles:
    """Reads a tiled cloud: all of it, some tiles, or what lies inside a box.

    Attributes
    ----------
    tiles : every tile, in the order in which all points are read.
    tile_size_m : edge of a tile.
    points : number of points.
    columns : names of the columns.
    classes : number of points by class.

    Raises
    ------
    InputError : the file is missing, damaged, or no tiled cloud.
    """

    def __init__(self, path: AnyPath) -> None:
        self._path = Path(path)
        with _readable(self._path):
            self._file = open_parquet(self._path)
            index = json.loads(self._file.metadata.metadata[METADATA_KEY])
            self.tile_size_m = float(index["tile_size_m"])
            self.classes = {int(cls): int(count) for cls, count in index["classes"].items()}
            self.tiles = [
                Tile(**tile | {"bounds_m": tuple(tile["bounds_m"])}) for tile in index["tiles"]
            ]
            self._groups: list[list[int]] = index["groups"]
            self.columns: list[str] = self._file.schema_arrow.names
            # Each row group belongs to one tile, and tiles have as many points as the index says.
            about = self._file.metadata
            rows = [about.row_group(group).num_rows for group in range(about.num_row_groups)]
            matched = sorted(chain.from_iterable(self._groups)) == list(range(len(rows))) and [
                sum(rows[group] for group in groups) for groups in self._groups
            ] == [tile.rows for tile in self.tiles]
            if not (matched and set(POSITION) <= set(self.columns)):
                raise ValueError("its tiles do not match its index")
        self.points = sum(tile.rows for tile in self.tiles)
        self._bounds_m = np.array([tile.bounds_m for tile in self.tiles]).reshape(-1, 6)

    def read(
        self, columns: Sequence[str] | None = None, tiles: Sequence[int] | None = None
    ) -> Points:
        """Columns of all points, or of those in some tiles.

        Parameters
        ----------
        columns : names; all if None.
        tiles : positions in `tiles`, each at most once; all if None.

        Returns
        -------
        arrays by column name, each of shape (n,), tile after tile in the order given

        Raises
        ------
        InputError : a column is not there, or the file is damaged.
        """
        names = self.columns if columns is None else list(columns)
        if missing := [name for name in names if name not in self.columns]:
            raise InputError(
                "lacks a column", where=str(self._path), found=missing, allowed=self.columns
            )
        numbers = range(len(self.tiles)) if tiles is None else tiles
        groups = [group for number in numbers for group in self._groups[number]]
        with _readable(self._path):
            table = self._file.read_row_groups(groups, columns=names, use_threads=False)
        return {name: as_numpy(table.column(name)) for name in names}

    def read_within(self, bounds_m: Bounds, columns: Sequence[str] | None = None) -> Points:
        """Columns of the points inside a box, half open (``west <= x < east``).

        Parameters
        ----------
        bounds_m : west, south, east, north, local metres.

        Raises
        ------
        InputError : as `read`.
        """
        return self._within(bounds_m, columns, lambda number, names: self.read(names, [number]))

    def iter_tiles(
        self, halo_m: float = 0.0, columns: Sequence[str] | None = None
    ) -> Iterator[tuple[Bounds, Points]]:
        """Tile after tile with the points around it.

        Parameters
        ----------
        halo_m : width of the margin around the tile whose points come along.

        Yields
        ------
        core bounds west, south, east, north in local metres, and the columns of the points inside
        the core and its margin, both half open

        Raises
        ------
        InputError : as `read`.
        """
        reach = int(np.ceil(halo_m / self.tile_size_m))
        cached = lru_cache((2 * reach + 1) ** 2)(lambda number, names: self.read(names, [number]))
        size = self.tile_size_m
        for tile in self.tiles:
            west, south = tile.ix * size, tile.iy * size
            core = (west, south, west + size, south + size)
            around = (west - halo_m, south - halo_m, core[2] + halo_m, core[3] + halo_m)
            yield core, self._within(around, columns, cached)

    def _within(
        self,
        bounds_m: Bounds,
        columns: Sequence[str] | None,
        read: Callable[[int, tuple[str, ...]], Points],
    ) -> Points:
        """Points inside a box, from tiles got by ``read``."""
        wanted = self.columns if columns is None else list(columns)
        names = tuple(dict.fromkeys([*wanted, "x", "y"]))
        parts = [self.read(names, [])]
        west, south, east, north = bounds_m
        least_x, least_y, _, greatest_x, greatest_y, _ = self._bounds_m.T
        touched = (
            (least_x < east) & (greatest_x >= west) & (least_y < north) & (greatest_y >= south)
        )
        for number in np.flatnonzero(touched).tolist():
            points = read(number, names)
            inside = in_bounds(points["x"], points["y"], bounds_m)
            parts.append({name: points[name][inside] for name in names})
        return {name: np.concatenate([part[name] for part in parts]) for name in wanted}


def stack_xyz(points: Mapping[str, NDArray]) -> Floats32:
    """Positions of points as one array of shape (n, 3), local metres."""
    return np.stack([points[axis] for axis in POSITION], axis=1)


def in_bounds(x: NDArray, y: NDArray, bounds_m: Bounds) -> Bools:
    """Whether places (n,) lie within west, south and before east, north."""
    west, south, east, north = bounds_m
    return (x >= west) & (x < east) & (y >= south) & (y < north)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turn whatever a damaged file raises into one message."""
    try:
        yield
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
        raise unreadable("a tiled cloud", path, error) from error


class StandingCloud:
    """Positions of the points that stand in the scene, tile by tile: none that only passed.

    Parameters
    ----------
    cloud : path of the tiled cloud.
    traffic : path of the traffic mask, or None where traffic was not cleared.
    without : classes whose points are left out, too.

    Raises
    ------
    InputError : a file is missing or damaged, the two do not belong together, or no point is of
        the classes that are to be left out.
    """

    def __init__(
        self, cloud: AnyPath, traffic: AnyPath | None, without: Sequence[int] = ()
    ) -> None:
        self._cloud = CloudTiles(cloud)
        rows = [tile.rows for tile in self._cloud.tiles]
        self._starts = np.cumsum([0, *rows])
        self._passed = (
            np.zeros(self._cloud.points, bool)
            if traffic is None
            else read_table(traffic)["traffic"].to_numpy()
        )
        if len(self._passed) != self._cloud.points:
            raise InputError(
                "is not the mask of this cloud",
                where=str(traffic),
                found=f"{len(self._passed)} points",
                allowed=f"{self._cloud.points} as in {cloud}",
                hint="delete it and run the workflow again",
            )
        if without:
            classes = self._cloud.read(["classification"])["classification"]
            left_out = np.isin(classes, without)
            if not left_out.any():
                raise InputError(
                    "no point of the cloud is of a class that is to be left out",
                    where=str(cloud),
                    allowed=f"classes {', '.join(map(str, without))}",
                    hint="classify the cloud, or let lidar.vegetation keep them",
                )
            self._passed = self._passed | left_out
        self.tiles = self._cloud.tiles
        self.points = int(self._cloud.points - self._passed.sum())

    def xyz(self, tile: int) -> Floats32:
        """Positions (n, 3) of a tile's standing points, local metres."""
        passed = self._passed[self._starts[tile] : self._starts[tile + 1]]
        return stack_xyz(self._cloud.read(POSITION, [tile]))[~passed]

    def around(self, tile: int, reach_m: float) -> Floats32:
        """Positions (n, 3) of other tiles' standing points within reach of a tile's box."""
        west, south, _, east, north, _ = self.tiles[tile].bounds_m
        box = (west - reach_m, south - reach_m, east + reach_m, north + reach_m)
        return self.xyz_within(box, without=tile)

    def xyz_within(self, bounds_m: Bounds, without: int = -1) -> Floats32:
        """Positions (n, 3) of the standing points in a box (west, south, east, north).

        Parameters
        ----------
        without : tile whose points are left out.
        """
        west, south, east, north = bounds_m
        parts: list[Floats32] = [np.empty((0, 3), np.float32)]
        for number, tile in enumerate(self.tiles):
            least_x, least_y, _, greatest_x, greatest_y, _ = tile.bounds_m
            touched = least_x < east and greatest_x >= west
            if touched and least_y < north and greatest_y >= south and number != without:
                xyz = self.xyz(number)
                parts.append(xyz[in_bounds(xyz[:, 0], xyz[:, 1], bounds_m)])
        return np.concatenate(parts)
