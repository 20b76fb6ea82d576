"""Poles as the best set of groups of rays: every group is listed, the choice is exact.

A ray says where its pole is by an uncertain point: its depth along the bearing, with a covariance
that is long along the ray and narrow across it. The best place of a group is the weighted mean of
these points, so nearly parallel rays count for little along their common direction. Of all groups
the most valuable set is chosen in which every ray is used at most once; then groups are merged.

The number of groups grows with the views of a pole and with how densely poles stand, so that 400
sightings take seconds; `explain` has replaced it. It is kept to compare with, as ``listing``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import block_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.poles.triangulate.explain import depth_scale
from roadsight.poles.triangulate.rays import Rays, TriangulationSettings, pair_rays

_ROUNDS = 10  # rounds of grouping and scaling at most, should the factor go to and fro
_SETTLED = 0.01  # the factor is found when it changes by less than this share


def choose_listed(
    rays: Rays, settings: TriangulationSettings
) -> tuple[list[Ints], Floats, Floats, float]:
    """Groups from west to east, their places (g, 2), covariances (g, 2, 2), and depth scale."""
    # The factor of the depths is found by turns of grouping and scaling.
    scale = 1.0
    for _ in range(_ROUNDS if settings.calibrate_depth else 0):
        latest = depth_scale(rays, group_rays(rays.scaled(scale), settings), 1.0)
        settled = abs(latest / scale - 1) < _SETTLED
        scale = latest
        if settled:
            break
    scaled = rays.scaled(scale)
    groups = group_rays(scaled, settings)
    return groups, *places_of(locate_points(scaled, settings), groups), scale


def group_rays(rays: Rays, settings: TriangulationSettings) -> list[Ints]:
    """Ray numbers of each pole, poles from west to east and south to north."""
    levels = build_groups(rays, settings)
    members = [row for level in levels for row in level.members]
    if not members:
        return []
    gain = np.concatenate([gains(level, settings) for level in levels])
    chosen = [members[number] for number in choose_groups(members, gain, len(rays))]
    points = locate_points(rays, settings)
    merged = merge_groups(rays, points, chosen, settings)
    return sorted(merged, key=lambda group: tuple(weighted_mean(points, group)[0]))


@dataclass(frozen=True)
class Points:
    """Where each ray alone puts its pole: places (n, 2) and inverse covariances (n, 2, 2)."""

    place_m: Floats
    information: Floats


def locate_points(rays: Rays, settings: TriangulationSettings) -> Points:
    """Each ray's own place and its inverse covariance.

    An unknown depth is taken as half the maximum distance, uncertain by as much.
    """
    unknown = np.isnan(rays.depth_m)
    half_m = settings.max_distance_m / 2
    depth = np.where(unknown, half_m, rays.depth_m)
    sigma_depth = np.where(
        np.isnan(rays.sigma_depth_m), settings.sigma_depth_ratio * depth, rays.sigma_depth_m
    )
    sigma_depth = np.where(unknown, half_m, sigma_depth)
    turn = np.where(
        np.isnan(rays.sigma_bearing_deg), settings.sigma_bearing_deg, rays.sigma_bearing_deg
    )
    across = np.hypot(settings.sigma_position_m, depth * np.radians(turn))
    along = np.hypot(settings.sigma_position_m, sigma_depth)
    ahead = rays.direction
    side = np.column_stack([ahead[:, 1], -ahead[:, 0]])
    information = (
        _outer(ahead) / along[:, None, None] ** 2 + _outer(side) / across[:, None, None] ** 2
    )
    return Points(rays.camera_m + depth[:, None] * ahead, information)


def _outer(vectors: Floats) -> Floats:
    return vectors[:, :, None] * vectors[:, None, :]


@dataclass(frozen=True)
class Groups:
    """Groups of one size.

    Parameters
    ----------
    members : ray numbers, ascending, shape (g, k).
    place_m : best place of each, shape (g, 2).
    information : its inverse covariance, shape (g, 2, 2).
    cost : half the chi squared of all members, shape (g,).
    """

    members: Ints
    place_m: Floats
    information: Floats
    cost: Floats

    def take(self, chosen: NDArray) -> Groups:
        """Groups at ``chosen``."""
        return Groups(*(value[chosen] for value in vars(self).values()))


# A group is kept for growing while its misfit is below this share of its members' gates: near all
# of them nothing is gained.
_GROWTH = 0.8


def build_groups(rays: Rays, settings: TriangulationSettings) -> list[Groups]:
    """Groups of two and more rays, by size; of larger ones the best for each ray.

    A group grows by a ray that pairs with all its members. Each ray keeps at most
    ``settings.beam`` groups of each size, so that work grows with the number of rays.
    """
    points = locate_points(rays, settings)
    pairs = pair_rays(rays, settings)
    level, fits = fit_groups(rays, points, pairs, settings)
    level = level.take(fits & (level.cost <= settings.gate_chi2))
    pairs = level.members
    keys = np.sort(pairs[:, 0] * len(rays) + pairs[:, 1])
    levels = []
    while len(level.members):
        # Groups that are among the best of at least one of their rays.
        ray = level.members.ravel()
        group = np.repeat(np.arange(len(level.members)), level.members.shape[1])
        order = np.lexsort([group, level.cost[group], ray])
        first = np.searchsorted(ray[order], np.arange(len(rays)))
        rank = np.arange(len(order)) - first[ray[order]]
        level = level.take(np.unique(group[order[rank < settings.beam]]))
        levels.append(level)
        members = _extended(level.members, keys, len(rays))
        level, fits = fit_groups(rays, points, members, settings)
        most = _GROWTH * members.shape[1] * settings.gate_chi2 / 2
        level = level.take(fits & (level.cost <= most))
    return levels


def fit_groups(
    rays: Rays, points: Points, members: Ints, settings: TriangulationSettings
) -> tuple[Groups, Bools]:
    """Best place of each group, and whether every member can see it there.

    A member sees it if it lies ahead of the camera, within the maximum distance and the gate.
    """
    information = points.information[members]
    origin = points.place_m[members[:, 0]]
    offset = points.place_m[members] - origin[:, None]
    total = information.sum(axis=1)
    moment = np.einsum("gkij,gkj->gi", information, offset)
    mean = np.linalg.solve(total, moment[:, :, None])[:, :, 0]
    rest = offset - mean[:, None]
    half_chi2 = 0.5 * np.einsum("gki,gkij,gkj->gk", rest, information, rest)
    sight = (origin + mean)[:, None] - rays.camera_m[members]
    ahead = np.einsum("gki,gki->gk", sight, rays.direction[members]) > 0
    near = np.hypot(sight[..., 0], sight[..., 1]) <= settings.max_distance_m
    # A member may be beyond its gate by half: the place still moves as rays join.
    fits = (ahead & near & (half_chi2 <= 0.75 * settings.gate_chi2)).all(axis=1)
    return Groups(members, origin + mean, total, half_chi2.sum(axis=1)), fits


def _extended(members: Ints, keys: Ints, rays: int) -> Ints:
    """Each group with each later ray that pairs with all of it.

    Keys of pairs, the first ray's number times all rays plus the second's, ascend.
    """
    start = np.searchsorted(keys, np.arange(rays + 1) * rays)
    last = members[:, -1]
    counts = start[last + 1] - start[last]
    group = np.repeat(np.arange(len(members)), counts)
    within = np.arange(len(group)) - np.repeat(np.cumsum(counts) - counts, counts)
    later = (keys % rays)[start[last[group]] + within]
    keep = np.ones(len(group), bool)
    for column in members[:, :-1].T:
        wanted = column[group] * rays + later
        found = np.searchsorted(keys, wanted)
        keep &= keys[np.minimum(found, len(keys) - 1)] == wanted
    return np.column_stack([members[group[keep]], later[keep]])


def gains(groups: Groups, settings: TriangulationSettings) -> Floats:
    """What believing in each group gains: its members' gates less its misfit and a pole's cost."""
    size = groups.members.shape[1]
    return size * settings.gate_chi2 / 2 - groups.cost - settings.pole_cost


_LARGEST = 20_000  # groups of a connected part up to which it is solved exactly
# Nodes of branch and bound for a part; more come nearer to the best choice, and take longer.
_NODES = 1000


def choose_groups(members: list[Ints], gain: Floats, rays: int, largest: int = _LARGEST) -> Ints:
    """Numbers of the chosen groups, ascending.

    Parameters
    ----------
    members : ray numbers of each group. gain : of each group; groups without gain are left out.
    rays : number of rays.
    largest : connected parts with more groups than this are solved greedily, best gain first, so
        that time stays bounded whatever the input.
    """
    useful = np.flatnonzero(gain > 0)
    if len(useful) == 0:
        return useful
    table = _incidence([members[group] for group in useful], rays)
    # Rays and groups as one graph: group by group it would be quadratic.
    _, part = connected_components(block_array([[None, table], [table.T, None]]), directed=False)
    part = part[rays:]
    order = np.argsort(part, kind="stable")
    chosen = []
    for block in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        own = [members[group] for group in useful[block]]
        known, row = np.unique(np.concatenate(own), return_inverse=True)
        cuts = np.cumsum([len(rows) for rows in own])[:-1]
        few = _incidence(np.split(row, cuts), len(known))
        solve = _exact if len(block) <= largest else _greedy
        chosen.append(block[solve(few, gain[useful[block]])])
    return np.sort(useful[np.concatenate(chosen)])


def _incidence(members: list[Ints], rays: int) -> csr_array:
    """Rays by groups."""
    group = np.repeat(np.arange(len(members)), [len(rows) for rows in members])
    ones = np.ones(len(group))
    return csr_array((ones, (np.concatenate(members), group)), shape=(rays, len(members)))


def _exact(table: csr_array, gain: Floats) -> Bools:
    if len(gain) == 1:
        return np.ones(1, bool)
    used = table[np.flatnonzero(table.sum(axis=1) > 1)]
    result = milp(
        -gain,
        integrality=np.ones(len(gain)),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(used, -np.inf, 1),
        options={"mip_rel_gap": 0.0, "node_limit": _NODES},
    )
    return _greedy(table, gain) if result.x is None else result.x > 0.5


def _greedy(table: csr_array, gain: Floats) -> Bools:
    columns = table.tocsc()
    free = np.ones(table.shape[0], bool)
    chosen = np.zeros(len(gain), bool)
    for group in np.argsort(-gain, kind="stable"):
        rows = columns.indices[columns.indptr[group] : columns.indptr[group + 1]]
        if free[rows].all():
            free[rows] = False
            chosen[group] = True
    return chosen


SAME_CHI2 = 5.99  # two poles nearer than this (95 %, 2 degrees of freedom) may be one
SEQUENCE_CHI2 = 13.8  # as above (99.9 %), where depths and bearings follow the order of the images
_STILL_DEG = 0.2  # a bearing that turns back by less than this has not turned


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
        # Half the chi squared at the best place.
        rest = points.place_m[members] - weighted_mean(points, members)[0]
        cost = 0.5 * np.einsum("ki,kij,kj->", rest, points.information[members], rest)
        if float(cost) <= 0.5 * settings.gate_chi2 * len(members):
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
