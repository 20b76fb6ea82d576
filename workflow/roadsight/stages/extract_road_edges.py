"""Road edges in the overhead view of the cloud (paper 2, section 3.2.1)."""

from __future__ import annotations

import argparse
import logging
import sys
from dataclasses import fields

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from roadsight.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.atomic import read_json
from roadsight.io.tables import write_table
from roadsight.io.top_rasters import TopRaster, read_top
from roadsight.io.vectors import write_layers
from roadsight.scene.road_edges import (
    EdgeLines,
    EdgeSettings,
    RoadImage,
    clean_road,
    edge_level,
    edge_lines,
    edge_pixels,
    outlines,
    surface_heights,
)
from roadsight.scene.voxel_kernels import BRIDGE, ROAD
from roadsight.stages.command import run_stage

log = logging.getLogger("extract_road_edges")

METHODS = ("contours", "pixels")


def extract_road_edges(arguments: argparse.Namespace) -> None:
    """Write the edge points as a table and as lines."""
    frame = Frame.from_dict(read_json(arguments.frame))
    top = read_top(arguments.top, frame)
    names = [field.name for field in fields(EdgeSettings)]
    settings = EdgeSettings(**{name: getattr(arguments, name) for name in names})
    image = clean_road(np.isin(top.cls, (ROAD, BRIDGE)), top.cls > 0, top.cell_size_m, settings)
    edges = (_pixels if arguments.method == "pixels" else _lines)(top, image, settings)
    if len(edges) == 0:
        raise InputError(
            "no road edge found",
            where=arguments.top,
            found=f"{image.road.sum() * top.cell_size_m**2:.0f} m2 of road after cleaning",
            hint="lower smallest_road_m2, or check the road class of the cloud",
        )
    log.info(
        "%d edge points of %.0f m2 of road, closed by %d cells",
        len(edges),
        image.road.sum() * top.cell_size_m**2,
        image.closing,
    )
    about = {"cell_size_m": top.cell_size_m, "method": arguments.method, "settings": vars(settings)}
    write_table(arguments.edges, edges, about)
    write_layers(arguments.lines, {"road_edges": _layer(edges)}, frame)


def _lines(top: TopRaster, image: RoadImage, settings: EdgeSettings) -> pd.DataFrame:
    """Edge points between the pixels, along polylines with the direction of each."""
    level = edge_level(top.road_share, top.cls > 0, image)
    rings = outlines(image, level, settings.window_cells(image, top.cell_size_m))
    return _table(top, edge_lines(rings, image, top.cell_size_m, settings))


def _pixels(top: TopRaster, image: RoadImage, settings: EdgeSettings) -> pd.DataFrame:
    """Edge pixels' centres; they belong to no line and have no direction."""
    place = np.argwhere(edge_pixels(image, settings.border_cells)).astype(np.float64)
    no_line = np.full(len(place), -1, np.int32)
    return _table(top, EdgeLines(place, np.full(place.shape, np.nan), no_line))


def _table(top: TopRaster, lines: EdgeLines) -> pd.DataFrame:
    x, y = top.xy_m(*lines.place.T).T
    z = surface_heights(lines.place, top.height_m, np.isin(top.cls, (ROAD, BRIDGE)))
    columns = {"x": x, "y": y, "z": z, "polyline": lines.polyline}
    columns |= {"tangent_x": lines.tangent[:, 1], "tangent_y": -lines.tangent[:, 0]}
    edges = pd.DataFrame(columns)
    bare = edges["z"].isna()
    if bare.any():
        log.warning("%d edge points without road near are left out", bare.sum())
    return edges[~bare].reset_index(drop=True)


def _layer(edges: pd.DataFrame) -> gpd.GeoDataFrame:
    """Lines, or points where there are none."""
    xyz = edges[["x", "y", "z"]].to_numpy()
    if (edges["polyline"] < 0).all():
        return gpd.GeoDataFrame({"cls": ROAD}, geometry=shapely.points(xyz), index=range(len(xyz)))
    numbers, first = np.unique(edges["polyline"], return_index=True)
    parts = zip(numbers, np.split(xyz, first[1:]), strict=True)
    lines = {number: shapely.LineString(part) for number, part in parts if len(part) > 1}
    return gpd.GeoDataFrame(
        {"polyline": list(lines), "length_m": [line.length for line in lines.values()]},
        geometry=list(lines.values()),
    )


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("top", "frame", "edges", "lines"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--method", choices=METHODS, default="contours")
    for field in fields(EdgeSettings):
        kind = int if isinstance(field.default, int) else float
        parser.add_argument(f"--{field.name.replace('_', '-')}", type=kind, default=field.default)
    return run_stage(parser, extract_road_edges, argv)


if __name__ == "__main__":
    sys.exit(main())
