"""Lens and mount of a drive from what its images measured and what they share, in one solution.

Road edges and a few columns tell the focal length of a drive to a hundredth at best. Where the
road bends, neighbouring images share a hundred points that turn with it: their turns, in pixels,
add up to the bend, which the track knows in degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.poles.alignment.chain import Normal, eliminated, solve_bordered
from roadsight.poles.alignment.drift import MARK_OVERLAP, OVERLAP, DriftModel
from roadsight.poles.alignment.epipolar import POSED
from roadsight.poles.alignment.pose import CX, FOCAL, SIZE, Spread
from roadsight.poles.alignment.solve import Fit
from roadsight.poles.alignment.ties import (
    HELD,
    SCALES,
    Member,
    drifting,
    first_place,
    shared_points,
    swaying,
)
from roadsight.poles.calibration.calibration import Mount

_SOFT = 4.0 * SIZE
"""Squared distance of an image from what all say, in standard deviations, at which it counts a
quarter: four times what is usual for so many unknowns."""
_FLAT = 1e-9
"""Directions of an image's misfit this much flatter than the steepest tell nothing."""

_LENS = np.array([FOCAL, CX])
"""Unknowns of the lens, which all images have in common."""


@dataclass(frozen=True)
class Tied:
    """One image of a drive, the points that it shares with the next one, and its own fit if any."""

    member: Member
    fit: Fit | None


def mount_together(
    images: Sequence[Tied],
    prior: Mount,
    spread: Spread,
    model: DriftModel,
    scales: Sequence[float] = SCALES,
) -> Mount:
    """Mean unknowns of a drive under all that its images measured and share.

    Gauss-Newton over the poses of all images and the drive's mean: the images' linearised misfits,
    how a vehicle sways about the mean, how the error of the track changes, and shared points.
    Images that the others contradict count less.

    Parameters
    ----------
    images : in the order of travel. prior : what is known of the mean beforehand.
    scales : of the rounds, in standard deviations of a shared point.
    """
    data = [None if one.fit is None else measured(one.fit, spread) for one in images]
    members = [one.member for one in images]
    now = np.array([member.unknowns for member in members])
    mean = prior.mean.copy()
    known = np.asarray(np.linalg.inv(prior.covariance), np.float64)
    weights = np.ones(len(images))
    held = Normal(np.zeros((POSED + SIZE, POSED + SIZE)), np.zeros(POSED + SIZE))
    held.matrix[:POSED, :POSED] = HELD.matrix
    covariance = prior.covariance
    for scale in scales:
        now[:, _LENS] = mean[_LENS]
        own = [_own(*pair, mean) for pair in zip(now, data, strict=True)]
        counted = [
            _beside_mean(swaying(x, mean, spread)) + o.times(w)
            for x, o, w in zip(now, own, weights, strict=True)
        ]
        counted[0] = counted[0] + _beside_mean(first_place(members[0], now[0], mean, model))
        links = [
            _beside_mean(drifting(*pair, at, mean, model))
            + _with_lens(shared_points(pair, at, scale))
            for pair, at in zip(pairwise(members), pairwise(now), strict=True)
        ]
        if scale > scales[-1]:
            counted = [one + held for one in counted]
        border = Normal(known, known @ (prior.mean - mean))
        steps, step, covariance = solve_bordered(counted, links, border)
        now[:, :POSED] += steps
        mean = mean + step
        off = [_misfit(o, np.r_[s, step]) for o, s in zip(own, steps, strict=True)]
        weights = (1.0 / (1.0 + np.array(off) / _SOFT)) ** 2
    return Mount(mean, covariance, sum(one is not None for one in data))


def measured(fit: Fit, spread: Spread) -> Normal:
    """What an image measured of its pose and of the drive's other mean unknowns, (14, 14).

    Its own other unknowns, which lie about these, are taken out.
    """
    normal, gradient = fit.taught(OVERLAP, MARK_OVERLAP)
    rest = SIZE - POSED
    pull = np.diag(spread.vector()[POSED:] ** -2.0)
    order = np.r_[POSED:SIZE, :POSED]
    matrix, right = np.zeros((SIZE + rest, SIZE + rest)), np.zeros(SIZE + rest)
    matrix[:SIZE, :SIZE] = normal[np.ix_(order, order)]
    right[:SIZE] = (normal @ fit.unknowns - gradient)[order]
    matrix[:rest, :rest] += pull
    matrix[:rest, SIZE:] = matrix[SIZE:, :rest] = -pull
    matrix[SIZE:, SIZE:] = pull
    return eliminated(Normal(matrix, right), rest)[0]


def _own(at: Floats, data: Normal | None, mean: Floats) -> Normal:
    """What an image measured, of steps of its pose and of the mean."""
    whole = Normal(np.zeros((POSED + SIZE, POSED + SIZE)), np.zeros(POSED + SIZE))
    if data is None:
        return whole
    place = np.r_[:POSED, POSED + POSED : POSED + SIZE]
    right = data.right - data.matrix @ np.r_[at[:POSED], mean[POSED:]]
    whole.matrix[np.ix_(place, place)] = data.matrix
    whole.right[place] = right
    return whole


def _beside_mean(one: Normal) -> Normal:
    """Misfit of poses about the mean's pose, of steps of both."""
    size = len(one.right)
    apart = np.zeros((size, size + SIZE))
    apart[:, :size] = np.eye(size)
    apart[:, size : size + POSED] = -np.tile(np.eye(POSED), (size // POSED, 1))
    return Normal(apart.T @ one.matrix @ apart, apart.T @ one.right)


def _with_lens(points: Normal) -> Normal:
    """Misfit of shared points, of steps of both poses and of the mean, whose lens both have."""
    size = 2 * POSED + SIZE
    place = np.r_[: 2 * POSED, 2 * POSED + _LENS]
    matrix, right = np.zeros((size, size)), np.zeros(size)
    matrix[np.ix_(place, place)] = points.matrix
    right[place] = points.right
    return Normal(matrix, right)


def _misfit(own: Normal, step: Floats) -> float:
    """Squared distance of a step from what an image measured, in its standard deviations."""
    gap = own.right - own.matrix @ step
    return float(gap @ np.linalg.pinv(own.matrix, rcond=_FLAT, hermitian=True) @ gap)
