"""The pose of one image from road edges and landmarks together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.poles.alignment.association import Hypothesis, associate, match_landmarks
from roadsight.poles.alignment.landmarks import VIEWS, LandmarkNoise, Turns
from roadsight.poles.alignment.search import search
from roadsight.poles.alignment.solve import FINEST, Fit, Task, descend

_ROUNDS = 3
"""Rounds of pairing and descent at most, should pairs go to and fro."""
_STARTS = 2
"""Minima of the road edges that landmarks are tried on."""
_FAR_WORSE = 15.0
"""A minimum that costs so much more than the best (log-likelihood) is not tried. An axis without a
column costs 4.5, so more than three landmarks would have to speak for it alone."""
_FEW = 20
"""Fewer pixels than this do not tell how well edges fit."""
_MOST_TRUST = 4.0
"""Edges count up to so many times more or less, which a scatter of half or twice the expected one
gives: a few pixels that fit by chance must not outweigh everything else."""
_MEDIAN_OF_NORMAL = 0.6745
"""Median of the absolute value of a standard normal variable."""
_UNEXPLAINED = 0.5 * FINEST**2
"""Cost of an axis without a column: that of a landmark that is infinitely far off."""


def locate(
    task: Task, noise: LandmarkNoise | None = None, start: Floats | None = None
) -> list[Fit]:
    """Minima, the best first; with landmarks where the image has any.

    The road edges alone lead to one or a few poses; from each the landmarks are associated, the
    pose is improved with them, and both again until nothing changes. Views whose yaw the
    expectation leaves open are not used.

    Parameters
    ----------
    start : unknowns (k,) that are known to be near; else they are searched for.
    """
    fits = search(task) if start is None else [descend(task, start, FINEST)]
    task = weighed(task, fits[0])
    fits = [descend(task, fit.unknowns, FINEST) for fit in fits]
    noise = noise or LandmarkNoise()
    if not _sees(task):
        return fits
    found: list[Fit] = []
    for fit in fits[:_STARTS]:
        if fit.cost - fits[0].cost > _FAR_WORSE:
            break
        for one in _hypotheses(task, fit, noise, 2):
            improved = _improved(task, one, noise)
            if all(not _same(improved, other) for other in found):
                found.append(improved)
    return sorted(found, key=lambda fit: fit.cost)


def _sees(task: Task) -> bool:
    """Whether any axis is in a view whose yaw is known."""
    if task.landmarks is None:
        return False
    covariance = np.asarray(np.linalg.inv(task.prior_information), np.float64)
    turns = Turns.of(task.prior_mean, covariance)
    return bool(turns.known(task.landmarks.axes.view).any())


def weighed(task: Task, fit: Fit) -> Task:
    """The same image with its edges trusted as far as they fit: masks are not all equally sharp.

    Lanes and borders by themselves: where one is blurred, the other need not be.
    """
    middle = task.image_edges.groups[2]
    parts = fit.residuals[:middle, 1], fit.residuals[middle:, 1]
    left, right = (_trust(part[part < FINEST]) for part in parts)
    return replace(task, noise=replace(task.noise, weight=(left, right)))


def _trust(off: Floats) -> float:
    """How much pixels count that are this far off, in standard deviations."""
    if len(off) < _FEW:
        return 1.0
    scatter = max(float(np.median(off)) / _MEDIAN_OF_NORMAL, 1e-3)
    return float(np.clip(scatter**-2, 1.0 / _MOST_TRUST, _MOST_TRUST))


def _hypotheses(task: Task, fit: Fit, noise: LandmarkNoise, count: int) -> list[Hypothesis]:
    assert task.landmarks is not None
    scene, pose = (task.scene[0], task.origin_m), (fit.unknowns, fit.covariance)
    return associate(task.landmarks, noise, scene, pose, count)


def _improved(task: Task, one: Hypothesis, noise: LandmarkNoise) -> Fit:
    """Minimum with the landmarks of a hypothesis, and of the hypotheses that follow from it."""
    assert task.landmarks is not None
    scene = task.scene[0], task.origin_m
    for number in range(_ROUNDS):
        matched = match_landmarks(one.columns, task.landmarks, scene, one.unknowns)
        told = task.with_matched(matched if len(matched.pairs) else None)
        fit = descend(told, one.unknowns, FINEST)
        if number == _ROUNDS - 1:
            break
        # The pose without the landmarks' own say would gate too widely, with it too narrowly:
        # what was paired stays in the gate of its own fit, and more may come in.
        again = _hypotheses(task, fit, noise, 1)[0]
        if np.array_equal(again.columns, one.columns):
            break
        one = replace(again, unknowns=fit.unknowns)
    left = len(one.columns) - len(matched.pairs)
    return replace(fit, cost=fit.cost + _UNEXPLAINED * left)


def without_view(task: Task, fit: Fit, view: str) -> Fit:
    """The minimum that is left without the landmarks of one view."""
    if fit.matched is None or task.landmarks is None:
        return fit
    kept = task.landmarks.axes.view[fit.matched.pairs[:, 0]] != VIEWS.index(view)
    if kept.all():
        return fit
    matched = fit.matched.part(kept) if kept.any() else None
    return descend(task.with_matched(matched), fit.unknowns, FINEST)


def _same(one: Fit, other: Fit) -> bool:
    gap = np.abs(one.unknowns - other.unknowns) / np.sqrt(np.diag(other.covariance))
    return bool(gap.max() < 0.1)
