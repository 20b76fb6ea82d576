"""The table that a crew takes along to set out a plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from roadsight.base.arrays import Floats
from roadsight.geometry.frames import Frame
from roadsight.placement.plans.handover import stations_m
from roadsight.report.handover.layers import sensor_table

_DECIMALS = {"latitude": 8, "longitude": 8}
"""Degrees to a millimetre; everything else to a millimetre or a thousandth of a degree."""


def stakeout(
    plan: str, sensors: Sequence[dict[str, Any]], edges: gpd.GeoDataFrame, frame: Frame
) -> pd.DataFrame:
    """One row a sensor.

    Parameters
    ----------
    sensors : entries of solution.json. edges : lines with their name (edge), local metres.

    Returns
    -------
    plan, point (plan and number), easting and northing (native), ground_m and sensor_m (height of
    ground and sensor in the cloud's vertical datum, metres), mast_m (sensor above ground),
    azimuth_deg (to set, clockwise from grid north), pitch_deg, roll_deg, sensor, chainage_m (along
    the road: its longest edge, from that edge's start), edge (whose line the sensor stands on),
    edge_m (along that line from its start), offset_m (to the right of it in its direction),
    latitude and longitude
    """
    table = sensor_table(sensors, frame)
    xy = table[["x", "y"]].to_numpy(np.float64)
    native = frame.to_native(xy)
    along, beside = _along(edges, table["edge"].astype(str).tolist(), xy)
    found = pd.DataFrame(
        {
            "plan": plan,
            "point": [f"{plan}-{number:02d}" for number in table["number"]],
            "easting": native[:, 0],
            "northing": native[:, 1],
            "ground_m": table["ground_m"],
            "sensor_m": table["sensor_m"],
            "mast_m": table["height_m"],
            "azimuth_deg": table["azimuth_deg"],
            "pitch_deg": table["pitch_deg"],
            "roll_deg": table["roll_deg"],
            "sensor": table["sensor"],
            "chainage_m": stations_m(list(edges.geometry), xy),
            "edge": table["edge"],
            "edge_m": along,
            "offset_m": beside,
            "latitude": table["latitude"],
            "longitude": table["longitude"],
        }
    )
    decimals = {str(name): 3 for name in found.select_dtypes("number")} | _DECIMALS
    return found.round(decimals).replace(-0.0, 0.0)


def _along(edges: gpd.GeoDataFrame, names: list[str], xy_m: Floats) -> tuple[Floats, Floats]:
    """Length along its own edge and offset to the right of places; NaN if no edge has the name."""
    lines = dict(zip(edges["edge"].astype(str), edges.geometry, strict=True))
    length, offset = np.full(len(xy_m), np.nan), np.full(len(xy_m), np.nan)
    for row, (name, place) in enumerate(zip(names, xy_m, strict=True)):
        line = lines.get(name)
        if line is None:
            continue
        length[row] = shapely.line_locate_point(line, shapely.Point(place))
        step = min(1.0, line.length / 2)
        start = shapely.line_interpolate_point(line, max(length[row] - step, 0.0))
        end = shapely.line_interpolate_point(line, min(length[row] + step, line.length))
        foot = shapely.line_interpolate_point(line, length[row])
        way = np.array([end.x - start.x, end.y - start.y])
        away = place - np.array([foot.x, foot.y])
        side = np.sign(away[0] * way[1] - away[1] * way[0])
        offset[row] = side * np.hypot(*away)
    return length, offset
