"""Layers of the roadside: rated objects, cross-sections, road geometry."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from roadsight.base.arrays import Floats
from roadsight.poles.risk.cross_sections import Height
from roadsight.poles.risk.roads import Road
from roadsight.poles.risk.roadside import Surroundings

GEOMETRY = {"hazard": "Point", "cross_sections": "LineString", "road_geometry": "LineString"}
"""Of layers that hold nothing."""
_STEP_KINDS = ("kerb", "drop-off", "wall")


def hazard_points(table: pd.DataFrame, height: Height | None) -> gpd.GeoDataFrame:
    """Rated objects as points; with z of the ground where all of it is known."""
    places = _with_z(table[["x", "y"]].to_numpy(np.float64), height)
    return gpd.GeoDataFrame(table.drop(columns=["x", "y"]), geometry=shapely.points(places))


def section_lines(table: pd.DataFrame, height: Height | None) -> gpd.GeoDataFrame:
    """Elements of cross-sections as lines in plan, each with the step that stands before it.

    Steps (kerbs, drop-offs, walls) have no width: ``step`` and ``step_m`` tell them on the element
    beyond.
    """
    step = table["kind"].isin(_STEP_KINDS).to_numpy(bool)
    before = np.r_[False, step[:-1]] if len(step) else step
    kinds = np.r_[[""], table["kind"].to_numpy(object)][: len(table)]
    rises = np.r_[[0.0], table["rise_m"].to_numpy(np.float64)][: len(table)]
    told = table.assign(step=np.where(before, kinds, ""), step_m=np.where(before, rises, 0.0))
    told = told[~step].reset_index(drop=True)
    ends = [told[[f"{end}_x", f"{end}_y"]].to_numpy(np.float64) for end in ("start", "end")]
    places = _with_z(np.stack(ends, axis=1).reshape(-1, 2), height)
    pairs = places.reshape(len(told), 2, -1) if len(told) else np.empty((0, 2, 2))
    return gpd.GeoDataFrame(told, geometry=[shapely.LineString(pair) for pair in pairs])


def geometry_lines(
    table: pd.DataFrame, surroundings: Surroundings, every_m: float, scale: float
) -> gpd.GeoDataFrame:
    """Centrelines in pieces, each with the geometry at its middle.

    Parameters
    ----------
    table : see `roadsight.poles.risk.roadside.geometry_table`. every_m : spacing of its rows.
    scale : metres of the grid for each metre on the ground, in which the roads are.
    """
    roads = surroundings.roads.roads
    counts = [len(surroundings.geometry(number)) for number in range(len(roads))]
    own = np.repeat(np.arange(len(roads)), counts)
    z_known = bool(len(table)) and bool(table["z"].notna().all())
    numbers = table[["station_m", "x", "y", "z", "grade_percent"]].to_numpy(np.float64)
    lines = []
    for (station, x, y, z, grade), number in zip(numbers, own, strict=True):
        line = _piece(roads[number], float(station), every_m) * scale
        if z_known:
            away = np.hypot(line[:, 0] - x, line[:, 1] - y) / scale
            sign = np.where(np.arange(len(line)) < len(line) / 2, -1.0, 1.0)
            line = np.column_stack([line, z + sign * away * np.nan_to_num(grade) / 100])
        lines.append(shapely.LineString(line))
    return gpd.GeoDataFrame(
        table.drop(columns=["x", "y", "z"]).reset_index(drop=True), geometry=lines
    )


def _piece(road: Road, station: float, every_m: float) -> Floats:
    """Centreline from half a spacing before a station to half a spacing beyond (n, 2)."""
    low = max(station - every_m / 2, road.start_m)
    high = min(station + every_m / 2, road.end_m)
    if high - low < 1e-3:
        low, high = station - every_m / 2, station + every_m / 2
    return road.place(np.unique(np.r_[low, np.clip(station, low, high), high]))


def _with_z(xy: Floats, height: Height | None) -> Floats:
    """Places (n, 2) with z (n, 3) where all heights are known."""
    if height is None or not len(xy):
        return xy
    z = np.asarray(height(xy[:, 0], xy[:, 1]), np.float64)
    return np.column_stack([xy, z]) if np.isfinite(z).all() else xy


def rounded(table: pd.DataFrame) -> pd.DataFrame:
    """Numbers with as many decimals as anyone reads: a tenth of a millimetre, of a per mille."""
    return table.round({name: 4 for name in table if name not in ("x", "y", "z")})
