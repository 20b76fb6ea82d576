"""Horizontal candidate positions along edges, on the regular spacing and denser near gaps."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree
from shapely import MultiPolygon

from roadsight.base.arrays import Bools, Floats
from roadsight.placement.candidates.candidates import facing_deg

_TANGENT_M = 0.5
"""The edge's direction at a station is taken from this far behind it to this far ahead."""
_COLUMNS = {
    **dict.fromkeys(("x", "y", "station_m", "yaw_deg"), "float64"),
    **dict.fromkeys(("edge", "mount", "key"), "str"),
}
"""Columns of a table without any position."""


def positions_along(
    edges: gpd.GeoDataFrame, pavement: MultiPolygon, spacing_m: float
) -> pd.DataFrame:
    """Positions at equal steps of each edge's length.

    Parameters
    ----------
    edges : lines in local metres with columns edge (unique name) and kind.
    pavement : decides to which side a position faces.
    spacing_m : step along an edge; a station is a whole number of steps.

    Returns
    -------
    key (stable name: edge and station), x, y, yaw_deg, edge, station_m, mount.
    """
    parts = []
    for name, kind, line in zip(edges["edge"], edges["kind"], edges.geometry, strict=True):
        stations = np.arange(0.0, line.length + 1e-6, spacing_m)
        if line.is_ring and len(stations) > 1 and line.length - stations[-1] < spacing_m / 2:
            stations = stations[:-1]
        xy = _along(line, stations)
        direction = _along(line, stations + _TANGENT_M) - _along(line, stations - _TANGENT_M)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        part = pd.DataFrame({"x": xy[:, 0], "y": xy[:, 1], "station_m": stations})
        part["yaw_deg"] = facing_deg(xy, direction, pavement)
        part["edge"], part["mount"] = name, kind
        part["key"] = [f"{name}-s{station:07.2f}" for station in stations]
        parts.append(part)
    if not parts:
        return pd.DataFrame({name: pd.Series(dtype=kind) for name, kind in _COLUMNS.items()})
    return pd.concat(parts, ignore_index=True)


def _along(line: shapely.LineString, stations_m: Floats) -> Floats:
    """Points (n, 2) at stations, clipped to the line's ends."""
    inside = np.clip(stations_m, 0.0, line.length)
    return shapely.get_coordinates(shapely.line_interpolate_point(line, inside))


def near_gaps(positions: pd.DataFrame, gaps_xy_m: Floats, radius_m: float) -> Bools:
    """Positions within a plan distance of any uncovered target (n, 2)."""
    if len(gaps_xy_m) == 0:
        return np.zeros(len(positions), dtype=bool)
    distance, _ = cKDTree(gaps_xy_m).query(positions[["x", "y"]].to_numpy())
    return np.asarray(distance) <= radius_m
