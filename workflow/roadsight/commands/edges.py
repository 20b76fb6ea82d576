"""``roadsight edges``: trace the road edges of a cloud."""

from __future__ import annotations

import argparse

import geopandas as gpd

from roadsight.base.errors import InputError
from roadsight.commands.memory import (
    add_cloud_arguments,
    check_output,
    ground_labels,
    load_cloud,
    pavement_of,
)
from roadsight.commands.pavement import add_pavement_arguments
from roadsight.io.vector.vectors import write_layers
from roadsight.scene.edges.splines import OutlineSettings, outline_edges, spline_line


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("edges", help="trace road edges into a GeoPackage")
    add_cloud_arguments(parser)
    add_pavement_arguments(parser)
    parser.add_argument("-o", "--out", required=True, help="GeoPackage to write")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Write layers ``edges`` and ``pavement`` in the cloud's CRS."""
    check_output(arguments, ".gpkg")
    cloud = load_cloud(arguments)
    road = pavement_of(cloud, ground_labels(cloud), arguments)
    found = outline_edges(road.outline, road.surface_m, OutlineSettings())
    if not found:
        raise InputError("the pavement has no edge long enough to trace", where=arguments.cloud)
    lines = [spline_line(line) for _, line in found]
    edges = gpd.GeoDataFrame(
        {
            "edge": [f"{kind[0]}{number:02d}" for number, (kind, _) in enumerate(found)],
            "kind": [kind for kind, _ in found],
            "source": "automatic",
            "length_m": [line.length for line in lines],
        },
        geometry=lines,
    )
    parts = list(road.outline.geoms)
    pavement = gpd.GeoDataFrame({"area_m2": [part.area for part in parts]}, geometry=parts)
    write_layers(arguments.out, {"edges": edges, "pavement": pavement}, cloud.frame)
    print(f"{len(edges)} edges, {edges['length_m'].sum():.0f} m: {arguments.out}")
