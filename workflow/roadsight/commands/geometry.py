"""``roadsight geometry``: radius, grade, cross-slope and paved width of roads by station."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import geopandas as gpd
import numpy as np
import shapely

from roadsight.api.scene import ground
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Edges
from roadsight.commands.pavement import Search
from roadsight.commands.verb import CloudPath, Reading, Verb, check_output, load_cloud
from roadsight.geometry.frames import Frame
from roadsight.io.records.text_tables import in_native, write_csv
from roadsight.io.vector.vector_sources import load_local
from roadsight.io.vector.vectors import AREAS, LINES, check_shape, read_lines, write_layers
from roadsight.poles.risk.road_geometry import STATION_M
from roadsight.poles.risk.roads import Roads, road_along
from roadsight.poles.risk.roadside import Surroundings, geometry_table
from roadsight.scene.splines import outline_edges, spline_line
from roadsight.scene.whole import heights_of
from roadsight.stages.poles.shared.hazard_layers import GEOMETRY, geometry_lines, rounded

_EDGE_STEP_M = 0.25  # spacing of edge points, as of the edges of a drive (`road_edges.spacing_m`)
# Areas nearer to each other than this are one pavement: neighbours that were digitised each by
# itself lie centimetres apart, a gutter is 0.3 m wide, and no median is so narrow.
_SLIVER_M = 0.3


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
    for file in (out, out.with_suffix(".csv")):
        read = [along, edges, search.track]
        check_output(file, cloud_path, ".gpkg" if file == out else ".csv", read=read)
    search.check()
    cloud = load_cloud(cloud_path, reading)
    lines = read_lines(along, cloud.frame)
    known, paved = _known(edges, cloud.frame) if edges else ([], shapely.MultiPolygon())
    unused = [] if paved.is_empty else search.given()
    if unused:
        raise InputError(
            "have no use with areas, which are the pavement",
            where=" and ".join(unused),
            found=f"--edges {edges}",
            hint="leave them out, or give the edges as lines",
        )
    labelled = ground(cloud)
    if paved.is_empty:
        road = search.road(cloud, labelled)
        paved = road.outline
        if not known:
            traced = outline_edges(road.outline, road.surface_m, Edges(offset_m=0.0))
            known = [spline_line(line) for _, line in traced]
    points = shapely.get_coordinates(shapely.segmentize(known, _EDGE_STEP_M))
    shapely.prepare(paved)
    roads = [
        road_along(
            shapely.get_coordinates(line)[:, :2],
            points,
            name,
            measured=f"along {name}",
            paved=paved,
        )
        for name, line in zip(lines["edge"], lines.geometry, strict=True)
    ]
    surroundings = Surroundings(Roads(roads), heights_of(cloud.xyz_m, labelled))
    table = geometry_table(surroundings)
    bare = [road.name for road in roads if not np.isfinite(road.left_m).any()]
    if bare:
        raise InputError(
            "has no pavement with an edge on both sides",
            where=f"{along}, {bare[0]}",
            allowed="lines on the pavement, or 2.5 m or less beside it, which move to its middle",
            hint="draw it on the road, not between two carriageways, or give other --edges",
        )
    layers = {
        "road_geometry": geometry_lines(table, surroundings, STATION_M, 1.0),
        "edges": gpd.GeoDataFrame({"length_m": shapely.length(known)}, geometry=known),
    }
    write_layers(out, layers, cloud.frame, GEOMETRY)
    write_csv(out.with_suffix(".csv"), rounded(in_native(table, cloud.frame)))
    for name, own in table.groupby("road", sort=False):
        share = own["paved_width_m"].notna().mean()
        print(f"{name}: {len(own)} stations, paved width known at {share:.0%}: {out}")


def _known(path: Path, frame: Frame) -> tuple[list[shapely.Geometry], shapely.Geometry]:
    """Edges of a user, lines or outlines of areas, and these areas as one, empty without any."""
    shapes = shapely.force_2d(load_local(path, frame).geometry.to_numpy())
    for number, shape in enumerate(shapes, start=1):
        check_shape(shape, (*LINES, *AREAS), f"{path}, feature {number}")
    flat = shapely.get_dimensions(shapes) == 2
    if flat.any() and not flat.all():
        raise InputError(
            "holds both lines and areas", where=str(path), allowed="edges as lines, or paved areas"
        )
    half = _SLIVER_M / 2
    grown = shapely.buffer(shapely.union_all(shapes[flat]), half, join_style="mitre")
    paved = shapely.buffer(grown, -half, join_style="mitre")
    parts = shapely.get_parts([paved.boundary, *shapes[~flat]])
    return [*parts[~shapely.is_empty(parts)]], paved


VERB = Verb("geometry", "radius, grade, cross-slope and width of roads by station", run)
