"""Poles that explain the rays, with what the rays tell about their own errors.

Rays are grouped by how well they agree, so that groups look better than the rays are: errors that
are found from groups that were made with found errors shrink turn by turn. They are found from
groups made with the stated errors, once again, and later only widened.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.poles.triangulate.association import (
    BIN_M,
    SETTLED,
    Grower,
    Likelihood,
    Neighbours,
    Pole,
    Work,
    find_neighbours,
    in_order,
    take_best,
)
from roadsight.poles.triangulate.noise import RayNoise, fit_noise, place_groups, stated_noise
from roadsight.poles.triangulate.published import swept_poles
from roadsight.poles.triangulate.rays import Rays, TriangulationSettings

# Turns of association and of finding errors and depth scale; most drives rest after four.
_ROUNDS = 7
# Turns with the stated errors, in which the depth scale comes to rest: errors that are found at a
# wrong scale are too wide.
_AS_STATED = 2
# Fits of the errors that may narrow them. With one, errors that are stated 4 times too wide stay
# too wide; with no end, they shrink to half of what they are on 173 ambiguous sightings.
_NARROWING = 2
_FEWEST_DEPTHS = 30  # depths that the factor needs, as the median of their ratios
_SCALES = (0.5, 2.0)  # bounds of the factor: beyond, groups rather than depths are wrong
# Least eigenvalue of the rays' normal matrix, a sum of squared sines: below, rays are so parallel
# that bearings alone do not tell the distance.
_WELL_CROSSED = 0.1


@dataclass(frozen=True)
class Explained:
    """What explains the rays.

    Parameters
    ----------
    groups : rays of each pole, from west to east and south to north. place_m : (g, 2).
    covariance : of the places, m2, (g, 2, 2). gain : log evidence of each, (g,).
    scale : what depths were multiplied by; 1 if not calibrated.
    """

    groups: list[Ints]
    place_m: Floats
    covariance: Floats
    gain: Floats
    scale: float
    noise: RayNoise


def explain_rays(
    rays: Rays, settings: TriangulationSettings, work: Work | None = None
) -> Explained:
    """Poles of rays, found in turns: poles, then the errors and the scale that they show.

    Parameters
    ----------
    work : counts operations, for tests.
    """
    near = find_neighbours(rays, settings)
    noise, scale, scaled = stated_noise(settings), 1.0, rays
    poles: list[Pole] = []
    work = work or Work()
    fits = 0
    for turn in range(_ROUNDS if len(rays) else 0):
        before = [pole.key for pole in poles]
        model = likelihood(scaled, near, poles, noise, settings)
        poles = associate(Grower(scaled, near, model, work))
        rests = [pole.key for pole in poles] == before
        if rests and fits >= _NARROWING:
            break
        groups = [pole.members for pole in poles]
        if settings.calibrate_depth:
            scale = depth_scale(rays, groups, scale)
            scaled = rays.scaled(scale)
        if turn >= _AS_STATED or rests:
            latest = fit_noise(scaled, groups, _places(poles), settings)
            noise = latest if fits < _NARROWING else noise.or_wider(latest)
            fits += 1
    groups = [pole.members for pole in poles]
    places, covariances = place_groups(scaled, groups, _places(poles), noise, settings)
    order = np.lexsort(places.T[::-1])
    return Explained(
        [groups[number] for number in order],
        places[order],
        covariances[order],
        np.array([poles[number].gain for number in order]),
        scale,
        noise,
    )


def _places(poles: list[Pole]) -> Floats:
    return np.array([(pole.x, pole.y) for pole in poles]).reshape(-1, 2)


def depth_scale(rays: Rays, groups: list[Ints], otherwise: float) -> float:
    """Factor that brings the monocular depths to the distances of the crossings.

    Depth networks err by a common factor. Poles with three and more well-crossed views are located
    by bearings alone; the factor is the median of distance over depth. Without enough such views it
    is ``otherwise``.
    """
    ratios = [depth_ratios(rays, members) for members in groups]
    found = np.concatenate([*ratios, np.empty(0)])
    if len(found) < _FEWEST_DEPTHS:
        return otherwise
    return float(np.clip(np.median(found), *_SCALES))


def depth_ratios(rays: Rays, members: Ints) -> Floats:
    """Distance by bearings alone over depth, of each ray of a well-crossed group."""
    if len(members) < 3:
        return np.empty(0)
    ahead = rays.direction[members]
    side = np.column_stack([ahead[:, 1], -ahead[:, 0]])
    normal = side.T @ side
    if np.linalg.eigvalsh(normal)[0] < _WELL_CROSSED:
        return np.empty(0)
    camera = rays.camera_m[members] - rays.camera_m[members[0]]
    place = np.linalg.solve(normal, side.T @ (side * camera).sum(axis=1))
    distance = ((place - camera) * ahead).sum(axis=1)
    ratio = distance / rays.depth_m[members]
    return ratio[np.isfinite(ratio) & (ratio > 0) & ~rays.anchored[members]]


# The set of poles that explains the rays best: greedy first, then improved by exchange.

_EXCHANGES = 6  # rounds of exchange between poles at most; most streets rest after three
# Two sets of poles whose evidence differs by less are equal: sums round more than terms.
_BETTER = 1e-6


def associate(grower: Grower) -> list[Pole]:
    """Poles that share no ray and together explain the rays best, as far as exchange finds it.

    The best hypothesis is taken first and what it leaves is grown anew; then rays are exchanged
    between poles image by image, poles that are better as one are merged, left-over hypotheses are
    forced in where that pays, and free rays seed new ones, until nothing changes. No step depends
    on the order of the caller's rows.
    """
    free = np.ones(len(grower.rays), bool)
    seeds = grower.seeds()
    poles, others = take_best(grower, seeds, free)
    for _ in range(_EXCHANGES):
        before = [pole.key for pole in poles]
        poles = _insert(grower, _merge(grower, _exchange(grower, poles)), others)
        free[:] = True
        for pole in poles:
            free[pole.members] = False
        left = [seed for seed in seeds if free[seed[0]]]
        poles = in_order(poles + take_best(grower, left, free)[0])
        if [pole.key for pole in poles] == before:
            break
    return poles


def _exchange(grower: Grower, poles: list[Pole]) -> list[Pole]:
    """Each image's rays to the poles that they fit best, one to one; poles fitted anew."""
    if not poles:
        return poles
    rays = grower.rays
    tree = cKDTree(_places(poles))
    members: list[list[int]] = [[] for _ in poles]
    by_image = np.argsort(rays.image, kind="stable")
    for own in np.split(by_image, np.flatnonzero(np.diff(rays.image[by_image])) + 1):
        around = sorted(tree.query_ball_point(rays.camera_m[own[0]], grower.model.reach_m))
        if not around:
            continue
        worth = np.maximum(grower.speaking([poles[p] for p in around], own), 0.0)
        for p, k in zip(*linear_sum_assignment(-worth), strict=True):
            if worth[p, k] > 0:
                members[around[p]].append(int(own[k]))
    kept = []
    for pole, rows in zip(poles, members, strict=True):
        if len(rows) < 2:
            continue
        ordered = np.sort(np.array(rows, np.int64))
        again = grower.fit(ordered, pole.x, pole.y, int(ordered[0]))
        if again is not None:
            kept.append(again)
    return in_order(kept)


def _merge(grower: Grower, poles: list[Pole]) -> list[Pole]:
    """Poles after joining those that explain their rays better as one, nearest first."""
    current, fresh = dict(enumerate(poles)), len(poles)
    tried: set[tuple[int, int]] = set()
    free = np.zeros(len(grower.rays), bool)
    joined = True
    while joined and len(current) > 1:
        joined, used = False, set()
        numbers = np.array(sorted(current))
        places = _places([current[n] for n in numbers.tolist()])
        near = cKDTree(places).query_pairs(grower.model.reach_m / 2, output_type="ndarray")
        apart = np.hypot(*(places[near[:, 0]] - places[near[:, 1]]).T)
        first, second = numbers[near.min(axis=1)], numbers[near.max(axis=1)]
        order = np.lexsort([second, first, np.round(apart, 9)])
        for a, b in zip(first[order].tolist(), second[order].tolist(), strict=True):
            if (a, b) in tried or a in used or b in used:
                continue
            tried.add((a, b))
            one = _as_one(grower, current[a], current[b], free)
            if one is not None and one.gain > current[a].gain + current[b].gain + _BETTER:
                used |= {a, b}
                del current[a], current[b]
                current[fresh] = one
                fresh, joined = fresh + 1, True
    return in_order(current.values())


def _as_one(grower: Grower, first: Pole, second: Pole, free: Bools) -> Pole | None:
    """One pole of the rays of two, from the places of both and between; no ray stays free."""
    free[first.members] = free[second.members] = True
    best = None
    middle = (0.5 * (first.x + second.x), 0.5 * (first.y + second.y))
    for x, y in (middle, (first.x, first.y), (second.x, second.y)):
        one = grower.grow(x, y, first.seed, free)
        if one is not None and (best is None or one.gain > best.gain + SETTLED):
            best = one
    free[first.members] = free[second.members] = False
    return best


def _insert(grower: Grower, poles: list[Pole], others: list[Pole]) -> list[Pole]:
    """Poles after forcing others in, one by one, wherever that explains the rays better.

    Poles that lose rays to the one forced in are grown anew from what they keep and what is free.
    """
    owner = np.full(len(grower.rays), -1)
    current, fresh = dict(enumerate(poles)), len(poles)
    keys = {pole.key for pole in poles}
    for number, pole in current.items():
        owner[pole.members] = number
    free = owner < 0
    for other in others:
        if other.key in keys:
            continue
        numbers = sorted({int(n) for n in owner[other.members] if n >= 0})
        rivals = [current[n] for n in numbers]
        kept = _with_forced(grower, other, rivals, free)
        if sum(pole.gain for pole in kept) > sum(pole.gain for pole in rivals) + _BETTER:
            for n in numbers:
                gone = current.pop(n)
                owner[gone.members] = -1
                keys.discard(gone.key)
            for pole in kept:
                current[fresh] = pole
                owner[pole.members] = fresh
                keys.add(pole.key)
                fresh += 1
        for pole in (*rivals, *kept):
            free[pole.members] = owner[pole.members] < 0
    return in_order(current.values())


def _with_forced(grower: Grower, other: Pole, rivals: list[Pole], free: Bools) -> list[Pole]:
    """A pole that is forced in, and what its rivals become without its rays, best rival first.

    ``free`` tells which rays are of no pole; when it returns, of none of the poles that come back.
    """
    for rival in rivals:
        free[rival.members] = True
    free[other.members] = False
    kept = [other]
    for rival in sorted(rivals, key=lambda pole: (-round(pole.gain, 9), pole.key)):
        again = grower.grow(rival.x, rival.y, rival.seed, free)
        if again is not None:
            kept.append(again)
            free[again.members] = False
    return kept


# What sightings of poles and strays look like on a drive, as far as the drive itself tells.

# Share of strays before any pole is known: detectors of street objects show 5 to 30 %.
_STRAYS_FIRST = 0.2
# Share of strays beyond those that no pole took: some have been taken for views.
_STRAYS_LEAST = 0.05
# Share of strays at most: rays that no pole took are also views of poles that nobody else saw.
_STRAYS_MOST = 0.3
# Share of near images that show a pole, before any is known: a camera that looks ahead sees a pole
# from half of them, and misses some.
_SEEN_FIRST = 0.4
# The same at most, once poles are known: with 0.5 one pole is taken for two more often (13 % too
# many on the worst simulated street instead of 7 %).
_SEEN_MOST = 0.7
# The same at least: below, poles that hide most of the time would be made of anything.
_SEEN_LEAST = 0.15
_SEEN_WORTH = 4.0  # images that the share before any pole is known counts for
_SEEN_BOUNDS = (0.01, 0.9)  # shares of any one bin: no image proves or excludes a pole by itself
_LONE = 0.5  # poles that a ray counts for which no pole took: it is a stray or a pole seen once
# Rays of a pole before any is known: three or four images show one on a drive of 8 m steps.
_RAYS_A_POLE = 4.0
# Least standard deviation of the logarithm of strays' depths: few depths show too little of it.
_LEAST_SPREAD = 0.3
# Times `gate_chi2`: evidence judges members itself, the gate saves time.
_GATE = 1.5
# Bounds of the sigma of a logarithm of depth: beyond one, a depth says nothing.
_SIGMAS = (1e-3, 1.0)


def likelihood(
    rays: Rays,
    near: Neighbours,
    poles: list[Pole],
    noise: RayNoise,
    settings: TriangulationSettings,
) -> Likelihood:
    """Densities of views and strays, from poles as they are known so far; none at first.

    Parameters
    ----------
    rays : depths are scaled already.
    """
    unknown = np.isnan(rays.depth_m)
    log_depth = np.log(rays.depth_m)
    free = ~rays.anchored
    angle = np.where(free, noise.bearing_rad, np.radians(settings.sigma_bearing_deg))
    angle = np.where(np.isnan(rays.sigma_bearing_deg), angle, np.radians(rays.sigma_bearing_deg))
    stated = np.nan_to_num(rays.sigma_depth_m / rays.depth_m, nan=1.0)
    stated = np.hypot(stated, np.where(free, noise.hidden_ratio, 0.0))
    ratio = np.where(np.isnan(rays.sigma_depth_m), noise.depth_ratio, stated)
    # Logarithms of depths; guesses where none is known.
    middle, spread = float(np.log(settings.max_distance_m / 2)), 0.5
    if not unknown.all():
        middle = float(np.median(log_depth[~unknown]))
        spread = max(float(np.std(log_depth[~unknown])), _LEAST_SPREAD)
    used = sum(len(pole.members) for pole in poles)
    count = len(poles) + _LONE * (len(rays) - used) if poles else len(rays) / _RAYS_A_POLE
    # Ground that the images see: a disc each, parted among the images inside it.
    _, first = np.unique(rays.image, return_index=True)
    places, radius_m = rays.camera_m[first], float(np.exp(middle + spread))
    inside = cKDTree(places).query_ball_point(places, radius_m, return_length=True)
    density = max(count, 1.0) / float((np.pi * radius_m**2 / inside).sum())
    # Strays: at any bearing, with depths like those of all rays.
    n = len(rays)
    strays = min(max(n - used, 0) + _STRAYS_LEAST * n, _STRAYS_MOST * n)
    rate = (strays if used else _STRAYS_FIRST * n) / len(first)
    by_depth = -0.5 * ((log_depth - middle) / spread) ** 2 - np.log(spread * np.sqrt(2 * np.pi))
    stray = np.log(rate / (2 * np.pi)) + np.where(unknown, 0.0, by_depth)
    seen = shares_seen(rays, poles, near, settings.max_distance_m)
    missed = np.log1p(-seen)
    return Likelihood(
        np.ascontiguousarray(rays.camera_m),
        rays.direction,
        rays.image,
        angle,
        np.clip(ratio, *_SIGMAS),
        np.where(free, noise.position_m, 0.0),
        log_depth,
        stray,
        missed,
        np.log(seen) - missed,
        float(np.log(density) - settings.pole_evidence),
        _GATE * settings.gate_chi2,
        settings.max_distance_m,
        settings.min_baseline_m,
    )


def shares_seen(rays: Rays, poles: list[Pole], near: Neighbours, reach_m: float) -> Floats:
    """Share of images that show a pole, by bins of its distance.

    It falls with distance as the number of sightings does, from a level that poles tell: a pole was
    found because two images show it, so that two count neither way.
    """
    bins = int(reach_m / BIN_M) + 1
    shape = _falling(rays.depth_m[np.isfinite(rays.depth_m)], bins)
    level = _SEEN_FIRST
    if poles:
        shown, images = 0.0, 0.0
        for pole in poles:
            around = near.of(pole.seed)
            _, once = np.unique(rays.image[around], return_index=True)
            away = np.hypot(*(rays.camera_m[around[once]] - [pole.x, pole.y]).T)
            expected = shape[_bin(away[away <= reach_m], bins)].sum()
            shown += len(pole.members) - 2
            images += expected * (1.0 - 2.0 / len(pole.members))
        level = (shown + _SEEN_WORTH * _SEEN_FIRST) / (images + _SEEN_WORTH)
        level = float(np.clip(level, _SEEN_LEAST, _SEEN_MOST))
    return np.clip(level * shape, *_SEEN_BOUNDS)


def _falling(depth_m: Floats, bins: int) -> Floats:
    """Number of depths by distance, smoothed, as a share of the most, never rising (bins,)."""
    counts = np.bincount(_bin(depth_m, bins), minlength=bins).astype(np.float64)
    smooth = np.convolve(np.pad(counts, 1, mode="edge"), [0.25, 0.5, 0.25], "valid")
    if smooth.max() <= 0:
        return np.ones(bins)
    shape = smooth / smooth.max()
    shape[: int(shape.argmax())] = 1.0
    return np.minimum.accumulate(shape)


def _bin(away_m: Floats, bins: int) -> np.ndarray:
    return np.minimum((away_m / BIN_M).astype(np.int64), bins - 1)


POLE_COLUMNS = [
    "x", "y", "score", "sigma_major_m", "sigma_minor_m", "sigma_azimuth_deg", "condition", "kept",
    "reason",
]  # fmt: skip


def triangulate(rays: Rays, settings: TriangulationSettings) -> tuple[pd.DataFrame, Ints, float]:
    """Poles with their errors.

    Parameters
    ----------
    settings : their method is ``sweep``: the pole study's, which states no errors (NaN) and
        withholds nothing; else groups by the evidence for them.

    Returns
    -------
    poles : one row each, columns `POLE_COLUMNS` and ``evidence`` (log odds that its rays show a
        pole and not strays), local metres; ``score`` is the number of views,
        ``condition`` the ratio of the error ellipse's variances; poles too weak to use have
        ``kept`` False and a reason.
    pole of each ray : row in ``poles``, -1 for none; shape (n,).
    scale : what depths were multiplied by; 1 if not calibrated.
    """
    if settings.method == "sweep":
        labels, places = swept_poles(rays, settings)
        order = np.lexsort((places[:, 1], places[:, 0]))
        rank = np.append(np.argsort(order), -1)
        unknown = dict.fromkeys(POLE_COLUMNS[3:-2], np.nan)
        views = np.bincount(labels[labels >= 0], minlength=len(places))
        poles = pd.DataFrame({"x": places[:, 0], "y": places[:, 1], "score": views}).iloc[order]
        poles = poles.reset_index(drop=True).assign(**unknown, kept=True, reason="")
        poles = poles.assign(evidence=np.nan).astype({"kept": bool, "reason": object})
        return poles, rank[labels], 1.0
    found = explain_rays(rays, settings)
    pole = np.full(len(rays), -1, np.int64)
    for number, members in enumerate(found.groups):
        pole[members] = number
    poles = describe_groups(found.groups, found.place_m, found.covariance, settings)
    return poles.assign(evidence=found.gain + settings.pole_evidence), pole, found.scale


def describe_groups(
    groups: list[Ints], places: Floats, covariances: Floats, settings: TriangulationSettings
) -> pd.DataFrame:
    """Poles of groups of rays with their errors; columns `POLE_COLUMNS`.

    Parameters
    ----------
    places : (g, 2), metres. covariances : (g, 2, 2), m2.
    """
    major, minor, azimuth = error_ellipse(covariances)
    weak = major > settings.max_sigma_m
    columns = [
        *places.T,
        np.array([len(members) for members in groups], np.int64),
        major,
        minor,
        azimuth,
        (major / minor) ** 2,
        ~weak,
        np.where(weak, f"error ellipse longer than {settings.max_sigma_m:g} m", "").astype(object),
    ]
    return pd.DataFrame(dict(zip(POLE_COLUMNS, columns, strict=True)))


def error_ellipse(covariance: Floats) -> tuple[Floats, Floats, Floats]:
    """Semi-axes of the 1-sigma ellipse and the bearing of the longer one.

    Parameters
    ----------
    covariance : of x and y, m2, shape (n, 2, 2).

    Returns
    -------
    longer and shorter semi-axis, m; bearing clockwise from grid north, degrees in [0, 180)
    """
    variances, axes = np.linalg.eigh(covariance)
    minor, major = np.sqrt(np.maximum(variances, 0.0)).T
    azimuth = np.degrees(np.arctan2(axes[:, 0, 1], axes[:, 1, 1])) % 180.0
    return major, minor, np.where(azimuth >= 180.0, 0.0, azimuth)
