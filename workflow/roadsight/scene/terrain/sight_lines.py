"""How much of the road ahead the terrain hides, estimated from a height model along sight lines.

Cheap enough to decide whether the triangulated terrain is worth building: `scene.occlusion` casts
exact rays at it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats
from roadsight.geometry.cameras import wrap_deg

Height = Callable[[Floats, Floats], Floats]
"""Function of x and y (n,), local metres, that gives heights (n,), NaN where unknown."""

TOLERANCE_M = 0.15
"""Sight lines end this much above the points: they would else meet the ground that these lie on."""
_HALF_ANGLE_DEG = 45.0
"""Road edges this far to either side of the heading are ahead of a camera."""
_STEP_M = 2.0
"""Steps along the longest sight line; crests that hide a road are longer."""
_POINTS = 120
"""Edge points looked at from each camera, about: a share needs no more."""


def hidden_by_heights(height: Height, eye_m: ArrayLike, points_m: ArrayLike) -> Bools:
    """Whether the ground rises above the straight way from an eye to points.

    Parameters
    ----------
    eye_m : (3,) local metres. points_m : (n, 3); the way ends the same little above them as rays
        at the terrain do. Unknown ground hides nothing.
    """
    points = np.asarray(points_m, np.float64).reshape(-1, 3) + np.array([0.0, 0.0, TOLERANCE_M])
    eye = np.asarray(eye_m, np.float64)
    way = points - eye
    longest_m = float(np.hypot(way[:, 0], way[:, 1]).max(initial=0.0))
    steps = max(int(np.ceil(longest_m / _STEP_M)), 1)
    share = np.arange(1, steps) / steps
    places = eye + share[:, None, None] * way
    ground = height(places[..., 0].ravel(), places[..., 1].ravel()).reshape(places.shape[:2])
    with np.errstate(invalid="ignore"):
        return np.asarray((ground > places[..., 2]).any(axis=0))


def hidden_road_share(
    height: Height,
    eyes_m: ArrayLike,
    heading_deg: ArrayLike,
    edges_m: ArrayLike,
    reach_m: float,
) -> float:
    """Share of the road edge points ahead of cameras that the ground hides.

    Parameters
    ----------
    eyes_m : (k, 3) local metres. heading_deg : (k,) clockwise from grid north.
    edges_m : (n, 3) road edge points. reach_m : farther ones do not count.

    Returns
    -------
    share between 0 and 1; NaN where no camera has a road edge ahead
    """
    edges = np.asarray(edges_m, np.float64).reshape(-1, 3)
    hidden = total = 0
    for eye, heading in zip(np.asarray(eyes_m, float), np.asarray(heading_deg), strict=True):
        east, north = (edges[:, :2] - eye[:2]).T
        turn = wrap_deg(np.degrees(np.arctan2(east, north)) - heading)
        away_m = np.hypot(east, north)
        ahead = np.flatnonzero((away_m <= reach_m) & (away_m > 0) & (abs(turn) <= _HALF_ANGLE_DEG))
        ahead = ahead[:: max(len(ahead) // _POINTS, 1)]  # evenly, up to twice as many
        hidden += int(hidden_by_heights(height, eye, edges[ahead]).sum())
        total += len(ahead)
    return hidden / total if total else float("nan")
