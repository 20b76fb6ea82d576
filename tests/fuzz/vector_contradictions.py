"""Valid vector layers with one contradiction each, beside the lines that they stand for."""

import json
import logging
import warnings
from functools import cache
from pathlib import Path

import geopandas as gpd
import numpy as np
import pyogrio
import shapely

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.vector.known import read_points
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vectors import read_lines
from tests.helpers.las_files import wkt_of

TEXTS = ("no heights", "swapped lines", "swapped points")
FILES = ("undefined", "layers", "no heights in a file", "swapped in a file")
KINDS = (*TEXTS, *FILES)
_FILES_SHARE = 0.05
"""Share of numbers whose layers are files of a database, which take longest to write."""
_EXTENT_M = 300.0
"""Reach of the lines from the origin."""
_NOWHERE = (0.0, -9999.0, -99999.0, -32768.0, -1e38, -1.797e308, 3.4e38)
"""Heights that mean that there are none; 0 throughout a line."""
_UNDEFINED = (
    'ENGCRS["Undefined Cartesian SRS",EDATUM["Unknown engineering datum"],CS[Cartesian,2],'
    'AXIS["x",unspecified],AXIS["y",unspecified],LENGTHUNIT["metre",1]]'
)
_PLACES = (
    ("EPSG:32632", 500_000.0, 5_400_000.0), ("EPSG:32617", 620_000.0, 3_950_000.0),
    ("EPSG:32756", 334_000.0, 6_252_000.0), ("EPSG:32633", 420_000.0, 30_000.0),
    ("EPSG:2193", 1_750_000.0, 5_920_000.0), ("EPSG:5070", -500_000.0, 1_800_000.0),
)  # fmt: skip
"""CRS and origin of sites on several continents, on both sides of the equator."""
_LOG = logging.getLogger("roadsight.fuzz")


@cache
def place(number: int) -> tuple[Frame, SiteNorth, int]:
    code, x, y = _PLACES[number]
    frame = Frame((x, y, 100.0), crs_wkt=wkt_of(code))
    return frame, SiteNorth(frame), int(code.split(":")[1])


def check_vector(folder: Path, number: int) -> None:
    """Write the layer of that number with its contradiction, and compare what is read."""
    rng = np.random.default_rng(number)
    of_file = rng.random() < _FILES_SHARE
    kind = str(rng.choice(FILES if of_file else TEXTS))
    frame, north, code = place(int(rng.integers(len(_PLACES))))
    lines = [
        np.cumsum(rng.uniform(1, 20, (int(rng.integers(2, 6)), 2)), axis=0)
        for _ in range(int(rng.integers(1, 4)))
    ]
    if kind.startswith("no heights"):
        _check_heights(folder, lines, frame, code, of_file, rng)
    elif kind == "undefined":
        _check_undefined(folder, lines, frame, rng)
    elif kind == "layers":
        _check_layers(folder, lines, frame, code, rng)
    else:
        _check_swapped(folder, kind, lines, frame, north, code, rng)


def same(found: gpd.GeoDataFrame, lines: list[np.ndarray], within_m: float = 1e-3) -> None:
    """Lines as they were digitised, without heights; some formats keep them in another order."""
    assert len(found) == len(lines)
    for geometry, line in zip(found.sort_values("edge").geometry, lines, strict=True):
        assert not geometry.has_z
        np.testing.assert_allclose(geometry.coords, line, rtol=0, atol=within_m)


def geojson(lines: list[np.ndarray], crs: int | None) -> str:
    features = [
        {
            "type": "Feature",
            "properties": {"edge": f"l{n}"},
            "geometry": {"type": "LineString", "coordinates": line.tolist()},
        }
        for n, line in enumerate(lines)
    ]
    named = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{crs}"}}
    member = {} if crs is None else {"crs": named}
    return json.dumps({"type": "FeatureCollection", **member, "features": features})


def csv(lines: list[np.ndarray], axes: tuple[str, ...]) -> str:
    rows = [",".join(("edge", *axes))]
    for n, line in enumerate(lines):
        rows += [",".join((f"l{n}", *(repr(float(c)) for c in vertex))) for vertex in line]
    return "\n".join(rows) + "\n"


def database(path: Path, layers: dict[str, list[np.ndarray]], crs: object) -> Path:
    """A GeoPackage or another file of layers."""
    path.unlink(missing_ok=True)
    for name, lines in layers.items():
        table = {"edge": [f"l{n}" for n in range(len(lines))]}
        features = gpd.GeoDataFrame(
            table, geometry=[shapely.LineString(line) for line in lines], crs=crs
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            pyogrio.write_dataframe(features, path, layer=name)
    return path


def _check_heights(folder, lines, frame, code, of_file, rng) -> None:
    """Heights that mean none: throughout, or a no-data number among others."""
    nothing = float(rng.choice(_NOWHERE))
    stored = []
    for line in lines:
        z = np.full(len(line), nothing)
        if nothing and rng.integers(2):
            z[1:] = rng.uniform(90, 120, len(line) - 1)
        stored.append(np.column_stack([frame.to_native(line), z]))
    if of_file:
        path = database(folder / f"a{rng.choice(['.gpkg', '.fgb'])}", {"a": stored}, code)
    elif rng.integers(2):
        path = folder / "a.geojson"
        path.write_text(geojson(stored, code))
    else:
        path = folder / "a.csv"
        path.write_text(csv(stored, ("x", "y", "z")))
    same(read_lines(path, frame), lines)


def _check_undefined(folder, lines, frame, rng) -> None:
    """A CRS that says that there is none: the cloud's own coordinates, or those that are stated."""
    stored = [frame.to_native(line) for line in lines]
    crs = [_UNDEFINED, None][int(rng.integers(2))]
    path = database(folder / "a.gpkg", {"a": stored}, crs)
    same(read_lines(path, frame), lines)
    same(read_lines(path, Frame(frame.origin)), lines)


def _check_layers(folder, lines, frame, code, rng) -> None:
    """Several layers: one is read by its name; none is refused, naming how."""
    stored = [frame.to_native(line) for line in lines]
    names = [str(name) for name in rng.permutation(["edges", "Kanten 2", "zäune"])[:2]]
    layers = {names[0]: stored, names[1]: [line + 50 for line in stored]}
    path = database(folder / "a.gpkg", layers, code)
    same(read_lines(f"{path}|layername={names[0]}", frame), lines)
    same(read_lines(f"{path}|layername={names[0]}|geometrytype=LineString", frame), lines)
    for name in (path, f"{path}|layername=none"):
        try:
            read_lines(name, frame)
        except InputError as error:
            assert f"a.gpkg|layername={names[0]}" in str(error)
        else:
            raise AssertionError("one of several layers was taken")


def _check_swapped(folder, kind, lines, frame, north, code, rng) -> None:
    """Exchanged axes, in half of the layers, end in a message that offers the exchange."""
    degrees = [np.column_stack(north.to_geographic(line)[::-1]) for line in lines]
    native = [frame.to_native(line) for line in lines]
    geographic = bool(rng.integers(2))
    clean = degrees if geographic else native
    bounds = [0.0, 0.0, 0.0, _EXTENT_M, _EXTENT_M, 9.0]
    about = frame.to_dict() | {"bounds_m": bounds}
    crs = 4326 if geographic else code
    swapped = bool(rng.integers(2))
    stored = [line[:, ::-1] if swapped else line for line in clean]
    try:
        shapes = _read_swapped(folder, kind, stored, frame, geographic, crs)
        doubts = tell_near(_LOG, "lines", shapes, about, "a")
    except InputError as error:
        assert swapped, error
        assert "axes exchanged" in str(error), error
    else:
        assert not swapped, f"{stored[0]} was taken"
        assert doubts == []


def _read_swapped(folder, kind, stored, frame, geographic, crs):
    if kind == "swapped in a file":
        return read_lines(database(folder / "b.gpkg", {"b": stored}, crs), frame).geometry
    if kind == "swapped points":
        path = folder / "p.csv"
        axes = ("lon", "lat") if geographic else ("x", "y")
        path.write_text(csv(stored, axes).replace("edge", "id", 1))
        return read_points(path, frame)[["x", "y"]].to_numpy()
    suffix = ".csv" if len(stored) % 2 else ".geojson"
    path = folder / f"b{suffix}"
    axes = ("lon", "lat") if geographic else ("x", "y")
    path.write_text(csv(stored, axes) if suffix == ".csv" else geojson(stored, crs))
    return read_lines(path, frame).geometry
