"""Sightings of all images become poles with errors."""

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
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints
from roadsight.base.doubts import tell_matches
from roadsight.base.sections.poles import Triangulation
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.raster.rasters import Raster, read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.io.records.text_tables import in_native, read_decisions, write_csv
from roadsight.io.vector.vectors import write_geojson, write_layers
from roadsight.poles.images.kinds import KINDS
from roadsight.poles.risk.roads import RouteTracks
from roadsight.poles.sightings.metric_depth import COLUMNS as NETWORK_COLUMNS
from roadsight.poles.sightings.metric_depth import network_scales, with_scales
from roadsight.poles.triangulate.cloud_objects import blocks_of, confirmed, guardrails_of, trees_of
from roadsight.poles.triangulate.pole_doubts import (
    are_filled,
    crown_doubts,
    drop_near_structures,
    far_reaching,
    network_doubts,
    panel_edges,
    pole_doubts,
    shares_above,
    withhold_by_height,
    withhold_filled,
    withhold_thin,
    withhold_under_crowns,
)
from roadsight.poles.triangulate.rays import TriangulationSettings
from roadsight.poles.triangulate.site import (
    POLE_COLUMNS,
    SHAPE_COLUMNS,
    SHARED_COLUMNS,
    SIGHTING_COLUMNS,
    UNKNOWN,
    apply_decisions,
    probability_source,
    real_probability,
    site_poles,
    with_shapes,
)
from roadsight.stages.command import Command, tell

log = logging.getLogger("triangulate_poles")

_STRUCTURES = (6, 11, 17)
"""ASPRS classes of buildings, road surface and bridge decks."""
_NO_CROWN = (7, 13, 14, 15, 16, 17, 18)
"""ASPRS classes of noise, wires, towers and bridge decks: what they show is no crown."""
_NOT_FIRM = (3, 4, 5, *_NO_CROWN)
"""Plants besides: they may stand around a sign."""
_EDGE_COLUMNS = ("z", "lower_edge_rise", "upper_edge_rise")
"""What tells how high the edges of a panel are."""
_CORNERS = 32
"""Corners of the polygon of an error ellipse."""
_NO_TRACK = pd.DataFrame({"route": [], "sequence": [], "x": [], "y": []})
_LAYERS = {
    "poles": "Point",
    "ellipses": "Polygon",
    "rays": "LineString",
    "guardrails": "LineString",
}
"""Geometry of each layer, for layers that are empty."""


def triangulate_poles(
    sightings_paths: Sequence[Path],
    frame_path: Path,
    asked: Triangulation,
    dem: Annotated[Path | None, "ground heights, for z"] = None,
    decisions: Annotated[str | None, "accepted, rejected, moved poles, CSV"] = None,
    voxels: Annotated[Path | None, "withhold poles near road, bridge, building"] = None,
    objects_path: Annotated[Path | None, "objects of the cloud"] = None,
    seen: Annotated[Sequence[Path], "what images show of them"] = (),
    frames: Annotated[Path | None, "track, to which the nearest place of a building is"] = None,
    columns: Annotated[Path | None, "pole-like columns of the cloud: heights, leans, arms"] = None,
    own_networks: Annotated[Sequence[str], "the project's own that read photographs"] = (),
    *,
    poles_path: Path,
    layers_path: Path,
    csv: Path,
    geojson: Path,
    doubts_path: Annotated[Path | None, "what the poles rest on"] = None,
) -> None:
    """Write poles, their ellipses and the rays that show them."""
    frame = Frame.from_dict(read_json(frame_path))
    shared = [name for parts in SHARED_COLUMNS.values() for name in parts]
    names = [*SIGHTING_COLUMNS, *shared, "view", "reason", "depth_from", *_EDGE_COLUMNS]
    parts = [read_table(path, [*names, *NETWORK_COLUMNS]) for path in sightings_paths]
    sightings = pd.concat(parts, ignore_index=True)
    voxels_m, voxel_class = _voxels(voxels) if voxels else (np.empty((0, 3)), np.empty(0, int))
    ground = read_raster(dem, frame) if dem else None
    objects, told = _confirmed(objects_path, seen)
    track = read_table(frames, ["route", "sequence", "x", "y"]) if frames else _NO_TRACK
    shapes = read_table(columns) if columns else None
    by_hand = read_decisions(decisions, frame) if decisions else None
    settings = TriangulationSettings(**asked.model_dump(), calibrate_depth=False)
    published = settings.method == "sweep"
    network = [] if published else network_scales(sightings)
    sightings = with_scales(sightings, network)
    sightings = sightings.assign(anchored=sightings["depth_lidar_m"].notna())
    poles, pole_of, scales = site_poles(sightings, settings)
    shown = {
        name: voxels_m[~np.isin(voxel_class, classes)]
        for name, classes in (("crowns", _NO_CROWN), ("firm", _NOT_FIRM))
    }
    if not published:  # which withholds by the clearance below alone
        poles = _doubtful_withheld(poles, pole_of, sightings, settings.min_views, shown, ground)
    if doubts_path:
        own = sightings[sightings["kind"] == "pole"]
        limits = pole_doubts(sightings, network, far_reaching(own, settings))
        doubts = [*network_doubts(own_networks), *limits, *crown_doubts(poles)]
        tell(doubts, doubts_path, "poles", log)
    others = trees_of(objects, told), blocks_of(objects, told, RouteTracks(track))
    blocks = sum(KINDS[kind].shape == "block" for kind in told["kind"])
    if blocks and not track[["x", "y"]].notna().all(axis=1).any():
        log.warning("%d buildings and headwalls are left out: no image has a place", blocks)
    found = pd.concat([part for part in (poles, *others) if len(part)] or [poles])
    every = poles.columns.union(found.columns, sort=False)
    poles = found.reindex(columns=every).reset_index(drop=True)
    if len(voxels_m):
        least_m = {name: kind.clearance_m for name, kind in KINDS.items()}
        clearance_m = poles["kind"].map(least_m).fillna(settings.clearance_m).to_numpy(np.float64)
        structures_m = np.unique(voxels_m[np.isin(voxel_class, _STRUCTURES), :2], axis=0)
        poles = drop_near_structures(poles, cKDTree(structures_m), clearance_m)
    poles = _decided(poles, by_hand, decisions)
    # A person may have moved a pole onto the right stem.
    poles = _finished(with_shapes(poles, shapes), frame, ground)
    if len(sightings) < 2:
        log.warning("fewer than two sightings: no pole can be triangulated")
    kept = poles["kept"].to_numpy(bool)
    log.info("%d sightings, %d poles, %d kept", len(sightings), len(poles), kept.sum())
    about = {
        "method": settings.method,
        "settings": settings.model_dump(),
        "depth_scale": scales,
        "sightings": len(sightings),
        "network_scales": [vars(scale) for scale in network],
    }
    write_table(poles_path, poles, about)
    layers = {
        "poles": _points(poles),
        "ellipses": _ellipses(poles),
        "rays": _rays(sightings, poles, pole_of),
        "guardrails": _lines(guardrails_of(objects, told)),
    }
    write_layers(layers_path, layers, frame, _LAYERS)
    write_csv(csv, in_native(poles[kept].drop(columns=["kept", "reason"]), frame))
    write_geojson(geojson, _points(poles[kept].reset_index(drop=True)), frame)


def _confirmed(
    objects_path: Path | None, seen: Sequence[Path]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Objects of the cloud, a row a place, and what images say of each; none unless asked for."""
    if objects_path is None or not seen:
        none = pd.DataFrame({"kind": pd.Series(dtype=str)})
        return none, none
    objects = read_table(objects_path)
    told = confirmed(objects, pd.concat([read_table(path) for path in seen], ignore_index=True))
    for reason, count in (told["kind"] + " " + told["reason"]).value_counts().items():
        log.info("%5d %s", count, reason)
    return objects, told


def _lines(guardrails: pd.DataFrame) -> gpd.GeoDataFrame:
    lines = [shapely.LineString(places) for places in guardrails["places_m"]]
    table = guardrails.drop(columns="places_m")
    table = table.assign(probability=np.nan, probability_from=UNKNOWN["line"])
    return gpd.GeoDataFrame(table, geometry=lines)


def _decided(poles: pd.DataFrame, decisions: pd.DataFrame | None, path: str | None) -> pd.DataFrame:
    """Poles with what a person decided on them, if there is such a table."""
    if decisions is None or path is None:
        return poles.assign(decided="")
    decided, rows = apply_decisions(poles, decisions)
    tell_matches(log, "decisions are about a pole", int((rows >= 0).sum()), len(rows), path)
    for name in decisions.loc[rows < 0, "pole"]:
        log.warning("no pole is left that the decision on %s is about", name or "one of them")
    return decided


def _doubtful_withheld(
    poles: pd.DataFrame,
    pole_of: Ints,
    sightings: pd.DataFrame,
    min_views: int,
    voxels_m: dict[str, Floats],
    ground: Raster | None,
) -> pd.DataFrame:
    """Poles with those withheld that few images, or the cloud around them, speak against."""
    in_cloud = sightings["anchored"].to_numpy(bool)
    poles = withhold_thin(poles, pole_of, in_cloud, min_views)
    if ground is None:
        return poles
    xy_m = poles[["x", "y"]].to_numpy(np.float64)
    ground_m = np.asarray(ground.sample(*xy_m.T), np.float64)
    if len(voxels_m["crowns"]):
        above = shares_above(xy_m, ground_m, voxels_m["crowns"])
        poles = withhold_under_crowns(poles, pole_of, in_cloud, min_views, above)
    if len(voxels_m["firm"]):
        poles = withhold_filled(poles, are_filled(xy_m, ground_m, voxels_m["firm"]))
    edges = panel_edges(poles, pole_of, sightings, ground_m)
    return withhold_by_height(poles, edges, min_views)


def _voxels(path: Path) -> tuple[Floats, Ints]:
    """Middles (m, 3) of the occupied voxels, local metres, and their classes (m,)."""
    about = read_about(path)
    voxels = read_table(path, ["ix", "iy", "iz", "cls"])
    index = voxels[["ix", "iy", "iz"]].to_numpy(np.float64)
    anchor = np.asarray(about["anchor"], np.float64)
    return anchor + (index + 0.5) * float(about["cell_size_m"]), voxels["cls"].to_numpy(np.int64)


def _finished(poles: pd.DataFrame, frame: Frame, ground: Raster | None) -> pd.DataFrame:
    """Poles with probability, ground height, latitude and longitude; NaN where not known."""
    probability = real_probability(poles)
    source = probability_source(poles, probability)
    x, y = poles["x"].to_numpy(np.float64), poles["y"].to_numpy(np.float64)
    z = ground.sample(x, y) if ground else np.full(len(poles), np.nan)
    latitude = longitude = np.full(len(poles), np.nan)
    if frame.crs_wkt is not None and len(poles):
        latitude, longitude = SiteNorth(frame).to_geographic(np.column_stack([x, y]))
    placed = poles.assign(z=z, latitude=latitude, longitude=longitude)
    placed = placed.assign(probability=probability, probability_from=source)
    told = ("decided", "probability", "probability_from", "cloud_shows")
    return placed[[*POLE_COLUMNS, *told, *SHAPE_COLUMNS]]


def _points(poles: pd.DataFrame) -> gpd.GeoDataFrame:
    """Pole features; with heights only where all are known."""
    coordinates = poles[["x", "y", "z"]].to_numpy(np.float64)
    if len(poles) == 0 or np.isnan(coordinates[:, 2]).any():
        coordinates = coordinates[:, :2]
    return gpd.GeoDataFrame(
        poles.drop(columns=["x", "y", "z"]), geometry=shapely.points(coordinates)
    )


def _ellipses(poles: pd.DataFrame) -> gpd.GeoDataFrame:
    """1-sigma ellipses as polygons, of poles that have errors."""
    poles = poles[poles["sigma_major_m"].notna()]
    turn = np.linspace(0.0, 2 * np.pi, _CORNERS, endpoint=False)
    azimuth = np.radians(poles["sigma_azimuth_deg"].to_numpy(np.float64))[:, None]
    major = poles["sigma_major_m"].to_numpy(np.float64)[:, None] * np.cos(turn)
    minor = poles["sigma_minor_m"].to_numpy(np.float64)[:, None] * np.sin(turn)
    x = poles["x"].to_numpy()[:, None] + major * np.sin(azimuth) + minor * np.cos(azimuth)
    y = poles["y"].to_numpy()[:, None] + major * np.cos(azimuth) - minor * np.sin(azimuth)
    rings = [shapely.Polygon(ring) for ring in np.stack([x, y], axis=-1)]
    return gpd.GeoDataFrame(poles[["id", "kept"]].reset_index(drop=True), geometry=rings)


def _rays(sightings: pd.DataFrame, poles: pd.DataFrame, pole_of: Ints) -> gpd.GeoDataFrame:
    """Lines from the cameras to the poles that they support."""
    used = np.flatnonzero(pole_of >= 0)
    start = sightings[["x", "y"]].to_numpy(np.float64)[used]
    end = poles[["x", "y"]].to_numpy(np.float64)[pole_of[used]]
    lines = [shapely.LineString(line) for line in np.stack([start, end], axis=1)]
    columns = {
        "pole": poles["id"].to_numpy()[pole_of[used]],
        "image": sightings["image"].to_numpy()[used],
    }
    return gpd.GeoDataFrame(columns, geometry=lines)


main = Command(triangulate_poles)


if __name__ == "__main__":
    sys.exit(main())
