"""How dangerous poles are to vehicles that leave the road."""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats
from roadsight.base.doubts import Doubt
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Hazard
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.io.records.text_tables import in_native, write_csv
from roadsight.io.vector.road_files import read_barriers, read_inventory, read_routes
from roadsight.io.vector.vectors import read_layer, write_layers
from roadsight.poles.risk.clear_zone import SOURCE
from roadsight.poles.risk.hazard import RULE, rate_roadside
from roadsight.poles.risk.inventory import Carriageway, Inventory, check_inventory
from roadsight.poles.risk.road_doubts import (
    edge_doubts,
    inventory_doubts,
    lane_doubts,
    traffic_doubts,
)
from roadsight.poles.risk.road_geometry import STATION_M
from roadsight.poles.risk.roads import Roads, RouteTracks, resampled, roads_of
from roadsight.poles.risk.roadside import REACH_M, Surroundings, geometry_table, section_table
from roadsight.poles.risk.roadside_rating import SOURCES
from roadsight.poles.risk.routes import UNITS_M, MeasureUnit, Route, with_routes
from roadsight.poles.risk.shielding import Barrier, barrier_ends, barriers_along
from roadsight.scene.terrain.tin import add_cells, cell_means, sum_cells
from roadsight.stages.command import Command, tell
from roadsight.stages.poles.shared.hazard_layers import (
    GEOMETRY,
    geometry_lines,
    hazard_points,
    rounded,
    section_lines,
)

log = logging.getLogger("rate_hazard")

PLAN = ("x", "y")

KINDS = {"poles": "Point", "ellipses": "Polygon", "rays": "LineString", "guardrails": "LineString"}
"""Geometry of layers of poles that are empty."""

_NONE = ("clear_zone_m", "runout_length_m")
"""Settings that 0 leaves to the guide's tables."""


def rate_hazard(
    poles_path: Path,
    frame_path: Path,
    frames_path: Path,
    edges: Path,
    settings: Hazard,
    given: RoadFiles,
    dem: Annotated[Path | None, "ground heights, for side slopes"] = None,
    cloud: Annotated[Path | None, "the cloud, for cross-sections of its points"] = None,
    ground: Annotated[Path | None, "which of its points are ground"] = None,
    placed: Annotated[Path | None, "layers of the poles, to go with the others"] = None,
    markings: Annotated[Sequence[Path], "lane markings that images show, on the ground"] = (),
    traffic: Annotated[Literal["right", "left"], "drives so"] = "right",
    carriageway: Carriageway = "two-way",
    scale_factor: Literal["simulate", "skip"] = "skip",
    *,
    out: Path,
    csv: Path,
    layers_path: Annotated[Path | None, "GeoPackage of all layers"] = None,
    geometry_csv: Annotated[Path | None, "road geometry by station"] = None,
    sections_path: Annotated[Path | None, "cross-sections, for the report"] = None,
    doubts: Annotated[Path | None, "what the hazard rests on"] = None,
) -> None:
    """Write the hazard of each kept pole, cross-sections, and the geometry of the roads."""
    frame = Frame.from_dict(read_json(frame_path))
    poles = read_table(poles_path)
    poles = poles[poles["kept"].to_numpy(bool)].reset_index(drop=True)
    edges_m = read_table(edges, ["x", "y"]).to_numpy(np.float64)
    frames = read_table(frames_path, ["route", "sequence", "x", "y"])
    height = read_raster(dem, frame).sample if dem else None
    layers = {name: read_layer(placed, name, frame) for name in KINDS if placed}
    marked = [read_table(path) for path in markings]
    scale = grid_scale(poles, frame) if scale_factor == "simulate" else 1.0
    rails: dict[str, Floats] = {}
    if placed:
        found = layers["guardrails"].itertuples()
        rails = {
            row.id: np.asarray(row.geometry.coords)[:, :2] / scale for row in found if row.kept
        }
    roads = roads_of(RouteTracks(_divided(frames, scale)), edges_m / scale)
    roads, inventory, barriers, told = given_roads(given, frame, roads, scale, rails, settings)
    points = None
    if cloud and ground:
        points = ground_near_roads(cloud, ground, roads, scale)
        log.info("%d ground points near roads", len(points))
    surroundings = Surroundings(
        roads,
        None if height is None else lambda x, y: height(scale * x, scale * y),
        points,
        inventory,
        barriers,
        traffic == "left",
        carriageway,
        _divided(pd.concat(marked, ignore_index=True), scale) if marked else None,
    )
    if doubts:
        tell([*told, *lane_doubts(surroundings)], doubts, f"poles {poles_path}", log)
    objects = _with_barrier_ends(poles, barriers, frame, scale)
    divided = _divided(objects, scale, (*PLAN, "sigma_major_m"))
    rated = rate_roadside(divided, edges_m / scale, surroundings, settings)
    known = objects[["id", "kind", "x", "y", "latitude", "longitude"]]
    table = pd.concat([known, rated.table], axis=1)
    unit = given.measure_unit
    if unit != "m":
        table[f"measure_{unit}"] = (table["station_m"] / UNITS_M[unit]).round(5)
    log.info("%d poles: %s", len(table), table["rating"].value_counts().to_dict())
    names = objects["id"].astype(str).tolist()
    sections = section_table(
        surroundings,
        names,
        rated.located,
        rated.edge_m,
        rated.outward,
        rated.sections,
        settings.section_every_m,
    )
    places = ["start_x", "start_y", "end_x", "end_y"]
    sections[places] *= scale
    geometry = geometry_table(surroundings, settings)
    geometry[list(PLAN)] *= scale
    about = {"clear_zone": SOURCE, "rule": RULE, "settings": settings.model_dump()}
    about |= {"sources": SOURCES}
    write_table(out, table, about)
    write_csv(csv, in_native(table, frame))
    if geometry_csv:
        write_csv(geometry_csv, rounded(in_native(geometry, frame)))
    if sections_path:
        profiles = {  # measured heights at each object, for drawings: above the edge, m
            name: {
                "run_m": np.round(section.profile.run_m, 3).tolist(),
                "height_m": np.round(section.profile.height_m, 3).tolist(),
            }
            for name, section in zip(names, rated.sections, strict=True)
            if section is not None
        }
        write_table(sections_path, sections, {"profiles": profiles})
    if layers_path:
        layers |= {
            "hazard": hazard_points(table, height),
            "cross_sections": section_lines(sections, height),
            "road_geometry": geometry_lines(geometry, surroundings, STATION_M, scale),
        }
        write_layers(layers_path, layers, frame, KINDS | GEOMETRY)


def _with_barrier_ends(
    poles: pd.DataFrame, barriers: Sequence[Barrier], frame: Frame, scale: float
) -> pd.DataFrame:
    """Poles, and the ends of barriers, which are objects themselves."""
    ends = barrier_ends(barriers)
    if ends.empty:
        return poles
    xy = ends[list(PLAN)].to_numpy(np.float64) * scale
    latitude = longitude = np.full(len(ends), np.nan)
    if frame.crs_wkt is not None:
        latitude, longitude = SiteNorth(frame).to_geographic(xy)
    ends = ends.assign(
        x=xy[:, 0], y=xy[:, 1], latitude=latitude, longitude=longitude, sigma_major_m=0.0
    )
    return pd.concat([poles, ends], ignore_index=True)


def grid_scale(poles: pd.DataFrame, frame: Frame) -> float:
    """Metres of the grid for each metre on the ellipsoid, mean over the poles; 1 without any."""
    if frame.crs_wkt is None or poles.empty:
        return 1.0
    return float(SiteNorth(frame).scale(poles[["x", "y"]].to_numpy(np.float64)).mean())


def _divided(table: pd.DataFrame, scale: float, lengths: Sequence[str] = PLAN) -> pd.DataFrame:
    """The table in metres on the ground."""
    return table.assign(**{name: table[name] / scale for name in lengths})


# What the hazard stage reads about roads: ground points, inventory, routes, barriers.

THINNED_M = 0.1
"""One mean ground point a cell of this width: half a bin of a cross-section. Clouds of 24 points/m2
stay as they are, mobile ones keep 100 a square metre."""

_SAME_RAIL_M = 2.0
"""A guardrail this near to a given one is the same: drawn lines are a metre or two off."""

_ROAD_HALF_M = 12.0
"""Half of the widest road about its centreline: points further than this and a cross-section's
reach decide about nothing."""


def ground_near_roads(cloud: Path, ground: Path, roads: Roads, scale: float) -> Floats:
    """Ground points (n, 3) near roads, thinned, tile by tile.

    Parameters
    ----------
    roads : in metres on the ground. scale : metres of the grid for each of them.
    """
    lines = [road.xy_m * scale for road in roads.roads]
    if not lines:
        return np.empty((0, 3))
    tree, reach = cKDTree(np.concatenate(lines)), (REACH_M + _ROAD_HALF_M) * scale
    tiles = CloudTiles(cloud)
    labels = read_table(ground, ["ground"])["ground"].to_numpy()
    if len(labels) != tiles.points:
        raise InputError(
            "are not the ground labels of this cloud",
            where=str(ground),
            found=f"{len(labels)} points",
            allowed=tiles.points,
            hint="delete it and run the workflow again",
        )
    starts = np.cumsum([0, *(tile.rows for tile in tiles.tiles)])
    parts = []
    for number, tile in enumerate(tiles.tiles):
        west, south, _, east, north, _ = tile.bounds_m
        middle = np.array([(west + east) / 2, (south + north) / 2])
        if tree.query(middle)[0] > reach + np.hypot(east - west, north - south) / 2:
            continue
        xyz = stack_xyz(tiles.read(("x", "y", "z"), [number]))
        xyz = xyz[labels[starts[number] : starts[number + 1]]]
        near, _ = tree.query(xyz[:, :2], distance_upper_bound=reach)
        xyz = xyz[np.isfinite(near)]
        parts.append(sum_cells(xyz, np.zeros(len(xyz), bool), THINNED_M))
    if not parts:
        return np.empty((0, 3))
    points = cell_means(add_cells(parts))
    return np.asarray(points / [scale, scale, 1.0])


@dataclass(frozen=True)
class RoadFiles:
    """What the user knows of the roads."""

    inventory: Annotated[str | None, "file of the user"] = None
    inventory_crs: Annotated[str | None, "its CRS if it names none"] = None
    routes: Annotated[str | None, "file of the user"] = None
    routes_crs: Annotated[str | None, "its CRS if it names none"] = None
    barriers: Annotated[str | None, "file of the user"] = None
    barriers_crs: Annotated[str | None, "its CRS if it names none"] = None
    measure_unit: MeasureUnit = "m"


def given_roads(
    given: RoadFiles,
    frame: Frame,
    roads: Roads,
    scale: float,
    rails: Mapping[str, Floats],
    site: Hazard,
) -> tuple[Roads, Inventory | None, list[Barrier], list[Doubt]]:
    """Roads measured along their routes, the inventory, the barriers, and doubts about them.

    Parameters
    ----------
    rails : guardrails that were found, lines (n, 2) on the ground by name; those that the user
        gives too count once, as given, and those of no road not at all.
    site : states speed and traffic where the inventory does not.
    """
    told: list[Doubt] = []
    inventory: Inventory | None = None
    routes: list[Route] = []
    stated: list[Floats] = []
    names: list[str] = []
    if given.inventory:
        table, places, routes = read_inventory(given.inventory, frame, given.inventory_crs)
        inventory = check_inventory(table, given.inventory, places)
    if given.routes:
        routes = read_routes(given.routes, frame, given.routes_crs, given.measure_unit)
    if given.barriers:
        stated, names = read_barriers(given.barriers, frame, given.barriers_crs)
    if routes:
        on_ground = [Route(r.name, r.xy_m / scale, r.measure_m, r.where) for r in routes]
        roads, more = with_routes(roads, on_ground)
        told += more
    if inventory is not None:
        told += inventory_doubts(inventory, roads.roads, bool(routes), site)
    else:
        told += traffic_doubts(site)
    lines = [line / scale for line in stated]
    barriers, more = barriers_along(lines, names, roads)
    told += more
    # A guardrail is given where half of its places or more lie along lines of the user. What was
    # found in a former run and is given now keeps its name.
    tree = cKDTree(np.concatenate([resampled(line, 1.0) for line in lines])) if lines else None
    new = {
        f"{name} found" if name in names else name: line
        for name, line in rails.items()
        if tree is None or np.median(tree.query(line)[0]) > _SAME_RAIL_M
    }
    barriers += barriers_along(list(new.values()), list(new), roads)[0]
    return roads, inventory, barriers, [*told, *edge_doubts(roads.roads)]


main = Command(rate_hazard)


if __name__ == "__main__":
    sys.exit(main())
