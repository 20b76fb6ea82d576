"""Pole-like targets on the pavement."""

from __future__ import annotations

import argparse
import logging
import sys

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from shapely import LineString, MultiPolygon

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.options import add_settings
from roadsight.config.sections.sensing import Targets
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.io.vector.vectors import read_layer, write_layers
from roadsight.placement.candidates.examined import (
    at_least_inside,
    examined_areas_m2,
    road_within,
)
from roadsight.placement.candidates.targets import headings_along, place_targets, points_needed
from roadsight.placement.plans.plan_doubts import target_doubts
from roadsight.stages.command import run_stage
from roadsight.stages.doubts import tell

log = logging.getLogger("place_targets")

LOCAL = "local"
"""Settings that follow the local density of the cloud."""


def write_targets(arguments: argparse.Namespace) -> None:
    """Write the targets, what pavement each stands for, and the pavement without any."""
    points = read_table(arguments.pavement, ["x", "y", "z"])
    local = arguments.min_points == LOCAL
    needed = points_needed(arguments.width_m, arguments.cell_size_m)
    least = needed if local else int(arguments.min_points)
    targets = place_targets(points.to_numpy(), arguments.cell_size_m, least, local)
    frame = Frame.from_dict(read_json(arguments.frame))
    outline = _outline(arguments.outline, frame)
    edges = read_layer(arguments.edges[0], "edges", frame) if arguments.edges else None
    digitised = [] if edges is None else list(edges.geometry[edges["source"] == "digitised"])
    road = road_within(outline, digitised)
    given = read_about(arguments.pavement).get("source") == "user"
    inset_m = _insets_m(arguments, targets, given)
    xy_m = targets[["x", "y"]].to_numpy(np.float64)
    on_road = at_least_inside(road, xy_m, inset_m)
    inside = targets[on_road].reset_index(drop=True)
    cells = np.floor(inside[["x", "y"]].to_numpy(np.float64) / arguments.cell_size_m)
    columns_rows = cells[:, 0].astype(np.int64), cells[:, 1].astype(np.int64)
    rim_m = float(np.median(inset_m)) if len(inset_m) else 0.0
    inside["area_m2"], left = examined_areas_m2(
        inside, columns_rows, outline, arguments.cell_size_m, max(rim_m, 0.0)
    )
    if arguments.box:
        feet_xy_m = inside[["x", "y"]].to_numpy(np.float64)
        inside["heading_rad"] = headings_along(_lines(edges, arguments), feet_xy_m)
    examined_m2 = float(inside["area_m2"].sum())
    log.info(
        "%d targets on %d pavement points examine %.0f of %.0f m2; %d more stand off the road or"
        " too near its edge",
        len(inside),
        len(points),
        examined_m2,
        outline.area,
        len(targets) - len(inside),
    )
    about = {
        "cell_size_m": arguments.cell_size_m,
        "min_points": least,
        "pavement_area_m2": float(outline.area),
        "examined_area_m2": examined_m2,
    }
    if arguments.doubts:
        doubts = target_doubts(len(inside), examined_m2, float(outline.area))
        tell(doubts, arguments.doubts, f"pavement {arguments.outline}", log)
    write_table(arguments.out, inside, about)
    if not arguments.unexamined:
        return
    parts = list(left.geoms)
    layer = gpd.GeoDataFrame({"area_m2": [part.area for part in parts]}, geometry=parts)
    write_layers(arguments.unexamined, {"unexamined": layer}, frame, {"unexamined": "Polygon"})


def _insets_m(arguments: argparse.Namespace, targets: pd.DataFrame, given: bool) -> Floats:
    """How far inside the outline each target stands at least (n,).

    An outline that was found is known to a spacing of its points; one that was given, exactly.
    """
    if arguments.inset_m != LOCAL:
        return np.full(len(targets), float(arguments.inset_m))
    return np.zeros(len(targets)) if given else targets["spacing_m"].to_numpy(np.float64)


def _lines(edges: gpd.GeoDataFrame | None, arguments: argparse.Namespace) -> list[LineString]:
    if edges is None:
        raise InputError("boxes stand along edges, which are missing", where=arguments.out)
    return list(edges.geometry)


def _outline(path: str, frame: Frame) -> MultiPolygon:
    parts = shapely.get_parts(read_layer(path, "pavement", frame).geometry.to_numpy())
    return shapely.multipolygons(parts)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pavement", required=True, help="pavement points")
    parser.add_argument("--outline", required=True, help="pavement polygons")
    parser.add_argument("--frame", required=True)
    parser.add_argument("--edges", nargs="*", default=[], help="that bound the road")
    parser.add_argument("--box", type=float, nargs=3, help="targets are boxes, which have headings")
    add_settings(parser, Targets, "inset_m", "min_points")
    add_settings(parser, Targets, "cell_size_m")
    parser.add_argument("--width-m", type=float, default=0.5, help="of a target")
    parser.add_argument("--unexamined", help="polygons without targets")
    parser.add_argument("--doubts", help="JSON with what the targets rest on")
    parser.add_argument("--out", required=True)
    return run_stage(parser, write_targets, argv)


if __name__ == "__main__":
    sys.exit(main())
