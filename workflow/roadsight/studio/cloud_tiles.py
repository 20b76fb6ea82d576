"""A site's cloud as the browser asks for it: one tile at one level of detail at a time."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from roadsight.base.arrays import Bools, Bytes, Floats, Floats32
from roadsight.base.errors import InputError
from roadsight.geometry.crs import unit_name
from roadsight.io.cloud.tiles import CloudTiles, Points, stack_xyz
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.tables import read_table
from roadsight.studio.project import CLOUD, DEM, FRAME, GROUND, SiteFolder
from roadsight.studio.site_files import OutdatedError

# Percentile of intensity that is drawn white; a few points above it, such as those of signs, would
# leave the road dark
_BRIGHT_PERCENT = 98.0
_SAMPLED_TILES = 9  # Tiles, spread over the cloud, that this percentile is taken from
# Read tiles that are kept, so that finer levels of a tile need not read it again
_KEPT_BYTES = 256 << 20


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
        ground, dem = site.results / GROUND, site.results / DEM
        self._ground: Bools | None = None
        if ground.exists():
            labels = read_table(ground, ["ground"])["ground"].to_numpy(bool)
            self._ground = labels if len(labels) == self._tiles.points else None
        self._dem = read_raster(dem, frame) if dem.exists() else None
        # Intensity near the top of a few tiles spread over the cloud.
        count = len(self._tiles.tiles)
        chosen = np.unique(np.linspace(0, count - 1, min(_SAMPLED_TILES, count)).astype(int))
        found = self._tiles.read(["intensity"], chosen.tolist())["intensity"]
        self._bright = float(np.percentile(found, _BRIGHT_PERCENT)) if len(found) else 1.0
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
                # Tiles that were asked for longest ago go first.
                while (
                    len(self._kept) > 1
                    and sum(len(level) for levels in self._kept.values() for level in levels)
                    > _KEPT_BYTES
                ):
                    self._kept.popitem(last=False)
            self._kept.move_to_end(number)
            return self._kept[number][level]

    def around(self, x_m: float, y_m: float, reach_m: float) -> Points:
        """Points x, y, z, intensity of the square around a place."""
        bounds = (x_m - reach_m, y_m - reach_m, x_m + reach_m, y_m + reach_m)
        with self._lock:
            return self._tiles.read_within(bounds, ("x", "y", "z", "intensity"))

    def _levels(self, number: int) -> list[bytes]:
        points = self._tiles.read(None, [number])
        xyz = stack_xyz(points)
        box = np.array(self._tiles.tiles[number].bounds_m)
        if self._dem is None:  # above the tile's lowest point
            height_m = xyz[:, 2].astype(np.float64) - box[2]
        else:
            height_m = xyz[:, 2] - self._dem.sample(xyz[:, 0], xyz[:, 1])
        ground = np.zeros(len(xyz), bool)
        if self._ground is not None:
            ground = self._ground[self._starts[number] : self._starts[number + 1]]
        packed = pack_points(
            xyz,
            box[:3],
            box[3:],
            height_m,
            scaled_intensity(points["intensity"], self._bright),
            points["classification"],
            ground,
        )
        level = level_of_points(xyz)
        return [packed[level == wanted].tobytes() for wanted in range(LEVELS)]


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
        paths = [site.results / name for name in (FRAME, CLOUD, GROUND, DEM)]
        state = tuple(path.stat().st_mtime_ns if path.exists() else 0 for path in paths)
        with self._lock:
            known = self._known.get(site.stem)
            if known is None or known[0] != state:
                version = hashlib.sha256(repr(state).encode()).hexdigest()[:16]
                self._known = {site.stem: (state, SiteCloud(site, version))}
            return self._known[site.stem][1]


# Levels of detail of a cloud's tiles: each adds points between those of the coarser ones.

# Edges of the cells of each level; the last level has all other points
CELLS_M = (1.6, 0.8, 0.4, 0.2, 0.1)
LEVELS = len(CELLS_M) + 1

# A point as the browser gets it: position by its tile's box, height above ground
RECORD = np.dtype(
    [
        ("xyz", "<u2", 3),
        ("height_cm", "<i2"),
        ("intensity", "u1"),
        ("cls", "u1"),
        ("ground", "u1"),
        ("free", "u1"),
    ]
)

_STEPS = 65535  # Steps of a coordinate within a tile's box: what 16 bits hold
_HIGHEST_CM = 32767  # Heights above ground are centimetres in 16 bits with a sign


def level_of_points(xyz_m: Floats32) -> Bytes:
    """Level (n,) at which each point first appears.

    A level takes the first point, in the order given, of each cubic cell in which no coarser level
    has taken one for itself.

    Parameters
    ----------
    xyz_m : (n, 3), all coordinates within a few kilometres.
    """
    level = np.full(len(xyz_m), LEVELS - 1, np.uint8)
    rest = np.arange(len(xyz_m))
    for number, cell_m in enumerate(CELLS_M):
        if not len(rest):
            break
        cell = np.floor(xyz_m[rest] / cell_m).astype(np.int64)
        cell -= cell.min(axis=0)
        rows, columns, _ = (cell.max(axis=0) + 1).tolist()
        key = cell[:, 0] + rows * (cell[:, 1] + columns * cell[:, 2])
        first = np.unique(key, return_index=True)[1]
        level[rest[first]] = number
        rest = np.delete(rest, first)
    return level


def pack_points(
    xyz_m: Floats32,
    low_m: Floats,
    high_m: Floats,
    height_m: Floats,
    intensity: Bytes,
    classes: Bytes,
    ground: Bools,
) -> NDArray[np.void]:
    """Points (n,) of `RECORD`.

    Parameters
    ----------
    low_m, high_m : (3,) corners of the tile's box; positions are steps of 1/65535 of it.
    height_m : (n,) above ground; NaN counts as 0.
    """
    extent = np.maximum(high_m - low_m, 1e-6)
    packed = np.zeros(len(xyz_m), RECORD)
    share = np.clip((xyz_m.astype(np.float64) - low_m) / extent, 0.0, 1.0)
    packed["xyz"] = np.rint(share * _STEPS)
    highest_m = _HIGHEST_CM / 100.0
    height = np.clip(np.nan_to_num(height_m), -highest_m, highest_m)
    packed["height_cm"] = np.rint(100.0 * height)
    packed["intensity"], packed["cls"], packed["ground"] = intensity, classes, ground
    return packed


def scaled_intensity(intensity: NDArray[np.uint16], brightest: float) -> Bytes:
    """Intensity (n,) as bytes, so that a cloud's bright points are 255.

    Parameters
    ----------
    brightest : value that becomes 255; larger ones, too.
    """
    scaled = intensity.astype(np.float64) * (255.0 / max(brightest, 1.0))
    return np.rint(np.minimum(scaled, 255.0)).astype(np.uint8)


# Where the cloud shows an edge near a click: a step in height, or a change of brightness.

REACH_M = 1.0  # Edges further from the click are not looked for
# Points are taken from so far beyond the reach, so that slopes at its rim are right
_MARGIN_M = 0.6
_CELL_M = 0.1  # Cells that height and brightness are averaged over
_BLUR_CELLS = 1.0  # Standard deviation of the blur, which bridges cells without points
_STEP_M_PER_M = 0.12  # Steepness that counts as much as `_BRIGHT_PER_M`: 12 mm of height in a cell
# Change of brightness a metre, as a share of its spread: a sixth of it in a cell
_BRIGHT_PER_M = 1.6
_GROUND_M = 0.6  # Points higher above the lowest tenth are left out: cars, plants, poles
_FEWEST = 60  # With fewer points around the click there is no edge to tell
_LEAST_SCORE = 1.0  # Edges no steeper than the two steepnesses above do not stand out


def snap_to_cloud(
    xyz_m: Floats32, intensity: NDArray, xy_m: tuple[float, float]
) -> tuple[float, float] | None:
    """Place of the strongest edge within `REACH_M` of a click; None where nothing stands out.

    Height and brightness of the points near the ground are averaged over cells. An edge is where
    either changes fast; near ones win over equal ones further off.

    Parameters
    ----------
    xyz_m : (n, 3) points around the click, local metres. intensity : (n,) any unit.
    """
    half = REACH_M + _MARGIN_M
    offset = xyz_m[:, :2].astype(np.float64) - xy_m
    inside = (np.abs(offset) < half).all(axis=1)
    if inside.sum() < _FEWEST:
        return None
    z = xyz_m[inside, 2].astype(np.float64)
    low = z < np.percentile(z, 10) + _GROUND_M
    offset, z, light = offset[inside][low], z[low], intensity[inside][low].astype(np.float64)
    # Brightness by its spread between dark and bright; zero where it hardly differs.
    dark, bright = np.percentile(light, [5, 95])
    light = np.clip((light - dark) / max(bright - dark, 0.1 * abs(bright), 1e-9), 0.0, 1.0)
    score = np.hypot(
        _slope(offset, z - z.mean(), half) / _STEP_M_PER_M,
        _slope(offset, light, half) / _BRIGHT_PER_M,
    )
    middle = (np.arange(score.shape[0]) + 0.5) * _CELL_M - half
    x, y = np.meshgrid(middle, middle, indexing="ij")
    away = np.hypot(x, y)
    weighed = np.where(away <= REACH_M, score * np.exp(-((away / REACH_M) ** 2)), 0.0)
    best = np.unravel_index(np.argmax(weighed), weighed.shape)
    if not score[best] > _LEAST_SCORE or weighed[best] == 0.0:
        return None
    near = np.hypot(x - x[best], y - y[best]) < 2.5 * _CELL_M
    share = np.where(near, score**2, 0.0) / np.where(near, score**2, 0.0).sum()
    return float(xy_m[0] + (share * x).sum()), float(xy_m[1] + (share * y).sum())


def _slope(offset_m: Floats, values: Floats, half_m: float) -> Floats:
    """Steepness (cells, cells), per metre, of values blurred over cells; gaps are bridged."""
    cells = int(np.ceil(2 * half_m / _CELL_M))
    index = np.clip(((offset_m + half_m) / _CELL_M).astype(int), 0, cells - 1)
    flat = index[:, 0] * cells + index[:, 1]
    count = np.bincount(flat, minlength=cells**2).reshape(cells, cells).astype(np.float64)
    total = np.bincount(flat, values, cells**2).reshape(cells, cells)
    weight = gaussian_filter(count, _BLUR_CELLS)
    known = weight > 0.05
    mean = np.where(
        known, gaussian_filter(total, _BLUR_CELLS) / np.where(known, weight, 1.0), np.nan
    )
    along, across = np.gradient(mean, _CELL_M)
    return np.nan_to_num(np.hypot(along, across))
