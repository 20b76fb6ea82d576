"""What people draw, as the page sends it: checked, and turned into shapes in local metres."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import geopandas as gpd
import numpy as np
import shapely
from pydantic import BaseModel, ConfigDict, Field
from shapely import LineString, MultiPolygon, Polygon

from roadsight.base.errors import InputError

_FURTHEST_M = 1e6
"""Largest coordinate, local metres, that is taken from a page."""
_MOST = 5000
"""Points of a shape, and poles, that are taken from a page."""
Metre = Annotated[float, Field(ge=-_FURTHEST_M, le=_FURTHEST_M, allow_inf_nan=False)]
Point = tuple[Metre, Metre]
Points = Annotated[list[Point], Field(max_length=_MOST)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,39}$")]


class Shape(BaseModel):
    """Anything that is drawn."""

    model_config = ConfigDict(extra="forbid")


class Edge(Shape):
    """Points of a piecewise road edge."""

    name: Name
    kind: Literal["edge", "median", "line"] = "edge"
    points: Points


class Area(Shape):
    """A polygon; its holes are kept, not drawn."""

    name: Name
    points: Points
    holes: Annotated[list[Points], Field(max_length=500)] = []


class Pole(Shape):
    """An existing pole that may carry a sensor."""

    name: Name
    x: Metre
    y: Metre
    height_m: Annotated[float, Field(gt=0, le=100, allow_inf_nan=False)] | None = None


class MonitoredArea(Shape):
    """What is added to and removed from the monitored area, in this order."""

    base: Literal["current", "none", "found"] = "current"
    add: Annotated[list[Points], Field(max_length=500)] = []
    remove: Annotated[list[Points], Field(max_length=500)] = []

    @property
    def changes(self) -> bool:
        """Whether it differs from what there is."""
        return self.base != "current" or bool(self.add or self.remove)

    @property
    def is_own(self) -> bool:
        """Whether it is the user's, not what the workflow finds."""
        return self.base != "found" or bool(self.add or self.remove)


class Drawing(Shape):
    """Layers that the page hands over; those that are absent stay as they are."""

    edges: Annotated[list[Edge], Field(max_length=500)] | None = None
    zones: Annotated[list[Area], Field(max_length=500)] | None = None
    mounts: Annotated[list[Pole], Field(max_length=_MOST)] | None = None
    tma: MonitoredArea | None = None


def edge_lines(edges: list[Edge]) -> gpd.GeoDataFrame:
    """Road edges as lines with edge (name) and kind.

    Raises
    ------
    InputError : two share a name, or one has too few different points or crosses itself.
    """
    _check_names([edge.name for edge in edges], "edges")
    lines = [edge_line(edge) for edge in edges]
    columns = {"edge": [e.name for e in edges], "kind": [e.kind for e in edges]}
    return gpd.GeoDataFrame(columns, geometry=gpd.GeoSeries(lines))


def edge_line(edge: Edge) -> LineString:
    """One road edge.

    Raises
    ------
    InputError : too few different points, or it crosses itself.
    """
    where = f"edge {edge.name}"
    if len(set(edge.points)) < 2:
        raise InputError("needs at least 2 different points", where=where)
    line = shapely.remove_repeated_points(LineString(edge.points))
    if not line.is_simple:
        raise InputError("crosses itself", where=where, hint="split it or move its points")
    return line


def polygon(points: list[Point], where: str, holes: Sequence[list[Point]] = ()) -> Polygon:
    """A polygon of its corners and those of its holes.

    Raises
    ------
    InputError : fewer than 3 corners, no area, or it crosses itself.
    """
    if len(set(points)) < 3:
        raise InputError("needs at least 3 different corners", where=where)
    area = Polygon(points, [hole for hole in holes if len(set(hole)) > 2])
    if not area.is_valid or area.area <= 0:
        raise InputError("crosses itself or has no area", where=where, hint="move its corners")
    return area


def zone_polygons(zones: list[Area]) -> gpd.GeoDataFrame:
    """Zones as polygons with their name.

    Raises
    ------
    InputError : as `polygon`, or two share a name.
    """
    _check_names([zone.name for zone in zones], "zones")
    areas = [polygon(zone.points, f"zone {zone.name}", zone.holes) for zone in zones]
    return gpd.GeoDataFrame({"name": [z.name for z in zones]}, geometry=gpd.GeoSeries(areas))


def mount_points(mounts: list[Pole]) -> gpd.GeoDataFrame:
    """Existing poles as points with name and height_m (NaN if unknown).

    Raises
    ------
    InputError : two share a name.
    """
    _check_names([mount.name for mount in mounts], "mounts")
    heights = [np.nan if m.height_m is None else m.height_m for m in mounts]
    points = [shapely.Point(m.x, m.y) for m in mounts]
    columns = {"name": [m.name for m in mounts], "height_m": np.array(heights, np.float64)}
    return gpd.GeoDataFrame(columns, geometry=gpd.GeoSeries(points))


def monitored(area: MonitoredArea, current: MultiPolygon) -> MultiPolygon:
    """The monitored area after additions and removals; parts sorted by size.

    Raises
    ------
    InputError : as `polygon`, or nothing is left.
    """
    add = [polygon(points, f"added area {n + 1}") for n, points in enumerate(area.add)]
    remove = [polygon(points, f"removed area {n + 1}") for n, points in enumerate(area.remove)]
    start = [] if area.base == "none" else list(current.geoms)
    left = shapely.difference(shapely.union_all([*start, *add]), shapely.union_all(remove))
    parts = [part for part in shapely.get_parts(left) if part.geom_type == "Polygon"]
    parts = [shapely.normalize(part) for part in parts if not part.is_empty]
    if not parts:
        raise InputError("nothing of the monitored area is left", where="monitored area")
    return MultiPolygon(sorted(parts, key=lambda part: -part.area))


def _check_names(names: list[str], where: str) -> None:
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError("two share a name", where=where, found=repeated[0])
