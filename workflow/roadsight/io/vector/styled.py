"""GeoPackages for other people: layers with descriptions, styles, and the vertical CRS."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import pyogrio
from pyproj import CRS

from roadsight.geometry.crs import with_heights
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import atomic_path
from roadsight.io.records.whole import check_geopackage
from roadsight.io.vector.vectors import FIXED_DATE, fixed_date, native_features

_TABLE = """
CREATE TABLE layer_styles (
    id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    f_table_catalog TEXT(256), f_table_schema TEXT(256), f_table_name TEXT(256),
    f_geometry_column TEXT(256), styleName TEXT(30), styleQML TEXT, styleSLD TEXT,
    useAsDefault BOOLEAN, description TEXT, owner TEXT(30), ui TEXT(30),
    update_time DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))
)
"""
"""Where QGIS looks for the styles of a GeoPackage's layers."""


@dataclass(frozen=True)
class StyledLayer:
    """A layer as it is written.

    Parameters
    ----------
    name, about : its name, and one sentence. features : local metres. geometry : their type.
    qml : style in the language of QGIS.
    """

    name: str
    about: str
    features: gpd.GeoDataFrame
    geometry: str
    qml: str


def write_styled(path: str | os.PathLike[str], layers: Sequence[StyledLayer], frame: Frame) -> None:
    """Write a GeoPackage in native coordinates; the same layers give the same bytes.

    Layers with heights carry the compound CRS where the cloud has one, all others its horizontal
    part.

    Parameters
    ----------
    layers : at least one, the topmost first.
    """
    if not layers:
        raise ValueError("a GeoPackage needs a layer")
    whole = None
    if frame.crs_wkt is not None:
        whole = with_heights(CRS.from_wkt(frame.crs_wkt), frame.vertical_unit_m)
    with atomic_path(path) as temporary, fixed_date():
        for layer in layers:
            native = native_features(layer.features, frame)
            if whole is not None and layer.geometry.endswith("Z"):
                native = native.set_crs(whole, allow_override=True)
            pyogrio.write_dataframe(
                native,
                temporary,
                layer=layer.name,
                driver="GPKG",
                geometry_type=layer.geometry,
                promote_to_multi=False,
                DESCRIPTION=layer.about,
            )
        _add_styles(temporary, layers)
        check_geopackage(temporary, {layer.name: len(layer.features) for layer in layers})


def _add_styles(path: Path, layers: Sequence[StyledLayer]) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(_TABLE)
        database.execute(
            "INSERT INTO gpkg_contents (table_name, data_type, identifier, last_change)"
            " VALUES ('layer_styles', 'attributes', 'layer_styles', ?)",
            (FIXED_DATE,),
        )
        columns = dict(
            database.execute("SELECT table_name, column_name FROM gpkg_geometry_columns")
        )
        database.executemany(
            "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name,"
            " f_geometry_column, styleName, styleQML, styleSLD, useAsDefault, description, owner,"
            " ui, update_time) VALUES ('', '', ?, ?, 'roadsight', ?, '', 1, ?, '', NULL, ?)",
            [
                (layer.name, columns[layer.name], layer.qml, layer.about, FIXED_DATE)
                for layer in layers
            ],
        )
