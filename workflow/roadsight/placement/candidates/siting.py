"""What a plan's maps mean for targets and candidates: areas, zones, poles, fixed sensors."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from scipy import sparse
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.errors import InputError
from roadsight.placement.sensors.poses import split_pose


def needs_by_area(
    areas: gpd.GeoDataFrame, targets: pd.DataFrame, at_least: int
) -> tuple[Floats, Ints]:
    """Weight of each target and how many sensors must see it, (n,) each.

    Inside several areas, the greatest weight and the greatest number hold. Outside, and where an
    area states none, the weight is 1 and the number ``at_least``.

    Parameters
    ----------
    areas : polygons, local metres, columns weight and at_least (NaN = not stated).
    targets : columns x, y.
    """
    inside = _inside(areas, targets)
    weight = _greatest(inside, areas["weight"].to_numpy(np.float64), 1.0)
    need = _greatest(inside, areas["at_least"].to_numpy(np.float64), float(at_least))
    return weight, need.astype(np.int64)


def within_zones(zones: gpd.GeoDataFrame, candidates: pd.DataFrame) -> Bools:
    """Candidates (m,) inside or on the rim of any polygon."""
    return np.asarray(_inside(zones, candidates).any(axis=0))


def mounting_costs(
    poles: pd.DataFrame, candidates: pd.DataFrame, within_m: float, cost: float, new_cost: float
) -> tuple[Floats, Ints]:
    """Cost of mounting at each candidate (m,), and the number of its pole or -1.

    A candidate uses the cheapest pole near it whose heights allow for it, the nearest of equals.

    Parameters
    ----------
    poles : columns x, y, cost (NaN = ``cost``), height_min_m, height_max_m (NaN = no limit).
    candidates : columns x, y, height_m.
    """
    xy_m = candidates[["x", "y"]].to_numpy(np.float64)
    height_m = candidates["height_m"].to_numpy(np.float64)
    price = poles["cost"].fillna(cost).to_numpy(np.float64)
    low_m = poles["height_min_m"].fillna(-np.inf).to_numpy(np.float64)
    high_m = poles["height_max_m"].fillna(np.inf).to_numpy(np.float64)
    best = np.full(len(xy_m), float(new_cost))
    used = np.full(len(xy_m), -1, np.int64)
    places = poles[["x", "y"]].to_numpy(np.float64)
    near = cKDTree(places).query_ball_point(xy_m, within_m)
    for k, around in enumerate(near):
        # Heights are sums of steps: rounding must not put one beyond the limit that it stands for.
        fits = [p for p in around if low_m[p] - 1e-9 <= height_m[k] <= high_m[p] + 1e-9]
        if fits:
            pole = min(fits, key=lambda p: (price[p], np.hypot(*(places[p] - xy_m[k])), p))
            best[k], used[k] = price[pole], pole
    return best, used


def snapped(
    points: pd.DataFrame,
    candidates: pd.DataFrame,
    choices: pd.DataFrame,
    matrix: sparse.csr_matrix,
    forbidden: Bools,
    within_m: float,
    where: str,
) -> list[int]:
    """Row of the matrix for each point that must carry a sensor.

    A point takes the nearest place of candidates; of its heights (and poses) the one nearest to the
    stated height, then the one turned as the stated candidate is; or else the one from which its
    sensor sees most targets, the lowest of equals.

    Parameters
    ----------
    points : columns id, kind (sensor; may be "" where the plan has one), x, y, height_m (or NaN),
        candidate (in its pose; "" or no such column: none is stated).
    choices : columns sensor and position (row of ``candidates``). matrix : rows = choices.
    forbidden : (m,) candidates that must carry none.

    Raises
    ------
    InputError : a point has no candidate near it, an unknown sensor, or shares its place.
    """
    rows: list[int] = []
    sensors = list(dict.fromkeys(choices["sensor"]))
    position = choices["position"].to_numpy(np.int64)
    seen = np.diff(matrix.indptr)
    taken: dict[tuple[float, float], str] = {}
    for point in points.itertuples():
        at = f"{where}, point {point.id}"
        sensor = str(point.kind)
        if sensor in ("", "nan", "None") and len(sensors) == 1:
            sensor = sensors[0]
        if sensor not in sensors:
            raise InputError(
                "kind names no sensor of the plan",
                where=at,
                found=sensor,
                allowed=", ".join(sensors),
            )
        nearby = _nearest_place(point, candidates, forbidden, within_m, at)
        place = tuple(candidates.iloc[nearby[0]][["x", "y"]].to_numpy(np.float64))
        if place in taken:
            raise InputError(
                f"stands at the same candidates as point {taken[place]}",
                where=at,
                hint="leave one of them out, or place candidates closer (candidates.spacing_m)",
            )
        taken[place] = str(point.id)
        fits = np.isin(position, nearby) & (choices["sensor"] == sensor).to_numpy()
        all_rows = np.flatnonzero(fits)
        if not len(all_rows):
            raise InputError(f"{sensor} sees no target from there in any pose", where=at)
        height_m = candidates["height_m"].to_numpy(np.float64)[position[all_rows]]
        stated_m = float(str(point.height_m))
        off_m = np.abs(height_m - stated_m) if np.isfinite(stated_m) else np.zeros(len(height_m))
        stated, off_deg = str(getattr(point, "candidate", "")), np.zeros(len(all_rows))
        if split_pose(stated)[0] != stated:
            named = choices["candidate"].iloc[all_rows].astype(str)
            turns = np.array([split_pose(name)[1] for name in (stated, *named)])
            off_deg = np.abs((turns[1:] - turns[0] + 180.0) % 360.0 - 180.0).sum(axis=1)
        order = np.lexsort((height_m, -seen[all_rows], off_deg, off_m))
        rows.append(int(all_rows[order[0]]))
    return rows


def _nearest_place(
    point: tuple, candidates: pd.DataFrame, forbidden: Bools, within_m: float, at: str
) -> Ints:
    """All allowed candidates of the place nearest to a point."""
    xy_m = candidates[["x", "y"]].to_numpy(np.float64)
    distance_m = np.hypot(xy_m[:, 0] - point.x, xy_m[:, 1] - point.y)  # type: ignore[attr-defined]
    nearest_m = distance_m.min(initial=np.inf)
    if nearest_m > within_m:
        raise InputError(
            "has no candidate near it",
            where=at,
            found=f"the nearest is {nearest_m:.1f} m away",
            allowed=f"mandatory.within_m: {within_m:g} m",
            hint="raise it, move the point, or place candidates closer",
        )
    if forbidden.any():
        distance_m = np.where(forbidden, np.inf, distance_m)
        if distance_m.min() > within_m:
            raise InputError(
                "lies in a zone without sensors", where=at, hint="move the point or the zone"
            )
    place = xy_m[np.argmax(distance_m <= distance_m.min() + 1e-6)]  # of two as near, the first
    return np.flatnonzero((xy_m == place).all(axis=1) & np.isfinite(distance_m))


def _inside(areas: gpd.GeoDataFrame, points: pd.DataFrame) -> Bools:
    """(areas, points): whether an area holds a point, its rim included."""
    places = shapely.points(points["x"].to_numpy(np.float64), points["y"].to_numpy(np.float64))
    found = np.zeros((len(areas), len(points)), bool)
    area, point = shapely.STRtree(places).query(areas.geometry.to_numpy(), predicate="intersects")
    found[area, point] = True
    return found


def _greatest(inside: Bools, value: Floats, otherwise: float) -> Floats:
    stated = np.where(inside & np.isfinite(value)[:, None], value[:, None], -np.inf)
    found = stated.max(axis=0, initial=-np.inf)
    return np.where(np.isfinite(found), found, otherwise)
