"""Where along the road a place lies, and what the road is like there.

Scenario classes follow paper 2, table 3: straight or curved, intersection near, extraneous features
(driveways, parking). The paper judged by eye; here they are measured from the tracks and from
pavement that leaves the road (`branches`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints

if TYPE_CHECKING:  # which stands on the tracks here
    from roadsight.poles.risk.branches import Branches


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


class RouteTracks:
    """The routes' camera places as lines.

    Parameters
    ----------
    frames : image rows with route, sequence, x, y (local metres), in any order.

    Attributes
    ----------
    names : of the routes, by number.
    """

    def __init__(self, frames: pd.DataFrame) -> None:
        frames = frames.sort_values(["route", "sequence"], kind="stable")
        xy = frames[["x", "y"]].to_numpy(np.float64)
        route, names = pd.factorize(frames["route"])
        self.names = [str(name) for name in names]
        known = np.isfinite(xy).all(axis=1)
        xy, route = xy[known], route[known]
        self._places = cKDTree(xy)
        first = np.r_[True, np.diff(route) != 0][: len(xy)]
        moved = np.hypot(*np.diff(xy, axis=0, prepend=xy[:1]).T) > 1e-3
        xy, route = xy[moved | first], route[moved | first]
        joined = route[1:] == route[:-1]
        self.start_m, self.end_m = xy[:-1][joined], xy[1:][joined]
        self.route = route[1:][joined]
        self.length_m = np.hypot(*(self.end_m - self.start_m).T)
        total = np.cumsum(self.length_m) - self.length_m
        new = np.r_[True, np.diff(self.route) != 0][: len(total)]
        before = np.maximum.accumulate(np.where(new, np.arange(len(total)), 0))
        self.station_m = total - total[before] if len(total) else total
        lines = np.stack([self.start_m, self.end_m], axis=1)
        self._tree = shapely.STRtree(shapely.linestrings(lines)) if len(lines) else None

    def __len__(self) -> int:
        return len(self.route)

    def locate(self, xy_m: Floats) -> tuple[Ints, Floats, Floats]:
        """Nearest piece of track, station along its route (m) and foot on it (n, 2) of places."""
        if self._tree is None or len(xy_m) == 0:
            none = np.full((len(xy_m), 2), np.nan)
            return np.full(len(xy_m), -1, np.int64), none[:, 0], none
        asked, pieces = self._tree.query_nearest(shapely.points(xy_m), all_matches=True)
        order = np.lexsort([pieces, asked])
        _, first = np.unique(asked[order], return_index=True)
        piece = pieces[order][first].astype(np.int64)
        way = (self.end_m - self.start_m)[piece] / self.length_m[piece, None]
        along = ((xy_m - self.start_m[piece]) * way).sum(axis=1)
        along = np.clip(along, 0.0, self.length_m[piece])
        return piece, self.station_m[piece] + along, self.start_m[piece] + along[:, None] * way

    def away_m(self, xy_m: Floats) -> Floats:
        """How far (n,) places are from a track, or from the only image of a route; inf: none."""
        to_track = np.hypot(*(xy_m - self.locate(xy_m)[2]).T)
        return np.fmin(to_track, self._places.query(xy_m)[0])

    def direction(self, piece: Ints) -> Floats:
        """Unit vectors of travel (n, 2)."""
        return (self.end_m - self.start_m)[piece] / self.length_m[piece, None]

    def side(self, xy_m: Floats) -> Ints:
        """-1 left, +1 right, 0 on the track or unknown, seen along the direction of travel."""
        piece, _, foot = self.locate(xy_m)
        if len(self) == 0:
            return np.zeros(len(xy_m), np.int64)
        way, gap = self.direction(piece), xy_m - foot
        cross = way[:, 1] * gap[:, 0] - way[:, 0] * gap[:, 1]
        return np.where(np.abs(cross) < 1e-6, 0, np.sign(cross)).astype(np.int64)

    def place(self, route: int, station_m: Floats) -> Floats:
        """Places (n, 2) at stations of a route, held at its ends."""
        own = self.route == route
        stations = np.r_[self.station_m[own], self.station_m[own][-1:] + self.length_m[own][-1:]]
        xy = np.concatenate([self.start_m[own], self.end_m[own][-1:]])
        return np.column_stack([np.interp(station_m, stations, axis) for axis in xy.T])

    def route_length_m(self, route: int) -> float:
        """Length of a route."""
        return float(self.length_m[self.route == route].sum())


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
