"""Edges, zones, mounts and monitored area of a site: read for the page, saved for the workflow.

A layer is a GeoJSON file in ``config/sites/<site>/``, which the site file names. Saving writes only
the layers that changed, and the same drawing gives the same bytes, so that exactly what depends on
a change is computed again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated, Any, Literal

import geopandas as gpd
import numpy as np
import shapely
from pydantic import Field
from shapely import LineString, MultiPolygon, Polygon

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import Raster, read_raster
from roadsight.io.vector.known import read_mounts
from roadsight.io.vector.vectors import read_layer, read_lines, read_polygons, write_geojson
from roadsight.placement.candidates.candidates import positions_along
from roadsight.placement.candidates.mounting import outside_zones, positions_on_poles
from roadsight.scene.splines import FURTHEST_M, spline_line
from roadsight.studio.project import DEM, Project, SiteFolder
from roadsight.studio.requests import Body, field_of
from roadsight.studio.site_files import Writer, save_beside, saving, site_version

LAYERS = ("edges", "zones", "mounts", "tma")
_PAVEMENT = "scene/pavement.gpkg"
_KNOT_M = 0.15  # A traced outline is drawn with as few knots as keep it within this distance


def load_drawing(site: SiteFolder) -> dict[str, Any]:
    """Editable layers and what to see and snap to beside them, in local metres."""
    frame = site.frame()
    terrain = terrain_of(site, frame)
    placement = site.resolved.site.placement
    zones = _layer(site, "zones", lambda path: read_polygons(path, frame))
    mounts = _layer(site, "mounts", lambda path: read_mounts(path, frame))
    edges = []
    if placement.edges == "sample":
        edges = _drawn(read_lines(str(site.file("sample/edges.geojson")), frame, None))
    elif placement.edges is not None:
        path = site.resolved.layered(str(placement.edges))
        edges = _drawn(read_lines(path, frame, placement.edges_crs))
    return {
        "version": site_version(site, "drawing"),
        "edges": edges,
        "zones": [] if zones is None else _zones(zones),
        "mounts": [
            {
                "name": row.name,
                "x": round(row.x, 4),
                "y": round(row.y, 4),
                "height_m": None if row.top_m != row.top_m else row.top_m,  # NaN: not known
            }
            for row in (() if mounts is None else mounts.itertuples(index=False))
        ],
        "area": rings(current_area(site, frame), terrain),
        "own": {name: getattr(placement, name) is not None for name in LAYERS},
        "reference": _reference(site, frame, terrain),
        "fields": {
            "name": field_of(Pole, "name"),
            "kind": field_of(Edge, "kind"),
            "height_m": field_of(Pole, "height_m"),
        },
        "spacing_m": site.resolved.settings.candidates.spacing_m,
        "frame": {
            "origin": list(frame.origin),
            "unit_m": frame.unit_m,
            "vertical_unit_m": frame.vertical_unit_m,
        },
    }


def terrain_of(site: SiteFolder, frame: Frame) -> Raster | None:
    """Ground heights, if they were computed."""
    return read_raster(site.results / DEM, frame) if (site.results / DEM).exists() else None


def current_area(site: SiteFolder, frame: Frame) -> MultiPolygon:
    """The user's monitored area, else the pavement that the workflow found, else nothing."""
    own = _layer(site, "tma", lambda path: read_polygons(path, frame))
    if own is not None:
        return _parts(own)
    found = site.results / _PAVEMENT
    return _parts(read_layer(found, "pavement", frame)) if found.exists() else MultiPolygon()


def _parts(layer: gpd.GeoDataFrame) -> MultiPolygon:
    area = shapely.union_all(layer.geometry.to_numpy())
    return MultiPolygon([p for p in shapely.get_parts(area) if p.geom_type == "Polygon"])


def _layer(site: SiteFolder, name: str, read: Callable[[str], Any]) -> Any:
    """What is read of a file that the site names, of the layer that it names there."""
    path = getattr(site.resolved.site.placement, name)
    return None if path is None else read(site.resolved.layered(path))


def _drawn(lines: gpd.GeoDataFrame) -> list[dict[str, Any]]:
    named = zip(lines["edge"], lines["kind"], lines.geometry, strict=True)
    return [
        {"name": name, "kind": kind, "points": _points(line.coords)} for name, kind, line in named
    ]


def _points(coordinates: Any) -> list[list[float]]:
    return [[round(c[0], 4), round(c[1], 4)] for c in coordinates]


def _zones(zones: gpd.GeoDataFrame) -> list[dict[str, Any]]:
    names = zones["name"] if "name" in zones else [f"zone{n + 1}" for n in range(len(zones))]
    found: list[dict[str, Any]] = []
    for name, area in zip(names, zones.geometry, strict=True):
        found.append({"name": str(name), "points": _points(area.exterior.coords[:-1])})
        if area.interiors:
            found[-1]["holes"] = [_points(ring.coords[:-1]) for ring in area.interiors]
    return found


def _reference(site: SiteFolder, frame: Frame, terrain: Raster | None) -> dict[str, Any]:
    """Lines to snap to, edges that the workflow found, and poles that it located."""
    lines, automatic = [], []
    for file, layer in (("placement/edges.gpkg", "edges"), ("poles/road_edges.gpkg", "road_edges")):
        path = site.results / file
        if not path.exists():
            continue
        found = read_layer(path, layer, frame)
        lines += [lifted(line, terrain) for line in found.geometry]
        if layer == "edges" and (found["source"] == "automatic").all():
            found = found.set_geometry(shapely.simplify(found.geometry.to_numpy(), _KNOT_M))
            automatic = _drawn(found)
    path, poles = site.results / "poles/poles.gpkg", []
    if path.exists():
        found = read_layer(path, "poles", frame)
        named = zip(found["id"], found["kept"], found.geometry, strict=True)
        poles = [{"name": str(n), "x": p.x, "y": p.y} for n, kept, p in named if kept]
    return {"lines": lines, "automatic": automatic, "poles": poles}


def save_drawing(project: Project, stem: str, drawing: Drawing) -> list[str]:
    """Write the given layers and name them in the site file.

    Returns
    -------
    files that changed, relative to the project

    Raises
    ------
    InputError : a shape is wrong, or the site file cannot be changed; nothing is written then.
    """
    with saving(project, stem, "drawing") as site:
        frame = site.frame()
        layers = _layers(site, frame, drawing)
        named = {n: None if layer is None else f"{n}.geojson" for n, layer in layers.items()}
        files: dict[str, Writer] = {
            f"{name}.geojson": partial(write_geojson, features=layer, frame=frame)
            for name, layer in layers.items()
            if layer is not None
        }
        if "edges" in layers and site.resolved.site.placement.edges_crs is not None:
            named["edges_crs"] = None
        return save_beside(project, site, "placement", files, named)


def _layers(site: SiteFolder, frame: Frame, drawing: Drawing) -> dict[str, gpd.GeoDataFrame | None]:
    """Layers to write; None for those that the site is to have no more."""
    found: dict[str, gpd.GeoDataFrame | None] = {}
    if drawing.edges is not None:
        found["edges"] = edge_lines(drawing.edges) if drawing.edges else None
    if drawing.zones is not None:
        found["zones"] = zone_polygons(drawing.zones) if drawing.zones else None
    if drawing.mounts is not None:
        found["mounts"] = mount_points(drawing.mounts) if drawing.mounts else None
    if drawing.tma is not None and drawing.tma.changes:
        found["tma"] = None
        if drawing.tma.is_own:
            parts = list(monitored(drawing.tma, current_area(site, frame)).geoms)
            found["tma"] = gpd.GeoDataFrame({"part": range(len(parts))}, geometry=parts)
    return found


# What a drawing leads to, as the workflow would compute it: splines and candidate positions.


def preview(
    drawing: Drawing, current: MultiPolygon, terrain: Raster | None, spacing_m: float, arm_m: float
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
    splines: list[tuple[str, str, LineString]] = []
    for edge in drawing.edges or []:
        line = _tried(problems, lambda e=edge: spline_line(edge_line(e)))
        if line is not None:
            splines.append((edge.name, edge.kind, line))
    zones = [
        shape
        for zone in drawing.zones or []
        if (shape := _tried(problems, lambda z=zone: polygon(z.points, f"zone {z.name}", z.holes)))
    ]
    mounts = _tried(problems, lambda: mount_points(drawing.mounts or []))
    xy, yaw = _positions(splines, mounts, pavement, spacing_m, arm_m)
    if not pavement.is_empty:  # the workflow refuses such edges: told while they are drawn
        problems += [
            f"edge {name} is {distance:.0f} m from the monitored area; at most {FURTHEST_M:.0f} m"
            for name, _, line in splines
            if (distance := line.distance(pavement)) > FURTHEST_M
        ]
    tma = drawing.tma or MonitoredArea()
    shapes = {
        "edges": [edge.points for edge in drawing.edges or []],
        "zones": [zone.points for zone in drawing.zones or []],
        "mounts": [[(mount.x, mount.y)] for mount in drawing.mounts or []],
        "add": tma.add,
        "remove": tma.remove,
    }
    return {
        "edges": [
            {"name": name, "length_m": line.length, "xyz": lifted(line, terrain)}
            for name, _, line in splines
        ],
        "positions": _flat(np.column_stack([xy, _heights(xy, terrain), yaw])),
        "forbidden": (~outside_zones(xy, zones)).astype(int).tolist(),
        "area": rings(area, terrain) if area is not None else None,
        "lifted": {
            name: [_on_terrain(np.array(xy, np.float64).reshape(-1, 2), terrain) for xy in drawn]
            for name, drawn in shapes.items()
        },
        "area_m2": pavement.area,
        "problems": problems,
    }


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


def lifted(line: shapely.Geometry, terrain: Raster | None) -> list[float]:
    """Flat x, y, z of a line on the terrain."""
    return _on_terrain(shapely.get_coordinates(line), terrain)


def _on_terrain(xy_m: Floats, terrain: Raster | None) -> list[float]:
    return _flat(np.column_stack([xy_m, _heights(xy_m, terrain)]))


def _heights(xy_m: Floats, terrain: Raster | None) -> Floats:
    if terrain is None or not len(xy_m):
        return np.zeros(len(xy_m))
    return np.nan_to_num(terrain.sample(xy_m[:, 0], xy_m[:, 1]))


def _flat(table: Floats) -> list[float]:
    return np.round(table, 3).ravel().tolist()


# What people draw, as the page sends it: checked, and turned into shapes in local metres.

_FURTHEST_M = 1e6  # Largest coordinate, local metres, that is taken from a page
_MOST = 5000  # Points of a shape, and poles, that are taken from a page
Metre = Annotated[float, Field(ge=-_FURTHEST_M, le=_FURTHEST_M, allow_inf_nan=False)]
Point = tuple[Metre, Metre]
Points = Annotated[list[Point], Field(max_length=_MOST)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,39}$")]


class Edge(Body):
    """Points of a piecewise road edge."""

    name: Name
    kind: Literal["edge", "median", "line"] = "edge"
    points: Points


class Area(Body):
    """A polygon; its holes are kept, not drawn."""

    name: Name
    points: Points
    holes: list[Points] = Field(default=[], max_length=500)


class Pole(Body):
    """An existing pole that may carry a sensor."""

    name: Name
    x: Metre
    y: Metre
    height_m: Annotated[float, Field(gt=0, le=100, allow_inf_nan=False)] | None = None


class MonitoredArea(Body):
    """What is added to and removed from the monitored area, in this order."""

    base: Literal["current", "none", "found"] = "current"
    add: list[Points] = Field(default=[], max_length=500)
    remove: list[Points] = Field(default=[], max_length=500)

    @property
    def changes(self) -> bool:
        """Whether it differs from what there is."""
        return self.base != "current" or bool(self.add or self.remove)

    @property
    def is_own(self) -> bool:
        """Whether it is the user's, not what the workflow finds."""
        return self.base != "found" or bool(self.add or self.remove)


class Drawing(Body):
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
