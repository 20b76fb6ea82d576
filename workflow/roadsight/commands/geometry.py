"""``roadsight geometry``: radius, grade, cross-slope and paved width of roads by station."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import geopandas as gpd
import numpy as np
import shapely

from roadsight.api.clouds import Cloud
from roadsight.api.scene import ground
from roadsight.base.arrays import Bools
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Edges
from roadsight.commands.cloud_arguments import CloudPath, Reading, check_output, load_cloud
from roadsight.commands.pavement import Search
from roadsight.commands.verb import Verb
from roadsight.io.records.sighting_tables import in_native, write_csv
from roadsight.io.vector.vector_sources import load_local
from roadsight.io.vector.vectors import read_lines, write_layers
from roadsight.poles.risk.road_geometry import STATION_M
from roadsight.poles.risk.roads import Roads, road_along
from roadsight.poles.risk.roadside import Surroundings, geometry_table
from roadsight.scene.edges.splines import outline_edges, spline_line
from roadsight.scene.whole import heights_of
from roadsight.stages.poles.shared.hazard_layers import GEOMETRY, geometry_lines, rounded

_EDGE_STEP_M = 0.25
"""Spacing of edge points, as of the edges of a drive (`road_edges.spacing_m`)."""


def run(
    cloud_path: CloudPath,
    /,
    reading: Reading,
    search: Search,
    along: Annotated[Path, "drives or centrelines, along which measures rise"],
    edges: Annotated[Path | None, "known road edges, lines or areas; else traced"] = None,
    *,
    out: Annotated[Path, "GeoPackage to write, and a CSV table beside it"],
) -> None:
    """Write layers ``road_geometry`` and ``edges`` in the cloud's CRS, and the table as CSV."""
    check_output(out, cloud_path, ".gpkg")
    search.check()
    cloud = load_cloud(cloud_path, reading)
    lines = read_lines(along, cloud.frame)
    labelled = ground(cloud)
    traced = _known(edges, cloud) if edges else _traced(search, cloud, labelled)
    points = shapely.get_coordinates(shapely.segmentize(traced, _EDGE_STEP_M))
    roads = [
        road_along(shapely.get_coordinates(line)[:, :2], points, name, measured=f"along {name}")
        for name, line in zip(lines["edge"], lines.geometry, strict=True)
    ]
    surroundings = Surroundings(Roads(roads), heights_of(cloud.xyz_m, labelled))
    table = geometry_table(surroundings)
    bare = [road.name for road in roads if not np.isfinite(road.left_m).any()]
    if bare:
        raise InputError(
            "has no road edge on both sides",
            where=f"{along}, {bare[0]}",
            allowed="lines on the pavement, 2.5 m or less beside a place midway between lanes",
            hint="draw it along the middle of the road, or give --edges",
        )
    layers = {
        "road_geometry": geometry_lines(table, surroundings, STATION_M, 1.0),
        "edges": gpd.GeoDataFrame({"length_m": shapely.length(traced)}, geometry=traced),
    }
    write_layers(out, layers, cloud.frame, GEOMETRY)
    write_csv(out.with_suffix(".csv"), rounded(in_native(table, cloud.frame)))
    for name, own in table.groupby("road", sort=False):
        known = own["paved_width_m"].notna()
        print(f"{name}: {len(own)} stations, paved width known at {known.mean():.0%}: {out}")


def _traced(search: Search, cloud: Cloud, labelled: Bools) -> list[shapely.LineString]:
    """Edges of the pavement that the cloud shows."""
    road = search.road(cloud, labelled)
    found = outline_edges(road.outline, road.surface_m, Edges(offset_m=0.0))
    return [spline_line(line) for _, line in found]


def _known(path: Path, cloud: Cloud) -> list[shapely.Geometry]:
    """Edges of a user: lines, or outlines of all areas together."""
    shapes = load_local(path, cloud.frame).geometry.to_numpy()
    flat = shapely.force_2d(shapes)
    areas = shapely.union_all(flat[shapely.get_dimensions(flat) == 2]).boundary
    rest = flat[shapely.get_dimensions(flat) == 1]
    return [line for line in shapely.get_parts([areas, *rest]) if not line.is_empty]


VERB = Verb("geometry", "radius, grade, cross-slope and width of roads by station", run)
