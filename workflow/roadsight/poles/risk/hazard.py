"""How dangerous poles are to vehicles that leave the road.

Rating, first rule that applies:

- high: inside the clear zone and at most half its width from the road edge, or inside it on or
  beyond a foreslope from which vehicles cannot return, or inside it where fixed objects stand
  denser than ``dense_per_km``;
- medium: otherwise inside the clear zone, or outside it by less than the pole's own 1-sigma error,
  or beyond a foreslope steeper than 1V:3H;
- low: otherwise. ``unknown`` where no road edge is near.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.poles.risk.clear_zone import clear_zone_m, slope_class
from roadsight.poles.risk.scenarios import RouteTracks

Height = Callable[[Floats, Floats], Floats]

RULE = __doc__.split("\n\n", 1)[1].strip() if __doc__ else ""
"""The rating in words, as written into results."""

HAZARD_COLUMNS = [
    "offset_m",
    "side",
    "clear_zone_m",
    "inside_clear_zone",
    "slope_rise_over_run",
    "slope_class",
    "station_m",
    "objects_per_km",
    "rating",
]


@dataclass(frozen=True)
class HazardSettings:
    """What decides how dangerous a pole is.

    Parameters
    ----------
    design_speed_kmh, aadt : speed and vehicles a day for which the road is made.
    window_m : length of road over which fixed objects are counted, centred on the pole.
    dense_per_km : objects a kilometre that make poles inside the clear zone a high hazard.
    edge_reach_m : a road edge further away is not the pole's.
    sample_m : spacing of height samples between edge and pole.
    """

    design_speed_kmh: float = 80.0
    aadt: float = 3000.0
    window_m: float = 100.0
    dense_per_km: float = 40.0
    edge_reach_m: float = 30.0
    sample_m: float = 0.5


def rate_poles(
    poles: pd.DataFrame,
    edges_m: Floats,
    tracks: RouteTracks,
    height: Height | None,
    settings: HazardSettings,
) -> pd.DataFrame:
    """Hazard of each pole.

    Parameters
    ----------
    poles : x, y (local metres) and sigma_major_m. edges_m : road edge points (n, 2 or 3).
    height : ground height (m) at x and y, NaN where unknown; None for none.

    Returns
    -------
    columns `HAZARD_COLUMNS`, rows as ``poles``. ``offset_m`` is negative on the road.
    """
    xy_m = poles[["x", "y"]].to_numpy(np.float64)
    offset_m, foot_m = edge_offsets(xy_m, edges_m, tracks, settings.edge_reach_m)
    slope = side_slopes(foot_m, xy_m, height, settings.sample_m)
    needed_m = clear_zone_m(settings.design_speed_kmh, settings.aadt, slope)
    inside = offset_m <= needed_m
    piece, station_m, _ = tracks.locate(xy_m)
    density = objects_per_km(tracks, piece, station_m, inside, settings.window_m)
    rating = _rating(offset_m, needed_m, slope, density, poles["sigma_major_m"], settings)
    columns = [
        offset_m,
        tracks.side(xy_m),
        needed_m,
        inside,
        slope,
        slope_class(slope),
        station_m,
        density,
        rating,
    ]
    return pd.DataFrame(dict(zip(HAZARD_COLUMNS, columns, strict=True)), index=poles.index)


def edge_offsets(
    xy_m: Floats, edges_m: Floats, tracks: RouteTracks, reach_m: float
) -> tuple[Floats, Floats]:
    """Distance to the nearest road edge and that edge's place (n, 2); NaN beyond ``reach_m``.

    Negative where the edge lies beyond the pole as seen from the track, so the pole is on the road.
    """
    offset_m, foot_m = np.full(len(xy_m), np.nan), np.full((len(xy_m), 2), np.nan)
    if len(edges_m) == 0 or len(xy_m) == 0:
        return offset_m, foot_m
    distance, row = cKDTree(edges_m[:, :2]).query(xy_m)
    near = distance <= reach_m
    offset_m[near], foot_m[near] = distance[near], edges_m[row[near], :2]
    _, _, on_track = tracks.locate(xy_m)
    outward = xy_m - on_track
    on_road = ((foot_m - xy_m) * outward).sum(axis=1) > 0
    return np.where(on_road, -offset_m, offset_m), foot_m


def side_slopes(foot_m: Floats, xy_m: Floats, height: Height | None, sample_m: float) -> Floats:
    """Rise over run from road edge to pole, by least squares over heights between them.

    Negative falls away from the road. NaN where fewer than three heights are known or the pole is
    nearer than three samples.
    """
    slopes = np.full(len(xy_m), np.nan)
    if height is None:
        return slopes
    run_m = np.hypot(*(xy_m - foot_m).T)
    for number in np.flatnonzero(run_m >= 2 * sample_m):
        run = np.linspace(0.0, run_m[number], int(run_m[number] / sample_m) + 1)
        way = (xy_m[number] - foot_m[number]) / run_m[number]
        places = foot_m[number] + run[:, None] * way
        heights = np.asarray(height(places[:, 0], places[:, 1]), np.float64)
        known = np.isfinite(heights)
        if known.sum() >= 3:
            centred = run[known] - run[known].mean()
            slopes[number] = (
                centred @ (heights[known] - heights[known].mean()) / (centred @ centred)
            )
    return slopes


def objects_per_km(
    tracks: RouteTracks,
    piece: Ints,
    station_m: Floats,
    counted: Bools,
    window_m: float,
) -> Floats:
    """Counted objects for each kilometre of road in a window around each; NaN without a track.

    At the ends of a route the window is only as long as the route reaches.
    """
    density = np.full(len(station_m), np.nan)
    if len(tracks) == 0:
        return density
    route = tracks.route[piece]
    for own in np.unique(route):
        rows = np.flatnonzero(route == own)
        stations = np.sort(station_m[rows[counted[rows]]])
        low, high = station_m[rows] - window_m / 2, station_m[rows] + window_m / 2
        count = np.searchsorted(stations, high, "right") - np.searchsorted(stations, low, "left")
        length_m = np.minimum(high, tracks.route_length_m(own)) - np.maximum(low, 0.0)
        density[rows] = count / np.maximum(length_m, 1e-3) * 1000
    return density


def _rating(
    offset_m: Floats,
    needed_m: Floats,
    slope: Floats,
    density: Floats,
    sigma_m: pd.Series,
    settings: HazardSettings,
) -> NDArray[np.object_]:
    inside = offset_m <= needed_m
    kind = slope_class(slope)
    no_return = np.isin(kind, ["non-recoverable", "critical"])
    crowded = np.nan_to_num(density) > settings.dense_per_km
    near = offset_m - np.nan_to_num(sigma_m.to_numpy(np.float64)) <= needed_m
    conditions = [
        np.isnan(offset_m),
        inside & ((offset_m <= needed_m / 2) | no_return | crowded),
        inside | near | (kind == "critical"),
    ]
    return np.select(conditions, ["unknown", "high", "medium"], "low").astype(object)
