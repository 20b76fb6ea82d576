"""What the hazard stage reads about roads: ground points, inventory, routes, barriers."""

from __future__ import annotations

import argparse
import logging

import numpy as np
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.records.tables import read_table
from roadsight.io.vector.road_files import read_barriers, read_inventory, read_routes
from roadsight.poles.risk.inventory import Inventory, check_inventory, uncovered
from roadsight.poles.risk.roads import Roads
from roadsight.poles.risk.roadside import REACH_M
from roadsight.poles.risk.routes import Route, with_routes
from roadsight.poles.risk.shielding import Barrier, barriers_along
from roadsight.scene.terrain.tin import add_cells, cell_means, sum_cells

log = logging.getLogger("rate_hazard")

THINNED_M = 0.1
"""One mean ground point a cell of this width: half a bin of a cross-section. Clouds of 24 points/m2
stay as they are, mobile ones keep 100 a square metre."""
_ROAD_HALF_M = 12.0
"""Half of the widest road about its centreline: points further than this and a cross-section's
reach decide about nothing."""


def ground_near_roads(cloud: str, ground: str, roads: Roads, scale: float) -> Floats:
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
            where=ground,
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
    return points / np.array([scale, scale, 1.0])


def given_roads(
    arguments: argparse.Namespace, frame: Frame, roads: Roads, scale: float
) -> tuple[Roads, Inventory | None, list[Barrier], list[str]]:
    """Roads measured along their routes, the inventory, the barriers, and what to tell of them."""
    told: list[str] = []
    inventory: Inventory | None = None
    routes: list[Route] = []
    if arguments.inventory:
        crs = arguments.inventory_crs or None
        table, places, routes = read_inventory(arguments.inventory, frame, crs)
        inventory = check_inventory(table, arguments.inventory, places)
        told += inventory.messages
    if arguments.routes:
        crs = arguments.routes_crs or None
        routes = read_routes(arguments.routes, frame, crs, arguments.measure_unit)
    if routes:
        on_ground = [Route(r.name, r.xy_m / scale, r.measure_m, r.where) for r in routes]
        roads, more = with_routes(roads, on_ground)
        told += more
    if inventory is not None:
        own = [uncovered(inventory, inventory.route_of(road), road) for road in roads.roads]
        told += [message for message in own if message]
        if not routes:
            told.append(
                "measures of the inventory are counted from each road's first image: it has no"
                " lines, and no routes are given (roads.routes)"
            )
    barriers: list[Barrier] = []
    if arguments.barriers:
        lines, names = read_barriers(arguments.barriers, frame, arguments.barriers_crs or None)
        barriers, more = barriers_along([line / scale for line in lines], names, roads)
        told += more
    for message in told:
        log.warning("%s", message)
    return roads, inventory, barriers, told
