"""What the road is like where a place lies.

Scenario classes follow paper 2, table 3: straight or curved, intersection near, extraneous features
(driveways, parking). The paper judged by eye; here they are measured from the tracks and from
pavement that leaves the road (`branches`).
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
from roadsight.poles.risk.roads import RouteTracks


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
    xy_m: Floats, tracks: RouteTracks, branches: Branches | None, settings: ScenarioSettings
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
    length_m = float(tracks.length_m[tracks.route == route].sum())
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


# Pavement that leaves the road: side roads, driveways, car parks, by its shape.
#
# The road itself is a corridor as wide as its edges are apart for the most part. What is paved
# beyond it and touches it branches off.

CELL_M = 1.0  # cells in which pavement is joined
# Cells this near to each other are of one branch: those that share a side or a corner.
_JOIN_M = 1.5
_DRIVEN_M = 15.0  # edges this near to a track are of its road: it has up to four lanes
_STATION_M = 5.0  # length of road for which the distance of its edge is told
# The usual distance is the median over so many of them: mouths up to 100 m wide do not move it.
_USUAL_BINS = 41
_BESIDE_M = 1.5  # pavement up to this beyond the usual edge is the road: shoulders and noise
# Smaller pieces are none: bays for a mailbox, and wrong classes beside the edge.
_SMALLEST_M2 = 12.0
_LEAST_REACH_M = 4.0  # what reaches less far beyond the edge is a lay-by or a wider shoulder
# Sine of the angle by which a place may lie ahead of the foot on its track: bends have corners.
_ABREAST = 0.5
_REACH_M = 40.0  # so far from the road pavement is looked at
_MOUTH_M = 10.0  # a branch narrows over this much from its mouth on; its width is measured beyond
_ROAD_REACH_M = 20.0  # a side road goes on farther than this from the edge
# Width of a side road: driveways are narrower (two lanes of 2.3 m are 4.6 m), car parks wider.
_ROAD_WIDTH_M = (4.5, 20.0)


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
    index = np.unique(np.floor(pavement_m / CELL_M).astype(np.int64), axis=0)
    xy = np.asarray((index + 0.5) * CELL_M, np.float64)
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
    roads = np.zeros(len(area), bool)
    for number in np.flatnonzero(farthest >= _ROAD_REACH_M):
        cells = np.count_nonzero(beyond[part == number] > _MOUTH_M)
        width = cells * CELL_M**2 / (farthest[number] - _MOUTH_M)
        # Cells that are paved in part stand out half a cell on either side.
        roads[number] = _ROAD_WIDTH_M[0] <= width - CELL_M <= _ROAD_WIDTH_M[1]
    own = kept[part]
    return Branches(xy[own], roads[part[own]])


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
