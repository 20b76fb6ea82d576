"""The published methods: links between rays, chosen by an energy, then clusters of crossings.

Each ray prefers partners whose crossing agrees with its depth, few of them spread in depth, and
pays for having none (Krylov et al. 2018, eq. 4). The first code visits the links at random. The
pole study (section 3.4) leaves nothing to chance and merges clusters along the drive; its authors'
code visits each link once, in order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.poles.triangulate.rays import (
    FURTHEST_CAMERAS,
    Rays,
    TriangulationSettings,
    camera_pairs,
    cross_rays,
)

# Metres on the equator of the published code's unit of distance; times cos(latitude) elsewhere.
UNIT_M = 640 / 256
PUBLISHED_DISTANCE = 25.0  # its maximum distance, in that unit
# The published code measures between cameras on an Earth of 6,367 km instead of 6,371 km.
_EARTH_RATIO = 6_367_000 / 6_371_000
_DEPTH_IF_UNKNOWN = 5.0  # depth of a ray that has none, in the unit of depths
_SWEEPS = 15  # visits of each ray on average, as in the first code
_MIN_BASELINE_M = 0.5  # cameras nearer to each other than this count as one place (both codes)


@dataclass(frozen=True)
class Energy:
    """Constants of the energy of a ray.

    Parameters
    ----------
    depth_weight : alpha, for each |crossing's distance - monocular depth|.
    spread_weight : beta, for the largest less the smallest distance of a ray's crossings.
    """

    depth_weight: float
    spread_weight: float

    @property
    def lonely(self) -> float:
        """Energy of a ray without partner: 1 - alpha - beta."""
        return 1.0 - self.depth_weight - self.spread_weight


FIRST_CODE = Energy(depth_weight=0.2, spread_weight=0.2)  # constants of the first code


def published_poles(
    rays: Rays, settings: TriangulationSettings, latitude_deg: float, seed: int
) -> tuple[Ints, Floats]:
    """Poles as the published code finds them, quirks included, in a seeded random order.

    Its unit of distance is 2.5 cos(latitude) m, its clusters are made in degrees, and images are
    not told apart.

    Returns
    -------
    as `cluster_rays`
    """
    narrow = float(np.cos(np.radians(latitude_deg)))
    least_m = _MIN_BASELINE_M / _EARTH_RATIO
    links = find_links(rays, settings.max_distance_m, UNIT_M * narrow, least_m)
    on = sweep_links(links, rays.depth_m, FIRST_CODE, np.random.default_rng(seed))
    diagonal = 0.707 * settings.cluster_m * UNIT_M * float(np.hypot(1.0, narrow))
    return cluster_rays(links, on, len(rays), diagonal, np.array([1 / narrow, 1.0]))


def swept_poles(rays: Rays, settings: TriangulationSettings) -> tuple[Ints, Floats]:
    """Poles by the pole study's deterministic method, in metres (section 3.4); as `cluster_rays`.

    Rays are taken in the order of the drive, as the authors' file has them, so that the order of
    links is theirs. Their unit of distance, which is not the metre, is not followed.
    """
    order = np.lexsort((rays.sequence, rays.route))
    driven = rays.take(order)
    links = find_links(driven, settings.sweep_distance_m)
    different = driven.image[links.pairs[:, 0]] != driven.image[links.pairs[:, 1]]
    links = Links(links.pairs[different], links.along[different], links.place_m[different])
    energy = Energy(settings.depth_weight, settings.spread_weight)
    on = sweep_links(links, driven.depth_m, energy)
    own, places = cluster_rays(links, on, len(rays), settings.cluster_m)
    own, places = merge_along_drive(driven, own, places, settings.sequence_m)
    labels = np.empty(len(rays), np.int64)
    labels[order] = own
    return labels, places


@dataclass(frozen=True)
class Links:
    """Possible links between rays.

    Parameters
    ----------
    pairs : ray numbers, shape (m, 2). along : distance of the crossing along either ray in the
        unit of the depths, (m, 2). place_m : the crossing, (m, 2).
    """

    pairs: Ints
    along: Floats
    place_m: Floats


def find_links(
    rays: Rays, farthest: float, unit_m: float = 1.0, min_baseline_m: float = _MIN_BASELINE_M
) -> Links:
    """Crossings ahead of both cameras and within the maximum distance of both.

    Parameters
    ----------
    farthest : maximum distance, units. min_baseline_m : of two cameras at least.
    unit_m : metres in the unit in which depths and the maximum distance count. In the published
        code this is not the metre, but the cameras' distance is in metres.
    """
    pairs = camera_pairs(rays, FURTHEST_CAMERAS * farthest, min_baseline_m)
    along_m, place_m = cross_rays(rays, pairs)
    along = along_m / unit_m
    # Comparisons with NaN are false, so parallel rays drop out.
    good = ((along > 0) & (along <= farthest)).all(axis=1)
    return Links(pairs[good], along[good], place_m[good])


def sweep_links(
    links: Links, depth: Floats, energy: Energy, rng: np.random.Generator | None = None
) -> Bools:
    """Which links are on after a search for a low energy.

    A link that is visited is switched if the energy of its two rays does not rise.

    Parameters
    ----------
    depth : of each ray, NaN where unknown.
    rng : visits links at random, 15 times the number of rays in all, as the first code did: a ray
        first, then one of its links; None visits each link once, in order, as the study's code.
    """
    depths = np.where(np.isnan(depth), _DEPTH_IF_UNKNOWN, depth).tolist()
    pairs, along = links.pairs.tolist(), links.along.tolist()
    on = np.zeros(len(pairs), bool)
    of_ray: list[list[int]] = [[] for _ in depths]
    for link, (first, second) in enumerate(pairs):
        of_ray[first].append(link)
        of_ray[second].append(link)

    def energy_of(ray: int) -> float:
        reach = [along[link][0 if pairs[link][0] == ray else 1] for link in of_ray[ray] if on[link]]
        if not reach:
            return energy.lonely
        misfit = sum(abs(distance - depths[ray]) for distance in reach)
        return energy.depth_weight * misfit + energy.spread_weight * (max(reach) - min(reach))

    def visit(link: int) -> None:
        before = sum(energy_of(ray) for ray in pairs[link])
        on[link] = not on[link]
        if sum(energy_of(ray) for ray in pairs[link]) > before:
            on[link] = not on[link]

    if rng is None:
        for link in range(len(pairs)):
            visit(link)
        return on
    for ray in rng.integers(0, len(depths), _SWEEPS * len(depths)):
        if len(of_ray[ray]):
            visit(of_ray[ray][rng.integers(0, len(of_ray[ray]))])
    return on


def cluster_rays(
    links: Links, on: Bools, rays: int, cluster_m: float, stretch: Floats | None = None
) -> tuple[Ints, Floats]:
    """Single-linkage clusters of the rays' mean crossings.

    Parameters
    ----------
    stretch : (2,), scales x and y before distances are compared with ``cluster_m``.

    Returns
    -------
    cluster of each ray, -1 for rays without partner, and the place of each cluster (n, 2): the mean
    over its rays
    """
    ends = np.concatenate([links.pairs[on, 0], links.pairs[on, 1]])
    crossings = np.concatenate([links.place_m[on]] * 2)
    counts = np.bincount(ends, minlength=rays)
    linked = np.flatnonzero(counts)
    labels = np.full(rays, -1, np.int64)
    if len(linked) == 0:
        return labels, np.empty((0, 2))
    # Far from the origin, sums of coordinates would lose digits.
    origin = crossings[0]
    sums = [np.bincount(ends, axis, minlength=rays) for axis in (crossings - origin).T]
    mean = np.column_stack(sums)[linked] / counts[linked, None]
    scale = np.ones(2) if stretch is None else stretch
    near = cKDTree(mean * scale).query_pairs(cluster_m, output_type="ndarray")
    graph = csr_array((np.ones(len(near)), near.T), shape=(len(linked), len(linked)))
    clusters, label = connected_components(graph, directed=False)
    labels[linked] = label
    size = np.bincount(label, minlength=clusters)
    places = [np.bincount(label, axis, minlength=clusters) / size for axis in mean.T]
    return labels, np.column_stack(places) + origin


def merge_along_drive(
    rays: Rays, labels: Ints, places_m: Floats, sequence_m: float
) -> tuple[Ints, Floats]:
    """Clusters after the study's rule for one pole that became several (section 3.4).

    Two clusters are one pole if the images of both together follow each other within
    ``sequence_m``, depths do not grow and bearings turn one way. Nothing else is asked, and what
    merges with a third one is one pole with both. That clusters which share an image are not
    merged is not in the text: one image shows a pole once.

    Parameters
    ----------
    labels : (n,) cluster of each ray, -1 for none. places_m : (k, 2) of each cluster.

    Returns
    -------
    as `cluster_rays`
    """
    used = np.flatnonzero(labels >= 0)
    near = cKDTree(rays.camera_m[used]).query_pairs(sequence_m, output_type="ndarray")
    pairs = np.unique(np.sort(labels[used[near]], axis=1), axis=0) if len(near) else near
    members = [np.flatnonzero(labels == number) for number in range(len(places_m))]
    same = np.zeros(len(pairs), bool)
    for number, (one, other) in enumerate(pairs.tolist()):
        both = np.concatenate([members[one], members[other]])
        if one != other and len(set(rays.image[both].tolist())) == len(both):
            same[number] = follows_sequence(rays, both, sequence_m)
    graph = csr_array((np.ones(same.sum()), pairs[same].T), shape=(len(places_m),) * 2)
    count, merged = connected_components(graph, directed=False)
    sizes = np.array([len(own) for own in members], np.float64)
    weight = np.bincount(merged, sizes, minlength=count)
    means = [np.bincount(merged, sizes * axis, minlength=count) / weight for axis in places_m.T]
    joined = np.full(len(labels), -1, np.int64)
    joined[used] = merged[labels[used]]
    return joined, np.column_stack(means)


def follows_sequence(rays: Rays, members: Ints, sequence_m: float) -> bool:
    """Whether rays of one route show a pole that the vehicle comes nearer to and passes.

    Consecutive images lie within ``sequence_m``, depths do not grow and bearings turn one way
    (paper 2, section 3.4).
    """
    route, sequence = rays.route[members], rays.sequence[members]
    if (route < 0).any() or len(set(route.tolist())) > 1 or (sequence < 0).any():
        return False
    members = members[np.argsort(sequence, kind="stable")]
    steps_m = np.hypot(*np.diff(rays.camera_m[members], axis=0).T)
    depth, bearing = rays.depth_m[members], rays.bearing_deg[members]
    turns = (np.diff(bearing) + 180.0) % 360.0 - 180.0
    one_way = (turns >= 0).all() or (turns <= 0).all()
    nearer = bool((np.diff(depth[np.isfinite(depth)]) <= 0).all())
    return bool((steps_m <= sequence_m).all() and one_way and nearer)
