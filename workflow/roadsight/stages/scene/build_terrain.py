"""Triangulated terrain of ground and road points (paper 2, section 3.2.1)."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated

import numpy as np

from roadsight.base.errors import InputError
from roadsight.base.sections.poles import RoadClasses, TerrainMesh
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.records.scene_tables import write_terrain
from roadsight.io.records.tables import read_table
from roadsight.scene.classes import BRIDGE, GROUND, ROAD, class_table
from roadsight.scene.terrain.tin import add_cells, cell_means, sum_cells, triangulate
from roadsight.stages.command import Command, logged

log = logging.getLogger("build_terrain")

_MERGE_EVERY = 64
"""Tiles whose sums wait until they are added up: bounds the memory. Sums are whole numbers, so that
the result does not depend on it."""


def build_terrain(
    cloud_path: Path,
    classes: RoadClasses,
    mesh: TerrainMesh,
    ground_path: Annotated[Path | None, "ground labels; class 2 of the cloud if not given"] = None,
    longest_m: Annotated[float, "longest side of a triangle at the outside"] = 30.0,
    *,
    out: Path,
) -> None:
    """Thin ground and road points to one per cell, tile by tile, and triangulate them."""
    cloud = CloudTiles(cloud_path)
    table = class_table(classes.road_classes, classes.bridge_classes)
    ground = _ground_labels(ground_path, cloud)
    starts = np.cumsum([0, *(tile.rows for tile in cloud.tiles)])
    parts = []
    for number in logged(range(len(cloud.tiles)), len(cloud.tiles), log, "tiles"):
        points = cloud.read(("x", "y", "z", "classification"), [number])
        cls = table[points["classification"]]
        is_road = (cls == ROAD) | (cls == BRIDGE)
        is_ground = cls == GROUND if ground is None else ground[starts[number] : starts[number + 1]]
        used = is_road | is_ground
        parts.append(sum_cells(stack_xyz(points)[used], is_road[used], mesh.terrain_cell_m))
        if len(parts) == _MERGE_EVERY:
            parts = [add_cells(parts)]
    terrain = triangulate(cell_means(add_cells(parts)), longest_m)
    log.info("%d vertices, %d triangles", len(terrain.vertices), len(terrain.triangles))
    write_terrain(out, terrain)


def _ground_labels(path: Path | None, cloud: CloudTiles) -> np.ndarray | None:
    """Ground labels (points,) in the cloud's order, or None to go by the cloud's classes."""
    if path is None:
        return None
    labels = read_table(path, ["ground"])["ground"].to_numpy()
    if len(labels) != cloud.points:
        raise InputError(
            "are not the ground labels of this cloud",
            where=str(path),
            found=f"{len(labels)} points",
            allowed=cloud.points,
            hint="delete it and run the workflow again",
        )
    return labels


main = Command(build_terrain)


if __name__ == "__main__":
    sys.exit(main())
