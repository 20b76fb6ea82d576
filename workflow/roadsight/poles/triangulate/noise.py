"""How sightings err: variances found from groups of rays, and poles placed with them.

An error is of one ray or shared: a receiver drifts, a heading stays off for some images, a column
of the cloud stands off by the same for all that end at it, and a pole whose foot is hidden looks
too far from everywhere. Variances of these parts are found by restricted maximum likelihood
(Patterson and Thompson 1971) by Fisher scoring, from the misfit of groups about their places, with
the stated sigmas as a prior. Places and their covariances follow by generalised least squares, so
that shared errors do not average out.

What all rays of a pole share alike, such as a receiver that is off by the same along a street,
moves the pole and leaves no misfit: of it there is the prior only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.poles.triangulate.rays import Rays, TriangulationSettings

# Length over which errors of a receiver stay alike: tens of seconds at the speed of a street. Those
# of aligned headings and places across do as well: 10, 50 and 100 m apart their correlation is
# 0.89, 0.72, 0.60 and 0.79, 0.53, 0.32 on twelve generated roads with 2 pulses/m2, and 0.75, 0.46,
# 0.21 and 0.54, 0.17, 0.21 on six with 8 and 24.
_DRIFT_M = 100.0
# Length over which errors of bearings stay alike that nothing else tells: of those without a sigma,
# and of the shared share of what is a ray's own. An inertial heading wanders between turns.
_HEADING_M = 30.0
# Standard deviations of the logarithm of a variance about what is stated: of places and bearings,
# where a factor of 4.5 is usual, and of depths. Groups are made of depths that agree, so that
# depths that scatter look better than they are.
_LOOSE = (1.5, 1.5, 0.5)
# As above, of the parts of one kind about each other: the share that is shared, which misfits
# hardly tell, is known to a factor of 3.
_APART = 1.0
_ROUNDS = 8  # steps of Fisher scoring at most; it rests after four
_SETTLED = 0.01  # steps of the logarithms of the variances that count as rest
_PLACINGS = 3  # gauss-Newton steps of a place; it starts within millimetres
# Least variance of a ray's point, a millimetre: keeps exact sightings from dividing by zero.
_FLOOR_M2 = 1e-6
_PARTS = 6  # variances of place, bearing and depth: a ray's own, and what near images share


@dataclass(frozen=True)
class RayNoise:
    """Variances of errors, each alone and shared.

    Parameters
    ----------
    variances : (6,), of a camera's place (m2) and bearing (rad2), alone and shared by near images;
        of the logarithm of a depth, alone and shared by the rays of a pole.
    """

    variances: Floats

    def or_wider(self, other: RayNoise) -> RayNoise:
        """The larger of the variances of both."""
        return RayNoise(np.maximum(self.variances, other.variances))

    @property
    def position_m(self) -> float:
        """Of a camera's place, one axis."""
        return float(np.sqrt(self.variances[0:2].sum()))

    @property
    def bearing_rad(self) -> float:
        """Of a bearing whose sigma is not stated."""
        return float(np.sqrt(self.variances[2:4].sum()))

    @property
    def hidden_ratio(self) -> float:
        """Of the logarithm of a depth, shared by all rays of a pole, stated or not."""
        return float(np.sqrt(self.variances[5]))

    @property
    def depth_ratio(self) -> float:
        """Of the logarithm of a depth whose sigma is not stated."""
        return float(np.sqrt(self.variances[4:6].sum()))


class Misfits(NamedTuple):
    """Groups of one size k: how their rays' points lie about a place, and what that may come of.

    Parameters
    ----------
    rest_m : (g, 2 k), a ray's point less the place. parts : (6, g, 2 k, 2 k), covariance of each
    part for a unit of its variance. fixed : (g, 2 k, 2 k), covariance that is stated.
    """

    rest_m: Floats
    parts: Floats
    fixed: Floats

    def covariance(self, noise: RayNoise) -> Floats:
        """Of the points (g, 2 k, 2 k)."""
        return np.tensordot(noise.variances, self.parts, 1) + self.fixed


def stated_noise(settings: TriangulationSettings) -> RayNoise:
    """What the settings say, before any ray is seen."""
    stated = (
        settings.sigma_position_m,
        np.radians(settings.sigma_bearing_deg),
        settings.sigma_depth_ratio,
    )
    share = settings.shared_variance
    return RayNoise(np.kron(np.square(stated), [1.0 - share, share]).astype(np.float64))


def fit_noise(
    rays: Rays, groups: Sequence[Ints], places: Floats, settings: TriangulationSettings
) -> RayNoise:
    """Variances that explain best how rays of groups lie about their places (g, 2)."""
    prior = np.log(stated_noise(settings).variances)
    together = np.kron(np.diag(np.square(_LOOSE)), np.ones((2, 2)))
    tight = np.linalg.inv(together + _APART**2 * np.eye(_PARTS))
    blocks = [
        misfits(rays, members, places[at], settings) for at, members in _by_size(groups, least=2)
    ]
    log_variances = prior.copy()
    for _ in range(_ROUNDS):
        variances = np.exp(log_variances)
        slope, information = np.zeros(_PARTS), np.zeros((_PARTS, _PARTS))
        for block in blocks:
            more_slope, more_information = _restricted(block, RayNoise(variances))
            slope += more_slope
            information += more_information
        uphill = variances * slope - tight @ (log_variances - prior)
        curved = variances[:, None] * variances * information + tight
        step = np.clip(np.linalg.solve(curved, uphill), -1.0, 1.0)
        log_variances = log_variances + step
        if np.abs(step).max() < _SETTLED:
            break
    return RayNoise(np.exp(log_variances))


def _restricted(block: Misfits, noise: RayNoise) -> tuple[Floats, Floats]:
    """Slope (6,) and expected curvature (6, 6) of the restricted log likelihood."""
    design = _repeated(block.rest_m.shape[1] // 2)
    weights = np.linalg.inv(block.covariance(noise))
    seen = weights @ design
    # What is left of the weights once the place has taken its part.
    rest = weights - seen @ np.linalg.inv(design.T @ seen) @ seen.transpose(0, 2, 1)
    pull = np.einsum("gij,gj->gi", rest, block.rest_m)
    felt = rest[None] @ block.parts
    slope = np.einsum("gi,pgij,gj->p", pull, block.parts, pull) - np.einsum("pgii->p", felt)
    return 0.5 * slope, 0.5 * np.einsum("pgij,qgji->pq", felt, felt)


def place_groups(
    rays: Rays,
    groups: Sequence[Ints],
    places: Floats,
    noise: RayNoise,
    settings: TriangulationSettings,
) -> tuple[Floats, Floats]:
    """Places (g, 2) and covariances (g, 2, 2) of groups by generalised least squares.

    Parameters
    ----------
    places : first places, (g, 2).
    """
    placed = np.array(places, np.float64).reshape(-1, 2).copy()
    covariances = np.empty((len(groups), 2, 2))
    for at, members in _by_size(groups):
        design = _repeated(members.shape[1])
        for _ in range(_PLACINGS):
            block = misfits(rays, members, placed[at], settings, cautious=True)
            weights = np.linalg.inv(block.covariance(noise))
            covariance = np.linalg.inv(design.T @ weights @ design)
            pull = design.T @ (weights @ block.rest_m[:, :, None])
            placed[at] += (covariance @ pull)[:, :, 0]
        covariances[at] = covariance
    return placed, covariances


def _by_size(groups: Sequence[Ints], least: int = 1) -> list[tuple[Ints, Ints]]:
    """Numbers of the groups of each size, and their rays (g, k)."""
    sizes = np.array([len(members) for members in groups], np.int64)
    found = [np.flatnonzero(sizes == size) for size in np.unique(sizes[sizes >= least])]
    return [(at, np.stack([groups[number] for number in at.tolist()])) for at in found]


def _repeated(size: int) -> Floats:
    """Design (2 k, 2): every ray's point is the place."""
    return np.tile(np.eye(2), (size, 1))


def misfits(
    rays: Rays,
    members: Ints,
    places: Floats,
    settings: TriangulationSettings,
    cautious: bool = False,
) -> Misfits:
    """Misfits of groups of rays (g, k) about places (g, 2).

    Rays of unknown depth have their point beside the place, as uncertain along the ray as poles
    may be far.

    Parameters
    ----------
    cautious : an error of the bearing of a ray of unknown depth counts as at half the maximum
        distance at least, since the place at which the ray ends rests on other rays.
    """
    groups, size = members.shape
    camera = rays.camera_m[members]
    gap = places[:, None] - camera
    r = np.maximum(np.hypot(gap[..., 0], gap[..., 1]), 0.5)
    ahead = gap / r[..., None]
    side = np.stack([ahead[..., 1], -ahead[..., 0]], axis=-1)
    turn = np.radians(rays.bearing_deg[members]) - np.arctan2(gap[..., 0], gap[..., 1])
    turn -= 2 * np.pi * np.round(turn / (2 * np.pi))
    depth = rays.depth_m[members]
    known = np.isfinite(depth)
    depth = np.where(known, depth, r)
    rest_m = (turn * r)[..., None] * side + (np.log(depth / r) * r)[..., None] * ahead
    lever = np.where(known | (not cautious), r, np.maximum(r, 0.5 * settings.max_distance_m))
    across, along = lever[..., None] * side, r[..., None] * ahead

    turns, depths = rays.sigma_bearing_deg[members], rays.sigma_depth_m[members]
    anchored = rays.anchored[members]
    own_turn = np.where(anchored, np.nan_to_num(np.radians(turns)), np.radians(turns))
    ratio = np.where(anchored, np.nan_to_num(depths), depths) / depth
    free, bound = (~anchored).astype(np.float64), anchored.astype(np.float64)
    loose_turn = free * np.isnan(own_turn)
    loose_depth = free * np.isnan(ratio) * known
    stated_depth = np.where(known, np.nan_to_num(ratio), settings.max_distance_m / r)

    apart = np.hypot(*np.moveaxis(camera[:, :, None] - camera[:, None], -1, 0))
    heading, alone = np.exp(-apart / _HEADING_M), np.eye(size)
    share = settings.shared_variance
    axes = np.broadcast_to(np.eye(2), (groups, size, 2, 2))
    parts = [
        _spread(alone * _pairs(free), axes),
        _spread(np.exp(-apart / _DRIFT_M) * _pairs(free), axes),
        _spread(alone * _pairs(loose_turn), across),
        _spread(heading * _pairs(loose_turn), across),
        _spread(alone * _pairs(loose_depth), along),
        _spread(_pairs(free * known), along),
    ]
    # Images that follow each other stand and look amiss alike, and a drive has one lens. The rest
    # of a stated bearing is shared by the same share as others, a column by all rays that end at
    # it. What hides a foot adds to any depth.
    turn_sigma = np.nan_to_num(own_turn)
    turned = np.radians(rays.turned_deg[members])
    own = np.radians(rays.own_deg[members])
    rest = np.where(np.isnan(own), turn_sigma, own)
    fixed = _spread(((1 - share) * alone + share * heading) * _pairs(free * rest), across)
    fixed += _spread(alone * _pairs(free * stated_depth), along)
    drive = rays.route[members][:, :, None] == rays.route[members][:, None]
    near = drive * np.exp(-apart / _DRIFT_M) * _pairs(free)
    for number, alike in enumerate((drive * _pairs(free), drive * _pairs(free), near)):
        fixed += _spread(alike * _pairs(turned[..., number]), across)
    for way in (rays.drift_m[members], rays.aside_m[members]):
        # How alike, by sign: ahead on the way out is astern on the way back.
        length = np.hypot(way[..., 0], way[..., 1])[..., None]
        unit = np.divide(way, length, out=np.zeros_like(way), where=length > 0)
        fixed += _spread(near * (unit @ unit.swapaxes(1, 2)), way)
    # Of a bearing that image and column tell together, what the image tells is the ray's own.
    column = np.divide(turn_sigma, stated_depth, out=np.ones_like(r), where=stated_depth > 0)
    column = np.minimum(column, 1.0) ** 2
    own_turn = turn_sigma * np.sqrt(1.0 - column)
    fixed += _spread(alone * _pairs(bound * own_turn), across)
    towards = ahead[..., :, None] * ahead[..., None, :]
    sideways = column[..., None, None] * side[..., :, None] * side[..., None, :]
    column_m = (bound * stated_depth * r)[..., None, None] * (towards + sideways)
    fixed += np.einsum("giac,gjbc->giajb", column_m, column_m).reshape(fixed.shape)
    fixed += _FLOOR_M2 * np.eye(2 * size)
    return Misfits(rest_m.reshape(groups, -1), np.stack(parts), fixed)


def _pairs(factor: Floats) -> Floats:
    """Products (g, k, k) of a number of each ray (g, k)."""
    return factor[:, :, None] * factor[:, None]


def _spread(correlation: Floats, direction: Floats) -> Floats:
    """Covariance (g, 2 k, 2 k) of errors along the rays' directions (g, k, 2), or axes."""
    groups, size = correlation.shape[:2]
    if direction.ndim == 3:
        blocks = np.einsum("gij,gia,gjb->giajb", correlation, direction, direction)
    else:
        blocks = np.einsum("gij,giab->giajb", correlation, direction)
    return blocks.reshape(groups, 2 * size, 2 * size)
