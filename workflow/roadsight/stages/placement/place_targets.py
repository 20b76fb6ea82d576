"""Pole-like targets on the pavement."""

from __future__ import annotations

import argparse
import logging
import sys

import numpy as np
import shapely
from shapely import MultiPolygon

from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.io.vector.vectors import read_layer
from roadsight.placement.candidates.targets import headings_along, place_targets, standing_inside
from roadsight.stages.command import run_stage

log = logging.getLogger("place_targets")


def write_targets(arguments: argparse.Namespace) -> None:
    """Write the targets."""
    points = read_table(arguments.pavement, ["x", "y", "z"])
    targets = place_targets(points.to_numpy(), arguments.cell_size_m, arguments.min_points)
    frame = Frame.from_dict(read_json(arguments.frame))
    outline = _outline(arguments.outline, frame)
    inside = standing_inside(targets, outline, arguments.inset_m)
    if arguments.edges:
        edges = read_layer(arguments.edges[0], "edges", frame)
        xy_m = inside[["x", "y"]].to_numpy(np.float64)
        inside["heading_rad"] = headings_along(list(edges.geometry), xy_m)
    log.info(
        "%d targets on %d pavement points; %d more stand off it or too near its edge",
        len(inside),
        len(points),
        len(targets) - len(inside),
    )
    names = ("cell_size_m", "min_points", "inset_m")
    write_table(arguments.out, inside, {name: getattr(arguments, name) for name in names})


def _outline(path: str, frame: Frame) -> MultiPolygon:
    parts = shapely.get_parts(read_layer(path, "pavement", frame).geometry.to_numpy())
    return shapely.multipolygons(parts)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pavement", required=True, help="pavement points")
    parser.add_argument("--outline", required=True, help="pavement polygons")
    parser.add_argument("--frame", required=True)
    parser.add_argument("--edges", nargs="*", default=[], help="along which boxes stand")
    parser.add_argument("--inset-m", type=float, default=0.0)
    parser.add_argument("--cell-size-m", type=float, default=1.0)
    parser.add_argument("--min-points", type=int, default=25)
    parser.add_argument("--out", required=True)
    return run_stage(parser, write_targets, argv)


if __name__ == "__main__":
    sys.exit(main())
