"""Edges, zones, mounts and monitored area of a site: read for the page, saved for the workflow.

A layer is a GeoJSON file in ``config/sites/<site>/``, which the site file names. Saving writes only
the layers that changed, and the same drawing gives the same bytes, so that exactly what depends on
a change is computed again.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import geopandas as gpd
import shapely
from shapely import MultiPolygon, Polygon

from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import Raster, read_raster
from roadsight.io.vector.mount_files import read_mounts
from roadsight.io.vector.vectors import read_layer, read_lines, read_polygons, write_geojson
from roadsight.studio.edges.preview import lifted, rings
from roadsight.studio.edges.shapes import (
    Drawing,
    Edge,
    Pole,
    edge_lines,
    monitored,
    mount_points,
    zone_polygons,
)
from roadsight.studio.fields import field_of
from roadsight.studio.project import DEM, Project, SiteFolder
from roadsight.studio.site_files import Writer, save_beside, saving, site_version

_SECTION = "placement"
LAYERS = ("edges", "zones", "mounts", "tma")
_PAVEMENT = "scene/pavement.gpkg"
_KNOT_M = 0.15
"""A traced outline is drawn with as few knots as keep it within this distance."""


def load_drawing(site: SiteFolder) -> dict[str, Any]:
    """Editable layers and what to see and snap to beside them, in local metres."""
    frame = site.frame()
    terrain = terrain_of(site, frame)
    placement = site.resolved.site.placement
    zones = _layer(site, "zones", lambda path: read_polygons(path, frame))
    mounts = _layer(site, "mounts", lambda path: read_mounts(path, frame))
    return {
        "version": site_version(site, "drawing"),
        "edges": [] if placement.edges is None else _edges(site, frame),
        "zones": [] if zones is None else _zones(zones),
        "mounts": [] if mounts is None else _mounts(mounts),
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


def _edges(site: SiteFolder, frame: Frame) -> list[dict[str, Any]]:
    placement = site.resolved.site.placement
    if placement.edges == "sample":
        path, crs = str(site.file("sample/edges.geojson")), None
    else:
        path, crs = site.resolved.layered(str(placement.edges)), placement.edges_crs
    return _drawn(read_lines(path, frame, crs))


def _drawn(lines: gpd.GeoDataFrame) -> list[dict[str, Any]]:
    named = zip(lines["edge"], lines["kind"], lines.geometry, strict=True)
    return [
        {"name": name, "kind": kind, "points": _points(line.coords)} for name, kind, line in named
    ]


def _points(coordinates: Any) -> list[list[float]]:
    return [[round(c[0], 4), round(c[1], 4)] for c in coordinates]


def _zones(zones: gpd.GeoDataFrame) -> list[dict[str, Any]]:
    names = zones["name"] if "name" in zones else [f"zone{n + 1}" for n in range(len(zones))]
    return [
        {"name": str(name), "points": _points(area.exterior.coords[:-1])} | _holes(area)
        for name, area in zip(names, zones.geometry, strict=True)
    ]


def _holes(area: Polygon) -> dict[str, Any]:
    holes = [_points(ring.coords[:-1]) for ring in area.interiors]
    return {"holes": holes} if holes else {}


def _mounts(mounts: Any) -> list[dict[str, Any]]:
    return [
        {
            "name": row.name,
            "x": round(row.x, 4),
            "y": round(row.y, 4),
            "height_m": None if row.top_m != row.top_m else row.top_m,
        }
        for row in mounts.itertuples(index=False)
    ]


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
        return _save(project, site, drawing)


def _save(project: Project, site: SiteFolder, drawing: Drawing) -> list[str]:
    frame = site.frame()
    layers = _layers(site, frame, drawing)
    files: dict[str, Writer] = {
        f"{name}.geojson": partial(write_geojson, features=layer, frame=frame)
        for name, layer in layers.items()
        if layer is not None
    }
    named = {
        name: f"{name}.geojson" if layer is not None else None for name, layer in layers.items()
    }
    if "edges" in layers and site.resolved.site.placement.edges_crs is not None:
        named["edges_crs"] = None
    return save_beside(project, site, _SECTION, files, named)


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
