"""Candidate sensor positions along road edges and their free heights (paper 1, section 2.3)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree
from shapely import MultiPolygon

from roadsight.base.arrays import Floats
from roadsight.base.sections.placement import Candidates
from roadsight.placement.candidates.solid import REACH_M, Surroundings

_ROOF_SHARE = 0.6
"""Of the cells of a position's plan, the share that a roof covers: more than a crown or a gantry
(`docs/decisions/009-roofs-end-the-search-for-heights.md`)."""
_ROOF_CELLS = 4
"""Cells along either side of that plan, a square as wide as the search radius reaches."""
_ROOF_PERCENTILE = 5
"""Percentile of the heights above a position at which its roof is: stray points may hang lower."""


def free_heights_m(point_heights_m: Floats, settings: Candidates) -> Floats:
    """Heights above ground at which a sensor fits between the points around a position.

    The paper's cases i to iv are one rule on the sorted heights of the points. Where no point lies
    below the lowest allowed height, that height counts as one (cases iii, iv). The space between
    two points is free when it is wider than ``gap_factor`` steps: heights then start half a step
    above the lower point, or at the lowest allowed height if that is higher, and keep half a step
    from the upper point. Above the highest point (cases ii, iii) they start half a step above it.
    Without points all heights are free (step iv).

    Parameters
    ----------
    point_heights_m : (n,) heights above ground, any order.

    Returns
    -------
    (k,) increasing heights within the allowed range.
    """
    low, high, step = settings.height_min_m, settings.height_max_m, settings.height_step_m
    heights = np.sort(np.asarray(point_heights_m, np.float64))
    if len(heights) == 0:
        return _steps(low, high, step)
    free: list[Floats] = []
    if heights[0] > low:
        heights = np.append(low, heights)
    for below, above in pairwise(heights):
        if above - below > settings.gap_factor * step:
            start = max(below + step / 2, low)
            free.append(_steps(start, min(above - step / 2, high), step))
    if heights[-1] < high:
        free.append(_steps(max(heights[-1] + step / 2, low), high, step))
    return np.concatenate(free) if free else np.empty(0)


def _steps(start: float, stop: float, step: float) -> Floats:
    """Values from ``start`` to ``stop`` inclusive; empty if the range is."""
    # Rounding must not cost the last height.
    return start + step * np.arange(max(0, np.floor((stop - start) / step + 1e-9) + 1))


def roof_height_m(offsets_m: Floats, point_heights_m: Floats, settings: Candidates) -> float:
    """Height of a roof above a position, infinite if there is none.

    A tunnel or bridge leaves free space above its ceiling, as far as the scanner can tell; a sensor
    there would hang in rock. Points above the lowest allowed height that cover most of the plan
    around the position are a roof.

    Parameters
    ----------
    offsets_m : (n, 2) plan offsets from the position. point_heights_m : (n,) above ground.
    """
    above = point_heights_m > settings.height_min_m
    if not above.any():
        return np.inf
    radius = settings.search_radius_m
    cell = np.floor((offsets_m[above] + radius) / (2 * radius) * _ROOF_CELLS).astype(int)
    covered = np.unique(np.clip(cell, 0, _ROOF_CELLS - 1), axis=0)
    if len(covered) < _ROOF_SHARE * _ROOF_CELLS**2:
        return np.inf
    return float(np.percentile(point_heights_m[above], _ROOF_PERCENTILE))


def facing_deg(
    xy_m: Floats, direction: Floats, pavement: MultiPolygon, reach_m: float = 3.0
) -> Floats:
    """Angle of the edge's normal that points to the pavement, counter-clockwise from local x.

    Where both sides or neither side are pavement (medians, digitised lines off the road), the left
    side of the edge is taken.

    Parameters
    ----------
    xy_m : (n, 2); direction : (n, 2) unit tangents.
    """
    left = np.column_stack([-direction[:, 1], direction[:, 0]])
    on_left, on_right = (
        shapely.contains_xy(pavement, *(xy_m + sign * reach_m * left).T) for sign in (1, -1)
    )
    normal = np.where((on_right & ~on_left)[:, None], -left, left)
    # Adding zero turns -0.0 into 0.0, so that the west is always +180.
    return np.degrees(np.arctan2(normal[:, 1] + 0.0, normal[:, 0]))


def stack_candidates(
    positions: pd.DataFrame,
    obstacles_xyz_m: Floats,
    obstacle_heights_m: Floats,
    settings: Candidates,
    around_xyz_m: Floats | None = None,
    roofs: bool = True,
) -> pd.DataFrame:
    """Candidates at every free height of every position, none in or above solid matter.

    Parameters
    ----------
    positions : columns key (str, stable name of the position), x, y, ground_z_m, yaw_deg, edge,
        station_m, mount; and top_m, where a pole ends (NaN: anywhere).
    obstacles_xyz_m : (n, 3) all points of the scene near the edges, local metres.
    obstacle_heights_m : (n,) their heights above ground.
    around_xyz_m : (m, 3) points within `solid.REACH_M` of the positions, thinned at will; where
        they are given, roofs wider than the search radius and walls all around count as well.
    roofs : whether roofs end the search for heights.

    Returns
    -------
    the columns of ``positions`` and candidate (str), z, height_m, wall_m (plan distance of the
    nearest point beside the sensor, at most 2 m); NaN ground drops a position.
    """
    positions = positions[np.isfinite(positions["ground_z_m"])].reset_index(drop=True)
    tree = cKDTree(obstacles_xyz_m[:, :2])
    xy = positions[["x", "y"]].to_numpy()
    near = tree.query_ball_point(xy, settings.search_radius_m, return_sorted=True)
    surroundings = _surroundings(xy, positions["ground_z_m"].to_numpy(np.float64), around_xyz_m)
    tops = positions.get("top_m", pd.Series(np.nan, positions.index)).to_numpy(np.float64)
    rows, heights, walls = [], [], []
    for row, index in enumerate(near):
        point_heights = obstacle_heights_m[index]
        offsets = obstacles_xyz_m[index][:, :2] - xy[row]
        free = free_heights_m(point_heights, settings)
        if np.isfinite(tops[row]):
            free = free[free <= tops[row]]
        if roofs:
            free = free[free < roof_height_m(offsets, point_heights, settings)]
            free = free[free < surroundings[row].roof_m(settings.height_min_m)]
        enclosed, wall_m = surroundings[row].walled(free)
        if roofs:
            free, wall_m = free[~enclosed], wall_m[~enclosed]
        rows += [row] * len(free)
        heights.append(free)
        walls.append(wall_m)
    stacked = positions.iloc[rows].reset_index(drop=True)
    stacked["height_m"] = np.concatenate(heights) if heights else np.empty(0)
    stacked["wall_m"] = np.concatenate(walls) if walls else np.empty(0)
    stacked["z"] = stacked["ground_z_m"] + stacked["height_m"]
    stacked["candidate"] = [
        f"{key}-h{height:05.2f}"
        for key, height in zip(stacked["key"], stacked["height_m"], strict=True)
    ]
    return stacked


def _surroundings(xy_m: Floats, ground_z_m: Floats, points_m: Floats | None) -> list[Surroundings]:
    """What lies within two metres of each position (n, 2); nothing where nobody looked."""
    if points_m is None or not len(points_m):
        return [Surroundings(np.empty((0, 2)), np.empty(0))] * len(xy_m)
    near = cKDTree(points_m[:, :2]).query_ball_point(xy_m, REACH_M, return_sorted=True)
    return [
        Surroundings(points_m[index][:, :2] - place, points_m[index][:, 2] - ground)
        for index, place, ground in zip(near, xy_m, ground_z_m, strict=True)
    ]
