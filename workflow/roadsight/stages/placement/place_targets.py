"""Pole-like targets on the pavement."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.sensing import TargetGrid
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.io.vector.vectors import read_layer, write_layers
from roadsight.placement.candidates.targets import (
    at_least_inside,
    examined_areas_m2,
    headings_along,
    place_targets,
    points_needed,
    road_within,
)
from roadsight.placement.plans.plan_doubts import target_doubts
from roadsight.stages.command import Command, tell

log = logging.getLogger("place_targets")

LOCAL = "local"
"""Settings that follow the local density of the cloud."""


def write_targets(
    pavement: Annotated[Path, "pavement points"],
    outline_path: Annotated[Path, "pavement polygons"],
    frame_path: Path,
    grid: TargetGrid,
    width_m: Annotated[float, "of a target, whatever its kind"],
    edges_paths: Annotated[Sequence[Path], "that bound the road"] = (),
    box: Annotated[
        tuple[float, float, float] | None, "targets are boxes, which have headings"
    ] = None,
    *,
    unexamined: Annotated[Path | None, "polygons without targets"] = None,
    doubts_path: Annotated[Path | None, "what the targets rest on"] = None,
    out: Path,
) -> None:
    """Write the targets, what pavement each stands for, and the pavement without any."""
    points = read_table(pavement, ["x", "y", "z"])
    local = grid.min_points == LOCAL
    needed = points_needed(width_m, grid.cell_size_m)
    least = needed if local else int(grid.min_points)
    targets = place_targets(points.to_numpy(), grid.cell_size_m, least, local)
    frame = Frame.from_dict(read_json(frame_path))
    layer = read_layer(outline_path, "pavement", frame)
    outline = shapely.multipolygons(shapely.get_parts(layer.geometry.to_numpy()))
    edges = read_layer(edges_paths[0], "edges", frame) if edges_paths else None
    digitised = [] if edges is None else list(edges.geometry[edges["source"] == "digitised"])
    road = road_within(outline, digitised)
    given = read_about(pavement).get("source") == "user"
    insets_m = _insets_m(grid.inset_m, targets, given)
    xy_m = targets[["x", "y"]].to_numpy(np.float64)
    on_road = at_least_inside(road, xy_m, insets_m)
    inside = targets[on_road].reset_index(drop=True)
    cells = np.floor(inside[["x", "y"]].to_numpy(np.float64) / grid.cell_size_m)
    columns_rows = cells[:, 0].astype(np.int64), cells[:, 1].astype(np.int64)
    rim_m = float(np.median(insets_m)) if len(insets_m) else 0.0
    inside["area_m2"], left = examined_areas_m2(
        inside, columns_rows, outline, grid.cell_size_m, max(rim_m, 0.0)
    )
    if box:
        if edges is None:
            raise InputError("boxes stand along edges, which are missing", where=str(out))
        feet_xy_m = inside[["x", "y"]].to_numpy(np.float64)
        inside["heading_rad"] = headings_along(list(edges.geometry), feet_xy_m)
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
        "cell_size_m": grid.cell_size_m,
        "min_points": least,
        "pavement_area_m2": float(outline.area),
        "examined_area_m2": examined_m2,
    }
    if doubts_path:
        doubts = target_doubts(len(inside), examined_m2, float(outline.area))
        tell(doubts, doubts_path, f"pavement {outline_path}", log)
    write_table(out, inside, about)
    if not unexamined:
        return
    parts = list(left.geoms)
    layer = gpd.GeoDataFrame({"area_m2": [part.area for part in parts]}, geometry=parts)
    write_layers(unexamined, {"unexamined": layer}, frame, {"unexamined": "Polygon"})


def _insets_m(inset_m: float | str, targets: pd.DataFrame, given: bool) -> Floats:
    """How far inside the outline each target stands at least (n,).

    An outline that was found is known to a spacing of its points; one that was given, exactly.
    """
    if inset_m != LOCAL:
        return np.full(len(targets), float(inset_m))
    return np.zeros(len(targets)) if given else targets["spacing_m"].to_numpy(np.float64)


main = Command(write_targets)


if __name__ == "__main__":
    sys.exit(main())
