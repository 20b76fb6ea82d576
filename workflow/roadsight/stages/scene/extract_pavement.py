"""The monitored area: found from smooth ground or given by the user."""

from __future__ import annotations

import argparse
import logging
import sys
from dataclasses import fields

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from shapely import MultiPolygon

from roadsight.base.engines import ENGINES
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vectors import read_polygons, write_layers
from roadsight.scene.pavement.outline import (
    PavementSettings,
    inside,
    outline_pavement,
    pavement_settings_for,
)
from roadsight.stages.command import run_stage

log = logging.getLogger("extract_pavement")


def extract_pavement(arguments: argparse.Namespace) -> None:
    """Write the pavement's polygons and its points."""
    about = read_json(arguments.frame)
    frame = Frame.from_dict(about)
    if arguments.tma:
        outline = _users_area(arguments.tma, frame)
        told = "polygons of the monitored area"
        tell_near(log, told, np.array(outline.geoms, object), about, arguments.tma)
        source = "user"
    else:
        outline = _found_area(arguments)
        source = "fpfh"
    points = _pavement_points(arguments, outline)
    if len(points) == 0:
        raise InputError(
            "no ground points inside the monitored area",
            where=arguments.tma or f"site {arguments.site}",
            hint="check the polygon's CRS and position",
        )
    parts = list(outline.geoms)
    layer = gpd.GeoDataFrame(
        {"part": range(len(parts)), "area_m2": [part.area for part in parts], "source": source},
        geometry=parts,
    )
    log.info("%d parts, %.0f m2, %d points", len(parts), outline.area, len(points))
    write_layers(arguments.pavement, {"pavement": layer}, frame)
    write_table(arguments.points, points, {"source": source, "area_m2": outline.area})


def _users_area(path: str, frame: Frame) -> MultiPolygon:
    area = shapely.union_all(read_polygons(path, frame).geometry.to_numpy())
    parts = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon"]
    return MultiPolygon(sorted(parts, key=lambda part: -part.area))


def _found_area(arguments: argparse.Namespace) -> MultiPolygon:
    columns = read_table(arguments.clusters)
    size_m = read_about(arguments.clusters)["voxel_size_m"]
    names = [field.name for field in fields(PavementSettings) if hasattr(arguments, field.name)]
    settings = PavementSettings(**{name: getattr(arguments, name) for name in names})
    settings = pavement_settings_for(size_m, settings)
    xyz, engine = columns[["x", "y", "z"]].to_numpy(np.float64), arguments.cluster_engine
    try:
        return outline_pavement(xyz, columns["smooth"].to_numpy(), settings, engine)
    except InputError as error:
        raise InputError(str(error), where=f"site {arguments.site}") from error


def _pavement_points(arguments: argparse.Namespace, outline: MultiPolygon) -> pd.DataFrame:
    """Ground points inside the outline, float32 local metres, in the cloud's order."""
    cloud = CloudTiles(arguments.cloud)
    ground = read_table(arguments.ground)["ground"].to_numpy()
    starts = np.cumsum([0, *(tile.rows for tile in cloud.tiles)])
    parts = []
    for number, tile in enumerate(cloud.tiles):
        mask = ground[starts[number] : starts[number] + tile.rows]
        xyz = stack_xyz(cloud.read(("x", "y", "z"), [number]))[mask]
        parts.append(xyz[inside(outline, xyz[:, 0], xyz[:, 1])])
    return pd.DataFrame(np.concatenate(parts), columns=["x", "y", "z"])


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("site", "cloud", "frame", "ground", "clusters", "pavement", "points"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--tma", nargs="?", help="polygon file of the monitored area")
    parser.add_argument("--cluster-distance-m", type=float, default=0.2)
    parser.add_argument("--vote-radius-m", type=float, default=0.5)
    parser.add_argument("--outline-cell-m", type=float, default=0.25)
    parser.add_argument("--closing-m", type=float, default=1.0)
    parser.add_argument("--smallest-hole-m2", type=float, default=20.0)
    parser.add_argument("--smallest-part-share", type=float, default=0.2)
    parser.add_argument("--cluster-engine", choices=ENGINES, default="own")
    return run_stage(parser, extract_pavement, argv)


if __name__ == "__main__":
    sys.exit(main())
