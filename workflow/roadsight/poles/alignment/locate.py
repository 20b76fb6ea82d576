"""The pose of one image from road edges and landmarks together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roadsight.poles.alignment.association import Hypothesis, associate, marks_of
from roadsight.poles.alignment.landmarks import VIEWS, LandmarkNoise, Turns
from roadsight.poles.alignment.solve import FINEST, Fit, Task, descend, search

_ROUNDS = 3
_STARTS = 2
_FAR_WORSE = 15.0
_FEW, _MOST_TRUST, _MEDIAN_OF_NORMAL = 20, 4.0, 0.6745
_UNEXPLAINED = 0.5 * FINEST**2
"""Cost of an axis without a column: that of a landmark that is infinitely far off."""


def locate(task: Task, turns: Turns | None = None, noise: LandmarkNoise | None = None) -> list[Fit]:
    """Minima, the best first; with landmarks where the image has any.

    The road edges alone lead to one or a few poses; from each the landmarks are associated, the
    pose is improved with them, and both again until nothing changes.

    Parameters
    ----------
    turns : yaw of the side views; without it only the front view's landmarks are used.
    """
    fits = search(task)
    task = weighed(task, fits[0])
    fits = [descend(task, fit.unknowns, FINEST) for fit in fits]
    turns, noise = turns or Turns(), noise or LandmarkNoise()
    if task.sight is None or not np.isfinite(turns.of(task.sight.axes.view)[1]).any():
        return fits
    found: list[Fit] = []
    for fit in fits[:_STARTS]:
        if fit.cost - fits[0].cost > _FAR_WORSE:
            break
        for one in _hypotheses(task, fit, turns, noise, 2):
            improved = _improved(task, one, turns, noise)
            if all(not _same(improved, other) for other in found):
                found.append(improved)
    return sorted(found, key=lambda fit: fit.cost)


def weighed(task: Task, fit: Fit) -> Task:
    """The same image with its edges trusted as far as they fit: masks are not all equally sharp."""
    off = fit.residuals[:, 1]
    off = off[off < FINEST]
    if len(off) < _FEW:
        return task
    scatter = max(float(np.median(off)) / _MEDIAN_OF_NORMAL, 1e-3)
    share = float(np.clip(scatter**-2, 1.0 / _MOST_TRUST, _MOST_TRUST))
    return replace(task, noise=replace(task.noise, independent=share * task.noise.independent))


def _hypotheses(
    task: Task, fit: Fit, turns: Turns, noise: LandmarkNoise, count: int
) -> list[Hypothesis]:
    assert task.sight is not None
    scene, pose = (task.scene[0], task.origin_m), (fit.unknowns, fit.covariance)
    return associate(task.sight, turns, noise, scene, pose, count)


def _improved(task: Task, one: Hypothesis, turns: Turns, noise: LandmarkNoise) -> Fit:
    """Minimum with the landmarks of a hypothesis, and of the hypotheses that follow from it."""
    assert task.sight is not None
    scene = task.scene[0], task.origin_m
    for number in range(_ROUNDS):
        marks = marks_of(one.columns, task.sight, turns, scene, one.unknowns)
        fit = descend(task.with_marks(marks if len(marks.pairs) else None), one.unknowns, FINEST)
        if number == _ROUNDS - 1:
            break
        # The pose without the landmarks' own say would gate too widely, with it too narrowly:
        # what was paired stays in the gate of its own fit, and more may come in.
        again = _hypotheses(task, fit, turns, noise, 1)[0]
        if np.array_equal(again.columns, one.columns):
            break
        one = replace(again, unknowns=fit.unknowns)
    left = len(one.columns) - len(marks.pairs)
    return replace(fit, cost=fit.cost + _UNEXPLAINED * left)


def without_view(task: Task, fit: Fit, view: str) -> Fit:
    """The same minimum, as it were without the landmarks of one view."""
    if fit.marks is None or task.sight is None:
        return fit
    kept = task.sight.axes.view[fit.marks.pairs[:, 0]] != VIEWS.index(view)
    if kept.all():
        return fit
    marks = fit.marks.part(kept) if kept.any() else None
    return descend(task.with_marks(marks), fit.unknowns, FINEST)


def _same(one: Fit, other: Fit) -> bool:
    gap = np.abs(one.unknowns - other.unknowns) / np.sqrt(np.diag(other.covariance))
    return bool(gap.max() < 0.1)
