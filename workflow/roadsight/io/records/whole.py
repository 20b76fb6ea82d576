"""Whether a file that GDAL wrote is whole: on a full disk it may close a cut-off one in silence."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rasterio.io import DatasetReader


def check_raster(path: Path, blocks: int | None = None) -> None:
    """Check that all blocks of a GeoTIFF lie inside the file.

    Parameters
    ----------
    blocks : how many were written over all bands; all of them if None.

    Raises
    ------
    OSError : it is cut off, or blocks are missing. RasterioError : it cannot be opened.
    """
    import rasterio  # noqa: PLC0415  # slow to load, and most files are none

    size = path.stat().st_size
    with rasterio.open(path) as raster:
        ends = _block_ends(raster)
        expected = blocks if blocks is not None else len(ends)
    if max(ends, default=0) > size or sum(end > 0 for end in ends) != expected:
        raise OSError(f"{path} is cut off")


def _block_ends(raster: DatasetReader) -> list[int]:
    """Where the bytes of each block end, 0 for a block that is not in the file."""
    places = [
        (f"{column}_{row}", band)
        for band, (height, width) in zip(raster.indexes, raster.block_shapes, strict=True)
        for row in range(-(-raster.height // height))
        for column in range(-(-raster.width // width))
    ]

    def number(name: str, place: str, band: int) -> int:
        return int(raster.get_tag_item(f"BLOCK_{name}_{place}", "TIFF", bidx=band) or 0)

    return [number("OFFSET", *place) + number("SIZE", *place) for place in places]


def check_geopackage(path: Path, layers: Mapping[str, int]) -> None:
    """Check the database's pages, and each layer's number of features, extent and spatial index.

    Raises
    ------
    OSError : something of it is missing. sqlite3.DatabaseError : it is no database.
    """
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
        if database.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
            raise OSError(f"{path} is damaged")
        for layer, features in layers.items():
            table = layer.replace('"', '""')
            column = _one(
                database,
                "SELECT column_name FROM gpkg_geometry_columns WHERE table_name = ?",
                layer,
            )
            indexed = f'SELECT count(*) FROM "rtree_{table}_{column}"'
            found = [_one(database, f'SELECT count(*) FROM "{table}"'), _one(database, indexed)]
            extent = _one(database, "SELECT min_x FROM gpkg_contents WHERE table_name = ?", layer)
            if found != [features, features] or (features and extent is None):
                raise OSError(f"{path} lacks a part of {layer}")


def _one(database: sqlite3.Connection, query: str, *values: str) -> object:
    """First value of a query's only row, None without one."""
    row = database.execute(query, values).fetchone()
    return row[0] if row else None


def check_geojson(path: Path, features: int) -> None:
    """Check the number of features.

    Raises
    ------
    OSError : some are missing. ValueError : it is no JSON.
    """
    if len(json.loads(path.read_text(encoding="utf-8"))["features"]) != features:
        raise OSError(f"{path} is cut off")
