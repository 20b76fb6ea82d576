"""Rules by which masts are built, and what they cost: applied to candidates after detection.

Nothing here changes what a candidate sees, so that a rule or a price asks for another cover and for
nothing before it.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
import pandas as pd
import shapely
from pydantic import Field
from shapely import MultiPolygon

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.base.section import Section

Length = Annotated[float, Field(ge=0, le=1000)]
Money = Annotated[float, Field(ge=0, le=1e12)]
# A cabinet farther than this from every candidate is on another site: cables are of some 100 m.
_OFF_SITE_M = 2000.0
_ROUNDING_M = 1e-6  # distances are sums of steps: rounding must not put one beyond its limit


class Mounting(Section):
    """Where new masts may stand, and what they cost, in the unit of sensors' costs."""

    offset_min_m: Length = Field(default=0.0, description="least distance off the pavement, m")
    clear_zone_m: Length = Field(
        default=0.0, description="masts nearer to the pavement than this need shielding, m"
    )
    unshielded: Literal["cost", "forbid"] = Field(
        default="cost", description="masts in the clear zone: shielded at a cost, or none"
    )
    shielding_cost: Money = Field(default=0.0, description="cost of shielding a mast")
    median: Literal["allow", "forbid"] = Field(
        default="allow", description="whether a median may carry masts"
    )
    clearance_m: Length = Field(
        default=0.0, description="least height of sensors near or above the pavement, m"
    )
    clearance_within_m: Length = Field(default=0.5, description="and how near that is, m")
    wall_distance_m: float = Field(
        default=0.0, ge=0, le=2, description="least distance of sensors from walls, m"
    )
    mast_cost: Money = Field(default=0.0, description="cost of a new mast")
    mast_cost_per_m: Money = Field(default=0.0, description="and of each metre of its height")
    foundation_cost: Money = Field(default=0.0, description="cost of its foundation")
    cable_cost_per_m: Money = Field(
        default=0.0, description="cost of a metre of power and fibre, to the nearest cabinet"
    )
    cable_max_m: Length = Field(default=0.0, description="longest cable, m; 0: any length")


def cable_lengths_m(
    candidates: pd.DataFrame, cabinets: pd.DataFrame | None, rules: Mounting, where: str
) -> Floats | None:
    """Distance of each candidate (m,) from the nearest cabinet; None where there is none.

    Parameters
    ----------
    candidates : columns x and y. cabinets : columns id, x and y, local metres.

    Raises
    ------
    InputError : a cabinet lies off the site, or cables cost something and no cabinet is known.
    """
    if cabinets is None:
        if rules.cable_cost_per_m > 0 or rules.cable_max_m > 0:
            raise InputError(
                "cables have a cost or a limit, but no cabinet is known",
                where=where,
                hint="name a file of points as placement.cabinets, or leave both out",
            )
        return None
    from scipy.spatial import cKDTree  # noqa: PLC0415  # slow to load, and each run reads the rules

    places = candidates[["x", "y"]].to_numpy(np.float64)
    boxes = cabinets[["x", "y"]].to_numpy(np.float64)
    if not len(places):
        return np.zeros(0)
    to_site_m, _ = cKDTree(places).query(boxes)
    if to_site_m.max() > _OFF_SITE_M:
        off = int(np.argmax(to_site_m))
        raise InputError(
            f"cabinet {cabinets['id'].iloc[off]} lies off the site",
            where=where,
            found=f"{to_site_m[off]:.0f} m from the nearest candidate",
            allowed=f"{_OFF_SITE_M:g} m",
            hint="check the CRS of the cabinets' file",
        )
    return np.asarray(cKDTree(boxes).query(places)[0])


def may_be_built(candidates: pd.DataFrame, rules: Mounting, cable_m: Floats | None) -> Bools:
    """Whether the rules allow each candidate (m,). Poles that stand already need only their cable.

    Parameters
    ----------
    candidates : columns mount and height_m; off_pavement_m and wall_m (to what stands
        beside the sensor), where they were measured.
    """
    new = (candidates["mount"] != POLE).to_numpy()
    height_m = candidates["height_m"].to_numpy(np.float64)
    allowed = np.ones(len(candidates), bool)
    if "off_pavement_m" in candidates:
        offset_m = candidates["off_pavement_m"].to_numpy(np.float64)
        allowed &= ~new | (offset_m >= rules.offset_min_m - _ROUNDING_M)
        if rules.unshielded == "forbid":
            allowed &= ~new | (offset_m >= rules.clear_zone_m - _ROUNDING_M)
        low = offset_m < rules.clearance_within_m - _ROUNDING_M
        allowed &= ~low | (height_m >= rules.clearance_m - _ROUNDING_M)
    if rules.median == "forbid":
        allowed &= ~new | (candidates["mount"] != "median").to_numpy()
    if "wall_m" in candidates:
        wall_m = candidates["wall_m"].to_numpy(np.float64)
        allowed &= ~new | (wall_m >= rules.wall_distance_m - _ROUNDING_M)
    if cable_m is not None and rules.cable_max_m > 0:
        allowed &= cable_m <= rules.cable_max_m + _ROUNDING_M
    return allowed


def building_cost(candidates: pd.DataFrame, rules: Mounting, cable_m: Floats | None) -> Floats:
    """What each candidate (m,) costs beside its sensor: mast, foundation, shielding, cable."""
    new = (candidates["mount"] != POLE).to_numpy()
    height_m = candidates["height_m"].to_numpy(np.float64)
    mast = rules.mast_cost + rules.foundation_cost + rules.mast_cost_per_m * height_m
    if "off_pavement_m" in candidates:
        near = candidates["off_pavement_m"].to_numpy(np.float64) < rules.clear_zone_m - _ROUNDING_M
        mast = mast + rules.shielding_cost * near
    cable = 0.0 if cable_m is None else rules.cable_cost_per_m * cable_m
    return np.asarray(np.where(new, mast, 0.0) + cable, np.float64)


POLE = "pole"  # mount of positions on poles, and what their keys begin with


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
    the columns of `positions_along` and top_m; a pole on the pavement, or where there is
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
