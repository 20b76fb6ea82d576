"""The layers of a site as one set, with their descriptions and how they are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from roadsight.base.arrays import Floats
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import bearing_deg, longitudes_latitudes
from roadsight.io.raster.rasters import Raster
from roadsight.report.handover.styles import SEEN, Category, Style

_SEEN = tuple(Category(str(n), f"seen {by}", rgb) for n, (by, rgb) in enumerate(SEEN.items()))
_RATED = (
    Category("high", "high", "#dc2626"),
    Category("medium", "medium", "#f59e0b"),
    Category("low", "low", "#16a34a"),
    Category("unknown", "unknown", "#64748b"),
)
_BESIDE = (
    Category("shoulder", "shoulder", "#94a3b8"),
    Category("foreslope", "foreslope", "#dc2626"),
    Category("ditch bottom", "ditch bottom", "#2563eb"),
    Category("backslope", "backslope", "#f59e0b"),
    Category("level", "level", "#16a34a"),
)
_KEPT = (Category("1", "kept", "#b45309"), Category("0", "withheld", "#cbd5e1"))
_LOST = (
    Category("2", "lost by more than 5 % of the changes", "#dc2626"),
    Category("1", "lost by fewer", "#f59e0b"),
    Category("0", "lost by none", "#16a34a"),
    Category("3", "not looked at", "#9ca3af"),
)
_BY_POINTS = (
    Category("2", "10 or more", "#1e3a8a"),
    Category("1", "fewer than 10", "#3b82f6"),
    Category("0", "none", "#dc2626"),
)
# On the lowest quarter of a target; plans of LiDARs have points, those of cameras pixels
_LOW = "coalesce(attribute('points_1'), attribute('pixels_1'))"
_EDGE = Style("line", "#0f172a", size_mm=0.4)
SENSOR_STYLE = Style("marker", "#b45309", size_mm=3.4, label="number")


@dataclass(frozen=True)
class Layer:
    """One layer of a hand-over.

    Parameters
    ----------
    name : in the GeoPackage. group : heading in a project. about : one sentence.
    features : in local metres, with z where heights are known. style : how it is drawn.
    geometry : type of its features, for a layer that holds none.
    """

    name: str
    group: str
    about: str
    features: gpd.GeoDataFrame
    style: Style
    geometry: str


@dataclass(frozen=True)
class Linked:
    """A layer that a project shows from a file of its own.

    Parameters
    ----------
    name, group, about : as of a `Layer`. source : address of the file from the project.
    style : how features are drawn; None for a raster. geometry : of features, empty for a raster.
    is_relief : whether a raster is drawn as relief.
    """

    name: str
    group: str
    about: str
    source: str
    style: Style | None = None
    geometry: str = ""
    is_relief: bool = False


def draped(features: gpd.GeoDataFrame, dem: Raster) -> gpd.GeoDataFrame:
    """Features with z of the ground at each vertex; where the ground is unknown, of the nearest.

    Parameters
    ----------
    features : local metres, any z is replaced. dem : heights in local metres.
    """
    geometries = features.geometry.to_numpy()
    xy = shapely.get_coordinates(geometries)
    z = dem.sample(xy[:, 0], xy[:, 1])
    known = np.isfinite(z)
    order = np.arange(len(z))
    z = np.interp(order, order[known], z[known]) if known.any() else np.zeros(len(z))
    flat = shapely.force_3d(shapely.force_2d(geometries))
    placed = shapely.set_coordinates(flat, np.column_stack([xy, z]))
    return features.set_geometry(gpd.GeoSeries(placed, features.index))


def sensor_table(sensors: Sequence[dict[str, Any]], frame: Frame) -> pd.DataFrame:
    """Chosen sensors as a crew and a GIS need them.

    Parameters
    ----------
    sensors : entries of solution.json.

    Returns
    -------
    number (from 1), candidate, sensor, edge, mount, height_m (above ground), ground_m and sensor_m
    (heights in metres in the cloud's own vertical datum), azimuth_deg (where it faces, clockwise
    from grid north), yaw_deg (the same counter-clockwise from grid east), pitch_deg and roll_deg,
    latitude and longitude (WGS 84, NaN without CRS), targets, only; x, y, z in local metres
    """
    xyz = np.array([[entry[axis] for axis in "xyz"] for entry in sensors]).reshape(-1, 3)
    degrees = longitudes_latitudes(frame, xyz[:, :2]) if len(xyz) else None
    sensor_m = frame.to_native(xyz)[:, 2] * frame.vertical_unit_m

    def column(name: str, missing: Any) -> list[Any]:
        return [entry.get(name, missing) for entry in sensors]

    heights = np.array(column("height_m", np.nan), np.float64)
    unknown = np.full(len(xyz), np.nan)
    return pd.DataFrame(
        {
            "number": np.arange(1, len(xyz) + 1),
            "candidate": column("candidate", ""),
            "sensor": column("sensor", ""),
            "edge": column("edge", ""),
            "mount": column("mount", ""),
            "height_m": heights,
            "ground_m": sensor_m - heights,
            "sensor_m": sensor_m,
            "azimuth_deg": [bearing_deg(float(yaw)) for yaw in column("yaw_deg", np.nan)],
            "yaw_deg": np.array(column("yaw_deg", np.nan), np.float64),
            "pitch_deg": np.array(column("pitch_deg", 0.0), np.float64),
            "roll_deg": np.array(column("roll_deg", 0.0), np.float64),
            "latitude": unknown if degrees is None else degrees[:, 1],
            "longitude": unknown if degrees is None else degrees[:, 0],
            "targets": np.array(column("targets", 0), np.int64),
            "only": np.array(column("only", 0), np.int64),
            "x": xyz[:, 0],
            "y": xyz[:, 1],
            "z": xyz[:, 2],
        }
    )


def field_text(value: Any) -> str:
    """Value of a feature's field as text, empty where there is none."""
    if not isinstance(value, str) and pd.isna(value):
        return ""
    return f"{value:.10g}" if isinstance(value, float | np.floating) else str(value)


def scene_layers(
    pavement: gpd.GeoDataFrame,
    edges: gpd.GeoDataFrame,
    dem: Raster,
    unexamined: gpd.GeoDataFrame | None = None,
) -> list[Layer]:
    """Road edges, what of the pavement was not examined, and pavement, on the ground."""
    found = [
        ("edges", "Lines along which sensors may stand; z is the ground.", edges, _EDGE),
        (
            "unexamined",
            "Pavement for which no target stands: nothing is proven there; z is the ground.",
            unexamined,
            Style("fill", "#dc2626", size_mm=0.2, pattern="b_diagonal"),
        ),
        (
            "pavement",
            "Pavement on which targets are to be seen; z is the ground.",
            pavement,
            Style("fill", "#94a3b8", size_mm=0.2, opacity=0.4),
        ),
    ]
    return [
        Layer(
            name,
            "Scene",
            about,
            draped(features, dem),
            style,
            "LineString Z" if style.kind == "line" else "Polygon Z",
        )
        for name, about, features, style in found
        if features is not None
    ]


def plan_layers(
    plan: str,
    sensors: gpd.GeoDataFrame,
    targets: gpd.GeoDataFrame,
    obstacles: gpd.GeoDataFrame,
    uncovered: gpd.GeoDataFrame,
    objects: gpd.GeoDataFrame | None = None,
) -> list[Layer]:
    """Layers of a plan, the sensors on top."""
    found = [
        ("sensors", "Chosen sensors; z is the sensor's.", sensors, SENSOR_STYLE),
        (
            "uncovered",
            "Targets that no candidate sees, and why.",
            uncovered,
            Style("marker", "#dc2626", size_mm=2.0),
        ),
        (
            "obstacles",
            "What stands in the way of sight lines.",
            obstacles,
            Style("marker", "#7c3aed", size_mm=1.2),
        ),
        (
            "objects",
            "Objects in the way, by what they hide.",
            objects,
            Style("marker", "#be185d", size_mm=2.4, label="name"),
        ),
        (
            "targets",
            "Targets by the number of chosen sensors that see them.",
            targets,
            Style("marker", _SEEN[1].colour, size_mm=1.2, by='min("sensors", 3)', categories=_SEEN),
        ),
    ]
    return [
        Layer(f"{name}_{plan}", f"Plan {plan}", about, features, style, "Point Z")
        for name, about, features, style in found
        if features is not None
    ]


def measured_layers(plan: str, folder: str) -> list[Linked]:
    """What was measured of a plan beyond its cover: tolerance and data, in files of their own.

    Parameters
    ----------
    folder : of the plan, from the project.
    """
    found = [
        (
            "data_sensors",
            "Points and pixels a second of the sensors, and what each shares with the next.",
            f"{folder}/data.gpkg|layername=sensors",
            Style("marker", "#0f766e", size_mm=3.0, label="road_points_per_s"),
        ),
        (
            "tolerance",
            "Targets by the share of small changes that lose them.",
            f"{folder}/tolerance.gpkg|layername=targets",
            Style(
                "marker",
                _LOST[2].colour,
                size_mm=1.2,
                by=(
                    'CASE WHEN "lost_share" > 0.05 THEN 2 WHEN "lost_share" > 0 THEN 1'
                    ' WHEN "lost_share" = 0 THEN 0 ELSE 3 END'
                ),
                categories=_LOST,
            ),
        ),
        (
            "data_targets",
            "Targets by the points, or pixels, of a frame on the lowest quarter of their height.",
            f"{folder}/data.gpkg|layername=targets",
            Style(
                "marker",
                _BY_POINTS[0].colour,
                size_mm=1.2,
                by=f"CASE WHEN {_LOW} >= 10 THEN 2 WHEN {_LOW} >= 1 THEN 1 ELSE 0 END",
                categories=_BY_POINTS,
            ),
        ),
    ]
    return [
        Linked(f"{name}_{plan}", f"Plan {plan}", about, source, style, "Point Z")
        for name, about, source, style in found
    ]


_POLE_LAYERS = {
    "poles": (
        "Located poles, and those that were withheld with the reason.",
        Style("marker", _KEPT[0].colour, 3.0, "id", by='if("kept", 1, 0)', categories=_KEPT),
        "Point Z",
    ),
    "rays": (
        "Sight lines from images to the poles that they place.",
        Style("line", "#94a3b8", size_mm=0.2),
        "LineString",
    ),
    "ellipses": (
        "One-sigma ellipses of the poles.",
        Style("fill", "#b45309", size_mm=0.3, opacity=0.2),
        "Polygon",
    ),
    "guardrails": (
        "Guardrails of the cloud, and how many views show them.",
        Style("line", "#0e7490", size_mm=0.8, label="id"),
        "LineString",
    ),
    "road_edges": (
        "Edges of the road in the LiDAR.",
        Style("line", "#0f172a", size_mm=0.4),
        "LineString Z",
    ),
    "hazard": (
        "Poles by the hazard that they are to traffic.",
        Style("marker", _RATED[1].colour, size_mm=2.6, by="rating", categories=_RATED),
        "Point Z",
    ),
    "cross_sections": (
        "What lies beside the road, square to it: slopes with their uncertainty.",
        Style("line", _BESIDE[0].colour, size_mm=0.6, by="kind", categories=_BESIDE),
        "LineString Z",
    ),
    "road_geometry": (
        "Centreline by station: radius, grade, cross-slope, width with their uncertainty.",
        Style("line", "#7c3aed", size_mm=0.3),
        "LineString Z",
    ),
}


def pole_layers(found: dict[str, gpd.GeoDataFrame]) -> list[Layer]:
    """Layers of the pole job that there are, the poles on top."""
    return [
        Layer(name, "Poles", about, found[name], style, geometry)
        for name, (about, style, geometry) in _POLE_LAYERS.items()
        if name in found
    ]


def bounds_native(layers: Sequence[Layer], frame: Frame) -> Floats:
    """West, south, east, north of all features in native coordinates, (4,)."""
    found = [layer.features.total_bounds for layer in layers if len(layer.features)]
    if not found:
        return np.zeros(4)
    boxes = np.array(found).reshape(-1, 2, 2)
    return frame.to_native(np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])).ravel()
