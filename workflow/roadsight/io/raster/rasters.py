"""GeoTIFF rasters: written in the site's CRS and units, read back into the local frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rasterio
from numpy.typing import ArrayLike
from pyproj import CRS
from rasterio.errors import RasterioError

from roadsight.base.arrays import AnyPath, Bools, Floats, Floats32
from roadsight.base.errors import InputError
from roadsight.geometry.crs import with_heights
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import atomic_path, check_raster

_CONTENT, _HEIGHT = "CONTENT", "height"  # tag of rasters that this workflow wrote, and its value
_NODATA = -9999.0
_MEASURED = "measured"  # description of the second band, where there is one


@dataclass(frozen=True)
class Raster:
    """Raster in the local frame.

    Parameters
    ----------
    values : float32, shape (rows, columns), rows from north to south; NaN where nothing is known.
    west_m, north_m : outer corner of cell (0, 0).
    cell_size_m : edge of a cell.
    measured : shape (rows, columns), False where a value was filled from around; None where the
        raster does not tell.
    """

    values: Floats32
    west_m: float
    north_m: float
    cell_size_m: float
    measured: Bools | None = None

    def sample(self, x_m: ArrayLike, y_m: ArrayLike) -> Floats:
        """Values at places, bilinear between cell centres.

        Unknown cells are left out of the mean. A place within the raster whose four cells are all
        unknown, and any place outside, gives NaN.

        Parameters
        ----------
        x_m, y_m : shape (n,).
        """
        column = (np.asarray(x_m, np.float64) - self.west_m) / self.cell_size_m - 0.5
        row = (self.north_m - np.asarray(y_m, np.float64)) / self.cell_size_m - 0.5
        rows, columns = self.values.shape
        inside = (np.abs(column + 0.5 - columns / 2) <= columns / 2) & (
            np.abs(row + 0.5 - rows / 2) <= rows / 2
        )
        column, row = np.where(inside, column, 0.0), np.where(inside, row, 0.0)
        total, weight = np.zeros(column.shape), np.zeros(column.shape)
        for i in (0, 1):
            for j in (0, 1):
                at_row, at_column = np.floor(row) + i, np.floor(column) + j
                share = (1 - np.abs(row - at_row)) * (1 - np.abs(column - at_column))
                cell = self.values[
                    np.clip(at_row, 0, rows - 1).astype(int),
                    np.clip(at_column, 0, columns - 1).astype(int),
                ]
                known = np.isfinite(cell)
                total += np.where(known, share * cell, 0.0)
                weight += np.where(known, share, 0.0)
        return np.divide(
            total, weight, out=np.full(column.shape, np.nan), where=inside & (weight > 0)
        )


def write_raster(
    path: AnyPath,
    values: ArrayLike,
    frame: Frame,
    west_m: float,
    north_m: float,
    cell_size_m: float,
    measured: ArrayLike | None = None,
) -> None:
    """Write heights as a cloud-optimised GeoTIFF, with overviews, in the native CRS and units.

    The same values give the same bytes. Heights become native ones in the native vertical unit, so
    that they agree with the cloud in any GIS.

    Parameters
    ----------
    values : shape (rows, columns), rows from north to south, local metres; cells that are not
        finite become -9999.
    west_m, north_m : outer corner of cell (0, 0), local metres.
    measured : shape (rows, columns), a second band with 1 for measured cells and 0 for filled ones.
    """
    known = np.isfinite(values)
    native = np.asarray(values, np.float64) / frame.vertical_unit_m + frame.origin[2]
    pixels = np.where(known, native, _NODATA).astype(np.float32)
    west, north = frame.to_native([west_m, north_m])
    cell_size = cell_size_m / frame.unit_m
    with atomic_path(path) as temporary:
        with rasterio.open(
            temporary,
            "w",
            driver="COG",
            height=pixels.shape[0],
            width=pixels.shape[1],
            count=1 if measured is None else 2,
            dtype="float32",
            crs=crs_wkt(frame),
            transform=rasterio.Affine(cell_size, 0.0, west, 0.0, -cell_size, north),
            nodata=_NODATA,
            compress="deflate",
            predictor="floating_point",
            overview_resampling="average",
        ) as raster:
            raster.write(pixels, 1)
            raster.set_band_unit(1, unit_text(frame.vertical_unit_m))
            if measured is not None:
                raster.write(np.asarray(measured, np.float32), 2)
                raster.set_band_description(2, _MEASURED)
            raster.update_tags(**{_CONTENT: _HEIGHT})
        check_raster(temporary)


def read_raster(path: AnyPath, frame: Frame) -> Raster:
    """Read what `write_raster` wrote, heights in local metres.

    Raises
    ------
    InputError : the file is missing, damaged, or no raster of this kind.
    """
    try:
        with rasterio.open(path) as raster:
            pixels = raster.read(1).astype(np.float64)
            transform, nodata = raster.transform, raster.nodata
            content = raster.tags().get(_CONTENT)
            bands = raster.descriptions
            measured = raster.read(2) == 1 if _MEASURED in bands[1:2] else None
    except (RasterioError, OSError, ValueError) as error:
        raise InputError(f"cannot be read as a raster ({error})", where=str(path)) from error
    if content != _HEIGHT:
        raise InputError(
            "is no raster that this workflow wrote", where=str(path), hint="delete it and run again"
        )
    values = np.where(pixels == nodata, np.nan, pixels)
    values = (values - frame.origin[2]) * frame.vertical_unit_m
    # Corners and cells come back to the digit, so that grids of one site still coincide.
    west_m, north_m = (round(float(m), 6) for m in frame.to_local([transform.c, transform.f]))
    cell_size_m = round(transform.a * frame.unit_m, 9)
    return Raster(values.astype(np.float32), west_m, north_m, cell_size_m, measured)


def crs_wkt(frame: Frame) -> str | None:
    """CRS of a raster of heights, with the vertical one where the site has one."""
    if frame.crs_wkt is None:
        return None
    return with_heights(CRS.from_wkt(frame.crs_wkt), frame.vertical_unit_m).to_wkt()


def unit_text(unit_m: float) -> str:
    """Name of a unit of so many metres, as GDAL writes it."""
    known = {"metre": 1.0, "foot": 0.3048, "US survey foot": 1200 / 3937}
    return min(known, key=lambda name: abs(known[name] - unit_m))
