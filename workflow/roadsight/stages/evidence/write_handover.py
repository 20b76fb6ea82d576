"""What GIS and CAD people take along: GeoPackage, QGIS project, KML and drawing of a site."""

from __future__ import annotations

import logging
import os
import sqlite3
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import geopandas as gpd
import pyogrio
from pyproj import CRS

from roadsight.geometry.crs import horizontal, with_heights
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import atomic_path, check_geopackage, read_json, write_text
from roadsight.io.vector.vectors import FIXED_DATE, fixed_date, native_features, points, read_layer
from roadsight.report.handover.drawing import drawing
from roadsight.report.handover.kml import kml
from roadsight.report.handover.layers import (
    Layer,
    Linked,
    bounds_native,
    measured_layers,
    plan_layers,
    pole_layers,
    scene_layers,
    sensor_table,
)
from roadsight.report.handover.project import project
from roadsight.report.handover.styles import qml
from roadsight.stages.command import Command

log = logging.getLogger("write_handover")

_POLE_LAYERS = (
    "poles",
    "rays",
    "ellipses",
    "guardrails",
    "hazard",
    "cross_sections",
    "road_geometry",
)
"""Layers of poles.gpkg that go along."""


def write_handover(
    site: str,
    frame_path: Path,
    title: Annotated[str, "name of the site for people"] = "",
    dem: Path | None = None,
    pavement: Path | None = None,
    edges: Path | None = None,
    unexamined: Path | None = None,
    poles: Path | None = None,
    road_edges: Path | None = None,
    solutions: Sequence[Path] = (),
    plan_layers: Sequence[Path] = (),
    obstacles: Sequence[Path] = (),
    orthophoto: Annotated[Path | None, "picture below the project's layers"] = None,
    *,
    layers_path: Path,
    project_path: Path,
    kml_path: Path,
    drawing_path: Path,
) -> None:
    """Gather the layers of a site's jobs, some one a plan, and write them four times."""
    about = read_json(frame_path)
    frame = Frame.from_dict(about)
    layers = [
        *_plans(solutions, plan_layers, obstacles, frame),
        *_poles(poles, road_edges, frame),
        *_scene(unexamined, pavement, edges, dem, frame),
    ]
    styled = [
        StyledLayer(layer.name, layer.about, layer.features, layer.geometry, qml(layer.style))
        for layer in layers
    ]
    write_styled(layers_path, styled, frame)
    linked = _linked(solutions, dem, orthophoto, project_path.parent)
    crs = None if frame.crs_wkt is None else horizontal(CRS.from_wkt(frame.crs_wkt))
    bounds = bounds_native(layers, frame)
    beside = layers_path.name
    texts = {
        project_path: project(title or site, beside, layers, crs, bounds, linked),
        kml_path: kml(title or site, layers, frame),
        drawing_path: drawing(layers, frame, about["unit"]),
    }
    for path, text in texts.items():
        write_text(path, text)
    log.info("%d layers, %d features", len(layers), sum(len(layer.features) for layer in layers))


def _scene(
    unexamined_path: Path | None,
    pavement_path: Path | None,
    edges_path: Path | None,
    dem: Path | None,
    frame: Frame,
) -> list[Layer]:
    if not (pavement_path and edges_path and dem):
        return []
    pavement = read_layer(pavement_path, "pavement", frame)
    edges = read_layer(edges_path, "edges", frame)
    unexamined = None
    if unexamined_path:
        unexamined = read_layer(unexamined_path, "unexamined", frame)
    return scene_layers(pavement, edges, read_raster(dem, frame), unexamined)


def _plans(
    solutions: Sequence[Path],
    plan_layers_paths: Sequence[Path],
    obstacles_paths: Sequence[Path],
    frame: Frame,
) -> list[Layer]:
    files = zip(solutions, plan_layers_paths, obstacles_paths, strict=True)
    found = []
    for solution_path, layers, obstacles in files:
        solution = read_json(solution_path)
        found += plan_layers(
            solution["plan"],
            points(sensor_table(solution["sensors"], frame)),
            read_layer(layers, "targets", frame),
            read_layer(obstacles, "obstacles", frame),
            read_layer(obstacles, "uncovered", frame),
            read_layer(obstacles, "objects", frame),
        )
    return found


def _linked(
    solutions: Sequence[Path], dem: Path | None, orthophoto: Path | None, folder: Path
) -> list[Linked]:
    """What the project shows from files that the folder does not hold."""
    found = [
        layer
        for path in solutions
        for layer in measured_layers(path.parent.name, _from(folder, path.parent))
    ]
    if dem:
        about = "Ground; band 2 marks measured cells."
        found.append(Linked("terrain", "Scene", about, _from(folder, dem), is_relief=True))
    if orthophoto:
        about = "Picture that the site file names."
        found.append(Linked("orthophoto", "Scene", about, _from(folder, orthophoto)))
    return found


def _from(folder: Path, path: Path) -> str:
    """Address of a file from a folder, with slashes."""
    return Path(os.path.relpath(path, folder)).as_posix()


def _poles(poles: Path | None, road_edges: Path | None, frame: Frame) -> list[Layer]:
    if not (poles and road_edges):
        return []
    found: dict[str, gpd.GeoDataFrame] = {
        name: read_layer(poles, name, frame) for name in _POLE_LAYERS
    }
    found["road_edges"] = read_layer(road_edges, "road_edges", frame)
    return pole_layers(found)


# GeoPackages for other people: layers with descriptions, styles, and the vertical CRS.

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


main = Command(write_handover)


if __name__ == "__main__":
    sys.exit(main())
