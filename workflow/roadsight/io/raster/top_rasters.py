"""The overhead view of a voxelised cloud as a GeoTIFF in the site's CRS and units.

Bands: class, height (native units), share of road points. Rows come in from south to north and go
out in blocks, so that memory is bounded by one row of blocks.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rasterio
from numpy.typing import ArrayLike
from rasterio.errors import RasterioError
from rasterio.io import DatasetReader, DatasetWriter
from rasterio.windows import Window

from roadsight.base.arrays import AnyPath, Bytes, Floats, Floats32
from roadsight.base.errors import unreadable
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import crs_wkt, unit_text
from roadsight.io.records.atomic import WholeFile, check_raster

if TYPE_CHECKING:  # compiled loops that a reader does not need
    from roadsight.scene.voxel_classes import Columns, VoxelGrid

# Rows of a block; the writer holds one row of blocks, so that lower blocks take less memory.
_BLOCK_ROWS = 128
_BLOCK_COLUMNS = 256  # columns of a block
_NODATA = -9999.0  # where nothing was hit; no class, height or share can have this value
_CACHE_MIB = 16  # each block is read once
_BANDS = ("class", "height", "road share")


class TopRasterWriter(WholeFile):
    """Writes columns of voxels; blocks without any are left out of the file.

    Parameters
    ----------
    path : GeoTIFF to write. frame : of the site. grid : of the voxels.
    """

    def __init__(self, path: AnyPath, frame: Frame, grid: VoxelGrid) -> None:
        super().__init__(path)
        self._frame, self._grid = frame, grid
        self._block, self._written = -1, 0
        self._pixels = np.full((len(_BANDS), _BLOCK_ROWS, grid.shape[0]), _NODATA, np.float32)

    def _open(self, temporary: Path) -> None:
        self._file = self._create(temporary)

    def _complete(self) -> None:
        self._flush()

    def _close(self) -> None:
        self._file.close()

    def _check(self) -> None:
        check_raster(Path(self._file.name), len(_BANDS) * self._written)

    def _create(self, path: Path) -> DatasetWriter:
        columns, rows, _ = self._grid.shape
        cell = self._grid.cell_size_m / self._frame.unit_m
        west_m, south_m = self._grid.corner_m[:2]
        west, north = self._frame.to_native([west_m, south_m + rows * self._grid.cell_size_m])
        raster = rasterio.open(
            path,
            "w",
            driver="GTiff",
            width=columns,
            height=rows,
            count=3,
            dtype="float32",
            crs=crs_wkt(self._frame),
            nodata=_NODATA,
            compress="deflate",
            zlevel=1,
            tiled=True,
            blockxsize=_BLOCK_COLUMNS,
            blockysize=_BLOCK_ROWS,
            interleave="band",
            sparse_ok=True,
            bigtiff="if_safer",
            transform=rasterio.Affine(cell, 0.0, west, 0.0, -cell, north),
        )
        for number, name in enumerate(_BANDS, start=1):
            raster.set_band_description(number, name)
        raster.set_band_unit(_BANDS.index("height") + 1, unit_text(self._frame.vertical_unit_m))
        return raster

    def add(self, columns: Columns) -> None:
        """Add columns that lie north of, or beside, all that came before."""
        if not len(columns.row):
            return
        row = self._grid.shape[1] - 1 - columns.row
        block = row // _BLOCK_ROWS
        place = (row % _BLOCK_ROWS).astype(np.intp) * self._grid.shape[0] + columns.column
        height = columns.height_m / self._frame.vertical_unit_m + self._frame.origin[2]
        bands = [band.astype(np.float32) for band in (columns.cls, height, columns.road_share)]
        for number in range(block.max(), block.min() - 1, -1):
            own = np.flatnonzero(block == number)
            if len(own) and number != self._block:
                self._flush()
                self._block = number
            for pixels, band in zip(self._pixels, bands, strict=True):
                pixels.reshape(-1)[place[own]] = band[own]

    def _flush(self) -> None:
        if self._block < 0:
            return
        first = self._block * _BLOCK_ROWS
        rows = min(_BLOCK_ROWS, self._grid.shape[1] - first)
        for west in range(0, self._grid.shape[0], _BLOCK_COLUMNS):
            part = self._pixels[:, :rows, west : west + _BLOCK_COLUMNS]
            if (part[0] != _NODATA).any():
                self._file.write(part, window=Window(west, first, part.shape[2], rows))
                self._written += 1
        self._pixels.fill(_NODATA)


@dataclass(frozen=True)
class TopRaster:
    """Overhead view in the local frame, rows from north to south.

    Parameters
    ----------
    cls : (rows, columns) class, 0 where nothing was hit.
    height_m : (rows, columns) float32, NaN where nothing was hit; (0, 0) if it was not read.
    road_share : (rows, columns) float32, 0 where there is no road; (0, 0) if it was not read.
    west_m, north_m : outer corner of cell (0, 0). cell_size_m : edge of a cell.
    """

    cls: Bytes
    height_m: Floats32
    road_share: Floats32
    west_m: float
    north_m: float
    cell_size_m: float

    def xy_m(self, row: ArrayLike, column: ArrayLike) -> Floats:
        """Places (n, 2) of fractional pixel positions (n,), whole at pixel centres."""
        x = self.west_m + (np.asarray(column, np.float64) + 0.5) * self.cell_size_m
        y = self.north_m - (np.asarray(row, np.float64) + 0.5) * self.cell_size_m
        return np.stack([x, y], axis=-1)

    def pixels(self, xy_m: ArrayLike) -> tuple[Floats, Floats]:
        """Fractional rows and columns (n,) of places (n, 2); inverse of `xy_m`."""
        x, y = np.asarray(xy_m, np.float64)[..., :2].T
        column = (x - self.west_m) / self.cell_size_m - 0.5
        return (self.north_m - y) / self.cell_size_m - 0.5, column


def read_top(
    path: AnyPath, frame: Frame, layers: Collection[str] = ("height_m", "road_share")
) -> TopRaster:
    """Read what `TopRasterWriter` wrote, heights in local metres.

    Parameters
    ----------
    layers : which to read beside the class.

    Raises
    ------
    InputError : the file is missing, damaged, or no raster of this kind.
    """
    try:
        with rasterio.Env(GDAL_CACHEMAX=_CACHE_MIB), rasterio.open(path) as raster:
            if raster.descriptions != _BANDS:
                raise ValueError("its bands are others")
            cls, height, share = _layers(raster, frame, layers)
            transform = raster.transform
    except (RasterioError, OSError, ValueError) as error:
        raise unreadable("an overhead view of the cloud", path, error) from error
    west_m, north_m = (round(float(m), 6) for m in frame.to_local([transform.c, transform.f]))
    cell_size_m = round(transform.a * frame.unit_m, 9)
    return TopRaster(cls, height, share, west_m, north_m, cell_size_m)


def _layers(
    raster: DatasetReader, frame: Frame, layers: Collection[str]
) -> tuple[Bytes, Floats32, Floats32]:
    """Class, height in local metres and road share, block by block: most are often empty."""
    heights, shares = "height_m" in layers, "road_share" in layers
    cls = np.zeros(raster.shape, np.uint8)
    height = np.full(raster.shape if heights else (0, 0), np.nan, np.float32)
    share = np.zeros(raster.shape if shares else (0, 0), np.float32)
    lowest, unit_m = np.float32(frame.origin[2]), np.float32(frame.vertical_unit_m)
    for _, window in raster.block_windows(1):
        kind = raster.read(1, window=window)
        empty, place = kind == _NODATA, window.toslices()
        if empty.all():
            continue
        cls[place] = np.maximum(kind, 0)
        if shares:
            share[place] = np.maximum(raster.read(3, window=window), 0)
        if heights:
            level = (raster.read(2, window=window) - lowest) * unit_m
            level[empty] = np.nan
            height[place] = level
    return cls, height, share
