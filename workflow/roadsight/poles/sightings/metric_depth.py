"""Metric depth: of a relative depth map, and of a foot on the ground (paper 2, section 3.3.1).

The paper maps relative depth d to the camera's z by d = c1 / (-z) + c2 with z negative in front
(OpenGL). Here z is positive in front, so d = c1 / z + c2: linear in 1 / z, and fitted there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats

_TUKEY = 4.685  # tuning constant of the bisquare: 95 % efficiency where errors are normal
TO_SIGMA = 1.4826  # standard deviation over median absolute deviation, of a normal distribution
_ROUNDS = 30  # rounds of least absolute errors, and as many of the bisquare after them
# Standard deviations from the pole of the relation within which depth is unknown.
_GUARD_SIGMAS = 2.0
_BINS = 12  # stretches of log depth that have the same say

_AGREE_SIGMAS = 3.0  # distances agree within so many common sigmas
_LEAST_POINTS = 8  # points of known depth that two coefficients need
# Farthest over nearest known depth: with less, scale and shift of the map look alike.
_LEAST_RATIO = 1.3


@dataclass(frozen=True)
class DepthFit:
    """Relation d = c1 / z + c2 of one image.

    Parameters
    ----------
    c1, c2 : coefficients, in units of d (c1 times metres). covariance : (2, 2) of them.
    sigma_d : scatter of d about the fit. near_m, far_m : planes between which it was fitted.
    points : that support it. reason : why there is no fit, or "".
    """

    c1: float
    c2: float
    covariance: Floats
    sigma_d: float
    near_m: float
    far_m: float
    points: int
    reason: str = ""

    def depth_m(
        self, relative: ArrayLike, sigma_relative: ArrayLike = 0.0
    ) -> tuple[Floats, Floats]:
        """Depth along the optical axis and its sigma (n,); NaN where d is too near the pole.

        The relation has its pole at d = c2, where z is infinite: within two sigmas of it, and
        beyond, nothing is known about the depth. Sigma carries the coefficients' covariance and
        the scatter of d.
        """
        d = np.asarray(relative, np.float64)
        if self.reason:
            return np.full(d.shape, np.nan), np.full(d.shape, np.nan)
        above = d - self.c2
        with np.errstate(divide="ignore", invalid="ignore"):
            z = self.c1 / above
            a, b, c = self.covariance[0, 0], self.covariance[1, 1], self.covariance[0, 1]
            own = self.sigma_d**2 + np.asarray(sigma_relative, np.float64) ** 2
            spread = np.sqrt(own + a / z**2 + b + 2.0 * c / z)
            good = np.isfinite(d) & (z > 0) & (np.abs(above) > _GUARD_SIGMAS * spread)
            return np.where(good, z, np.nan), np.where(good, z**2 / abs(self.c1) * spread, np.nan)


def fit_metric_depth(
    relative: ArrayLike, z_true_m: ArrayLike, weights: ArrayLike | None = None
) -> DepthFit:
    """Fit d = c1 / z + c2 to points of known depth, robustly.

    d is regressed on 1 / z, because the error is in d; by Tukey's bisquare from a least absolute
    start, so that a third of wrong points does no harm.

    Parameters
    ----------
    relative : d (n,), any scale and shift, larger = nearer. z_true_m : depth along the optical
        axis (n,). weights : (n,), not negative; all one if None.

    Returns
    -------
    the fit; its ``reason`` says why there is none (too few points, too little range in depth, or
    d that does not grow towards the camera).
    """
    d, z = np.asarray(relative, np.float64), np.asarray(z_true_m, np.float64)
    w = np.asarray(np.ones(len(d)) if weights is None else weights, np.float64)
    good = np.isfinite(d) & np.isfinite(z) & (z > 0) & np.isfinite(w) & (w > 0)
    d, z, w = d[good], z[good], w[good]
    if len(d) < _LEAST_POINTS:
        return _no_fit(f"{len(d)} points of known depth, {_LEAST_POINTS} are needed")
    near, far = float(z.min()), float(z.max())
    if far < _LEAST_RATIO * near:
        return _no_fit("points of known depth are all at one distance")
    basis = np.column_stack([1.0 / z, np.ones(len(z))])
    w = w * (len(w) / w.sum())
    solution, scatter, robust = _bisquare(basis, d, w)
    if scatter == 0.0 and np.ptp(d) == 0.0:
        return _no_fit("relative depth is constant")
    if solution[0] <= 0.0:
        return _no_fit("relative depth does not grow towards the camera")
    kept = robust > 0
    normal = np.linalg.pinv(basis.T @ (basis * robust[:, None]))
    # Neighbouring points err together: as if every tenth were independent.
    covariance = normal * scatter**2 * max(min(10.0, kept.sum() / _LEAST_POINTS), 1.0)
    return DepthFit(
        float(solution[0]), float(solution[1]), covariance, scatter, near, far, int(kept.sum())
    )


def fit_published_depth(relative: ArrayLike, z_true_m: ArrayLike) -> DepthFit:
    """The study's fit, d = c1 / z + c2 by ordinary least squares (section 3.3.1).

    LiDAR depths, normalised between near and far plane, are regressed on the network's; whatever
    the planes are, that is a line of 1 / z by d. The authors' code takes it through the origin, for
    maps that are stretched over 8 bits; the text names a linear regression, and others are not
    stretched, so that here it has a level.

    Parameters
    ----------
    relative : d (n,), any scale and shift, larger = nearer. z_true_m : depth along the optical
        axis (n,).

    Returns
    -------
    the fit, without errors; its ``reason`` says why there is none
    """
    d, z = np.asarray(relative, np.float64), np.asarray(z_true_m, np.float64)
    good = np.isfinite(d) & np.isfinite(z) & (z > 0)
    d, z = d[good], z[good]
    if len(d) < _LEAST_POINTS:
        return _no_fit(f"{len(d)} points of known depth, {_LEAST_POINTS} are needed")
    if np.ptp(d) == 0.0:
        return _no_fit("relative depth is constant")
    slope, level = np.polyfit(d, 1.0 / z, 1)
    if slope <= 0.0:
        return _no_fit("relative depth does not grow towards the camera")
    near, far = float(z.min()), float(z.max())
    return DepthFit(1.0 / slope, -level / slope, np.zeros((2, 2)), 0.0, near, far, len(d))


def _bisquare(basis: Floats, d: Floats, w: Floats) -> tuple[Floats, float, Floats]:
    """Coefficients (2,), scatter of d and final weights (n,)."""
    robust = w
    scatter = 0.0
    solution: Floats = np.zeros(2)
    # Where the fit is exact, weights stay finite.
    floor = 1e-9 * max(float(np.abs(d).max()), 1e-300)
    for turn in range(2 * _ROUNDS):
        root = np.sqrt(robust)
        solution = np.asarray(
            np.linalg.lstsq(basis * root[:, None], d * root, rcond=None)[0], np.float64
        )
        residual = d - basis @ solution
        scatter = TO_SIGMA * _weighted_median(np.abs(residual), w)
        if turn < _ROUNDS:
            robust = w / np.maximum(np.abs(residual), max(0.1 * scatter, floor))
        else:
            robust = w * np.clip(1 - (residual / max(_TUKEY * scatter, floor)) ** 2, 0, None) ** 2
    return solution, float(scatter), robust


def _weighted_median(values: Floats, weights: Floats) -> float:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def _no_fit(reason: str) -> DepthFit:
    nan = float("nan")
    return DepthFit(nan, nan, np.full((2, 2), nan), nan, nan, nan, 0, reason)


def balancing_weights(z_m: ArrayLike) -> Floats:
    """Weights (n,) that give each stretch of log depth the same say: near points are too many."""
    z = np.log(np.maximum(np.asarray(z_m, np.float64), 1e-3))
    if not len(z):
        return z
    number = np.clip(((z - z.min()) / max(np.ptp(z), 1e-9) * _BINS).astype(int), 0, _BINS - 1)
    return 1.0 / np.bincount(number, minlength=_BINS)[number]


def fuse_depths(depths_m: ArrayLike, sigmas_m: ArrayLike) -> tuple[float, float, Bools]:
    """One distance from several by inverse variance, without those that disagree.

    While two used ones differ by more than three of their common sigmas, the one furthest
    from the weighted mean of the others goes; of two that disagree the surer one stays, and sigma
    is widened to half of their difference.

    Parameters
    ----------
    depths_m, sigmas_m : (k,), NaN where there is none.

    Returns
    -------
    distance and sigma (NaN if there is none), and which (k,) were used
    """
    depth, sigma = np.asarray(depths_m, np.float64), np.asarray(sigmas_m, np.float64)
    used = np.isfinite(depth) & np.isfinite(sigma) & (sigma > 0)
    widened = 0.0
    while np.count_nonzero(used) > 1:
        # Which one is furthest from the mean of the others, in their common sigmas.
        worst, score = -1, -1.0
        for one in np.flatnonzero(used):
            others = used.copy()
            others[one] = False
            weights = 1.0 / sigma[others] ** 2
            middle = np.sum(weights * depth[others]) / weights.sum()
            apart = abs(depth[one] - middle) / np.sqrt(sigma[one] ** 2 + 1.0 / weights.sum())
            if apart > score:
                worst, score = int(one), float(apart)
        if score <= _AGREE_SIGMAS:
            break
        if np.count_nonzero(used) == 2:
            first, second = np.flatnonzero(used)
            worst = int(second if sigma[first] <= sigma[second] else first)
            widened = 0.5 * abs(depth[first] - depth[second])
        used[worst] = False
    if not used.any():
        return float("nan"), float("nan"), used
    weights = 1.0 / sigma[used] ** 2
    mean = float(np.sum(weights * depth[used]) / weights.sum())
    return mean, float(max(np.sqrt(1.0 / weights.sum()), widened)), used


# Depth networks by camera: their distances held against those where feet meet the ground.
#
# A network that sees another lens than it learned from errs alike on the whole drive, while its
# fit to each image's road says that all is well. Feet that stand on the terrain tell by how much.

_FEWEST = 12  # objects with both distances from which a camera's scale is found
_SURE = 3.0  # standard errors by which a scale must differ from 1
# Ways to a distance, in the order in which `COLUMNS` has them.
_KINDS = ("network", "ground", "lidar")
# Distance and sigma of each way.
COLUMNS = tuple(f"{part}depth_{kind}_m" for kind in _KINDS for part in ("", "sigma_"))


@dataclass(frozen=True)
class NetworkScale:
    """How a network's distances in one camera compare with the ground's.

    Parameters
    ----------
    route, view : of the camera. ratio : network over ground, median. sigma : of one logarithm of
        the ratio. pairs : objects that have both.
    """

    route: str
    view: str
    ratio: float
    sigma: float
    pairs: int


def network_scales(sightings: pd.DataFrame) -> list[NetworkScale]:
    """Cameras whose network is surely off, in order of route and view.

    Parameters
    ----------
    sightings : a row for each object, kept or not: route, view and `COLUMNS`.
    """
    found = []
    for (route, view), part in sightings.groupby(["route", "view"], sort=True, observed=True):
        pairs = part[["depth_network_m", "depth_ground_m"]].to_numpy(np.float64)
        network_m, ground_m = pairs[(pairs > 0).all(axis=1)].T
        logs = np.log(network_m / ground_m)
        if len(logs) < _FEWEST:
            continue
        middle = float(np.median(logs))
        sigma = TO_SIGMA * float(np.median(np.abs(logs - middle)))
        # A median errs by a quarter more than a mean does.
        if abs(middle) > _SURE * 1.25 * sigma / np.sqrt(len(logs)):
            ratio = float(np.exp(middle))
            found.append(NetworkScale(str(route), str(view), ratio, sigma, len(logs)))
    return found


def with_scales(sightings: pd.DataFrame, scales: list[NetworkScale]) -> pd.DataFrame:
    """Sightings with the network's distances over their camera's scale, all distances fused anew.

    A scaled distance is not surer than the scatter of its camera's ratios.
    """
    if not scales:
        return sightings
    table = sightings.copy()
    network_m = table["depth_network_m"].to_numpy(np.float64).copy()
    sigma_m = table["sigma_depth_network_m"].to_numpy(np.float64).copy()
    touched = np.zeros(len(table), bool)
    for scale in scales:
        rows = ((table["route"] == scale.route) & (table["view"] == scale.view)).to_numpy()
        network_m[rows] /= scale.ratio
        sigma_m[rows] = np.fmax(sigma_m[rows] / scale.ratio, scale.sigma * network_m[rows])
        touched |= rows
    table["depth_network_m"], table["sigma_depth_network_m"] = network_m, sigma_m
    ways = table[list(COLUMNS)].to_numpy(np.float64)
    depth_m, depth_sigma_m = (
        table[name].to_numpy(np.float64).copy() for name in ("depth_m", "sigma_depth_m")
    )
    sources = table["depth_from"].to_numpy(object).copy()
    # Of a sighting that ends at a column nothing else tells the distance.
    free = ~np.isfinite(table["depth_lidar_m"].to_numpy(np.float64))
    for row in np.flatnonzero(touched & free & np.isfinite(network_m)):
        depth_m[row], depth_sigma_m[row], used = fuse_depths(ways[row, ::2], ways[row, 1::2])
        sources[row] = "+".join(kind for kind, one in zip(_KINDS, used, strict=True) if one)
    return table.assign(depth_m=depth_m, sigma_depth_m=depth_sigma_m, depth_from=sources)
