"""Triangulated terrain of ground and road points (paper 2, section 3.2.1)."""

from __future__ import annotations

import argparse
import logging
import sys

import numpy as np

from roadsight.base.errors import InputError
from roadsight.base.options import add_settings
from roadsight.config.sections.poles import TerrainMesh, Voxels
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.records.tables import read_table
from roadsight.io.records.terrains import write_terrain
from roadsight.scene.classes import BRIDGE, GROUND, ROAD, class_table
from roadsight.scene.terrain.tin import add_cells, cell_means, sum_cells, triangulate
from roadsight.stages.command import run_stage
from roadsight.stages.progress import logged

log = logging.getLogger("build_terrain")

_MERGE_EVERY = 64
"""Tiles whose sums wait until they are added up: bounds the memory. Sums are whole numbers, so that
the result does not depend on it."""


def build_terrain(arguments: argparse.Namespace) -> None:
    """Thin ground and road points to one per cell, tile by tile, and triangulate them."""
    cloud = CloudTiles(arguments.cloud)
    table = class_table(arguments.road_classes, arguments.bridge_classes)
    ground = _ground_labels(arguments.ground, cloud)
    starts = np.cumsum([0, *(tile.rows for tile in cloud.tiles)])
    parts = []
    for number in logged(range(len(cloud.tiles)), len(cloud.tiles), log, "tiles"):
        points = cloud.read(("x", "y", "z", "classification"), [number])
        cls = table[points["classification"]]
        is_road = (cls == ROAD) | (cls == BRIDGE)
        is_ground = cls == GROUND if ground is None else ground[starts[number] : starts[number + 1]]
        used = is_road | is_ground
        parts.append(sum_cells(stack_xyz(points)[used], is_road[used], arguments.terrain_cell_m))
        if len(parts) == _MERGE_EVERY:
            parts = [add_cells(parts)]
    terrain = triangulate(cell_means(add_cells(parts)), arguments.longest_m)
    log.info("%d vertices, %d triangles", len(terrain.vertices), len(terrain.triangles))
    write_terrain(arguments.out, terrain)


def _ground_labels(path: str | None, cloud: CloudTiles) -> np.ndarray | None:
    """Ground labels (points,) in the cloud's order, or None to go by the cloud's classes."""
    if path is None:
        return None
    labels = read_table(path, ["ground"])["ground"].to_numpy()
    if len(labels) != cloud.points:
        raise InputError(
            "are not the ground labels of this cloud",
            where=path,
            found=f"{len(labels)} points",
            allowed=cloud.points,
            hint="delete it and run the workflow again",
        )
    return labels


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("cloud", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument(
        "--ground", nargs="?", help="ground labels; class 2 of the cloud if not given"
    )
    add_settings(parser, Voxels, "road_classes", "bridge_classes")
    add_settings(parser, TerrainMesh, "terrain_cell_m")
    parser.add_argument(
        "--longest-m", type=float, default=30.0, help="longest side of a triangle at the outside"
    )
    return run_stage(parser, build_terrain, argv)


if __name__ == "__main__":
    sys.exit(main())
