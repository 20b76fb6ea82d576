"""What GIS and CAD people take along: GeoPackage, QGIS project, KML and drawing of a site."""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

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
    bounds_native,
    plan_layers,
    points,
    pole_layers,
    scene_layers,
    sensor_table,
)
from roadsight.report.handover.project import project
from roadsight.report.handover.styles import qml
from roadsight.stages.command import run_stage

log = logging.getLogger("write_handover")

_POLE_LAYERS = ("poles", "rays", "ellipses", "hazard", "cross_sections", "road_geometry")
"""Layers of poles.gpkg that go along."""


def write_handover(arguments: argparse.Namespace) -> None:
    """Gather the layers of a site and write them four times."""
    about = read_json(arguments.frame)
    frame = Frame.from_dict(about)
    layers = [*_plans(arguments, frame), *_poles(arguments, frame), *_scene(arguments, frame)]
    styled = [
        StyledLayer(layer.name, layer.about, layer.features, layer.geometry, qml(layer.style))
        for layer in layers
    ]
    write_styled(arguments.layers, styled, frame)
    crs = None if frame.crs_wkt is None else horizontal(CRS.from_wkt(frame.crs_wkt))
    title = arguments.title or arguments.site
    bounds = bounds_native(layers, frame)
    beside = Path(arguments.layers).name
    texts = {
        arguments.project: project(title, beside, layers, crs, bounds),
        arguments.kml: kml(title, layers, frame),
        arguments.drawing: drawing(layers, frame, about["unit"]),
    }
    for path, text in texts.items():
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    log.info("%d layers, %d features", len(layers), sum(len(layer.features) for layer in layers))


def _scene(arguments: argparse.Namespace, frame: Frame) -> list[Layer]:
    if not arguments.pavement:
        return []
    pavement = read_layer(arguments.pavement, "pavement", frame)
    edges = read_layer(arguments.edges, "edges", frame)
    unexamined = None
    if arguments.unexamined:
        unexamined = read_layer(arguments.unexamined, "unexamined", frame)
    return scene_layers(pavement, edges, read_raster(arguments.dem, frame), unexamined)


def _plans(arguments: argparse.Namespace, frame: Frame) -> list[Layer]:
    files = zip(arguments.solutions, arguments.plan_layers, arguments.obstacles, strict=True)
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


def _poles(arguments: argparse.Namespace, frame: Frame) -> list[Layer]:
    if not arguments.poles:
        return []
    found: dict[str, gpd.GeoDataFrame] = {
        name: read_layer(arguments.poles, name, frame) for name in _POLE_LAYERS
    }
    found["road_edges"] = read_layer(arguments.road_edges, "road_edges", frame)
    return pole_layers(found)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("site", "frame", "layers", "project", "kml", "drawing"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--title", default="", help="name of the site for people")
    for name in ("dem", "pavement", "edges", "unexamined", "poles", "road-edges"):
        parser.add_argument(f"--{name}", nargs="?", help="of the job that the site asks for")
    for name in ("solutions", "plan-layers", "obstacles"):
        parser.add_argument(f"--{name}", nargs="*", default=[], help="one a plan")
    return run_stage(parser, write_handover, argv)


if __name__ == "__main__":
    sys.exit(main())
