"""Road inventories, routes and barriers of a user: tables by measures, and lines with measures."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyogrio
import shapely
from pyproj import CRS, Transformer

from roadsight.base.arrays import AnyPath, Floats
from roadsight.base.errors import InputError
from roadsight.geometry.crs import horizontal, parse_crs
from roadsight.geometry.frames import Frame
from roadsight.io.records.companions import split_layer
from roadsight.io.records.text_tables import read_cells
from roadsight.io.vector.vector_sources import load_local
from roadsight.poles.risk.inventory import COLUMNS
from roadsight.poles.risk.routes import UNITS_M, Route

_SPEEDS_KMH = {"speed_kmh": 1.0, "speed_mph": 1.609344}
# Columns that may name a route, the first that is there.
_ROUTE = ("route", "route_id", "routeid", "road", "name", "id", "edge")


def read_inventory(
    path: AnyPath, frame: Frame, default_crs: str | None = None
) -> tuple[pd.DataFrame, list[str], list[Route]]:
    """Segments of an inventory, where each stands in its file, and their lines if it has any.

    A CSV table or a line layer with columns route, from and to (in m, km, ft, usft, mi or usmi:
    ``from_mi``), and speed_kmh or speed_mph, aadt, lanes, lane_width_m (or _ft), carriageway; names
    in any case, empty is unknown.

    Parameters
    ----------
    default_crs : CRS of a vector file that names none, see `load_local`.

    Returns
    -------
    table : columns `roadsight.poles.risk.inventory.COLUMNS`. places : such as "line 3". routes

    Raises
    ------
    InputError : the file cannot be read, lacks columns, or a cell is no number.
    """
    if Path(split_layer(path)[0]).suffix.lower() == ".csv":
        cells = read_cells(path)
        places = [f"line {n + 2}" for n in range(len(cells))]
        return _segments(cells, path, places), places, []
    features = load_local(Path(path), frame, default_crs)
    places = [f"feature {n + 1}" for n in range(len(features))]
    table = _segments(pd.DataFrame(features.drop(columns="geometry")), path, places)
    routes = []
    bounds = table[["from_m", "to_m"]].to_numpy(np.float64)
    for row, line in enumerate(features.geometry):
        where = f"{path}, {places[row]}"
        parts = _parts(line, where)
        if np.isfinite(bounds[row]).all():
            measures = _along(parts, float(bounds[row, 0]), float(bounds[row, 1]))
            routes += _routes(str(table["route"].iloc[row]), parts, measures, where)
    return table, places, routes


def read_routes(
    path: AnyPath, frame: Frame, default_crs: str | None = None, unit: str = "m"
) -> list[Route]:
    """Routes with measures, in local metres.

    Read are lines with measures in their vertices (M), lines with columns from and to as
    `read_inventory` takes them, CSV tables of vertices (route; x, y or lon, lat; measure_m or
    another unit), and GPX tracks, whose measure is their length from the first point.

    Parameters
    ----------
    unit : of measures in vertices, one of `UNITS_M`.

    Raises
    ------
    InputError : as `load_local`; the file states no measures; a feature is no line.
    """
    file, layer = split_layer(path)
    suffix = Path(file).suffix.lower()
    if suffix == ".csv":
        return _route_table(path, frame, default_crs)
    if suffix == ".gpx":
        path = f"{file}|layername={layer or 'tracks'}"
    with _quiet_measures():
        features = load_local(Path(path), frame, default_crs)
    names = _named(features, path)
    stored = None if suffix == ".gpx" else _stored_measures(file, layer)
    bounds = [_column(features, end, UNITS_M, path) for end in ("from", "to")]
    found = []
    for row, (name, line) in enumerate(zip(names, features.geometry, strict=True)):
        where = f"{path}, feature {row + 1}"
        parts = _parts(line, where)
        own = None if stored is None else stored[row]
        if own is not None:
            measures = [measure * UNITS_M[unit] for measure in own]
        elif bounds[0] is not None and bounds[1] is not None:
            measures = _along(parts, float(bounds[0][row]), float(bounds[1][row]))
        elif suffix == ".gpx":
            measures = _along(parts)
        else:
            raise InputError(
                "states no measures",
                where=where,
                found=", ".join(map(str, features.columns)),
                allowed="measures in the vertices (M), or columns from_m and to_m (or _km, _mi)",
                hint="in QGIS, `Add route measures` or a table join writes them",
            )
        found += _routes(name, parts, measures, where)
    return found


def read_barriers(
    path: AnyPath, frame: Frame, default_crs: str | None = None
) -> tuple[list[Floats], list[str]]:
    """Lines of barriers (n, 2) in local metres, and their names.

    Raises
    ------
    InputError : as `load_local`, or a feature is no line.
    """
    features = load_local(Path(path), frame, default_crs)
    column = _name_column(features)
    names = [f"b{n + 1}" for n in range(len(features))]
    if column is not None:
        own = features[column].fillna("").astype(str)
        names = [text or name for text, name in zip(own, names, strict=True)]
    lines, titles = [], []
    for name, geometry in zip(names, features.geometry, strict=True):
        many = geometry.geom_type == "MultiLineString"
        parts = _parts(shapely.line_merge(geometry) if many else geometry, f"{path}, {name}")
        for number, part in enumerate(parts, start=1):
            lines.append(part)
            titles.append(name if len(parts) == 1 else f"{name}.{number}")
    return lines, titles


def _segments(table: pd.DataFrame, path: Any, places: list[str]) -> pd.DataFrame:
    """Columns of an inventory out of a user's table."""
    table = table.rename(columns={c: str(c).strip().lower() for c in table.columns})
    ends = {f"{end}_m": _column(table, end, UNITS_M, path, places) for end in ("from", "to")}
    lacking = [end for end, values in ends.items() if values is None]
    if lacking or _name_column(table) is None:
        raise InputError(
            "lacks columns",
            where=str(path),
            found=", ".join(map(str, table.columns)),
            allowed="route, from_m, to_m (or _km, _ft, _usft, _mi), and speed_kmh or speed_mph,"
            " aadt, lanes, lane_width_m or _ft",
        )
    unknown = np.full(len(table), np.nan)
    speed = _column(table, "speed", {n[6:]: f for n, f in _SPEEDS_KMH.items()}, path, places)
    found: dict[str, Any] = {"route": _named(table, path), **ends}
    found["speed_kmh"] = unknown if speed is None else speed
    wide = _column(table, "lane_width", UNITS_M, path, places)
    found["lane_width_m"] = unknown if wide is None else wide
    for name in ("aadt", "lanes"):
        values = _numbers(table[name], 1.0, path, places, name) if name in table else unknown
        found[name] = values
    ways = table["carriageway"] if "carriageway" in table else pd.Series("", index=table.index)
    found["carriageway"] = ways.fillna("").astype(str).str.strip().str.lower().to_numpy()
    return pd.DataFrame(found)[list(COLUMNS)]


def _column(
    table: pd.DataFrame,
    stem: str,
    units: dict[str, float],
    path: Any,
    places: list[str] | None = None,
) -> Floats | None:
    """Column ``stem_unit`` of a table in the first unit, None if it has none.

    Raises
    ------
    InputError : a cell is no number, or, of a table by measures (``places``), the column is named
        ``stem`` alone: in a layer of routes `from` may be a town.
    """
    lower = {str(c).strip().lower(): c for c in table.columns}
    for unit, factor in units.items():
        if f"{stem}_{unit}" in lower:
            values = table[lower[f"{stem}_{unit}"]]
            where = places or [f"feature {n + 1}" for n in range(len(table))]
            return _numbers(values, factor, path, where, f"{stem}_{unit}")
    if stem in lower and places:
        raise InputError(
            f"column {lower[stem]} names no unit",
            where=str(path),
            found=lower[stem],
            allowed=", ".join(f"{stem}_{unit}" for unit in units),
            hint="rename it to what its numbers are",
        )
    return None


def _numbers(values: pd.Series, factor: float, path: Any, places: list[str], name: str) -> Floats:
    """Numbers of cells, NaN where empty."""
    text = values.astype(object).where(values.notna(), "").astype(str).str.strip()
    numbers = pd.to_numeric(text.replace("", "nan"), errors="coerce").to_numpy(np.float64)
    wrong = np.isnan(numbers) & ~text.str.lower().isin(["", "nan", "none", "null"]).to_numpy()
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{name} is no number",
            where=f"{path}, {places[row]}",
            found=text.iloc[row],
            allowed="a number, or empty for unknown",
        )
    return numbers * factor


def _name_column(table: pd.DataFrame) -> str | None:
    lower = {str(c).strip().lower(): c for c in table.columns}
    return next((lower[name] for name in _ROUTE if name in lower), None)


def _named(table: pd.DataFrame, path: Any) -> list[str]:
    """Names of the routes; the file's own where it names none."""
    column = _name_column(table)
    stem = Path(split_layer(path)[0]).stem
    if column is None:
        return [stem] * len(table)
    return [str(v) if pd.notna(v) and str(v) else stem for v in table[column]]


def _parts(geometry: shapely.Geometry, where: str) -> list[Floats]:
    """Vertices (n, 2) of each part of a line, in the order in which they are stored."""
    parts = list(shapely.get_parts(geometry))
    if not parts or any(part.geom_type != "LineString" for part in parts):
        raise InputError(
            "is no line", where=where, found=geometry.geom_type, allowed="a line of parts or of one"
        )
    return [shapely.get_coordinates(part) for part in parts]


def _along(parts: Sequence[Floats], start: float = 0.0, end: float | None = None) -> list[Floats]:
    """Measures (n,) of each part that go with the length from the first vertex, gaps included."""
    step = np.hypot(*np.diff(np.concatenate(parts), axis=0).T)
    measure = np.r_[0.0, np.cumsum(step)]
    if end is not None:
        measure = start + measure * (end - start) / max(measure[-1], 1e-9)
    return np.split(measure, np.cumsum([len(xy) for xy in parts])[:-1])


def _routes(
    name: str, parts: Sequence[Floats], measures: Sequence[Floats], where: str
) -> list[Route]:
    """A route for each part of a feature, without repeated vertices."""
    found = []
    for number, (xy, measure) in enumerate(zip(parts, measures, strict=True), start=1):
        place = where if len(parts) == 1 else f"{where}, part {number}"
        moved = np.r_[True, np.hypot(*np.diff(xy, axis=0).T) > 1e-6]
        if moved.sum() < 2:
            raise InputError("is a line without length", where=place)
        found.append(Route(name, xy[moved], measure[moved], place))
    return found


@contextmanager
def _quiet_measures() -> Iterator[None]:
    """Without pyogrio's warning that it drops measures, which are read on their own."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Measured")
        yield


def _stored_measures(file: str, layer: str | None) -> list[list[Floats] | None]:
    """Measures in the vertices of each part of each feature, None for features that have none."""
    chosen = {"layer": layer} if layer else {}
    with _quiet_measures():
        # Only by way of Arrow do measures come along.
        geometries = pyogrio.read_dataframe(file, use_arrow=True, **chosen).geometry
    found: list[list[Floats] | None] = []
    for geometry in geometries:
        if geometry is None or not shapely.has_m(geometry):
            found.append(None)
            continue
        parts = shapely.get_parts(geometry)
        found.append([shapely.get_coordinates(part, include_m=True)[:, -1] for part in parts])
    return found


def _route_table(path: AnyPath, frame: Frame, default_crs: str | None) -> list[Route]:
    """Routes of a CSV table, one vertex a row."""
    cells = read_cells(path)
    places = [f"line {n + 2}" for n in range(len(cells))]
    measure = _column(cells, "measure", UNITS_M, path, places)
    lower = {str(c).strip().lower(): c for c in cells.columns}
    axes = next((a for a in (("x", "y"), ("lon", "lat")) if set(a) <= set(lower)), None)
    if measure is None or axes is None:
        raise InputError(
            "lacks columns",
            where=str(path),
            found=", ".join(map(str, cells.columns)),
            allowed="route; x, y or lon, lat; measure_m (or _km, _ft, _usft, _mi)",
        )
    stated = "EPSG:4326" if axes == ("lon", "lat") else default_crs
    xy = np.column_stack([_numbers(cells[lower[a]], 1.0, path, places, a) for a in axes])
    if stated not in (None, "local", "native"):
        if frame.crs_wkt is None:
            raise InputError(f"is in {stated}, but the site is local", where=str(path))
        own = horizontal(CRS.from_wkt(frame.crs_wkt))
        mover = Transformer.from_crs(parse_crs(stated, f"CRS of {path}"), own, always_xy=True)
        xy = np.column_stack(mover.transform(*xy.T))
    if not np.isfinite(xy).all():
        row = int(np.argmax(~np.isfinite(xy).all(axis=1)))
        raise InputError("holds a place that is no finite number", where=f"{path}, line {row + 2}")
    local = frame.to_local(xy)
    names = np.array(_named(cells, path), object)
    found = []
    for name in dict.fromkeys(names):
        rows = np.flatnonzero(names == name)
        if len(rows) < 2:
            raise InputError("has fewer than two vertices", where=f"{path}, route {name}")
        found += _routes(name, [local[rows]], [measure[rows]], f"{path}, route {name}")
    return found
