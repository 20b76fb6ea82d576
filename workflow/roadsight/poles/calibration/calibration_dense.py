"""Mount of a drive with a known lens, from photographs and cloud (`alignment.dense`).

A common yaw, pitch, roll and height is sought that fits some of the images best, coarsely. Then the
drive's mean and the images' own small deviations from it are found together: those of an image are
taken out of its linearised misfit exactly, and what is left adds up over the images. At last each
image is searched by itself about that mean, and the median of those that stand out is the mount.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.poles.alignment.dense import (
    SIZE,
    DenseTask,
    Samples,
    align_dense,
    common_sigma,
    evaluate,
    gather,
    moved,
)
from roadsight.poles.alignment.pose import FOCAL, Spread
from roadsight.poles.alignment.verdict import LEAST_LEAD
from roadsight.poles.calibration.calibration import Mount, with_known

# Makes the task of one image from expected unknowns (6,) and their covariance (6, 6)
DenseLoader = Callable[[Floats, Floats], DenseTask]
# Images that tell the mount: what it is known by is their own sway, over the root of 12
IMAGES = 12
# What changes from image to image: the road's bank is left to the roll
SPREAD = Spread(roll_deg=0.7)
# Yaw, pitch and roll that are tried: a blur of 16 px is 1.3 degrees at 720 px
_AIMS_DEG = (np.arange(-4.0, 4.1, 1.0), np.arange(-4.0, 4.1, 1.0), np.arange(-4.0, 4.1, 2.0))
_AIMS_M = (-0.6, 0.0, 0.6)  # Heights that are tried, from that of a van's roof: 1.6 m is a car
_COARSE_PX = 16.0  # Blur of that search
# Blurs of the joint rounds; before each the images see the cloud anew
_PLAN_PX = (8.0, 4.0, 4.0, 2.0, 2.0)
_STEPS = 8  # Steps of a round at most
_GAIN = 0.5  # Log-likelihood that a step must gain to be followed by another
FEWEST = 3  # Images below which a drive has no mount of its own


def calibrate_dense(
    loaders: Sequence[DenseLoader], prior: Mount, spread: Spread
) -> tuple[Mount, list[Floats]]:
    """Mount of a drive and the unknowns (6,) of each image.

    Parameters
    ----------
    loaders : one for each image. prior : what is known beforehand; its lens is kept as it is.

    Raises
    ------
    InputError : fewer than three images.
    """
    if len(loaders) < FEWEST:
        raise InputError(
            "too few images of the drive to find how its camera is mounted",
            where="camera calibration",
            found=len(loaders),
            allowed=f"at least {FEWEST}",
        )
    expected, variance = prior.mean[:SIZE], np.diag(prior.covariance)[:SIZE]
    own = spread.vector()[:SIZE]
    tasks = [load(expected, np.diag(variance + own**2)) for load in loaders]
    start = _aimed(tasks, np.diag(1.0 / variance))
    mean, covariance, images = _joint(tasks, start, np.diag(1.0 / variance), np.diag(1.0 / own**2))
    mean, covariance = _confirmed(tasks, mean, covariance, own)
    covariance = covariance + np.diag(common_sigma(tasks[0].lens) ** 2)
    found = prior.mean.copy()
    found[:SIZE] = expected + mean
    full = prior.covariance.copy()
    full[:SIZE, :], full[:, :SIZE] = 0.0, 0.0
    full[:SIZE, :SIZE] = covariance
    return Mount(found, full, len(tasks)), [expected + one for one in images]


def with_lens(prior: Mount, focal_px: float, sigma_log: float) -> Mount:
    """The same mount with a known focal length."""
    return with_known(prior, FOCAL, np.log(focal_px), sigma_log)


def _aimed(tasks: Sequence[DenseTask], information: Floats) -> Floats:
    """Offsets (6,) of a turn and a height that fit all images best, coarsely."""
    best_cost, best = np.inf, np.zeros(SIZE)
    for up in _AIMS_M:
        height = np.array([0.0, 0.0, up, 0.0, 0.0, 0.0])
        seen = [gather(task, height).thinned(6) for task in tasks]
        for turn in product(*_AIMS_DEG):
            offsets = height + np.array([0.0, 0.0, 0.0, *turn])
            cost = 0.5 * float(offsets @ information @ offsets)
            for task, samples in zip(tasks, seen, strict=True):
                cost -= evaluate(task, samples, _COARSE_PX, offsets, False)[0]
            if cost < best_cost:
                best_cost, best = cost, offsets
    return best


def _joint(
    tasks: Sequence[DenseTask], start: Floats, known: Floats, pull: Floats
) -> tuple[Floats, Floats, Floats]:
    """Mean (6,) of the offsets, its covariance (6, 6), and each image's offsets (n, 6).

    Parameters
    ----------
    known : inverse covariance (6, 6) of the mean beforehand. pull : of an image about the mean.
    """

    def cost(blur_px: float, seen: Sequence[Samples], mean: Floats, images: Floats) -> float:
        found = 0.5 * float(mean @ known @ mean)
        for task, samples, own in zip(tasks, seen, images, strict=True):
            apart = own - mean
            gain = evaluate(task, samples, blur_px, own, False)[0]
            found += 0.5 * float(apart @ pull @ apart) - gain
        return found

    mean, images = start.copy(), np.repeat(start[None], len(tasks), axis=0)
    total = known
    for blur_px in _PLAN_PX:
        seen = [gather(task, own) for task, own in zip(tasks, images, strict=True)]
        for _ in range(_STEPS):
            parts = [
                evaluate(task, samples, blur_px, own)
                for task, samples, own in zip(tasks, seen, images, strict=True)
            ]
            total, right = known.copy(), np.zeros(SIZE)
            for (_, slope, normal), own in zip(parts, images, strict=True):
                left = pull @ np.linalg.inv(normal + pull)
                total += pull - left @ pull
                right += left @ (normal @ own + slope)
            new = np.linalg.solve(total, right)
            turned = np.array(
                [
                    np.linalg.solve(normal + pull, normal @ own + slope + pull @ new)
                    for (_, slope, normal), own in zip(parts, images, strict=True)
                ]
            )
            before = cost(blur_px, seen, mean, images)
            length, after = 1.0, np.inf
            while length > 0.05:
                trial = mean + length * (new - mean), images + length * (turned - images)
                after = cost(blur_px, seen, *trial)
                if after < before:
                    mean, images = trial
                    break
                length *= 0.5
            if before - after < _GAIN:
                break
    return mean, np.asarray(np.linalg.inv(total), np.float64), images


def _confirmed(
    tasks: Sequence[DenseTask], mean: Floats, covariance: Floats, own: Floats
) -> tuple[Floats, Floats]:
    """Mean (6,) and covariance (6, 6) from the images' own searches; as they were without any.

    The joint rounds only descend: on a real street they ended 1.2 m behind where all images found
    themselves.

    Parameters
    ----------
    own : standard deviation (6,) of what changes from image to image.
    """
    found = []
    for task in tasks:
        about = replace(task, pose=moved(task.pose, mean), covariance=np.diag(own**2))
        fit = align_dense(about)
        if fit.lead >= LEAST_LEAD:
            found.append(mean + fit.offsets)
    if len(found) < FEWEST:
        return mean, covariance
    offsets = np.array(found)
    middle = np.median(offsets, axis=0)
    scatter = 1.4826 * np.median(np.abs(offsets - middle), axis=0)
    # Of a median, in place of a mean; few images scatter less than they should by chance.
    sigma = 1.2533 * np.maximum(scatter, 0.5 * own) / np.sqrt(len(found))
    return middle, np.diag(sigma**2)
