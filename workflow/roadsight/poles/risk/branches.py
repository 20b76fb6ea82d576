"""Pavement that leaves the road: side roads, driveways, car parks, by its shape.

The road itself is a corridor as wide as its edges are apart for the most part. What is paved beyond
it and touches it branches off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import shapely
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.poles.risk.tracks import RouteTracks

CELL_M = 1.0
"""Cells in which pavement is joined."""
_JOIN_M = 1.5
"""Cells this near to each other are of one branch: those that share a side or a corner."""
_DRIVEN_M = 15.0
"""Edges this near to a track are of its road: it has up to four lanes."""
_STATION_M = 5.0
"""Length of road for which the distance of its edge is told."""
_USUAL_BINS = 41
"""The usual distance is the median over so many of them: mouths up to 100 m wide do not move it."""
_BESIDE_M = 1.5
"""Pavement up to this beyond the usual edge is the road: shoulders and noise."""
_SMALLEST_M2 = 12.0
"""Smaller pieces are none: bays for a mailbox, and wrong classes beside the edge."""
_LEAST_REACH_M = 4.0
"""What reaches less far beyond the edge is a lay-by or a wider shoulder."""
_ABREAST = 0.5
"""Sine of the angle by which a place may lie ahead of the foot on its track: bends have corners."""
_REACH_M = 40.0
"""So far from the road pavement is looked at."""
_MOUTH_M = 10.0
"""A branch narrows over this much from its mouth on; its width is measured beyond."""
_ROAD_REACH_M = 20.0
"""A side road goes on farther than this from the edge."""
_ROAD_WIDTH_M = (4.5, 20.0)
"""Width of a side road: driveways are narrower (two lanes of 2.3 m are 4.6 m), car parks wider."""


@dataclass(frozen=True)
class Branches:
    """Cells of branches.

    Parameters
    ----------
    xy_m : (n, 2) middles. road : (n,) whether the branch is a side road; else a driveway, a car
    park or the like.
    """

    xy_m: Floats
    road: Bools

    def near(self, places_m: Floats, within_m: float, road: bool) -> Bools:
        """Whether a side road, or another branch, is within a distance of each place."""
        own = self.xy_m[self.road == road]
        if not len(own) or not len(places_m):
            return np.zeros(len(places_m), bool)
        return np.asarray(cKDTree(own).query(places_m)[0] <= within_m)

    def with_outlines(self, outlines: Sequence[shapely.Geometry]) -> Branches:
        """The same with known driveways and car parks: their outlines, a point each `CELL_M`."""
        rings = [shapely.segmentize(one, CELL_M) for one in outlines]
        known = shapely.get_coordinates(rings)[:, :2]
        beside = np.zeros(len(known), bool)
        return Branches(np.concatenate([self.xy_m, known]), np.concatenate([self.road, beside]))


def find_branches(tracks: RouteTracks, pavement_m: Floats, edges_m: Floats) -> Branches:
    """Branches of the roads that were driven.

    Parameters
    ----------
    pavement_m : places (n, 2) that are paved, at most `CELL_M` apart. edges_m : points (m, 2) of
        the edges of roads.
    """
    none = Branches(np.empty((0, 2)), np.zeros(0, bool))
    if not len(tracks) or not len(pavement_m) or not len(edges_m):
        return none
    cells = np.unique(np.floor(pavement_m / CELL_M).astype(np.int64), axis=0)
    xy = np.asarray((cells + 0.5) * CELL_M, np.float64)
    beyond = _beyond_m(tracks, xy, edges_m)
    out = np.flatnonzero((beyond > _BESIDE_M) & (beyond <= _REACH_M))
    if not len(out):
        return none
    xy, beyond = xy[out], beyond[out]
    pairs = cKDTree(xy).query_pairs(_JOIN_M * CELL_M, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(xy), len(xy)))
    _, part = connected_components(graph, directed=False)
    area = np.bincount(part) * CELL_M**2
    nearest = np.full(len(area), np.inf)
    np.minimum.at(nearest, part, beyond)
    farthest = np.zeros(len(area))
    np.maximum.at(farthest, part, beyond)
    kept = (area >= _SMALLEST_M2) & (farthest >= _LEAST_REACH_M)
    kept &= nearest <= _BESIDE_M + 2 * CELL_M
    roads = np.array([_is_road(beyond[part == number]) for number in range(len(area))], bool)
    own = kept[part]
    return Branches(xy[own], roads[part[own]])


def _is_road(beyond_m: Floats) -> bool:
    """Whether a branch goes on like a road, from the distances of its cells from the edge."""
    reach = beyond_m.max()
    if reach < _ROAD_REACH_M:
        return False
    width = np.count_nonzero(beyond_m > _MOUTH_M) * CELL_M**2 / (reach - _MOUTH_M)
    # Cells that are paved in part stand out half a cell on either side.
    return bool(_ROAD_WIDTH_M[0] <= width - CELL_M <= _ROAD_WIDTH_M[1])


def _beyond_m(tracks: RouteTracks, xy_m: Floats, edges_m: Floats) -> Floats:
    """How far places lie beyond the usual edge on their side of the nearest track; NaN: unknown."""
    route, station, offset = _located(tracks, xy_m)
    edge_route, edge_station, edge_offset = _located(tracks, edges_m)
    own = np.abs(edge_offset) <= _DRIVEN_M
    beyond = np.full(len(xy_m), np.nan)
    for number in np.unique(route):
        for side in (-1.0, 1.0):
            rows = (route == number) & (np.sign(offset) == side)
            edge = own & (edge_route == number) & (np.sign(edge_offset) == side)
            if not rows.any() or not edge.any():
                continue
            bins = np.floor(edge_station[edge] / _STATION_M).astype(np.int64)
            usual = pd.Series(np.abs(edge_offset[edge])).groupby(bins).median()
            usual = usual.rolling(_USUAL_BINS, center=True, min_periods=1).median()
            middle = (usual.index.to_numpy(np.float64) + 0.5) * _STATION_M
            beyond[rows] = np.abs(offset[rows]) - np.interp(station[rows], middle, usual)
    return beyond


def _located(tracks: RouteTracks, xy_m: Floats) -> tuple[Ints, Floats, Floats]:
    """Route, station and offset (positive to the right) of places by their nearest track.

    Offsets are NaN before a track's start and behind its end.
    """
    piece, station, foot = tracks.locate(xy_m)
    way, gap = tracks.direction(piece), xy_m - foot
    side = np.where(way[:, 1] * gap[:, 0] - way[:, 0] * gap[:, 1] >= 0, 1.0, -1.0)
    away = np.hypot(*gap.T)
    beside = np.abs((way * gap).sum(axis=1)) <= _ABREAST * away
    return tracks.route[piece], station, np.where(beside, side * away, np.nan)
