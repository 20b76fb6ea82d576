"""What the hazard stage reads about roads: ground points, inventory, routes, barriers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats
from roadsight.base.doubts import Doubt
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Hazard
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.records.tables import read_table
from roadsight.io.vector.road_files import read_barriers, read_inventory, read_routes
from roadsight.poles.risk.inventory import Inventory, check_inventory
from roadsight.poles.risk.road_doubts import edge_doubts, inventory_doubts, traffic_doubts
from roadsight.poles.risk.roads import Roads, resampled
from roadsight.poles.risk.roadside import REACH_M
from roadsight.poles.risk.routes import MeasureUnit, Route, with_routes
from roadsight.poles.risk.shielding import Barrier, barriers_along
from roadsight.scene.terrain.tin import add_cells, cell_means, sum_cells

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
    if given.inventory:
        table, places, routes = read_inventory(given.inventory, frame, given.inventory_crs)
        inventory = check_inventory(table, given.inventory, places)
    if given.routes:
        routes = read_routes(given.routes, frame, given.routes_crs, given.measure_unit)
    if routes:
        on_ground = [Route(r.name, r.xy_m / scale, r.measure_m, r.where) for r in routes]
        roads, more = with_routes(roads, on_ground)
        told += more
    if inventory is not None:
        told += inventory_doubts(inventory, roads.roads, bool(routes), site)
    else:
        told += traffic_doubts(site)
    barriers: list[Barrier] = []
    lines: list[Floats] = []
    names: list[str] = []
    if given.barriers:
        stated, names = read_barriers(given.barriers, frame, given.barriers_crs)
        lines = [line / scale for line in stated]
        barriers, more = barriers_along(lines, names, roads)
        told += more
    # What was found in a former run and is given now keeps its name.
    new = {
        f"{name} found" if name in names else name: line
        for name, line in rails.items()
        if not _is_given(line, lines)
    }
    barriers += barriers_along(list(new.values()), list(new), roads)[0]
    return roads, inventory, barriers, [*told, *edge_doubts(roads.roads)]


def _is_given(rail: Floats, lines: Sequence[Floats]) -> bool:
    """Whether half of a guardrail's places or more lie along lines that the user gives."""
    if not lines:
        return False
    tree = cKDTree(np.concatenate([resampled(line, 1.0) for line in lines]))
    return bool(np.median(tree.query(rail)[0]) <= _SAME_RAIL_M)
