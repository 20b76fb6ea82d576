"""Candidate sensor positions along road edges and their free heights (paper 1, section 2.3)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree
from shapely import MultiPolygon

from roadsight.base.arrays import Bools, Floats, Floats32
from roadsight.base.doubts import Doubt, Severity, listed
from roadsight.base.sections.placement import Candidates
from roadsight.geometry.areas import depth_inside_m
from roadsight.placement.candidates.mounting import POLE

# Of the cells of a position's plan, the share that a roof covers: more than a crown or a gantry
# (`docs/decisions/009-roofs-end-the-search-for-heights.md`).
_ROOF_SHARE = 0.6
_ROOF_CELLS = 4  # along either side of that plan, a square as wide as the search radius reaches
_ROOF_PERCENTILE = 5  # of a roof's heights, where it begins: stray points may hang lower


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
    around_xyz_m : (m, 3) points within `REACH_M` of the positions, thinned at will; where
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
    surroundings = [Surroundings(np.empty((0, 2)), np.empty(0))] * len(xy)
    if around_xyz_m is not None and len(around_xyz_m):
        ground = positions["ground_z_m"].to_numpy(np.float64)
        plan = cKDTree(around_xyz_m[:, :2])
        surroundings = [
            Surroundings(around_xyz_m[index][:, :2] - place, around_xyz_m[index][:, 2] - ground_z_m)
            for index, place, ground_z_m in zip(
                plan.query_ball_point(xy, REACH_M, return_sorted=True), xy, ground, strict=True
            )
        ]
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


_TANGENT_M = 0.5  # the edge's direction is taken from this far behind a station to this far ahead
_ASIDE_M = 3.0  # how far to either side of an edge pavement is looked for


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
        columns = dict.fromkeys(("x", "y", "station_m", "yaw_deg"), "float64")
        columns |= dict.fromkeys(("edge", "mount", "key"), "str")
        return pd.DataFrame({name: pd.Series(dtype=kind) for name, kind in columns.items()})
    return pd.concat(parts, ignore_index=True)


def _along(line: shapely.LineString, stations_m: Floats) -> Floats:
    """Points (n, 2) at stations, clipped to the line's ends."""
    inside = np.clip(stations_m, 0.0, line.length)
    return shapely.get_coordinates(shapely.line_interpolate_point(line, inside))


def facing_deg(xy_m: Floats, direction: Floats, pavement: MultiPolygon) -> Floats:
    """Angle of the edge's normal that points to the pavement, counter-clockwise from local x.

    Where both sides or neither side are pavement (medians, digitised lines off the road), the left
    side of the edge is taken.

    Parameters
    ----------
    xy_m : (n, 2); direction : (n, 2) unit tangents.
    """
    left = np.column_stack([-direction[:, 1], direction[:, 0]])
    on_left, on_right = (
        shapely.contains_xy(pavement, *(xy_m + sign * _ASIDE_M * left).T) for sign in (1, -1)
    )
    normal = np.where((on_right & ~on_left)[:, None], -left, left)
    # Adding zero turns -0.0 into 0.0, so that the west is always +180.
    return np.degrees(np.arctan2(normal[:, 1] + 0.0, normal[:, 0]))


def near_gaps(positions: pd.DataFrame, gaps_xy_m: Floats, radius_m: float) -> Bools:
    """Positions within a plan distance of any uncovered target (n, 2)."""
    if len(gaps_xy_m) == 0:
        return np.zeros(len(positions), dtype=bool)
    distance, _ = cKDTree(gaps_xy_m).query(positions[["x", "y"]].to_numpy())
    return np.asarray(distance) <= radius_m


# Solid matter that a scan shows only in part: no sensor inside it, behind it or above it.
#
# A scanner on the road sees the faces of walls and ceilings and nothing behind them. What it
# shows as free there is rock, fill or a building. Three signs tell: no measured ground at the
# foot of a mast, a roof that is wider than the space searched for points, and walls all around.

# Surroundings of a position that are looked at: more than the half of a wall between two bores or
# two carriageways (0.4 to 1.5 m), less than the width of a lane, so that open road shows.
REACH_M = 2.0
_CELLS = 8  # cells along either side of the plan of the surroundings, 0.5 m wide
# Of the cells of the surroundings, those that a roof covers at its height: more than a gantry (a
# fifth) or wires; both halves of a ceiling beside a wall of 0.8 m cover four fifths, and two thirds
# 1 m behind a portal.
_WIDE_ROOF_SHARE = 0.6
# The height of a roof differs by less than this: ceilings on a grade of 12 % by 0.48 m over 4 m; of
# a crown with a radius of 2.5 m, half of the cells do.
_ROOF_SPREAD_M = 0.5
_THIN_SHARE = 0.35  # of the cells, those where a roof is thin at least: crowns are metres thick
_SECTORS = 16  # directions in which walls are looked for
# Of the directions, those with walls around a place that is enclosed. Beside a straight wall half
# of them have one, in a corner three quarters, between the faces of a wall nearly all.
_WALL_SHARE = 0.8
_BAND_M = 0.5  # points so far above and below a place count as walls at its height
FOOT_M = 1.5  # a mast has measured ground so near: a foundation, the shadow of a rail or half a car
_FOOT_SPACINGS = 2.0  # or within so many spacings of the ground points, where that is more


@dataclass(frozen=True)
class Surroundings:
    """Points around one position.

    Parameters
    ----------
    offsets_m : (n, 2) plan offsets from the position. heights_m : (n,) above its ground.
    """

    offsets_m: Floats | Floats32
    heights_m: Floats | Floats32

    def roof_m(self, lowest_m: float) -> float:
        """Height of a roof above the position that begins above ``lowest_m``; infinite if none."""
        above = self.heights_m > lowest_m
        if not above.any():
            return np.inf
        cell = np.floor((self.offsets_m[above] + REACH_M) / (2 * REACH_M) * _CELLS).astype(int)
        cell = np.clip(cell, 0, _CELLS - 1)
        number = cell[:, 0] * _CELLS + cell[:, 1]
        # The tops of cells: in those that a wall stands in, the least height is the wall's.
        top, underside = np.full((2, _CELLS * _CELLS), [[-np.inf], [np.inf]])
        np.maximum.at(top, number, self.heights_m[above])
        np.minimum.at(underside, number, self.heights_m[above])
        known = np.isfinite(top)
        found, thick_m = top[known], (top - underside)[known]
        middle = float(np.median(found)) if len(found) else np.inf
        level = np.abs(found - middle) <= _ROOF_SPREAD_M / 2
        # Of the cells whose middles lie within the reach, which is a circle.
        whole = np.pi / 4 * _CELLS**2
        thin = level & (thick_m <= _ROOF_SPREAD_M)
        if level.sum() < _WIDE_ROOF_SHARE * whole or thin.sum() < _THIN_SHARE * whole:
            return np.inf
        body = self.heights_m[above]
        return float(np.percentile(body[body >= middle - _ROOF_SPREAD_M], _ROOF_PERCENTILE))

    def walled(self, heights_m: Floats) -> tuple[Bools, Floats]:
        """Whether walls stand around each height, and how near the nearest points beside it are.

        Parameters
        ----------
        heights_m : (k,) above ground.

        Returns
        -------
        (k,) enclosed, and (k,) plan distance of the nearest point, at most `REACH_M`.
        """
        far = np.full(len(heights_m), REACH_M)
        if not len(self.heights_m) or not len(heights_m):
            return np.zeros(len(heights_m), bool), far
        away = np.hypot(self.offsets_m[:, 0], self.offsets_m[:, 1])
        turn = np.arctan2(self.offsets_m[:, 1], self.offsets_m[:, 0])
        sector = np.floor((turn + np.pi) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
        enclosed = np.zeros(len(heights_m), bool)
        for k, height in enumerate(heights_m):
            beside = np.abs(self.heights_m - height) <= _BAND_M
            if beside.any():
                enclosed[k] = len(np.unique(sector[beside])) >= _WALL_SHARE * _SECTORS
                far[k] = min(float(away[beside].min()), REACH_M)
        return enclosed, far


def has_measured_ground(xy_m: Floats, ground_xy_m: Floats) -> Bools:
    """Whether ground was measured at the foot of each position (n, 2).

    A terrain model is filled over gaps of many metres: under buildings, in rock beside a tunnel,
    behind walls. Where the ground's points are sparse, two of their spacings are near enough.

    Parameters
    ----------
    ground_xy_m : (m, 2) points labelled ground, near the positions at least.
    """
    if not len(ground_xy_m) or not len(xy_m):
        return np.zeros(len(xy_m), bool)
    tree = cKDTree(ground_xy_m)
    counts = np.asarray(tree.query_ball_point(xy_m, REACH_M, return_length=True))
    near = counts[counts > 0]
    spacing_m = np.sqrt(np.pi * REACH_M**2 / np.median(near)) if len(near) else 0.0
    reach_m = max(FOOT_M, _FOOT_SPACINGS * spacing_m)
    distance_m, _ = tree.query(xy_m, distance_upper_bound=reach_m * (1 + 1e-9))
    return np.isfinite(distance_m)


# Edges that run over the pavement, because they were digitised some metres off.

_REACH_M = 15.0  # shifts are tried this far: four lanes
_STEPS_M = (1.0, 0.25, 0.05)  # on grids ever finer; one reaches a step of the one before
_OUTLIER_M = 5.0  # what is farther from the border counts as this: edges of a road beyond the cloud
# What is beside the pavement counts less, since lines along a verge or a median strip keep off it.
_BESIDE = 0.1
# What each metre of a shift costs, m2: none along the road, which no border tells.
_PER_M = 0.02
_MOST_PLACES = 200


def plan_shift_m(xy_m: Floats, pavement: MultiPolygon) -> Floats:
    """Shift (2,) in plan that brings places along the edges nearest to the pavement's border.

    Of shifts up to 15 m east or west and north or south, on grids down to 0.05 m, the one of the
    least mean squared distance to the border. Places beside the pavement count a tenth, and at most
    as 5 m; of shifts alike, the shortest is taken.

    Parameters
    ----------
    xy_m : (n, 2) places, n >= 1; at most 200 of them, evenly taken, are used.
    """
    xy = xy_m[:: -(-len(xy_m) // _MOST_PLACES)]
    best, reach = np.zeros(2), _REACH_M
    for step in _STEPS_M:
        along = step * np.arange(-round(reach / step), round(reach / step) + 1)
        tried = best + np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
        depth_m = depth_inside_m(pavement, (tried[:, None] + xy).reshape(-1, 2))
        misfit_m2 = np.where(depth_m > 0, 1.0, _BESIDE) * depth_m**2
        misfit_m2 = np.minimum(misfit_m2, _OUTLIER_M**2).reshape(len(tried), -1).mean(axis=1)
        best, reach = tried[np.argmin(misfit_m2 + _PER_M * np.hypot(*tried.T))], step
    return best


_WINDS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")


def shift_in_words(shift_m: Floats) -> str:
    """A shift (2,) east and north, such as ``1.4 m to the north-east (dx +1.0, dy +1.0 m)``."""
    dx, dy = np.round(shift_m, 1) + 0.0  # turns -0.0 into 0.0
    wind = _WINDS[round(np.degrees(np.arctan2(dx, dy)) / 45) % 8]
    return f"{np.hypot(dx, dy):.1f} m to the {wind} (dx {dx:+.1f}, dy {dy:+.1f} m)"


def lane_doubts(
    candidates: pd.DataFrame, positions: pd.DataFrame, pavement: MultiPolygon, settings: Candidates
) -> list[Doubt]:
    """Doubts about edges whose candidates stand in the lanes; sensors on existing poles may.

    Parameters
    ----------
    candidates : columns x, y, edge and mount. positions : columns x, y and mount, all places along
        the edges, also those that carry no candidate.
    """
    candidates = candidates[candidates["mount"] != POLE]
    xy_m = candidates[["x", "y"]].to_numpy(np.float64)
    inside = depth_inside_m(pavement, xy_m) > settings.on_pavement_m
    share = float(inside.mean()) if len(inside) else 0.0
    refused = share >= settings.on_pavement_refused
    if not share or not (refused or share >= settings.on_pavement_doubt):
        return []
    along = positions.loc[positions["mount"] != POLE, ["x", "y"]].to_numpy(np.float64)
    shift_m = plan_shift_m(along, pavement)
    left = float((depth_inside_m(pavement, xy_m + shift_m) > settings.on_pavement_m).mean())
    advice = f"moved {shift_in_words(shift_m)} they fit its border best: {left:.0%} still inside"
    if left > share / 2:
        advice = f"no shift of all edges by up to {_REACH_M:g} m brings them off it"
    text = (
        f"sensors along {listed(list(candidates['edge'][inside]))} would stand in the lanes, more"
        f" than {settings.on_pavement_m:g} m inside the pavement; {advice}. Correct the edges"
        " (placement.edges) or their CRS (placement.edges_crs), or raise candidates.on_pavement_m"
        " if they are to hang over the lanes. Share of candidates in the lanes"
    )
    limit = settings.on_pavement_refused if refused else settings.on_pavement_doubt
    severity: Severity = "refused" if refused else "doubt"
    return [Doubt("edges_on_pavement", severity, text, round(share, 3), limit)]
