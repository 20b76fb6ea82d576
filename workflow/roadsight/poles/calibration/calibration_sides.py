"""Yaw of a drive's side views, from the poles that they show and the front view's poses.

The angle between two cameras is the same in every image, so every pole axis of a side view and
every column near its ray vote for one; wrong pairs scatter, right ones agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.poles.alignment.association import own_variance
from roadsight.poles.alignment.drift import MARK_OVERLAP
from roadsight.poles.alignment.landmarks import (
    POSE,
    VIEWS,
    LandmarkNoise,
    Turns,
    mapped_rows,
    measure,
    observed_rows,
    slopes,
)
from roadsight.poles.alignment.locate import without_view
from roadsight.poles.alignment.pose import CX
from roadsight.poles.alignment.solve import Fit, Task

_STEP_DEG = 0.02
"""Step of the yaws whose votes are counted; the best one is refined afterwards."""
_REACH_DEG = 10.0
"""How far to either side of a guess yaws are tried."""
_FARTHEST_M = 80.0
"""Columns beyond this do not vote: more of them lie near every ray."""
_GATE = 3.0
"""Standard deviations by which rows of foot and top may differ."""
_FEWEST = 6
"""Votes that must agree on a yaw."""
_WRONG = 0.5
"""Share of the axes whose vote is astray, since their pole is no column of the cloud."""
_APART_DEG = 0.6
"""Yaws that differ by more are rivals of the best one, not its flank."""
_CLEARER = 6.0
"""Log-likelihood by which the best yaw must lead its rivals, else the view stays unused."""
_LEAST_SIGMA_DEG = 0.005
"""Standard deviation that many votes do not get below."""


def side_turns(
    images: Sequence[tuple[Task, Fit]],
    guesses_deg: Mapping[str, Sequence[float]],
    noise: LandmarkNoise,
) -> Turns:
    """Yaw of each side view; a view whose poles do not tell stays unused.

    The poses that a view's poles are compared with do not rest on these poles.

    Parameters
    ----------
    images : tasks with their poses. guesses_deg : by view; each is searched 10 degrees either way.
    """
    deg, sigma = list(Turns().deg), list(Turns().sigma_deg)
    for view, guesses in guesses_deg.items():
        if not guesses:
            continue
        found = _turn(images, view, np.array(guesses, float), noise)
        number = VIEWS.index(view)
        deg[number], sigma[number] = found if found is not None else (float(guesses[0]), np.inf)
    return Turns((deg[0], deg[1], deg[2]), (sigma[0], sigma[1], sigma[2]))


def _turn(
    images: Sequence[tuple[Task, Fit]], view: str, guesses_deg: Floats, noise: LandmarkNoise
) -> tuple[float, float] | None:
    """Yaw and sigma in degrees, None if the votes do not agree."""
    guess = float(guesses_deg[0])
    votes = [_votes(t, without_view(t, fit, view), view, guess, noise) for t, fit in images]
    votes = [vote for vote in votes if len(vote)]
    if not votes:
        return None
    first = np.concatenate([[0], np.cumsum([vote[:, 0].max() + 1 for vote in votes])[:-1]])
    table = np.concatenate([v + np.array([n, 0, 0]) for v, n in zip(votes, first, strict=True)])
    grid = np.arange(-180.0, 180.0, _STEP_DEG)
    near = np.abs(grid[:, None] - guesses_deg).min(axis=1) <= _REACH_DEG
    grid = grid[near]
    score = _score(grid, table, 2 * _REACH_DEG)
    best = int(np.argmax(score))
    others = score[np.abs(grid - grid[best]) > _APART_DEG]
    if len(others) and score[best] - others.max() < _CLEARER:
        return None
    return _refined(grid[best], table)


def _votes(task: Task, fit: Fit, view: str, guess_deg: float, noise: LandmarkNoise) -> Floats:
    """Rows (k, 3): number of the axis, yaw that would put it on a column, its sigma (degrees)."""
    sight = task.landmarks
    own = sight.axes.seen_by(view) if sight is not None else np.empty(0, np.int64)
    if sight is None or not len(own):
        return np.empty((0, 3))
    axis = np.repeat(own, len(sight.columns.top_m))
    column = np.tile(np.arange(len(sight.columns.top_m)), len(own))
    start, pose = task.scene[0], fit.unknowns
    seen = observed_rows(sight.axes)[axis]
    seen[:, 5:] = 0.0, np.radians(guess_deg)  # As if in the front view, turned by themselves.
    seen[:, 0] += pose[CX]
    there = mapped_rows(sight.columns, task.origin_m)[column]
    for _ in range(2):  # A tilted camera turns its views not quite by the bearings' difference.
        seen[:, 6] -= measure(pose, start, seen, there)[:, 0]
    rows = measure(pose, start, seen, there)
    good = (rows[:, 3] > noise.nearest_m) & (rows[:, 3] < _FARTHEST_M) & np.isfinite(rows[:, 1])
    axis, column = axis[good], column[good]
    seen, there, rows = seen[good], there[good], rows[good]
    slope = slopes(pose, start, seen, there)[..., :POSE]
    open_ = np.einsum("nia,ab,nib->ni", slope, fit.covariance[:POSE, :POSE], slope)
    focal = np.exp(pose[6]) * sight.axes.scale[axis]
    foot, top = (
        np.sqrt(noise.foot_px**2 + (height_m * focal / rows[:, 3]) ** 2 + open_[:, k])
        for k, height_m in ((1, noise.ground_m), (2, noise.top_m))
    )
    agrees = np.where(
        sight.axes.foot_visible[axis], np.abs(rows[:, 1]) < _GATE * foot, rows[:, 1] < _GATE * foot
    )
    cut = sight.axes.top_cut[axis]
    open_top = sight.columns.open_top[column]
    agrees &= (open_top | (rows[:, 2] > -_GATE * top)) & (cut | (rows[:, 2] < _GATE * top))
    sigma_m = sight.columns.sigma_m[column]
    variance = open_[:, 0] + own_variance(sight.axes.sigma_px[axis], sigma_m, rows)
    turn_deg = (np.degrees(seen[:, 6]) + 180.0) % 360.0 - 180.0
    number = np.searchsorted(own, axis)
    return np.column_stack([number, turn_deg, np.degrees(np.sqrt(variance))])[agrees]


def _score(grid: Floats, table: Floats, range_deg: float) -> Floats:
    """Log-likelihood of yaws, every axis one vote, about half of them astray."""
    number = table[:, 0].astype(np.int64)
    total = np.zeros(len(grid))
    for axis in np.unique(number):
        _, turn, sigma = table[number == axis].T
        off = (grid[:, None] - turn) / sigma
        density = (np.exp(-0.5 * off**2) / (2.5066 * sigma)).sum(axis=1)  # The root of 2 pi.
        total += np.log(_WRONG / range_deg + (1.0 - _WRONG) * density)
    return total


def _refined(turn_deg: float, table: Floats) -> tuple[float, float] | None:
    """Weighted robust mean of the votes around a yaw."""
    near = np.abs(table[:, 1] - turn_deg) < 4.0 * table[:, 2] + 2.0 * _STEP_DEG
    if np.count_nonzero(near) < _FEWEST:
        return None
    _, turn, sigma = table[near].T
    mean = turn_deg
    for _ in range(10):
        weight = (1.0 + ((turn - mean) / (2.0 * sigma)) ** 2) ** -2 / sigma**2
        mean = float((weight * turn).sum() / weight.sum())
    return mean, float(np.hypot(1.0 / np.sqrt(MARK_OVERLAP * weight.sum()), _LEAST_SIGMA_DEG))
