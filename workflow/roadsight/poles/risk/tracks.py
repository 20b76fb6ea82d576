"""Where along its routes' tracks a place lies."""

from __future__ import annotations

import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints


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
