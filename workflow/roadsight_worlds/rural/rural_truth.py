"""Layers of what is true about the rural site, local metres."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import shapely

from roadsight_worlds.rural.rural_ground import SIDE_ROAD, Branch
from roadsight_worlds.rural.rural_road import RuralSite
from roadsight_worlds.rural.videolog_tables import pole_table

# By kind of branch (`SIDE_ROAD` and so on).
_KINDS = ("side road", "gravel driveway", "paved driveway", "car park")
_MARGIN_M = 20.0  # Layers go on so far beyond both ends of the road.
_ARC_POINTS = 24  # Points of a rounded corner.


def rural_layers(site: RuralSite) -> dict[str, gpd.GeoDataFrame]:
    """Layers of what is true, by name: road, its edges, and what stands beside it.

    ``pavement`` (with side road), ``driveways`` (with car parks), ``edges``, ``centreline``,
    ``poles``, ``trees``, ``guardrails``, ``buildings``. Curves are drawn by chords of 0.5 m, less
    than 0.2 mm off.
    """
    stations = np.arange(-_MARGIN_M, site.length_m + _MARGIN_M + 0.25, 0.5)
    half = site.ground.section.pavement_m
    left, right = (site.line.plan(stations, s * half) for s in (1.0, -1.0))
    shapes = [("road", shapely.Polygon(np.concatenate([left, right[::-1]])))]
    shapes += [(_KINDS[b.kind], _outline(b)) for b in site.ground.branches]
    roads = [(k, s) for k, s in shapes if k in ("road", _KINDS[SIDE_ROAD])]
    drives = [(k, s) for k, s in shapes if k not in ("road", _KINDS[SIDE_ROAD])]
    lines = {"left": left, "right": right}
    middle = shapely.LineString(site.line.plan(stations, 0.0))
    columns = {
        "kind": [tree.kind for tree in site.trees],
        "height_m": [tree.height_m for tree in site.trees],
        "edge_distance_m": [abs(tree.offset_m) - half for tree in site.trees],
    }
    stems = [shapely.Point(tree.xyz_m) for tree in site.trees]
    table = pole_table(site)
    feet = [shapely.Point(pole.xyz_m) for pole in site.poles]
    return {
        "pavement": _features(roads),
        "driveways": _features(drives),
        "edges": _features([(name, shapely.LineString(line)) for name, line in lines.items()]),
        "centreline": _features([("middle", middle)]),
        "poles": gpd.GeoDataFrame(table.drop(columns=["x_m", "y_m", "z_m"]), geometry=feet),
        "trees": gpd.GeoDataFrame(columns, geometry=stems),
        "guardrails": _features([("guardrail", shapely.LineString(g)) for g in site.guardrails]),
        "buildings": _features([("building", shapely.Polygon(b)) for b in site.buildings]),
    }


def _features(shapes: list[tuple[str, shapely.Geometry]]) -> gpd.GeoDataFrame:
    return gpd.GeoDataFrame({"kind": [k for k, _ in shapes]}, geometry=[s for _, s in shapes])


def _outline(branch: Branch) -> shapely.Polygon:
    """Branch with its rounded corners, from the road's pavement edge."""
    radius = branch.radius_m
    into = radius * np.linspace(0.0, 1.0, _ARC_POINTS)
    along = np.concatenate([[-1.5], into, [branch.length_m]])
    bend = radius - np.clip(along, 0.0, radius)
    half = branch.half_m + radius - np.sqrt(radius**2 - bend**2)
    left = np.array([-branch.ahead[1], branch.ahead[0]])
    sides = [
        branch.start_m + along[:, None] * branch.ahead + s * half[:, None] * left
        for s in (1.0, -1.0)
    ]
    return shapely.Polygon(np.concatenate([sides[0], sides[1][::-1]]))
