"""The monitored area: found as one surface or from smooth ground, or given by the user."""

from __future__ import annotations

import logging
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from shapely import MultiPolygon

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.doubts import Doubt
from roadsight.base.engines import Engine
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Pavement, PavementOutline
from roadsight.geometry.areas import inside
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, in_bounds, stack_xyz
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.io.vector.known import read_seeds, read_track
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vectors import read_lines, read_polygons, write_layers
from roadsight.scene.pavement.choice import Choice, choose_method
from roadsight.scene.pavement.hidden_ground import to_what_stands
from roadsight.scene.pavement.outline import outline_pavement, pavement_settings_for
from roadsight.scene.pavement.pavement_doubts import PavementFacts, pavement_doubts
from roadsight.scene.pavement.road_surface import KnownRoad
from roadsight.scene.terrain.terrain import Bounds
from roadsight.scene.whole import road_of, sharpen
from roadsight.stages.command import Command, tell

log = logging.getLogger("extract_pavement")


_HALO_M = 5.0
"""Ground around a tile that is looked at with it: a step is compared with three metres around."""


@dataclass(frozen=True)
class _Found:
    """A pavement and how it was found.

    Parameters
    ----------
    points : (n,) which points of the cloud lie on it, or None: ground inside the outline.
    layer_m, open_share, unsure_share : as the method met them, NaN where they are still to be
        measured, or unknown.
    """

    outline: MultiPolygon
    method: str
    doubts: list[Doubt]
    points: Bools | None = None
    layer_m: float = math.nan
    open_share: float = math.nan
    unsure_share: float = math.nan


@dataclass(frozen=True)
class Way:
    """How the pavement is found, and what each way goes by."""

    outline: PavementOutline
    method: Annotated[str, Pavement]
    intensity: Annotated[str, Pavement]
    cluster_engine: Annotated[Engine, Pavement]
    tma: Annotated[str | None, "polygon file of the monitored area"] = None
    profile: Annotated[Path | None, "what auto decides by"] = None
    clusters: Annotated[Path | None, "published: smooth and rough ground"] = None
    seeds: Annotated[str, "surface: places on the road, x,y;x,y"] = ""
    track: Annotated[str | None, "surface: line file, where a vehicle drove"] = None
    track_crs: Annotated[str | None, "its CRS if the file names none"] = None
    edges: Annotated[str | None, "surface: digitised edges, any vector format"] = None
    edges_crs: Annotated[str | None, "their CRS if the file names none"] = None


def extract_pavement(
    site: str,
    cloud_path: Path,
    frame_path: Path,
    ground_path: Path,
    way: Way,
    *,
    pavement: Path,
    points_path: Path,
    doubts_path: Annotated[Path | None, "what the pavement rests on"] = None,
) -> None:
    """Write the pavement's polygons and its points."""
    about = read_json(frame_path)
    frame = Frame.from_dict(about)
    cloud = CloudTiles(cloud_path)
    ground = read_table(ground_path)["ground"].to_numpy()
    found = _found(site, way, cloud, ground, frame, about)
    points, facts = _pavement_points(cloud, ground, found, bool(doubts_path))
    outline = found.outline
    if len(points) == 0:
        raise InputError(
            "no ground points inside the monitored area",
            where=way.tma or f"site {site}",
            hint="check the polygon's CRS and position",
        )
    if doubts_path:
        layer_m, open_share = found.layer_m, found.open_share
        if found.method == "published":
            layer_m, open_share = facts.layer_m, facts.open_m / max(facts.outline_m, 1e-9)
        track_xy = read_track(way.track, frame, way.track_crs)
        doubts = pavement_doubts(
            outline, found.method, facts, layer_m, open_share, track_xy, found.unsure_share
        )
        tell([*found.doubts, *doubts], doubts_path, f"site {site}", log)
    source = _SOURCE[found.method]
    parts = list(outline.geoms)
    layer = gpd.GeoDataFrame(
        {"part": range(len(parts)), "area_m2": [part.area for part in parts], "source": source},
        geometry=parts,
    )
    log.info("%d parts, %.0f m2, %d points", len(parts), outline.area, len(points))
    write_layers(pavement, {"pavement": layer}, frame)
    write_table(points_path, points, {"source": source, "area_m2": outline.area})


_SOURCE = {"user": "user", "surface": "surface", "published": "fpfh", "sharpened": "fpfh, surface"}
"""What the layer says of where its polygons come from."""


def _found(
    site: str, way: Way, cloud: CloudTiles, ground: Bools, frame: Frame, about: dict[str, Any]
) -> _Found:
    """The pavement by the user's polygon, as one surface, or by FPFH and k-means.

    Raises
    ------
    InputError : none is found.
    """
    if way.tma:
        area = shapely.union_all(read_polygons(way.tma, frame).geometry.to_numpy())
        polygons = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon"]
        outline = MultiPolygon(sorted(polygons, key=lambda part: -part.area))
        told = "polygons of the monitored area"
        tell_near(log, told, np.array(outline.geoms, object), about, way.tma)
        return _Found(outline, "user", [])
    profile = read_json(way.profile) if way.profile else {"extent_m": [0.0, 0.0]}
    choice = choose_method(way.method, bool(way.seeds), profile)
    log.info("%s: %s", choice.method, choice.why)
    try:
        if choice.method == "surface":
            return _surface(way, cloud, frame, about, choice)
        outline, column_m = _published(way)
        found = _Found(outline, "published", [choice.told()])
        if way.method == "auto":
            found = _sharpened(way, cloud, found)
            if found.method == "published":
                return _to_what_stands(cloud, ground, found, column_m, way)
        return found
    except InputError as error:
        raise InputError(str(error), where=f"site {site}") from error


def _surface(
    way: Way, cloud: CloudTiles, frame: Frame, about: dict[str, Any], choice: Choice
) -> _Found:
    """The road as one surface, with all that is known of it."""
    xyz_m, intensity, points = _whole(way, cloud)
    known = KnownRoad(
        read_track(way.track, frame, way.track_crs),
        read_seeds(way.seeds, frame, "pavement.seeds"),
        _edges(way, frame, about),
    )
    road, surface = road_of(
        xyz_m,
        intensity,
        points["scan"].astype(np.int64) if "scan" in points else None,
        known,
        classes=points["classification"],
    )
    seeded = {"scans": "the blind discs of the scans", "ground": "the smoothest ground"}
    doubts = [
        choice.told(),
        Doubt(
            "pavement_seeds",
            "note",
            f"grown from {seeded.get(surface.seeded_by, surface.seeded_by)}",
        ),
    ]
    if surface.seeded_by == "ground":
        text = "nothing says where the road is: give pavement.seeds or placement.track"
        doubts.append(Doubt("pavement_unseeded", "doubt", text))
    if surface.seam_m:
        text = (
            "turns of the scanner do not close: heights differ where they begin and end (taken out"
            " where the pavement is sought, not in ground and depth maps; register the scans again)"
        )
        doubts.append(Doubt("scans_open", "doubt", text, round(surface.seam_m, 3)))
    met = surface.layer_m, surface.open_share, surface.unsure_share
    return _Found(road.outline, "surface", doubts, road.points, *met)


def _whole(way: Way, cloud: CloudTiles) -> tuple[Floats, Floats | None, dict[str, NDArray[Any]]]:
    """Points (n, 3), their intensity where it is used and varies, and the other columns."""
    names = ["x", "y", "z", "intensity", "classification"]
    points = cloud.read(names + (["scan"] if "scan" in cloud.columns else []))
    use = way.intensity != "ignore" and len(np.unique(points["intensity"][:100_000])) > 1
    intensity = points["intensity"].astype(np.float64) if use else None
    xyz_m = stack_xyz(points).astype(np.float64)
    return xyz_m, intensity, {name: column for name, column in points.items() if name not in "xyz"}


def _sharpened(way: Way, cloud: CloudTiles, found: _Found) -> _Found:
    """Smooth ground with sharper edges, where the surface that runs on from it agrees with it."""
    xyz_m, intensity, points = _whole(way, cloud)
    sharp = sharpen(found.outline, xyz_m, intensity, classes=points["classification"])
    if sharp is None:
        text = "its edges are as smooth ground has them: too narrow or too wide for one surface"
        return replace(found, doubts=[*found.doubts, Doubt("pavement_sharpened", "note", text)])
    if not sharp.agrees:
        measured, limit = sharp.weakest
        text = (
            "two ways to find the pavement disagree; that of FPFH and k-means is kept (look at it"
            " on the map; give pavement.seeds or draw it where it is wrong). Share that both find"
        )
        doubt = Doubt("pavement_ways_differ", "doubt", text, round(measured, 3), limit)
        return replace(found, doubts=[*found.doubts, doubt])
    text = "its edges are where the surface from its middle ends; share of it that this keeps"
    note = Doubt("pavement_sharpened", "note", text, round(sharp.kept, 3))
    surface = sharp.surface
    met = surface.layer_m, surface.open_share, surface.unsure_share
    return _Found(sharp.road.outline, "sharpened", [*found.doubts, note], sharp.road.points, *met)


def _to_what_stands(
    cloud: CloudTiles, ground: Bools, found: _Found, column_m: float, way: Way
) -> _Found:
    """Smooth ground up to what hides its edge."""
    starts = _starts(cloud)
    outline, share = to_what_stands(
        found.outline,
        lambda bounds: _points_within(cloud, ground, starts, bounds),
        column_m,
        way.outline.smallest_hole_m2,
    )
    if share == 0:
        return found
    text = "its edge is hidden and taken to be at a wall or crown, or behind a parked car: share"
    note = Doubt("pavement_edge_hidden", "note", text, round(share, 3))
    return replace(found, outline=outline, doubts=[*found.doubts, note])


def _edges(way: Way, frame: Frame, about: dict[str, Any]) -> list[shapely.Geometry]:
    """Digitised edges, which the road ends at."""
    if not way.edges:
        return []
    lines = read_lines(way.edges, frame, way.edges_crs).geometry.to_numpy()
    tell_near(log, "edges", lines, about, way.edges)
    return list(lines)


def _published(way: Way) -> tuple[MultiPolygon, float]:
    """Outline of the smooth ground that `cluster_fpfh` found, and the size of its columns."""
    if not way.clusters:
        raise InputError("lacks the classes of the ground", where="--clusters")
    columns = read_table(way.clusters)
    about = read_about(way.clusters)
    column_m = float(about["voxel_size_m"])
    settings = pavement_settings_for(column_m, way.outline, about["thinning"])
    xyz = columns[["x", "y", "z"]].to_numpy(np.float64)
    smooth = columns["smooth"].to_numpy()
    return outline_pavement(xyz, smooth, settings, way.cluster_engine), column_m


def _pavement_points(
    cloud: CloudTiles, ground: Bools, found: _Found, with_rim: bool
) -> tuple[pd.DataFrame, PavementFacts]:
    """Points on the pavement, float32 local metres, in the cloud's order; and what they tell."""
    starts = _starts(cloud)
    parts, facts = [], PavementFacts()
    size = cloud.tile_size_m
    told = [name for name in ("classification", "scan") if name in cloud.columns]
    for number, tile in enumerate(cloud.tiles):
        rows = slice(starts[number], starts[number + 1])
        points = cloud.read(("x", "y", "z", *told), [number])
        xyz, low = stack_xyz(points), ground[rows]
        exact = xyz.astype(np.float64)
        on = inside(found.outline, exact[:, 0], exact[:, 1])
        taken = on & low if found.points is None else found.points[rows]
        parts.append(xyz[taken])
        scan = points["scan"].astype(np.int64) if "scan" in points else None
        facts.add_points(exact, points.get("classification"), low | taken, on, scan)
        if with_rim and found.method == "published":
            west, south = tile.ix * size, tile.iy * size
            core = (west, south, west + size, south + size)
            halo = (west - _HALO_M, south - _HALO_M, core[2] + _HALO_M, core[3] + _HALO_M)
            around, is_ground = _points_within(cloud, ground, starts, halo)
            facts.add_rim(around[is_ground], found.outline, core)
    return pd.DataFrame(np.concatenate(parts), columns=["x", "y", "z"]), facts


def _starts(cloud: CloudTiles) -> Ints:
    """Row of the cloud at which each tile begins."""
    return np.cumsum([0, *(tile.rows for tile in cloud.tiles)])


def _points_within(
    cloud: CloudTiles, ground: Bools, starts: Ints, bounds: Bounds
) -> tuple[Floats, Bools]:
    """Points (n, 3) of the cloud within bounds, and which are ground."""
    west, south, east, north = bounds
    parts, labels = [], []
    for number, tile in enumerate(cloud.tiles):
        low_x, low_y, _, high_x, high_y, _ = tile.bounds_m
        if low_x > east or high_x < west or low_y > north or high_y < south:
            continue
        xyz = stack_xyz(cloud.read(("x", "y", "z"), [number])).astype(np.float64)
        near = in_bounds(xyz[:, 0], xyz[:, 1], bounds)
        parts.append(xyz[near])
        labels.append(ground[starts[number] : starts[number + 1]][near])
    return np.concatenate([np.empty((0, 3)), *parts]), np.concatenate([np.zeros(0, bool), *labels])


main = Command(extract_pavement)


if __name__ == "__main__":
    sys.exit(main())
