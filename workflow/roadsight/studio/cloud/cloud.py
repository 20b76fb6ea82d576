"""A site's cloud as the browser asks for it: one tile at one level of detail at a time."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np

from roadsight.base.arrays import Bools, Floats, Floats32
from roadsight.base.errors import InputError
from roadsight.geometry.crs import unit_name
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, Points, Tile, stack_xyz
from roadsight.io.raster.rasters import Raster, read_raster
from roadsight.io.records.tables import read_table
from roadsight.studio.cloud.levels import (
    CELLS_M,
    LEVELS,
    RECORD,
    level_of_points,
    pack_points,
    scaled_intensity,
)
from roadsight.studio.project import CLOUD, DEM, FRAME, GROUND, SiteFolder
from roadsight.studio.site_files import OutdatedError

_BRIGHT_PERCENT = 98.0
"""Percentile of intensity that is drawn white; a few points above it, such as those of signs, would
leave the road dark."""
_SAMPLED_TILES = 9
"""Tiles, spread over the cloud, that this percentile is taken from."""
_KEPT_BYTES = 256 << 20
"""Read tiles that are kept, so that finer levels of a tile need not read it again."""


class SiteCloud:
    """The cloud of one site, read as it is now on disk.

    Parameters
    ----------
    site : where it lies. version : of the files that it is read from.

    Raises
    ------
    InputError : it is not there yet, or damaged.
    """

    def __init__(self, site: SiteFolder, version: str) -> None:
        self._version = version
        frame = site.frame()
        self._unit_m = frame.unit_m
        self._tiles = CloudTiles(site.file(CLOUD))
        self._starts = np.append(0, np.cumsum([tile.rows for tile in self._tiles.tiles]))
        self._ground = _ground_labels(site.results / GROUND, self._tiles.points)
        self._dem = _terrain(site.results / DEM, frame)
        self._bright = self._brightest()
        self._kept: OrderedDict[int, list[bytes]] = OrderedDict()
        self._lock = threading.Lock()

    def about(self) -> dict[str, Any]:
        """Tiles with boxes and numbers of points, the unit of x and y, which colours make sense."""
        return {
            "version": self._version,
            "points": self._tiles.points,
            "cells_m": [*CELLS_M, 0.0],
            "bytes_per_point": RECORD.itemsize,
            "unit": {"name": unit_name(self._unit_m), "metres": self._unit_m},
            "has_ground": self._ground is not None,
            "has_heights": self._dem is not None,
            "tiles": [
                {"points": tile.rows, "box": list(tile.bounds_m)} for tile in self._tiles.tiles
            ],
        }

    def chunk(self, number: int, level: int, version: str) -> bytes:
        """Points that a level adds to a tile, as `RECORD`.

        Parameters
        ----------
        version : as `about` told it with the boxes of the tiles.

        Raises
        ------
        OutdatedError : the cloud is another one by now. InputError : no such tile or level.
        """
        if version != self._version:
            raise OutdatedError(
                "the cloud has changed since the page was opened",
                where="studio",
                hint="reload the page",
            )
        if not (0 <= number < len(self._tiles.tiles) and 0 <= level < LEVELS):
            raise InputError("no such part of the cloud", where="studio", found=(number, level))
        with self._lock:
            if number not in self._kept:
                self._kept[number] = self._levels(number)
                self._forget()
            self._kept.move_to_end(number)
            return self._kept[number][level]

    def around(self, x_m: float, y_m: float, reach_m: float) -> Points:
        """Points x, y, z, intensity of the square around a place."""
        bounds = (x_m - reach_m, y_m - reach_m, x_m + reach_m, y_m + reach_m)
        with self._lock:
            return self._tiles.read_within(bounds, ("x", "y", "z", "intensity"))

    def _forget(self) -> None:
        """Drop the tiles that were asked for longest ago."""
        while len(self._kept) > 1 and sum(map(_bytes, self._kept.values())) > _KEPT_BYTES:
            self._kept.popitem(last=False)

    def _levels(self, number: int) -> list[bytes]:
        points = self._tiles.read(None, [number])
        xyz = stack_xyz(points)
        box = np.array(self._tiles.tiles[number].bounds_m)
        packed = pack_points(
            xyz,
            box[:3],
            box[3:],
            self._heights(xyz, self._tiles.tiles[number]),
            scaled_intensity(points["intensity"], self._bright),
            points["classification"],
            self._labels(number, len(xyz)),
        )
        level = level_of_points(xyz)
        return [packed[level == wanted].tobytes() for wanted in range(LEVELS)]

    def _heights(self, xyz_m: Floats32, tile: Tile) -> Floats:
        """Heights above the terrain, or above the tile's lowest point where there is none."""
        if self._dem is None:
            return xyz_m[:, 2].astype(np.float64) - tile.bounds_m[2]
        return xyz_m[:, 2] - self._dem.sample(xyz_m[:, 0], xyz_m[:, 1])

    def _labels(self, number: int, points: int) -> Bools:
        if self._ground is None:
            return np.zeros(points, bool)
        return self._ground[self._starts[number] : self._starts[number + 1]]

    def _brightest(self) -> float:
        """Intensity near the top of a few tiles spread over the cloud."""
        count = len(self._tiles.tiles)
        chosen = np.unique(np.linspace(0, count - 1, min(_SAMPLED_TILES, count)).astype(int))
        found = self._tiles.read(["intensity"], chosen.tolist())["intensity"]
        return float(np.percentile(found, _BRIGHT_PERCENT)) if len(found) else 1.0


def _ground_labels(path: Path, points: int) -> Bools | None:
    if not path.exists():
        return None
    labels = read_table(path, ["ground"])["ground"].to_numpy(bool)
    return labels if len(labels) == points else None


def _terrain(path: Path, frame: Frame) -> Raster | None:
    return read_raster(path, frame) if path.exists() else None


def _bytes(levels: list[bytes]) -> int:
    return sum(map(len, levels))


class Clouds:
    """Clouds by site, read again when their files change."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[tuple[int, ...], SiteCloud]] = {}
        self._lock = threading.Lock()

    def of(self, site: SiteFolder) -> SiteCloud:
        """Cloud of a site; only the one asked for last is kept in memory.

        Raises
        ------
        InputError : as `SiteCloud`.
        """
        state = tuple(_state(site.results / name) for name in (FRAME, CLOUD, GROUND, DEM))
        with self._lock:
            known = self._known.get(site.stem)
            if known is None or known[0] != state:
                version = hashlib.sha256(repr(state).encode()).hexdigest()[:16]
                self._known = {site.stem: (state, SiteCloud(site, version))}
            return self._known[site.stem][1]


def _state(path: Path) -> int:
    return path.stat().st_mtime_ns if path.exists() else 0
