"""A drive's camera from upright things alone: roll from how poles lean, the rest from landmarks.

Where road edges are broken by parked cars and side roads, poles still stand upright and trunks
and posts still stand where the cloud has them. No single image tells which axis is which column;
all images of a drive together do, for they share one camera.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.poles.alignment.landmarks import (
    POSE,
    LandmarkNoise,
    mapped_rows,
    measure,
    observed_rows,
    slopes,
)
from roadsight.poles.alignment.locate import own_variance
from roadsight.poles.alignment.pose import ALONG, FOCAL, LATERAL, ROLL, YAW, Spread
from roadsight.poles.alignment.solve import Task
from roadsight.poles.calibration.calibration import Loader, Mount, with_known

_LEAN_DEG = 1.5  # One standard deviation of a pole's own lean
_FEWEST_AXES = 20  # Axes that roll needs; with fewer, a few leaning trunks would decide
_LEAST_SIGMA_DEG = 0.3  # Standard deviation that this roll is given, however many axes there are
_FARTHEST_M = 50.0  # Columns beyond this are not paired: more of them lie near every ray
_CLUTTER = 0.5  # Share of the axes that are no column of the cloud
# Range of bearings, centred on an axis, in which its column is looked for and in which an axis
# without one may lie anywhere
_RANGE_RAD = np.radians(40.0)
# Width of a match, one standard deviation, when the search starts: it must bridge a step of the
# grid
_COARSE_RAD = np.radians(0.8)
_FINE_RAD = np.radians(0.25)  # The same in the last round: each image still sways about the mean
# Rounds in which the width shrinks from the coarse to the fine one, by the same factor each
_ROUNDS = 25
_IMAGES = 20  # Images that the coarse search looks at; its time grows with them
# Axes with a possible column before the search, and pairs believed after it, that are needed
_FEWEST_PAIRS = 30
_INDEPENDENT = 0.1  # Share of the pairs that tell something new
_FRONT = 0  # Number of the front view in `VIEWS`
_YAW_DEG = np.arange(-4.0, 4.1, 0.5)  # Yaws that the coarse search adds to the expected one
_PLACE_M = np.arange(-2.0, 2.1, 1.0)  # Places, along and across, that it adds
# Logarithms of the focal length that it adds: a tenth to either side
_FOCAL = np.array([-0.10, -0.05, 0.0, 0.05, 0.10])
_Pairs = tuple[Task, Floats, Floats, Ints, Floats]


def aimed(prior: Mount, loaders: Sequence[Loader], noise: LandmarkNoise, spread: Spread) -> Mount:
    """Prior of a drive after a look at its upright things; the same one if there are too few."""
    information = prior.expected(spread)
    tasks = [load(prior.mean, information) for load in loaders]
    return aimed_at_landmarks(level_roll(prior, tasks), tasks, noise)


def level_roll(prior: Mount, tasks: Sequence[Task]) -> Mount:
    """Mount whose roll is that at which the poles of all images together stand upright."""
    lean, across, sigma = [], [], []
    for task in tasks:
        if task.landmarks is None:
            continue
        axes = task.landmarks.axes
        front = axes.view == _FRONT
        bank_deg = np.degrees(np.arctan(task.start.bank))
        lean.append(-np.degrees(np.arctan(axes.slope[front])) - bank_deg)
        across.append(axes.middle_px[front, 0] / np.exp(prior.mean[FOCAL]))
        length = np.maximum(axes.foot_px[front] - axes.top_px[front], 1.0)
        sigma.append(np.hypot(_LEAN_DEG, np.degrees(1.0 / length)))
    if sum(map(len, lean)) < _FEWEST_AXES:
        return prior
    y, x, s = (np.concatenate(part) for part in (lean, across, sigma))
    terms = np.column_stack([np.ones_like(x), x])
    weight = 1.0 / s**2
    for _ in range(20):
        normal = terms.T @ (weight[:, None] * terms)
        roll, tilt = np.linalg.solve(normal, terms.T @ (weight * y))
        off = (y - roll - tilt * x) / s
        weight = 1.0 / (s * (1.0 + (off / 2.0) ** 2)) ** 2
    return with_known(prior, ROLL, roll, _LEAST_SIGMA_DEG)


def aimed_at_landmarks(prior: Mount, tasks: Sequence[Task], noise: LandmarkNoise) -> Mount:
    """Mount at which the axes of all images together point at the cloud's columns.

    A coarse search over yaw, place and focal length, then expectation and maximisation: every axis
    belongs to each column as far as their bearings agree, or to none. The same mount if too few
    pairs agree.
    """
    pairs = [_pairs(task, prior, noise) for task in tasks]
    pairs = [part for part in pairs if len(part[3])]
    if sum(len(np.unique(part[3])) for part in pairs) < _FEWEST_PAIRS:
        return prior
    mean = _coarse(prior, pairs)
    known = np.linalg.inv(prior.covariance)
    for number in range(_ROUNDS):
        share = number / (_ROUNDS - 1)
        width = _COARSE_RAD * (_FINE_RAD / _COARSE_RAD) ** share
        normal, gradient, count = known.copy(), known @ (mean - prior.mean), 0.0
        for part in pairs:
            own = _expected(part, mean, width)
            normal[:POSE, :POSE] += own[0]
            gradient[:POSE] += own[1]
            count += own[2]
        mean = mean - np.linalg.solve(normal, gradient)
    if count < _FEWEST_PAIRS:
        return prior
    # Images a metre apart see the same columns with the same errors.
    information = known + _INDEPENDENT * (normal - known)
    covariance = np.linalg.inv(information)
    return Mount(mean, 0.5 * (covariance + covariance.T), prior.images)


def _pairs(task: Task, prior: Mount, noise: LandmarkNoise) -> _Pairs:
    """Every axis of the front view with every column that it might be."""
    nothing = task, np.empty((0, 7)), np.empty((0, 4)), np.empty(0, np.int64), np.empty(0)
    if task.landmarks is None:
        return nothing
    axes, columns = task.landmarks.axes, task.landmarks.columns
    own = np.flatnonzero(axes.view == _FRONT)
    axis = np.repeat(own, len(columns.top_m))
    column = np.tile(np.arange(len(columns.top_m)), len(own))
    seen = observed_rows(axes)[axis]
    there = mapped_rows(columns, task.origin_m)[column]
    rows = measure(prior.mean, task.scene[0], seen, there)
    near = (rows[:, 3] >= noise.nearest_m) & (rows[:, 3] <= _FARTHEST_M)
    near &= np.abs(rows[:, 0]) < 0.5 * _RANGE_RAD
    sigma_m, sigma_px = columns.sigma_m[column], axes.sigma_px[axis]
    variance = own_variance(sigma_px, sigma_m, rows)
    return (
        task,
        np.ascontiguousarray(seen[near]),
        np.ascontiguousarray(there[near]),
        axis[near],
        variance[near],
    )


def _coarse(prior: Mount, pairs: Sequence[_Pairs]) -> Floats:
    """Best trial on the grid, on some of the images."""
    number = np.unique(np.linspace(0, len(pairs) - 1, min(_IMAGES, len(pairs))).round())
    few = [pairs[int(k)] for k in number]
    grid = np.meshgrid(_YAW_DEG, _PLACE_M, _PLACE_M, _FOCAL, indexing="ij")
    moves = np.stack([part.ravel() for part in grid], axis=1)
    trials = np.repeat(prior.mean[None], len(moves), axis=0)
    trials[:, [YAW, LATERAL, ALONG, FOCAL]] += moves
    sigma = np.sqrt(np.diag(prior.covariance))
    score = -0.5 * (((trials - prior.mean) / sigma) ** 2).sum(axis=1)
    for k, trial in enumerate(trials):
        likelihood = 0.0
        for part in few:
            axis = part[3]
            density = _density(part, trial, part[4] + _COARSE_RAD**2)
            total = np.bincount(axis, density)[np.unique(axis)]
            likelihood += float(np.log(_CLUTTER / _RANGE_RAD + (1.0 - _CLUTTER) * total).sum())
        score[k] += _INDEPENDENT * likelihood
    return np.asarray(trials[int(np.argmax(score))], np.float64)


def _density(pairs: _Pairs, unknowns: Floats, variance: Floats) -> Floats:
    """Normal density (k,) of the gap between the bearings of each pair."""
    task, seen, there, _, _ = pairs
    gap = measure(unknowns, task.scene[0], seen, there)[:, 0]
    return np.asarray(np.exp(-0.5 * gap**2 / variance) / np.sqrt(2 * np.pi * variance), np.float64)


def _expected(pairs: _Pairs, unknowns: Floats, width: float) -> tuple[Floats, Floats, float]:
    """Normal matrix and gradient of one image, each pair as far as it is believed; their number."""
    task, seen, there, axis, own = pairs
    slope = slopes(unknowns, task.scene[0], seen, there)[:, 0, :POSE]
    variance = own + width**2
    density = _density(pairs, unknowns, variance)
    total = np.bincount(axis, density)[axis]
    belief = (1 - _CLUTTER) * density / (_CLUTTER / _RANGE_RAD + (1 - _CLUTTER) * total)
    gap = measure(unknowns, task.scene[0], seen, there)[:, 0]
    weight = belief / variance
    normal = slope.T @ (weight[:, None] * slope)
    return normal, slope.T @ (weight * gap), float(belief.sum())
