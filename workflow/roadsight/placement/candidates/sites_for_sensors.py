"""Where sensors may hang besides road edges, and where they may not: existing poles, zones."""

from __future__ import annotations

import numpy as np
import pandas as pd
import shapely
from shapely import MultiPolygon

from roadsight.base.arrays import Bools, Floats

POLE = "pole"
"""Mount of positions on poles, and what their keys begin with."""


def outside_zones(xy_m: Floats, zones: list[shapely.Polygon]) -> Bools:
    """Whether places (n, 2) lie outside all zones without sensors; the rim belongs to a zone."""
    if not zones or not len(xy_m):
        return np.ones(len(xy_m), bool)
    return ~shapely.intersects_xy(shapely.union_all(zones), *np.asarray(xy_m, np.float64).T)


def positions_on_poles(poles: pd.DataFrame, pavement: MultiPolygon, arm_m: float) -> pd.DataFrame:
    """Positions of sensors on arms of existing poles, towards the nearest pavement.

    A sensor keeps off the pole's own points by its arm, so that the pole is neither in its way nor
    all that it sees.

    Parameters
    ----------
    poles : name (unique), x, y and top_m (height of the pole, NaN if unknown), local metres.
    arm_m : length of the arm.

    Returns
    -------
    the columns of `positions.positions_along` and top_m; a pole on the pavement, or where there is
    no pavement, holds its sensor to the north
    """
    xy = poles[["x", "y"]].to_numpy(np.float64).reshape(-1, 2)
    direction = _towards(xy, pavement)
    place = xy + arm_m * direction
    return pd.DataFrame(
        {
            "x": place[:, 0],
            "y": place[:, 1],
            "station_m": np.zeros(len(xy)),
            "yaw_deg": np.degrees(np.arctan2(direction[:, 1], direction[:, 0])),
            "edge": poles["name"].astype(str).to_numpy(),
            "mount": POLE,
            "key": [f"{POLE}-{name}" for name in poles["name"]],
            "top_m": poles["top_m"].to_numpy(np.float64),
        }
    )


def _towards(xy_m: Floats, pavement: MultiPolygon) -> Floats:
    """Unit vectors (n, 2) from places to the nearest pavement."""
    north = np.tile([0.0, 1.0], (len(xy_m), 1))
    if pavement.is_empty or not len(xy_m):
        return north
    nearest = shapely.get_coordinates(
        shapely.get_point(shapely.shortest_line(pavement, shapely.points(xy_m)), 0)
    )
    step = nearest - xy_m
    length = np.hypot(*step.T)
    clear = length > 1e-9
    north[clear] = step[clear] / length[clear, None]
    return north
