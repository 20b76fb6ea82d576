"""Candidate positions and heights on the regular spacing."""

from __future__ import annotations

import argparse
import logging
import sys

import geopandas as gpd
import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from shapely import MultiPolygon

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import write_table
from roadsight.io.vector.mount_files import read_mounts
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vectors import read_layer, read_polygons
from roadsight.placement.candidates.candidates import HeightSettings, stack_candidates
from roadsight.placement.candidates.positions import positions_along
from roadsight.placement.candidates.sites_for_sensors import outside_zones, positions_on_poles
from roadsight.stages.command import run_stage

log = logging.getLogger("place_candidates")

COLUMNS = [
    *("candidate", "key", "edge", "mount", "station_m"),
    *("x", "y", "z", "height_m", "ground_z_m", "yaw_deg"),
]


def place_candidates(arguments: argparse.Namespace) -> None:
    """Write the candidates of round 0."""
    frame = Frame.from_dict(read_json(arguments.frame))
    edges, pavement = read_road(arguments, frame)
    positions = allowed_positions(
        positions_along(edges, pavement, arguments.spacing_m), pavement, arguments, frame
    )
    candidates = candidates_at(positions, arguments, frame, arguments.height_step_m)
    if candidates.empty:
        raise InputError(
            "no candidate: every position along the edges is obstructed or off the terrain model",
            where=f"site {arguments.site}",
            found=f"{len(positions)} positions",
            hint="move the edges (edges.offset_m, placement.edges), make the zones without sensors"
            " smaller (placement.zones) or widen the height range",
        )
    log.info("%d candidates at %d positions", len(candidates), candidates["key"].nunique())
    write_table(arguments.out, candidates[COLUMNS])


def allowed_positions(
    positions: pd.DataFrame, pavement: MultiPolygon, arguments: argparse.Namespace, frame: Frame
) -> pd.DataFrame:
    """Positions along the edges and on existing poles, without those in zones for no sensor."""
    if arguments.mounts:
        poles = read_mounts(arguments.mounts, frame)
        places = poles[["x", "y"]].to_numpy(np.float64)
        tell_near(log, "existing poles", places, read_json(arguments.frame), arguments.mounts)
        hung = positions_on_poles(poles, pavement, arguments.arm_m)
        positions = pd.concat([positions, hung], ignore_index=True)
    if not arguments.zones:
        return positions
    zones = list(read_polygons(arguments.zones, frame).geometry)
    tell_near(log, "zones", np.array(zones, object), read_json(arguments.frame), arguments.zones)
    free = outside_zones(positions[["x", "y"]].to_numpy(np.float64), zones)
    log.info("%d of %d positions lie in zones without sensors", (~free).sum(), len(positions))
    return positions[free].reset_index(drop=True)


def read_road(arguments: argparse.Namespace, frame: Frame) -> tuple[gpd.GeoDataFrame, MultiPolygon]:
    """Edges and pavement in local metres."""
    pavement = read_layer(arguments.pavement, "pavement", frame)
    return read_layer(arguments.edges, "edges", frame), MultiPolygon(list(pavement.geometry))


def candidates_at(
    positions: pd.DataFrame, arguments: argparse.Namespace, frame: Frame, height_step_m: float
) -> pd.DataFrame:
    """Candidates at every free height of the given positions."""
    settings = HeightSettings(
        arguments.height_min_m,
        arguments.height_max_m,
        height_step_m,
        arguments.search_radius_m,
        arguments.gap_factor,
        arguments.overhead_cover == "simulate",
    )
    dem = read_raster(arguments.dem, frame)
    positions = positions.assign(
        ground_z_m=dem.sample(positions["x"].to_numpy(), positions["y"].to_numpy())
    )
    xy = positions[["x", "y"]].to_numpy()
    points = _points_near(arguments.cloud, xy, settings.search_radius_m)
    # Heights are above the ground at the position itself, where the pole would stand.
    nearest = cKDTree(xy).query(points[:, :2])[1] if len(points) else np.empty(0, int)
    heights = points[:, 2] - positions["ground_z_m"].to_numpy()[nearest]
    return stack_candidates(positions, points, heights, settings)


def _points_near(cloud_path: str, xy_m: Floats, radius_m: float) -> Floats:
    """All points of the cloud within a plan distance of any position, (n, 3)."""
    cloud = CloudTiles(cloud_path)
    tree = cKDTree(xy_m)
    parts = [np.empty((0, 3))]
    for number in range(len(cloud.tiles)):
        xyz = stack_xyz(cloud.read(("x", "y", "z"), [number])).astype(np.float64)
        # A hair more, so that points at the radius itself are kept.
        distance, _ = tree.query(xyz[:, :2], distance_upper_bound=radius_m * (1 + 1e-9))
        parts.append(xyz[np.isfinite(distance)])
    return np.concatenate(parts)


def add_candidate_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that the regular and the denser candidates share."""
    for name in ("site", "edges", "pavement", "dem", "cloud", "frame", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--spacing-m", type=float, default=4.0)
    parser.add_argument("--height-min-m", type=float, default=4.0)
    parser.add_argument("--height-max-m", type=float, default=10.0)
    parser.add_argument("--height-step-m", type=float, default=0.5)
    parser.add_argument("--search-radius-m", type=float, default=0.5)
    parser.add_argument("--gap-factor", type=float, default=2.0)
    parser.add_argument("--zones", nargs="?", help="polygons in which no sensor may stand")
    parser.add_argument("--mounts", nargs="?", help="existing poles that may carry sensors")
    parser.add_argument("--arm-m", type=float, default=0.75, help="from a pole to its sensor")
    parser.add_argument("--overhead-cover", choices=["simulate", "skip"], default="simulate")


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_candidate_arguments(parser)
    return run_stage(parser, place_candidates, argv)


if __name__ == "__main__":
    sys.exit(main())
