"""Vector layers: written in the site's CRS and units, read back into the local frame."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import shapely
from pyproj import CRS, Transformer

from roadsight.base.arrays import AnyPath, Floats
from roadsight.base.errors import InputError
from roadsight.geometry.crs import horizontal
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import atomic_path, check_geojson, check_geopackage
from roadsight.io.vector.vector_sources import load_local, map_coordinates, read_features

KINDS = ("edge", "median", "line")  # kinds of lines along which sensors may stand
LINES = ("LineString", "MultiLineString")
AREAS = ("Polygon", "MultiPolygon")  # types of geometry that are lines, and areas
# Columns that may hold a feature's name, the first that is there.
_NAME_COLUMNS = ("edge", "name", "id")
# Time of change in a GeoPackage, so that the same features give the same bytes.
FIXED_DATE = "2000-01-01T00:00:00.000Z"
_GEOJSON_DECIMALS = "9"  # of degrees: a tenth of a millimetre


def write_layers(
    path: AnyPath,
    layers: Mapping[str, gpd.GeoDataFrame],
    frame: Frame,
    empty: Mapping[str, str] | None = None,
) -> None:
    """Write a GeoPackage in native coordinates; the same layers give the same bytes.

    Parameters
    ----------
    layers : features in local metres (x, y, or x, y, z) by layer name, at least one.
    empty : geometry types, such as "Point Z", of layers that may hold nothing.
    """
    if not layers:
        raise ValueError("a GeoPackage needs a layer")
    with atomic_path(path) as temporary, fixed_date():
        for name, features in layers.items():
            native = native_features(features, frame)
            kind = None if len(native) else (empty or {}).get(name, "Unknown")
            pyogrio.write_dataframe(
                native, temporary, layer=name, driver="GPKG", geometry_type=kind
            )
        check_geopackage(temporary, {name: len(features) for name, features in layers.items()})


def write_geojson(path: AnyPath, features: gpd.GeoDataFrame, frame: Frame) -> None:
    """Write GeoJSON: WGS 84 degrees with z in metres, or native coordinates of a local site."""
    native = native_features(features, frame)
    options = {"COORDINATE_PRECISION": _GEOJSON_DECIMALS}
    if native.crs is not None:
        transformer = Transformer.from_crs(native.crs, "EPSG:4326", always_xy=True)

        def degrees(xyz: Floats) -> Floats:
            lon_lat = transformer.transform(xyz[:, 0], xyz[:, 1])
            return np.column_stack([*lon_lat, *(xyz[:, 2:].T * frame.vertical_unit_m)])

        geometries = map_coordinates(native.geometry.to_numpy(), degrees)
        native = native.set_geometry(gpd.GeoSeries(geometries, native.index, crs="EPSG:4326"))
        options["RFC7946"] = "YES"
    with atomic_path(path) as temporary, fixed_date():
        pyogrio.write_dataframe(
            native, temporary, layer=Path(path).stem, driver="GeoJSON", layer_options=options
        )
        check_geojson(temporary, len(native))


def points(table: pd.DataFrame) -> gpd.GeoDataFrame:
    """A table with x, y, z in local metres as points."""
    geometry = gpd.points_from_xy(table["x"], table["y"], table["z"])
    return gpd.GeoDataFrame(table.drop(columns=["x", "y", "z"]), geometry=geometry)


def read_layer(path: AnyPath, layer: str, frame: Frame) -> gpd.GeoDataFrame:
    """Features of a layer that `write_layers` wrote, in local metres.

    Raises
    ------
    InputError : the file or the layer is missing or unreadable.
    """
    features = read_features(Path(path), layer)
    local = map_coordinates(features.geometry.to_numpy(), frame.to_local)
    attributes = features.drop(columns=features.geometry.name)
    return gpd.GeoDataFrame(_moved(attributes, frame, -1), geometry=local)


def read_lines(path: AnyPath, frame: Frame, default_crs: str | None = None) -> gpd.GeoDataFrame:
    """Digitised lines of a user in local metres.

    Reads GeoJSON, GeoPackage, Shapefile and other GDAL vector files, and CSV tables with one vertex
    a row (see `roadsight.io.vector.vector_sources`), in any CRS. Repeated vertices are dropped;
    heights of 0 throughout, as stored, or of no data mean that none were digitised; parts
    that do not join become lines of their own, ``name.1`` and so on.

    Parameters
    ----------
    default_crs : CRS of a file that names none, see `load_local`.

    Returns
    -------
    LineStrings with columns edge (a name of its own) and kind (one of `KINDS`, edge if not stated)

    Raises
    ------
    InputError : as `load_local`, or a feature is no line, has fewer than two different vertices,
        crosses itself, shares its name with another, or is of an unknown kind.
    """
    features = load_local(Path(path), frame, default_crs)
    column = next((name for name in _NAME_COLUMNS if name in features), None)
    given = [None] * len(features) if column is None else features[column].tolist()
    kinds = features["kind"].tolist() if "kind" in features else ["edge"] * len(features)
    rows = []
    for number, geometry in enumerate(features.geometry, start=1):
        named, stated = given[number - 1], kinds[number - 1]
        name = f"e{number}" if pd.isna(named) or named == "" else str(named)
        where = f"{path}, {name}"
        kind = "edge" if pd.isna(stated) or stated == "" else stated
        for part_name, part in _parts(name, geometry, where):
            if kind not in KINDS:
                raise InputError("unknown kind", where=where, found=kind, allowed=", ".join(KINDS))
            rows.append((part_name, str(kind), part))
    lines = gpd.GeoDataFrame(rows, columns=["edge", "kind", "geometry"], geometry="geometry")
    repeated = lines["edge"][lines["edge"].duplicated()]
    if len(repeated):
        raise InputError("two lines share a name", where=str(path), found=repeated.iloc[0])
    return lines


def read_polygons(path: AnyPath, frame: Frame, default_crs: str | None = None) -> gpd.GeoDataFrame:
    """Polygons of a user in local metres, without z, one row for each part, attributes kept.

    Parameters
    ----------
    default_crs : CRS of a file that names none, see `load_local`.

    Raises
    ------
    InputError : as `load_local`, or a feature is no polygon or crosses itself.
    """
    features = load_local(Path(path), frame, default_crs)
    features = features.set_geometry(shapely.force_2d(features.geometry.to_numpy()))
    for number, geometry in enumerate(features.geometry, start=1):
        check_shape(geometry, AREAS, f"{path}, feature {number}")
    return features.explode(ignore_index=True)


def native_features(features: gpd.GeoDataFrame, frame: Frame) -> gpd.GeoDataFrame:
    """Features in native coordinates with the horizontal CRS of the site.

    Fields that hold places go with them: ``name_x``, ``name_y``, ``name_z`` become native, and
    heights ``name_z_m`` metres in the cloud's vertical datum.
    """
    crs = None if frame.crs_wkt is None else horizontal(CRS.from_wkt(frame.crs_wkt))
    geometries = map_coordinates(features.geometry.to_numpy(), frame.to_native)
    attributes = features.drop(columns=features.geometry.name).reset_index(drop=True)
    return gpd.GeoDataFrame(_moved(attributes, frame, 1), geometry=geometries, crs=crs)


def _moved(attributes: pd.DataFrame, frame: Frame, direction: int) -> pd.DataFrame:
    """Fields that hold places, from the local frame into native coordinates (1) or back (-1)."""
    moved = attributes.copy()
    move = frame.to_native if direction > 0 else frame.to_local
    for name in [str(column)[:-2] for column in attributes if str(column).endswith("_x")]:
        columns = [f"{name}_{axis}" for axis in "xyz" if f"{name}_{axis}" in attributes]
        moved[columns] = move(attributes[columns].to_numpy(np.float64))
    for name in [str(column) for column in attributes if str(column).endswith("_z_m")]:
        datum_m = frame.origin[2] * frame.vertical_unit_m
        moved[name] = attributes[name].to_numpy(np.float64) + direction * datum_m
    return moved


@contextmanager
def fixed_date() -> Iterator[None]:
    """Keep the clock out of what GDAL writes, and its warning about local coordinates."""
    before = pyogrio.get_gdal_config_option("OGR_CURRENT_DATE")
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": FIXED_DATE})
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="'crs' was not provided")
            yield
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": before})


def _parts(
    name: str, geometry: shapely.Geometry, where: str
) -> Iterator[tuple[str, shapely.LineString]]:
    """Joined parts of a line feature, named and checked."""
    check_shape(geometry, LINES, where)
    joined = shapely.line_merge(geometry) if geometry.geom_type == "MultiLineString" else geometry
    parts = shapely.get_parts(joined)
    for number, part in enumerate(parts, start=1):
        line = shapely.remove_repeated_points(part)
        if shapely.get_num_coordinates(line) < 2 or line.length == 0:
            raise InputError("has fewer than two different vertices", where=where)
        if not line.is_simple:
            raise InputError("crosses itself", where=where, hint="split it or move its vertices")
        yield (name if len(parts) == 1 else f"{name}.{number}"), line


def check_shape(geometry: shapely.Geometry, allowed: tuple[str, ...], where: str) -> None:
    """Refuse geometry of another type, and areas that cross themselves.

    Raises
    ------
    InputError : it is one of these.
    """
    if geometry.geom_type not in allowed:
        raise InputError(
            "is of another kind",
            where=where,
            found=geometry.geom_type,
            allowed=" or ".join(allowed),
        )
    if geometry.geom_type in AREAS and not geometry.is_valid:
        reason = shapely.is_valid_reason(geometry)
        raise InputError("is no valid polygon", where=where, found=reason)
