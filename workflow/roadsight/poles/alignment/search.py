"""Where to look for the pose of one image: a grid over what the expectation leaves open."""

from __future__ import annotations

import numpy as np

from roadsight.poles.alignment.pose import FOCAL, LATERAL, PITCH, YAW
from roadsight.poles.alignment.solve import FINEST, Fit, Task, descend

_NEAR_M = 20.0
"""Range at which an error across the road is counted as a turn; a shorter one calls for the grid
search more often."""
_PULL = 16.0
"""Scale, in standard deviations of a pixel, from which a descent still finds its edges."""


def coarse_scale(task: Task) -> float:
    """Scale at which the expected pose pulls from as far as it may be wrong, at least 8."""
    sigma_deg = np.sqrt(np.linalg.inv(task.prior_information)[YAW, YAW])
    reach_px = np.exp(task.prior_mean[FOCAL]) * np.radians(sigma_deg)
    return float(max(8.0, reach_px / task.noise.pixel_px))


def uncertain_px(task: Task) -> float:
    """How far two standard deviations of the expected pose move road edges in the image."""
    sigma = np.sqrt(np.diag(np.linalg.inv(task.prior_information)))
    turn = max(np.radians(sigma[YAW]), np.radians(sigma[PITCH]), sigma[LATERAL] / _NEAR_M)
    return float(2.0 * turn * np.exp(task.prior_mean[FOCAL]))


def search(task: Task, starts: int = 3) -> list[Fit]:
    """Minima, the best first, from a grid over yaw, pitch and lateral place.

    Where the expectation leaves less open than edges pull from, there is one minimum: the one that
    is downhill from there.
    """
    pull = uncertain_px(task) / task.noise.pixel_px
    if pull <= _PULL:
        return [descend(task, task.prior_mean, max(pull, FINEST))]
    sigma = np.sqrt(np.diag(np.linalg.inv(task.prior_information)))
    scale = coarse_scale(task)
    grid = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    trials = np.repeat(task.prior_mean[None], len(grid), axis=0)
    trials[:, [YAW, PITCH, LATERAL]] += grid * sigma[[YAW, PITCH, LATERAL]]
    values = task.scan(trials, 0.5 * scale)
    chosen: list[int] = []
    for number in np.argsort(values, kind="stable"):
        apart = [np.abs(grid[number] - grid[other]).max() for other in chosen]
        if not apart or min(apart) > 1:
            chosen.append(int(number))
        if len(chosen) == starts:
            break
    fits = [descend(task, trials[number], 0.5 * scale) for number in chosen]
    return sorted(fits, key=lambda fit: fit.cost)
