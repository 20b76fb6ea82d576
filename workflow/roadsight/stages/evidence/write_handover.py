"""What GIS and CAD people take along: GeoPackage, QGIS project, KML and drawing of a site."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import geopandas as gpd
from pyproj import CRS

from roadsight.geometry.crs import horizontal
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import atomic_path, read_json
from roadsight.io.vector.styled import StyledLayer, write_styled
from roadsight.io.vector.vectors import read_layer
from roadsight.report.handover.drawing import drawing
from roadsight.report.handover.kml import kml
from roadsight.report.handover.layers import (
    Layer,
    Linked,
    bounds_native,
    measured_layers,
    plan_layers,
    points,
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
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
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


main = Command(write_handover)


if __name__ == "__main__":
    sys.exit(main())
