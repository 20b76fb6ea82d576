"""What a drawing leads to, as the workflow would compute it: splines and candidate positions."""

from __future__ import annotations

from typing import Any

import geopandas as gpd
import numpy as np
import shapely
from shapely import LineString, MultiPolygon

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.io.raster.rasters import Raster
from roadsight.placement.candidates.positions import positions_along
from roadsight.placement.candidates.sites_for_sensors import outside_zones, positions_on_poles
from roadsight.scene.edges.splines import FURTHEST_M, spline_line
from roadsight.studio.edges.shapes import (
    Drawing,
    MonitoredArea,
    edge_line,
    monitored,
    mount_points,
    polygon,
)

LIFTED = ("edges", "zones", "mounts", "add", "remove")


def preview(
    drawing: Drawing,
    current: MultiPolygon,
    terrain: Raster | None,
    spacing_m: float,
    arm_m: float,
) -> dict[str, Any]:
    """Splines of the edges, positions of candidates, the monitored area, and what is wrong.

    A shape that is wrong, since it is still being drawn, is left out and told.

    Parameters
    ----------
    current : monitored area as it is. spacing_m : between positions. arm_m : of pole mounts.

    Returns
    -------
    edges : name, xyz (flat) of each spline; positions : x, y, z, yaw_deg (flat), forbidden;
    area : rings (flat x, y, z) of the monitored area; lifted : points of the shapes of each layer
    (flat x, y, z) on the terrain; problems : messages.
    """
    problems: list[str] = []
    area = _tried(problems, lambda: monitored(drawing.tma, current)) if drawing.tma else None
    pavement = area or current
    splines = _splines(drawing, problems)
    zones = [
        shape
        for zone in drawing.zones or []
        if (shape := _tried(problems, lambda z=zone: polygon(z.points, f"zone {z.name}", z.holes)))
    ]
    mounts = _tried(problems, lambda: mount_points(drawing.mounts or []))
    xy, yaw = _positions(splines, mounts, pavement, spacing_m, arm_m)
    problems += _far(splines, pavement)
    return {
        "edges": [
            {"name": name, "length_m": line.length, "xyz": lifted(line, terrain)}
            for name, _, line in splines
        ],
        "positions": _flat(np.column_stack([xy, _heights(xy, terrain), yaw])),
        "forbidden": (~outside_zones(xy, zones)).astype(int).tolist(),
        "area": rings(area, terrain) if area is not None else None,
        "lifted": {name: _lifted_points(name, drawing, terrain) for name in LIFTED},
        "area_m2": pavement.area,
        "problems": problems,
    }


def _splines(drawing: Drawing, problems: list[str]) -> list[tuple[str, str, LineString]]:
    found: list[tuple[str, str, LineString]] = []
    for edge in drawing.edges or []:
        line = _tried(problems, lambda e=edge: spline_line(edge_line(e)))
        if line is not None:
            found.append((edge.name, edge.kind, line))
    return found


def _positions(
    splines: list[tuple[str, str, LineString]],
    mounts: gpd.GeoDataFrame | None,
    pavement: MultiPolygon,
    spacing_m: float,
    arm_m: float,
) -> tuple[Floats, Floats]:
    """Places (n, 2) of candidates along the edges, then on poles, and where they face (n,)."""
    edges = gpd.GeoDataFrame(
        {"edge": [name for name, _, _ in splines], "kind": [kind for _, kind, _ in splines]},
        geometry=gpd.GeoSeries([line for _, _, line in splines]),
    )
    parts = [positions_along(edges, pavement, spacing_m)]
    if mounts is not None and len(mounts):
        poles = mounts.assign(x=mounts.geometry.x, y=mounts.geometry.y, top_m=mounts["height_m"])
        parts.append(positions_on_poles(poles, pavement, arm_m))
    table = np.vstack([part[["x", "y", "yaw_deg"]].to_numpy(np.float64) for part in parts])
    return table[:, :2], table[:, 2]


def _far(splines: list[tuple[str, str, LineString]], pavement: MultiPolygon) -> list[str]:
    """The workflow refuses edges that are far from the road: told while they are drawn."""
    if pavement.is_empty:
        return []
    return [
        f"edge {name} is {distance:.0f} m from the monitored area; at most {FURTHEST_M:.0f} m"
        for name, _, line in splines
        if (distance := line.distance(pavement)) > FURTHEST_M
    ]


def _tried(problems: list[str], make: Any) -> Any:
    try:
        return make()
    except InputError as error:
        problems.append(str(error))
        return None


def rings(area: shapely.Geometry, terrain: Raster | None) -> list[list[float]]:
    """Outer and inner rings of polygons as flat x, y, z on the terrain."""
    polygons = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon"]
    return [lifted(ring, terrain) for part in polygons for ring in (part.exterior, *part.interiors)]


def _lifted_points(name: str, drawing: Drawing, terrain: Raster | None) -> list[list[float]]:
    """Points of a layer's shapes as they are drawn, on the terrain."""
    tma = drawing.tma or MonitoredArea()
    shapes = {
        "edges": [edge.points for edge in drawing.edges or []],
        "zones": [zone.points for zone in drawing.zones or []],
        "mounts": [[(mount.x, mount.y)] for mount in drawing.mounts or []],
        "add": tma.add,
        "remove": tma.remove,
    }[name]
    places = [np.array(points, np.float64).reshape(-1, 2) for points in shapes]
    return [_flat(np.column_stack([xy, _heights(xy, terrain)])) for xy in places]


def lifted(line: shapely.Geometry, terrain: Raster | None) -> list[float]:
    """Flat x, y, z of a line on the terrain."""
    xy = shapely.get_coordinates(line)
    return _flat(np.column_stack([xy, _heights(xy, terrain)]))


def _heights(xy_m: Floats, terrain: Raster | None) -> Floats:
    if terrain is None or not len(xy_m):
        return np.zeros(len(xy_m))
    return np.nan_to_num(terrain.sample(xy_m[:, 0], xy_m[:, 1]))


def _flat(table: Floats) -> list[float]:
    return np.round(table, 3).ravel().tolist()
