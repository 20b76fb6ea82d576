"""Candidate positions and heights on the regular spacing."""

from __future__ import annotations

import logging
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree
from shapely import MultiPolygon

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.placement import Candidates
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.io.vector.known import read_mounts
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vectors import read_layer, read_polygons
from roadsight.placement.candidates.candidates import (
    REACH_M,
    has_measured_ground,
    lane_doubts,
    positions_along,
    stack_candidates,
)
from roadsight.placement.candidates.mounting import POLE, outside_zones, positions_on_poles
from roadsight.stages.command import Command, tell

log = logging.getLogger("place_candidates")

_AROUND_M = 0.2
"""Cubes to which the surroundings of positions are thinned: a fraction of a wall's thickness."""
COLUMNS = [
    *("candidate", "key", "edge", "mount", "station_m"),
    *("x", "y", "z", "height_m", "ground_z_m", "yaw_deg", "off_pavement_m", "wall_m"),
]


@dataclass(frozen=True)
class CandidateFiles:
    """What candidates are placed by, in any round."""

    edges: Path
    pavement: Path
    dem: Path
    cloud: Path
    frame: Path
    settings: Candidates
    zones: Annotated[str | None, "polygons in which no sensor may stand"] = None
    mounts: Annotated[str | None, "existing poles that may carry sensors"] = None
    ground: Annotated[Path | None, "which points are ground; unknown if absent"] = None
    overhead_cover: Literal["simulate", "skip"] = "simulate"


def place_candidates(
    site: str,
    given: CandidateFiles,
    *,
    doubts_path: Annotated[Path, "what the candidates rest on"],
    out: Path,
) -> None:
    """Write the candidates of round 0; edges in the lanes are refused."""
    frame = Frame.from_dict(read_json(given.frame))
    edges, pavement = read_road(given.edges, given.pavement, frame)
    positions = allowed_positions(
        positions_along(edges, pavement, given.settings.spacing_m), pavement, given, frame
    )
    candidates = candidates_at(positions, given, given.settings, frame, pavement)
    if candidates.empty:
        raise InputError(
            "no candidate: every position along the edges is obstructed, without measured ground or"
            " off the terrain model",
            where=f"site {site}",
            found=f"{len(positions)} positions",
            hint="move the edges (edges.offset_m, placement.edges), make the zones without sensors"
            " smaller (placement.zones) or widen the height range",
        )
    doubts = lane_doubts(candidates, positions, pavement, given.settings)
    tell(doubts, doubts_path, f"site {site}", log)
    log.info("%d candidates at %d positions", len(candidates), candidates["key"].nunique())
    write_table(out, candidates[COLUMNS])


def allowed_positions(
    positions: pd.DataFrame, pavement: MultiPolygon, given: CandidateFiles, frame: Frame
) -> pd.DataFrame:
    """Positions along the edges and on existing poles, without those in zones for no sensor."""
    if given.mounts:
        poles = read_mounts(given.mounts, frame)
        places = poles[["x", "y"]].to_numpy(np.float64)
        tell_near(log, "existing poles", places, read_json(given.frame), given.mounts)
        hung = positions_on_poles(poles, pavement, given.settings.arm_m)
        positions = pd.concat([positions, hung], ignore_index=True)
    if not given.zones:
        return positions
    zones = list(read_polygons(given.zones, frame).geometry)
    tell_near(log, "zones", np.array(zones, object), read_json(given.frame), given.zones)
    free = outside_zones(positions[["x", "y"]].to_numpy(np.float64), zones)
    log.info("%d of %d positions lie in zones without sensors", (~free).sum(), len(positions))
    return positions[free].reset_index(drop=True)


def read_road(
    edges: Path, pavement_path: Path, frame: Frame
) -> tuple[gpd.GeoDataFrame, MultiPolygon]:
    """Edges and pavement in local metres."""
    pavement = read_layer(pavement_path, "pavement", frame)
    return read_layer(edges, "edges", frame), MultiPolygon(list(pavement.geometry))


def candidates_at(
    positions: pd.DataFrame,
    given: CandidateFiles,
    settings: Candidates,
    frame: Frame,
    pavement: MultiPolygon,
) -> pd.DataFrame:
    """Candidates at every free height of the given positions, where a mast can be built."""
    dem = read_raster(given.dem, frame)
    xy = positions[["x", "y"]].to_numpy(np.float64)
    off_m = np.full(len(xy), np.inf)
    if not pavement.is_empty:
        off_m = shapely.distance(shapely.points(xy), pavement)
    positions = positions.assign(ground_z_m=dem.sample(*xy.T), off_pavement_m=off_m)
    near = _points_near(given.cloud, given.ground, xy, settings.search_radius_m)
    if near.ground_xy_m is not None:
        standing = (positions["mount"] == POLE).to_numpy()
        built = standing | has_measured_ground(xy, near.ground_xy_m)
        log.info("%d of %d positions have no measured ground", (~built).sum(), len(built))
        positions, xy = positions[built].reset_index(drop=True), xy[built]
    points = near.xyz_m
    # Heights are above the ground at the position itself, where the pole would stand.
    nearest = cKDTree(xy).query(points[:, :2])[1] if len(points) and len(xy) else []
    heights = points[:, 2] - positions["ground_z_m"].to_numpy()[np.asarray(nearest, np.int64)]
    roofs = given.overhead_cover == "simulate"
    return stack_candidates(positions, points, heights, settings, near.around_xyz_m, roofs)


@dataclass(frozen=True)
class _Near:
    """Points near positions: those that obstruct them, thinned ones around, ground if known."""

    xyz_m: Floats
    around_xyz_m: Floats
    ground_xy_m: Floats | None


def _points_near(
    cloud_path: Path, ground_path: Path | None, xy_m: Floats, radius_m: float
) -> _Near:
    """Points of the cloud within plan distances of any position."""
    cloud = CloudTiles(cloud_path)
    labels = read_table(ground_path)["ground"].to_numpy() if ground_path else None
    tree = cKDTree(xy_m)
    starts = np.cumsum([0, *(tile.rows for tile in cloud.tiles)])
    parts, rings, grounds = [np.empty((0, 3))], [np.empty((0, 3))], [np.empty((0, 2))]
    for number, tile in enumerate(cloud.tiles):
        xyz = stack_xyz(cloud.read(("x", "y", "z"), [number])).astype(np.float64)
        # A hair more, so that points at the radius itself are kept.
        reach_m = max(radius_m, REACH_M) * (1 + 1e-9)
        distance, _ = tree.query(xyz[:, :2], distance_upper_bound=reach_m)
        parts.append(xyz[distance <= radius_m * (1 + 1e-9)])
        around = np.isfinite(distance)
        rings.append(_thinned(xyz[around]))
        if labels is not None:
            ground = labels[starts[number] : starts[number] + tile.rows] & around
            grounds.append(xyz[ground][:, :2])
    known = None if labels is None else np.concatenate(grounds)
    return _Near(np.concatenate(parts), np.concatenate(rings), known)


def _thinned(xyz_m: Floats) -> Floats:
    """The first point of each cube of 0.2 m: enough to show walls and roofs."""
    cells = np.floor(xyz_m / _AROUND_M).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return xyz_m[np.sort(first)]


main = Command(place_candidates)


if __name__ == "__main__":
    sys.exit(main())
