"""What is true about the sample site: surfaces, pavement, edges, poles, objects."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import shapely

from roadsight.base.arrays import Floats
from roadsight_worlds.casting.alignment import to_plan
from roadsight_worlds.casting.primitives import BOX, ELLIPSOID, RECTANGLE, Bodies, body_extent_m
from roadsight_worlds.highway.highway import Highway

_LINE_STEP_M = 0.5  # Chords that edges are drawn by.
# Least and greatest distance between the points that a person would click on an edge.
_CLICK_SPACING_M = (15.0, 25.0)
_CLICK_SIGMA_M = 0.05  # How far a person clicks beside the edge, one sigma.


def truth_layers(highway: Highway) -> dict[str, gpd.GeoDataFrame]:
    """Layers ``pavement``, ``edges``, ``poles`` and ``objects`` in local metres.

    Curves are drawn by chords of 0.5 m, at most 0.06 mm off. A pole's point is its foot.
    """
    inner, outer = highway.section.pavement_m
    rings = [(_line(highway, s * inner), _line(highway, s * outer)[::-1]) for s in (1.0, -1.0)]
    shapes = [shapely.Polygon(np.concatenate(ring)) for ring in rings]
    listed = {
        name: [getattr(pole, name) for pole in highway.poles]
        for name in ("kind", "station_m", "offset_m", "height_m", "radius_m")
    }
    feet = [shapely.Point(pole.xyz_m) for pole in highway.poles]
    return {
        "pavement": gpd.GeoDataFrame({"carriageway": ["left", "right"]}, geometry=shapes),
        "edges": _edges(highway),
        "poles": gpd.GeoDataFrame(listed, geometry=feet),
        "objects": _objects(highway),
    }


def digitised_edges(highway: Highway, rng: np.random.Generator) -> gpd.GeoDataFrame:
    """Edges as somebody would click them: a point every 15 m to 25 m, 5 cm off along each axis.

    LineStrings in local metres: the outer edges of both carriageways (``kind`` "edge") and the
    middle of the median ("median").
    """
    outer = highway.section.pavement_m[1]
    lines = {"left": (outer, "edge"), "median": (0.0, "median"), "right": (-outer, "edge")}
    clicked = []
    for offset, _ in lines.values():
        stations = [0.0]
        while stations[-1] + _CLICK_SPACING_M[1] < highway.length_m:
            stations.append(stations[-1] + rng.uniform(*_CLICK_SPACING_M))
        stations.append(highway.length_m)  # the last step as it comes out
        road = np.column_stack([stations, np.full(len(stations), offset)])
        exact = to_plan(highway.alignment, road)
        clicked.append(exact + rng.normal(0.0, _CLICK_SIGMA_M, exact.shape))
    columns = {"edge": list(lines), "kind": [kind for _, kind in lines.values()]}
    return gpd.GeoDataFrame(columns, geometry=[shapely.LineString(line) for line in clicked])


def _line(highway: Highway, offset_m: float) -> Floats:
    """Plan points (n, 2) along an offset, from the start to the end of the site."""
    pieces = int(np.ceil(highway.length_m / _LINE_STEP_M))
    stations = np.linspace(0.0, highway.length_m, pieces + 1)
    return to_plan(highway.alignment, np.column_stack([stations, np.full_like(stations, offset_m)]))


def _edges(highway: Highway) -> gpd.GeoDataFrame:
    inner, outer = highway.section.pavement_m
    offsets = {
        "left": outer,
        "median_left": inner,
        "median": 0.0,
        "median_right": -inner,
        "right": -outer,
    }
    kinds = ["median" if name.startswith("median") else "edge" for name in offsets]
    shapes = [shapely.LineString(_line(highway, offset)) for offset in offsets.values()]
    columns = {"edge": list(offsets), "kind": kinds, "offset_m": list(offsets.values())}
    return gpd.GeoDataFrame(columns, geometry=shapes)


def _objects(highway: Highway) -> gpd.GeoDataFrame:
    """Footprint of every object but the ground, with its lowest and highest point."""
    scene, bodies = highway.scene, highway.scene.bodies
    outlines = np.array([_outline(bodies, i) for i in range(len(bodies.kind))], dtype=object)
    reach = body_extent_m(bodies)[:, 2]
    bottom, top = bodies.centre_m[:, 2] - reach, bodies.centre_m[:, 2] + reach
    numbers = [i for i in range(len(scene.objects)) if i != highway.terrain.object_id]
    parts = [np.flatnonzero(bodies.object_id == i) for i in numbers]
    columns = {
        "object_id": list(numbers),
        "kind": [scene.objects[i].kind for i in numbers],
        "truth_class": [int(scene.objects[i].truth_class) for i in numbers],
        "bottom_m": [float(bottom[part].min()) for part in parts],
        "top_m": [float(top[part].max()) for part in parts],
    }
    shapes = [shapely.union_all(outlines[part]) for part in parts]
    return gpd.GeoDataFrame(columns, geometry=shapes)


def _outline(bodies: Bodies, i: int) -> shapely.Geometry:
    """Footprint of a body, round ones with 32 corners."""
    rotation, half = bodies.scene_from_body[i], bodies.half_m[i]
    turn = np.linspace(0.0, 2.0 * np.pi, 33)[:-1]
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    if bodies.kind[i] in (BOX, RECTANGLE):
        signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
        plan = signs * half @ rotation[:2].T
    elif bodies.kind[i] == ELLIPSOID:
        spread = rotation[:2] * half
        plan = circle @ np.linalg.cholesky(spread @ spread.T).T
    else:
        rims = [np.column_stack([circle, np.full(len(circle), end)]) for end in (-1, 1)]
        plan = np.concatenate(rims) * half @ rotation[:2].T
    return shapely.MultiPoint(bodies.centre_m[i, :2] + plan).convex_hull
