"""Groups of rays that show the same pole, found by their errors or by the order of the images."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints
from roadsight.poles.triangulate.groups import Points
from roadsight.poles.triangulate.rays import Rays, TriangulationSettings

SAME_CHI2 = 5.99
"""Two poles nearer than this (95 %, 2 degrees of freedom) may be one."""
SEQUENCE_CHI2 = 13.8
"""As above (99.9 %), where depths and bearings follow the order of the images."""
_STILL_DEG = 0.2
"""A bearing that turns back by less than this has not turned."""


def merge_groups(
    rays: Rays, points: Points, groups: list[Ints], settings: TriangulationSettings
) -> list[Ints]:
    """Groups after merging, nearest first, until no two are the same pole.

    Two groups merge if they share no image, their joint misfit stays within every member's gate on
    average, and they are either within their errors of each other or continue each other along the
    route (paper 2, section 3.4: images within 100 ft, depth decreasing, bearing monotone).
    """
    groups = [np.sort(group) for group in groups]
    if len(groups) < 2:
        return groups
    places, covariances = places_of(points, groups)
    pairs, chi2 = _near_pairs(places, covariances, settings)
    near = pairs[chi2 <= SEQUENCE_CHI2]
    graph = csr_array((np.ones(len(near)), near.T), shape=(len(groups), len(groups)))
    parts, part = connected_components(graph, directed=False)
    neighbours: list[list[Ints]] = [[] for _ in range(parts)]
    for group, number in zip(groups, part, strict=True):
        neighbours[number].append(group)
    return [group for few in neighbours for group in _merge_few(rays, points, few, settings)]


def _merge_few(
    rays: Rays, points: Points, groups: list[Ints], settings: TriangulationSettings
) -> list[Ints]:
    """Groups of one neighbourhood after merging."""
    while len(groups) > 1:
        places, covariances = places_of(points, groups)
        merged = _first_merge(rays, points, groups, places, covariances, settings)
        if merged is None:
            break
        first, second = merged
        joined = np.sort(np.concatenate([groups[first], groups[second]]))
        groups = [g for n, g in enumerate(groups) if n not in (first, second)] + [joined]
    return groups


def follows_sequence(
    rays: Rays, members: Ints, sequence_m: float, still_deg: float = _STILL_DEG
) -> bool:
    """Whether rays of one route show a pole that the vehicle comes nearer to and passes.

    Consecutive images lie within ``sequence_m``, depths do not grow and bearings turn one way, but
    for turns of less than ``still_deg``.
    """
    route, sequence = rays.route[members], rays.sequence[members]
    if (route < 0).any() or len(set(route.tolist())) > 1 or (sequence < 0).any():
        return False
    members = members[np.argsort(sequence, kind="stable")]
    steps_m = np.hypot(*np.diff(rays.camera_m[members], axis=0).T)
    depth, bearing = rays.depth_m[members], rays.bearing_deg[members]
    turns = (np.diff(bearing) + 180.0) % 360.0 - 180.0
    one_way = (turns >= -still_deg).all() or (turns <= still_deg).all()
    nearer = bool((np.diff(depth[np.isfinite(depth)]) <= 0).all())
    return bool((steps_m <= sequence_m).all() and one_way and nearer)


def places_of(points: Points, groups: list[Ints]) -> tuple[Floats, Floats]:
    """Weighted mean (n, 2) and covariance (n, 2, 2) of each group."""
    places, covariances = np.empty((len(groups), 2)), np.empty((len(groups), 2, 2))
    for number, members in enumerate(groups):
        places[number], covariances[number] = weighted_mean(points, members)
    return places, covariances


def weighted_mean(points: Points, members: Ints) -> tuple[Floats, Floats]:
    """Best place (2,) of a group and its covariance (2, 2)."""
    information = points.information[members]
    origin = points.place_m[members[0]]
    moment = np.einsum("kij,kj->i", information, points.place_m[members] - origin)
    covariance = np.linalg.inv(information.sum(axis=0))
    return origin + covariance @ moment, covariance


def _first_merge(
    rays: Rays,
    points: Points,
    groups: list[Ints],
    places: Floats,
    covariances: Floats,
    settings: TriangulationSettings,
) -> tuple[int, int] | None:
    """The pair of groups to merge next, nearest by their errors first."""
    pairs, chi2 = _near_pairs(places, covariances, settings)
    order = np.lexsort([places[pairs.min(axis=1), 1], places[pairs.min(axis=1), 0], chi2])
    for number in order[chi2[order] <= SEQUENCE_CHI2]:
        first, second = sorted(pairs[number].tolist())
        members = np.concatenate([groups[first], groups[second]])
        if len(set(rays.image[members].tolist())) < len(members):
            continue
        if chi2[number] > SAME_CHI2 and not follows_sequence(rays, members, settings.sequence_m):
            continue
        if _misfit(points, members) <= 0.5 * settings.gate_chi2 * len(members):
            return first, second
    return None


def _near_pairs(
    places: Floats, covariances: Floats, settings: TriangulationSettings
) -> tuple[Ints, Floats]:
    """Pairs (m, 2) of groups within the maximum distance, and their distances by their errors."""
    tree = cKDTree(places)
    pairs = tree.query_pairs(settings.max_distance_m, output_type="ndarray").astype(np.int64)
    gap = places[pairs[:, 0]] - places[pairs[:, 1]]
    spread = covariances[pairs[:, 0]] + covariances[pairs[:, 1]]
    return pairs, np.einsum("ni,ni->n", gap, np.linalg.solve(spread, gap[:, :, None])[:, :, 0])


def _misfit(points: Points, members: Ints) -> float:
    """Half the chi squared of a group at its best place."""
    place, _ = weighted_mean(points, members)
    rest = points.place_m[members] - place
    return float(0.5 * np.einsum("ki,kij,kj->", rest, points.information[members], rest))
