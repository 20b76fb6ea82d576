"""Orthophotos of users: any raster that GDAL reads, warped into the site's local frame."""

from __future__ import annotations

import numpy as np
import rasterio
from pyproj import CRS
from rasterio.enums import Resampling
from rasterio.errors import RasterioError
from rasterio.vrt import WarpedVRT

from roadsight.base.arrays import AnyPath, Bytes
from roadsight.base.errors import InputError
from roadsight.geometry.crs import horizontal
from roadsight.geometry.frames import Frame

_BYTE = 255


def read_orthophoto(
    path: AnyPath,
    frame: Frame,
    west_m: float,
    north_m: float,
    rows: int,
    columns: int,
    cell_size_m: float,
) -> Bytes:
    """Part of an orthophoto as a picture in the local frame.

    Parameters
    ----------
    west_m, north_m : outer corner of the first pixel wanted, local metres.
    cell_size_m : edge of a pixel.

    Returns
    -------
    (rows, columns, 4) uint8: red, green, blue and opacity

    Raises
    ------
    InputError : no raster, without CRS, of other than 8 bits, or it covers nothing of the site.
    """
    where = f"site.orthophoto ({path})"
    if frame.crs_wkt is None:
        raise InputError(
            "an orthophoto needs a site with a CRS", where=where, hint="give the cloud's crs"
        )
    west, north = frame.to_native([west_m, north_m])
    cell = cell_size_m / frame.unit_m
    try:
        with rasterio.open(path) as source:
            _check(source, where)
            with WarpedVRT(
                source,
                crs=horizontal(CRS.from_wkt(frame.crs_wkt)).to_wkt(),
                transform=rasterio.Affine(cell, 0.0, west, 0.0, -cell, north),
                height=rows,
                width=columns,
                resampling=Resampling.average,
                add_alpha=source.count in (1, 3),
            ) as warped:
                bands = warped.read()
    except RasterioError as error:
        raise InputError("is no raster that can be read", where=where, found=error) from error
    grey = len(bands) < 3
    picture = np.dstack([bands[0] if grey else bands[i] for i in range(3)] + [bands[-1]])
    if not picture[..., 3].any():
        raise InputError(
            "covers nothing of the cloud",
            where=where,
            found=f"{source.crs}, {tuple(round(edge, 1) for edge in source.bounds)}",
            allowed="a raster of the same place",
        )
    picture[..., 3] = np.where(picture[..., 3] > _BYTE // 2, _BYTE, 0)
    return np.ascontiguousarray(picture)


def _check(source: rasterio.DatasetReader, where: str) -> None:
    if source.crs is None:
        raise InputError(
            "has no CRS",
            where=where,
            hint="write it into the file, e.g. gdal_translate -a_srs EPSG:25832",
        )
    if source.count > 4 or set(source.dtypes) != {"uint8"}:
        raise InputError(
            "is no picture of bytes",
            where=where,
            found=f"{source.count} bands of {', '.join(sorted(set(source.dtypes)))}",
            allowed="1 band (grey), 3 (colours) or 4 (colours and opacity) of uint8",
            hint="convert it, e.g. gdal_translate -ot Byte -scale -b 1 -b 2 -b 3",
        )
