"""Users' vector files of any common kind and CRS, brought into the local frame."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from shapely import LineString

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.geometry.crs import horizontal, parse_crs
from roadsight.geometry.frames import Frame
from roadsight.io.records.companions import split_layer
from roadsight.io.records.text_tables import read_cells

_GEOJSON = (".geojson", ".json")  # formats whose CRS is WGS 84 unless the file names another
_TABLE = (".csv",)  # formats that are read as tables of vertices
# Formats whose files name their CRS where they have one.
_OTHER = (".gpkg", ".shp", ".fgb", ".sqlite", ".gml", ".kml", ".gpx")
_NATIVE = ("local", "native")  # words for the cloud's own coordinates
# Heights that stand for no data in common formats.
_NO_DATA = (-9999.0, -99999.0, -32768.0, -32767.0)
# Heights beyond are the least or greatest numbers of a type, which stand for no data too.
_NO_HEIGHT_M = 1e30
_WGS84 = CRS.from_epsg(4326)
_UNDEFINED = ("undefined", "unknown cartesian")  # how names of CRS begin that stand for none
# What lies within this distance of a site's origin may belong to it: sites are tens of kilometres
# at most, and exchanged axes lead further away.
_SITE_REACH_M = 100_000.0
# What is offered as the reason where it fits.
EXCHANGED = "with axes exchanged they would lie there: write x before y, or check lat, lon"
Mapping = Callable[[Floats], Floats]


def load_local(path: Path, frame: Frame, default_crs: str | None = None) -> gpd.GeoDataFrame:
    """Features of a file in local metres, with their attributes.

    Parameters
    ----------
    default_crs : CRS of a file that names none; the site's own if None, but longitude and latitude
        for GeoJSON, as its standard says. ``local`` stands for the site's own coordinates. A CRS
        that says that there is none (undefined, engineering) counts as none.

    Raises
    ------
    InputError : the file is missing, of another kind, empty, has features without geometry or with
        coordinates that are no numbers, or its CRS is unknown or leads outside the site's.
    """
    file, layer = split_layer(path)
    path = Path(file)
    features, stated = _load(path, layer)
    # As QGIS and R write into a GeoPackage that there is none.
    none = stated is not None and stated.name.lower().startswith(_UNDEFINED)
    if stated is not None and (stated.is_engineering or none):
        if default_crs is None:
            stated = _WGS84 if stated.is_geographic else None
            default_crs = "local"
        else:
            stated = None
    if len(features) == 0:
        raise InputError("holds no features", where=str(path))
    geometries = features.geometry.to_numpy().copy()
    for number, stored in enumerate(geometries, start=1):
        if stored is None or stored.is_empty:
            raise InputError("has no geometry", where=f"{path}, feature {number}")
        geometry = geometries[number - 1] = with_known_heights(stored)
        coordinates = shapely.get_coordinates(geometry, include_z=geometry.has_z)
        if not np.isfinite(coordinates).all():
            raise InputError(
                "has a coordinate that is no finite number", where=f"{path}, feature {number}"
            )
    if stated is None and default_crs not in (None, *_NATIVE):
        stated = parse_crs(str(default_crs), f"CRS of {path}")
    elif stated is None and default_crs is None and path.suffix.lower() in _GEOJSON:
        stated = None if frame.crs_wkt is None else _WGS84
    if stated is not None and stated.is_geographic:
        _check_degrees(path, geometries, stated.name)
    native = _to_native(path, stated, frame)
    local = map_coordinates(geometries, lambda xyz: frame.to_local(native(xyz)))
    return gpd.GeoDataFrame(features.drop(columns=features.geometry.name), geometry=local)


def is_near(xy_m: Floats) -> NDArray[np.bool_]:
    """Whether places (n, 2), local metres, may belong to a site; no number is nowhere."""
    return np.abs(xy_m).max(axis=1, initial=0) <= _SITE_REACH_M


def with_known_heights(geometry: shapely.Geometry) -> shapely.Geometry:
    """A geometry as stored, without its heights where they mean that none were digitised.

    They are 0 throughout, or one of them is a number that stands for no data.
    """
    if not geometry.has_z:
        return geometry
    z = shapely.get_coordinates(geometry, include_z=True)[:, 2]
    unknown = np.isnan(z) | (np.abs(z) >= _NO_HEIGHT_M) | np.isin(z, _NO_DATA)
    return shapely.force_2d(geometry) if unknown.any() or not z.any() else geometry


def map_coordinates(geometries: NDArray, mapping: Mapping) -> NDArray:
    """Geometries with ``mapping`` applied to their coordinates, (n, 2) or (n, 3) as they have z."""
    mapped = geometries.copy()
    for has_z in (False, True):
        chosen = shapely.has_z(geometries) == has_z
        mapped[chosen] = shapely.transform(geometries[chosen], mapping, include_z=has_z)
    return mapped


def read_features(path: Path, layer: str | None = None) -> gpd.GeoDataFrame:
    """Features of one layer, or of the only one, as they are stored.

    Raises
    ------
    InputError : the file is missing or unreadable, or has several layers and none is named.
    """
    if not path.is_file():
        raise InputError("is a directory" if path.is_dir() else "no such file", where=str(path))
    try:
        layers = [name for name, kind in pyogrio.list_layers(path) if kind is not None]
        if layer is None and len(layers) == 1:
            layer = layers[0]
        if layer in layers:
            return pyogrio.read_dataframe(path, layer=layer)
    except Exception as error:  # GDAL's drivers raise of every kind
        raise InputError(f"cannot be read as vector data ({error})", where=str(path)) from error
    raise InputError(
        "has no layer with geometry" if not layers else "needs one layer that can be told",
        where=str(path),
        found=", ".join(layers) or None,
        allowed=layer or "a file with one layer",
        hint=f"name it: {path.name}|layername={layers[0]}" if layers else "",
    )


def _load(path: Path, layer: str | None = None) -> tuple[gpd.GeoDataFrame, CRS | None]:
    """Features and the CRS that the file itself names."""
    suffix = path.suffix.lower()
    if suffix in _TABLE:
        return _line_table(path)
    if suffix not in (*_GEOJSON, *_OTHER):
        raise InputError(
            "is no vector file by its name",
            where=str(path),
            allowed=", ".join((*_GEOJSON, *_TABLE, *_OTHER)),
        )
    features = read_features(path, layer)
    if suffix not in _GEOJSON:
        return features, features.crs
    try:  # GDAL does not tell whether the file has a member `crs`
        named = "crs" in json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, TypeError, RecursionError):
        named = False
    return features, features.crs if named else None


def _check_degrees(path: Path, geometries: NDArray, name: str) -> None:
    """Refuse longitudes and latitudes that are none."""
    west, south, east, north = shapely.total_bounds(geometries)
    if west < -180 or east > 360 or south < -90 or north > 90:
        exchanged = west >= -90 and east <= 90 and south >= -180 and north <= 360
        raise InputError(
            f"is in {name}, so its coordinates should be longitude and latitude in degrees",
            where=str(path),
            found=f"x {west:g} to {east:g}, y {south:g} to {north:g}",
            hint=EXCHANGED
            if exchanged
            else "state its CRS in the site file, or `local` for the cloud's own coordinates",
        )


def _to_native(path: Path, stated: CRS | None, frame: Frame) -> Mapping:
    """Way from a file's coordinates to the site's native ones."""
    if stated is None:
        return lambda xyz: xyz
    if frame.crs_wkt is None:
        raise InputError(
            f"is in {stated.name}, but the site is local and has no place on Earth",
            where=str(path),
            allowed="the cloud's own coordinates",
            hint="give the site a CRS, or the file none",
        )
    site_crs = CRS.from_wkt(frame.crs_wkt)
    transformer = Transformer.from_crs(horizontal(stated), horizontal(site_crs), always_xy=True)
    # One unit of z: by the vertical axis, a metre beside degrees, else as at the site.
    unit_m = 1.0 if stated.is_geographic else frame.vertical_unit_m
    up = [axis.unit_conversion_factor for axis in stated.axis_info if axis.direction == "up"]
    z_factor = (up[0] if up else unit_m) / frame.vertical_unit_m

    def native(xyz: Floats) -> Floats:
        x, y = transformer.transform(xyz[:, 0], xyz[:, 1])
        moved = np.column_stack([x, y, *(xyz[:, 2:].T * z_factor)])
        if not np.isfinite(moved).all():
            places = np.column_stack(transformer.transform(xyz[:, 1], xyz[:, 0]))
            near = is_near(frame.to_local(places))
            raise InputError(
                f"has coordinates that {site_crs.name} cannot hold",
                where=str(path),
                hint=EXCHANGED if near.any() else "",
            )
        return moved

    return native


def _line_table(path: Path) -> tuple[gpd.GeoDataFrame, CRS | None]:
    """Lines of a CSV file, and WGS 84 if they are lon, lat.

    One vertex a row, in the order of the rows; columns edge, x, y or edge, lon, lat; further z,
    kind.
    """
    table = read_cells(path)
    table.columns = table.columns.str.strip().str.lower()
    if len(table) == 0:
        raise InputError("holds no vertices", where=str(path))
    axes = next((pair for pair in (["x", "y"], ["lon", "lat"]) if set(pair) <= set(table)), [])
    if not axes or "edge" not in table:
        raise InputError(
            "lacks columns",
            where=str(path),
            found=", ".join(table.columns),
            allowed="edge, x, y or edge, lon, lat; further z, kind",
        )
    names = [*axes, "z"] if "z" in table and (table["z"].str.strip() != "").any() else axes
    vertices = table[names].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
    wrong = np.argwhere(~np.isfinite(vertices))
    if len(wrong):
        row, column = wrong[0]
        raise InputError(
            f"{names[column]} is no finite number",
            where=f"{path}, line {row + 2}",
            found=repr(table[names[column]].iloc[row]),
        )
    edges = table["edge"].str.strip()
    if (edges == "").any():
        raise InputError(
            "has no edge name", where=f"{path}, line {int(np.argmax(edges == '')) + 2}"
        )
    rows = []
    for name in dict.fromkeys(edges):
        own = (edges == name).to_numpy()
        kinds = sorted(set(table["kind"][own].str.strip())) if "kind" in table else [""]
        if len(kinds) > 1:
            raise InputError("its rows differ in kind", where=f"{path}, edge {name}", found=kinds)
        if own.sum() < 2:
            raise InputError("has fewer than two vertices", where=f"{path}, edge {name}")
        rows.append((name, kinds[0], LineString(vertices[own])))
    lines = gpd.GeoDataFrame(rows, columns=["edge", "kind", "geometry"], geometry="geometry")
    if "kind" not in table:
        lines = lines.drop(columns="kind")
    return lines, CRS.from_epsg(4326) if axes == ["lon", "lat"] else None
