"""What the road is like where a place lies.

Scenario classes follow paper 2, table 3: straight or curved, intersection near, extraneous features
(driveways, parking). The paper judged by eye; here they are measured from the tracks and from
pavement that leaves the road (`branches`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.poles.risk.branches import Branches
from roadsight.poles.risk.tracks import RouteTracks


@dataclass(frozen=True)
class ScenarioSettings:
    """What makes a scenario.

    Parameters
    ----------
    curve_radius_m : the road is curved where its radius is smaller.
    chord_m : half the length of track by which the radius is measured.
    crossing_m : an intersection is near if a track in another direction comes this near.
    crossing_deg : directions differ from this angle on.
    aside_m : extraneous features are near from here on.
    """

    curve_radius_m: float = 300.0
    chord_m: float = 25.0
    crossing_m: float = 30.0
    crossing_deg: float = 30.0
    aside_m: float = 25.0


def classify_places(
    xy_m: Floats,
    tracks: RouteTracks,
    branches: Branches | None,
    settings: ScenarioSettings,
) -> pd.DataFrame:
    """Scenario of each place.

    Parameters
    ----------
    branches : side roads, driveways and car parks, None where no pavement is known. Side roads are
    intersections whether anybody drove them or not.

    Returns
    -------
    radius_m (inf where straight), straight, curved, intersection (bool) and extraneous (bool, or
    None where no pavement is known)
    """
    if len(tracks) == 0:
        nothing = np.zeros(len(xy_m), bool)
        columns = {"radius_m": np.full(len(xy_m), np.nan), "straight": nothing, "curved": nothing}
        return pd.DataFrame(columns | {"intersection": nothing, "extraneous": None})
    piece, station_m, _ = tracks.locate(xy_m)
    radius = np.array(
        [
            track_radius_m(tracks, route, at, settings.chord_m)
            for route, at in zip(tracks.route[piece], station_m, strict=True)
        ]
    )
    curved = radius < settings.curve_radius_m
    crossing = _crossings(xy_m, tracks, piece, station_m, settings)
    extraneous: object = None
    if branches is not None:
        crossing |= branches.near(xy_m, settings.crossing_m, road=True)
        extraneous = branches.near(xy_m, settings.aside_m, road=False) & ~crossing
    columns = {"radius_m": radius, "straight": ~curved, "curved": curved}
    return pd.DataFrame(columns | {"intersection": crossing, "extraneous": extraneous})


def track_radius_m(tracks: RouteTracks, route: int, station_m: float, chord_m: float) -> float:
    """Radius of the circle through the track at a station and half a chord before and after it."""
    length_m = tracks.route_length_m(route)
    middle = np.clip(station_m, min(chord_m, length_m / 2), max(length_m - chord_m, length_m / 2))
    a, b, c = tracks.place(route, np.array([middle - chord_m, middle, middle + chord_m]))
    ab, bc = b - a, c - b
    area = abs(ab[0] * bc[1] - ab[1] * bc[0]) / 2
    sides = np.hypot(*ab) * np.hypot(*bc) * np.hypot(*(c - a))
    return float("inf") if area <= 1e-9 * max(sides, 1e-12) else float(sides / (4 * area))


def _crossings(
    xy_m: Floats, tracks: RouteTracks, piece: Ints, station_m: Floats, settings: ScenarioSettings
) -> Bools:
    """Whether a track of another route, or far along the same, runs in another direction near."""
    middle = (tracks.start_m + tracks.end_m) / 2
    near = cKDTree(middle).query_ball_point(xy_m, settings.crossing_m)
    found = np.zeros(len(xy_m), bool)
    for number, others in enumerate(near):
        other = np.array(others, np.int64)
        own = tracks.route[other] == tracks.route[piece[number]]
        far = np.abs(tracks.station_m[other] - station_m[number]) > 3 * settings.crossing_m
        cosine = tracks.direction(other) @ tracks.direction(piece[number : number + 1])[0]
        turned = np.abs(cosine) < np.cos(np.radians(settings.crossing_deg))
        found[number] = bool(((~own | far) & turned).any())
    return found
