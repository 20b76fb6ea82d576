"""The pose of one image from road edges and landmarks together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.poles.alignment.landmarks import (
    LandmarkNoise,
    Landmarks,
    MatchedLandmarks,
    Turns,
    mapped_rows,
    measure,
    observed_rows,
    slopes,
)
from roadsight.poles.alignment.solve import FINEST, MEDIAN_OF_NORMAL, Fit, Task, descend, search
from roadsight.poles.images.views import VIEWS

_ROUNDS = 3  # Rounds of pairing and descent at most, should pairs go to and fro
_STARTS = 2  # Minima of the road edges that landmarks are tried on
# A minimum that costs so much more than the best (log-likelihood) is not tried. An axis without a
# column costs 4.5, so more than three landmarks would have to speak for it alone.
_FAR_WORSE = 15.0
_FEW = 20  # Fewer pixels than this do not tell how well edges fit
# Edges count up to so many times more or less, which a scatter of half or twice the expected one
# gives: a few pixels that fit by chance must not outweigh everything else
_MOST_TRUST = 4.0
# Cost of an axis without a column: that of a landmark that is infinitely far off
_UNEXPLAINED = 0.5 * FINEST**2


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
    if task.landmarks is None:
        return fits
    covariance = np.asarray(np.linalg.inv(task.prior_information), np.float64)
    turns = Turns.of(task.prior_mean, covariance)
    if not turns.known(task.landmarks.axes.view).any():
        return fits
    found: list[Fit] = []
    for fit in fits[:_STARTS]:
        if fit.cost - fits[0].cost > _FAR_WORSE:
            break
        for one in _hypotheses(task, fit, noise, 2):
            new = _improved(task, one, noise)
            gaps = (
                np.abs(new.unknowns - other.unknowns) / np.sqrt(np.diag(other.covariance))
                for other in found
            )
            if not any(gap.max() < 0.1 for gap in gaps):
                found.append(new)
    return sorted(found, key=lambda fit: fit.cost)


def weighed(task: Task, fit: Fit) -> Task:
    """The same image with its edges trusted as far as they fit: masks are not all equally sharp.

    Lanes and borders by themselves: where one is blurred, the other need not be.
    """
    middle = task.image_edges.groups[2]
    trust = [1.0, 1.0]
    for number, off in enumerate((fit.residuals[:middle, 1], fit.residuals[middle:, 1])):
        near = off[off < FINEST]
        if len(near) >= _FEW:
            scatter = max(float(np.median(near)) / MEDIAN_OF_NORMAL, 1e-3)
            trust[number] = float(np.clip(scatter**-2, 1.0 / _MOST_TRUST, _MOST_TRUST))
    return replace(task, noise=replace(task.noise, weight=(trust[0], trust[1])))


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


# Which pole axis in the image is which column of the cloud.
# Every axis may be one of the columns in its gate or none. Hypotheses are grown axis by axis,
# each with the pose that its pairs imply (Kalman updates of the linearised bearings); the
# likeliest few survive. Truth is never asked; two hypotheses that are about as likely stay two
# minima, and the verdict says that the pose is ambiguous.

# Standard deviations by which an axis and a column may differ: a narrower gate loses true pairs, a
# wider one makes more hypotheses
_GATE = 4.0
# Hypotheses that are followed up: with fewer, the true one may drop out while others look as good;
# time grows with them
_BEAM = 12
_LOST_TOP = 0.4  # Share of a pole's length that a mask may lose at its thin upper end


@dataclass(frozen=True)
class Hypothesis:
    """Pairs of axis and column, and the pose that they imply.

    Attributes
    ----------
    columns : (n,) column of each axis, -1 for none. unknowns : (k,). covariance : (k, k).
    cost : minus its log-likelihood.
    """

    columns: Ints
    unknowns: Floats
    covariance: Floats
    cost: float


@dataclass(frozen=True)
class _Pairs:
    """Admissible pairs: numbers of axis and column, gap, slopes (n, k) and own variance."""

    axis: Ints
    column: Ints
    gap: Floats
    slope: Floats
    variance: Floats
    extra: Floats


def associate(
    landmarks: Landmarks,
    noise: LandmarkNoise,
    scene: tuple[Floats, Floats],
    pose: tuple[Floats, Floats],
    count: int = 2,
) -> list[Hypothesis]:
    """Likeliest hypotheses, the best first.

    Parameters
    ----------
    scene : `Start.vector` and its origin (3,). pose : unknowns (k,) and their covariance (k, k).
    count : how many at most.
    """
    pairs = admissible(landmarks, noise, scene, pose)
    empty = np.full(len(landmarks.axes), -1, np.int64)
    beam = [Hypothesis(empty, pose[0], pose[1], 0.0)]
    candidates = np.bincount(pairs.axis, minlength=len(empty))
    for axis in np.argsort(candidates, kind="stable"):
        own = np.flatnonzero(pairs.axis == axis)
        if not len(own):
            continue
        grown = [replace(one, cost=one.cost + noise.clutter) for one in beam]
        for one in beam:
            more = (_with(one, pairs, int(k), pose[0], landmarks) for k in own)
            grown += [hypothesis for hypothesis in more if hypothesis is not None]
        grown.sort(key=lambda one: (one.cost, one.columns.tolist()))
        beam = grown[:_BEAM]
    return beam[:count]


def _with(
    one: Hypothesis, pairs: _Pairs, k: int, at: Floats, landmarks: Landmarks
) -> Hypothesis | None:
    """Hypothesis with one more pair; None if the pair is too far off or the column is taken."""
    axis, column = pairs.axis[k], pairs.column[k]
    same_view = landmarks.axes.view == landmarks.axes.view[axis]
    if (one.columns[same_view] == column).any():
        return None
    slope = pairs.slope[k]
    gap = pairs.gap[k] + slope @ (one.unknowns - at)
    spread = one.covariance @ slope
    variance = slope @ spread + pairs.variance[k]
    if gap * gap > _GATE**2 * variance:
        return None
    gain = spread / variance
    columns = one.columns.copy()
    columns[axis] = column
    cost = 0.5 * gap * gap / variance + 0.5 * np.log(variance / pairs.variance[k])
    return Hypothesis(
        columns,
        one.unknowns - gain * gap,
        one.covariance - np.outer(gain, spread),
        one.cost + float(cost + pairs.extra[k]),
    )


def admissible(
    landmarks: Landmarks,
    noise: LandmarkNoise,
    scene: tuple[Floats, Floats],
    pose: tuple[Floats, Floats],
) -> _Pairs:
    """Pairs whose bearings, feet and tops agree within what the pose leaves open.

    Views whose yaw is not known yet have none.
    """
    axes, columns = landmarks.axes, landmarks.columns
    turns = Turns.of(*pose)
    usable = np.flatnonzero(turns.known(axes.view))
    axis = np.repeat(usable, len(columns.top_m))
    column = np.tile(np.arange(len(columns.top_m)), len(usable))
    observed, mapped = observed_rows(axes)[axis], mapped_rows(columns, scene[1])[column]
    rows = measure(pose[0], scene[0], observed, mapped)
    # Most columns are out of sight by far: slopes are for the rest.
    sides = max(sigma for sigma in turns.sigma_deg if np.isfinite(sigma))
    loose = 0.05 + _GATE * np.radians(np.sqrt(pose[1][3, 3]) + sides)
    loose += _GATE * np.sqrt(pose[1][0, 0] + pose[1][1, 1]) / rows[:, 3]
    near = (rows[:, 3] >= noise.nearest_m) & (rows[:, 3] <= noise.farthest_m)
    near &= (np.abs(rows[:, 0]) < loose) & np.isfinite(rows[:, 1])
    axis, column, rows = axis[near], column[near], rows[near]
    slope = slopes(pose[0], scene[0], observed[near], mapped[near])
    open_ = np.einsum("nia,ab,nib->ni", slope, pose[1], slope)
    own = own_variance(axes.sigma_px[axis], columns.sigma_m[column], rows)
    focal = np.exp(pose[0][6]) * axes.scale[axis]
    foot, top = (
        np.sqrt(noise.foot_px**2 + (height_m * focal / rows[:, 3]) ** 2 + open_[:, k])
        for k, height_m in ((1, noise.ground_m), (2, np.hypot(noise.top_m, noise.ground_m)))
    )
    length = columns.top_m[column] * focal / rows[:, 3]
    foot_good = rows[:, 1] < _GATE * foot
    visible = axes.foot_visible[axis]
    foot_good &= ~visible | (rows[:, 1] > -_GATE * foot)
    top_good = columns.open_top[column] | (rows[:, 2] > -_GATE * top)
    top_good &= axes.top_cut[axis] | (rows[:, 2] < _GATE * top + _LOST_TOP * length)
    good = (rows[:, 0] ** 2 < _GATE**2 * (open_[:, 0] + own)) & foot_good & top_good
    extra = np.where(visible, 0.5 * (rows[:, 1] / foot) ** 2, 0.0)
    parts = axis, column, rows[:, 0], slope[:, 0], own, extra
    return _Pairs(*(part[good] for part in parts))


def own_variance(sigma_px: Floats, sigma_m: Floats, rows: Floats) -> Floats:
    """Variance (n,) of bearings but for the pose, from rows of `measure`."""
    return (sigma_px * rows[:, 4]) ** 2 + (sigma_m / rows[:, 3]) ** 2


def match_landmarks(
    columns: Ints, landmarks: Landmarks, scene: tuple[Floats, Floats], unknowns: Floats
) -> MatchedLandmarks:
    """Pairs of a hypothesis with their sigmas at a pose."""
    axis = np.flatnonzero(columns >= 0)
    column = columns[axis]
    observed = np.ascontiguousarray(observed_rows(landmarks.axes)[axis])
    mapped = np.ascontiguousarray(mapped_rows(landmarks.columns, scene[1])[column])
    rows = measure(unknowns, scene[0], observed, mapped)
    sigma_m = landmarks.columns.sigma_m[column]
    variance = own_variance(landmarks.axes.sigma_px[axis], sigma_m, rows)
    return MatchedLandmarks(np.column_stack([axis, column]), observed, mapped, np.sqrt(variance))
