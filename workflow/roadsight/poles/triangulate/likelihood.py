"""What sightings of poles and strays look like on a drive, as far as the drive itself tells."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats
from roadsight.poles.triangulate.association import Neighbours, Pole
from roadsight.poles.triangulate.kernels import BIN_M, Likelihood
from roadsight.poles.triangulate.noise import Noise
from roadsight.poles.triangulate.rays import Rays, TriangulationSettings

_STRAYS_FIRST = 0.2
"""Share of strays before any pole is known: detectors of street objects show 5 to 30 %."""
_STRAYS_LEAST = 0.05
"""Share of strays beyond those that no pole took: some have been taken for views."""
_STRAYS_MOST = 0.3
"""Share of strays at most: rays that no pole took are also views of poles that nobody else saw."""
_SEEN_FIRST = 0.4
"""Share of near images that show a pole, before any is known: a camera that looks ahead sees a pole
from half of them, and misses some."""
_SEEN_MOST = 0.7
"""The same at most, once poles are known: with 0.5 one pole is taken for two more often (13 % too
many on the worst simulated street instead of 7 %)."""
_SEEN_LEAST = 0.15
"""The same at least: below, poles that hide most of the time would be made of anything."""
_SEEN_WORTH = 4.0
"""Images that the share before any pole is known counts for."""
_SEEN_BOUNDS = (0.01, 0.9)
"""Shares of any one bin: no image proves or excludes a pole by itself."""
_LONE = 0.5
"""Poles that a ray counts for which no pole took: it is a stray or a pole seen once."""
_RAYS_A_POLE = 4.0
"""Rays of a pole before any is known: three or four images show one on a drive of 8 m steps."""
_LEAST_SPREAD = 0.3
"""Least standard deviation of the logarithm of strays' depths: few depths show too little of it."""
_GATE = 1.5
"""Gate of a member over that of `listing`: evidence judges members itself, the gate saves time."""
_SIGMAS = (1e-3, 1.0)
"""Bounds of the sigma of a logarithm of depth: beyond one, a depth says nothing."""


def likelihood(
    rays: Rays,
    near: Neighbours,
    poles: list[Pole],
    noise: Noise,
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
    stated = np.hypot(_ratio(rays), np.where(free, noise.hidden_ratio, 0.0))
    ratio = np.where(np.isnan(rays.sigma_depth_m), noise.depth_ratio, stated)
    middle, spread = _depths(log_depth[~unknown], settings.max_distance_m)
    used = sum(len(pole.members) for pole in poles)
    count = len(poles) + _LONE * (len(rays) - used) if poles else len(rays) / _RAYS_A_POLE
    density = max(count, 1.0) / _ground_m2(rays, float(np.exp(middle + spread)))
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
        _stray_density(rays, used, unknown, (log_depth - middle) / spread, spread),
        missed,
        np.log(seen) - missed,
        float(np.log(density) - settings.pole_evidence),
        _GATE * settings.gate_chi2,
        settings.max_distance_m,
        settings.min_baseline_m,
    )


def _ratio(rays: Rays) -> Floats:
    """Sigma of the logarithm of a depth; 1 where unknown."""
    return np.nan_to_num(rays.sigma_depth_m / rays.depth_m, nan=1.0)


def _depths(log_depth: Floats, reach_m: float) -> tuple[float, float]:
    """Middle and spread of the logarithms of known depths; guesses where there are none."""
    if not len(log_depth):
        return float(np.log(reach_m / 2)), 0.5
    return float(np.median(log_depth)), max(float(np.std(log_depth)), _LEAST_SPREAD)


def _stray_density(rays: Rays, used: int, unknown: Bools, away: Floats, spread: float) -> Floats:
    """Log density of each ray as a stray: any bearing, a depth like that of all rays."""
    n = len(rays)
    strays = min(max(n - used, 0) + _STRAYS_LEAST * n, _STRAYS_MOST * n)
    if used == 0:
        strays = _STRAYS_FIRST * n
    rate = strays / len(np.unique(rays.image))
    depth = -0.5 * away**2 - np.log(spread * np.sqrt(2 * np.pi))
    return np.log(rate / (2 * np.pi)) + np.where(unknown, 0.0, depth)


def _ground_m2(rays: Rays, radius_m: float) -> float:
    """Ground that the images see: a disc each, parted among the images inside it."""
    _, first = np.unique(rays.image, return_index=True)
    tree = cKDTree(rays.camera_m[first])
    inside = tree.query_ball_point(rays.camera_m[first], radius_m, return_length=True)
    return float((np.pi * radius_m**2 / inside).sum())


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
