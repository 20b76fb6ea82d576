"""``roadsight edges``: trace the road edges of a cloud."""

from __future__ import annotations

import argparse

import geopandas as gpd

from roadsight.api.scene import edges, pavement
from roadsight.base.errors import InputError
from roadsight.commands.cloud_arguments import add_cloud_arguments, check_output, load_cloud
from roadsight.commands.pavement import (
    add_pavement_arguments,
    check_pavement_arguments,
    known_places,
)
from roadsight.io.vector.vectors import write_layers


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
    check_pavement_arguments(arguments)
    cloud = load_cloud(arguments)
    seeds_xy, track_xy = known_places(arguments, cloud.frame)
    road = pavement(
        cloud,
        method=arguments.method,
        intensity=arguments.intensity,
        seed=arguments.seed,
        seeds_xy=seeds_xy,
        track_xy=track_xy,
    )
    try:
        lines = edges(road)
    except InputError as error:
        raise InputError(str(error), where=str(arguments.cloud)) from error
    parts = list(road.outline.geoms)
    outline = gpd.GeoDataFrame({"area_m2": [part.area for part in parts]}, geometry=parts)
    write_layers(arguments.out, {"edges": lines, "pavement": outline}, cloud.frame)
    print(f"{len(lines)} edges, {lines['length_m'].sum():.0f} m: {arguments.out}")
