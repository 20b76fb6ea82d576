"""Headings along a videolog's track of noisy positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.geometry.cameras import azimuth_deg, compass_deg

STANDING_M = 0.5
"""Steps below this are standing still: their direction is noise."""
WANDERING_M = 10.0
"""Side of the square within which a standing camera's positions wander: GPS noise of 2 to 3 m."""
_ROUNDS = 5
"""Fits of each parabola, each with weights from the one before."""


def steps_m(xy_m: ArrayLike) -> Floats:
    """Distance (n,) from each place (n, 2) to the next, 0 for the last."""
    xy = np.asarray(xy_m, np.float64)
    return np.append(np.hypot(*np.diff(xy, axis=0).T), 0.0)[: len(xy)]


def moving(xy_m: ArrayLike, standing_m: float = STANDING_M) -> Ints:
    """Numbers of the places that are ``standing_m`` or more from the last such place."""
    xy = np.asarray(xy_m, np.float64)
    kept = [0] if len(xy) else []
    for number in range(1, len(xy)):
        if np.hypot(*(xy[number] - xy[kept[-1]])) >= standing_m:
            kept.append(number)
    return np.array(kept, np.int64)


def headings_deg(
    xy_m: ArrayLike, half_window: int = 3, standing_m: float = STANDING_M
) -> tuple[Floats, Floats]:
    """Headings at places of one drive, clockwise from grid north.

    The raw heading is the direction to the next place (the last one takes the one before). The
    smoothed heading is the tangent of a parabola fitted to the places around: GPS noise of 1 m
    over steps of 8 m would else turn the camera by 7 degrees, and the direction to the next place
    is off by half of the bend between the two. A place where the vehicle stands takes the heading
    at which it came, or at which it left if it had not moved before.

    Parameters
    ----------
    xy_m : (n, 2) local metres in the order of travel.
    half_window : places to either side that are fitted; 0 gives the raw heading twice.
    standing_m : places nearer than this to the last one are standing still.

    Returns
    -------
    smoothed, raw : (n,) degrees in [0, 360), NaN throughout if the vehicle never moved.
    """
    xy = np.asarray(xy_m, np.float64).reshape(-1, 2)
    nodes = moving(xy, standing_m)
    if len(nodes) < 2:
        return np.full(len(xy), np.nan), np.full(len(xy), np.nan)
    chord = azimuth_deg(xy[nodes[:-1]], xy[nodes[1:]])
    raw = np.append(chord, chord[-1])
    smooth = raw if half_window < 1 else _tangents_deg(xy[nodes], half_window)
    node_of = np.searchsorted(nodes, np.arange(len(xy)), side="right") - 1
    # A place of a stop that is not its first one came with the node's arrival.
    arrived = np.where(node_of > 0, node_of - (np.arange(len(xy)) != nodes[node_of]), 0)
    return smooth[node_of], raw[arrived]


def wandering(xy_m: ArrayLike, half_window: int = 3) -> Bools:
    """Places (n,) around which a camera stood or wandered, so that its track has no direction.

    Within a few metres, the way from first to last of the places around is less than half of the
    way along them: steps are the noise of positions.
    """
    xy = np.asarray(xy_m, np.float64).reshape(-1, 2)
    reach = max(half_window, 2)
    if _wanders(xy):
        return np.ones(len(xy), bool)
    parts = [xy[max(0, k - reach) : k + reach + 1] for k in range(len(xy))]
    return np.array([_wanders(part) for part in parts], bool)


def _wanders(xy: Floats) -> bool:
    """Whether places (n, 2), four or more, lie within a few metres and lead nowhere."""
    if len(xy) < 4 or np.ptp(xy, axis=0).max() >= WANDERING_M:
        return False
    way = np.hypot(*np.diff(xy, axis=0).T).sum()
    return bool(np.hypot(*(xy[-1] - xy[0])) < 0.5 * way)


def turning_back(xy_m: ArrayLike, standing_m: float = STANDING_M) -> tuple[int, int]:
    """How many of the places that moved turn back by more than 120 degrees, and how many there are.

    Only tracks longer than where a camera may wander are looked at.
    """
    xy = np.asarray(xy_m, np.float64).reshape(-1, 2)
    nodes = xy[moving(xy, standing_m)]
    if len(nodes) < 4 or np.ptp(nodes, axis=0).max() < 2 * WANDERING_M:
        return 0, max(len(nodes) - 2, 0)
    step = np.diff(nodes, axis=0)
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    back = (step[:-1] * step[1:]).sum(axis=1) < -0.5
    return int(back.sum()), len(back)


def _tangents_deg(xy: Floats, half_window: int) -> Floats:
    """Headings of robust local parabolas through places (n, 2) that all moved."""
    station = np.append(0.0, np.cumsum(np.hypot(*np.diff(xy, axis=0).T)))
    tangent = np.empty_like(xy)
    for k in range(len(xy)):
        part = slice(max(0, k - half_window), k + half_window + 1)
        tangent[k] = _slope(station[part] - station[k], xy[part] - xy[k])
    return compass_deg(np.degrees(np.arctan2(tangent[:, 0], tangent[:, 1])))


def _slope(station: Floats, xy: Floats) -> Floats:
    """Derivative (2,) at station 0 of a weighted parabola; two places give their chord."""
    scale = np.abs(station).max()
    share = station / scale
    # Somewhat wider than the places, so that the outermost still count.
    window = (1 - (np.abs(share) / 1.15) ** 3) ** 3
    terms = np.stack([np.ones_like(share), share, share**2], axis=1)
    weight = window
    # As if bends were known to be some decimetres over the window, so that an end of the route,
    # where the parabola is free, does not follow the noise.
    bend = np.diag([0.0, 0.0, 1e-2 if len(share) > 3 else 1.0])
    for _ in range(_ROUNDS):
        square = terms.T @ (weight[:, None] * terms) + bend
        fitted = np.linalg.solve(square, terms.T @ (weight[:, None] * xy))
        off = np.linalg.norm(xy - terms @ fitted, axis=1)
        # Places that fit to a few centimetres are no outliers of each other.
        reach = 3.0 * max(float(np.median(off)), 0.05)
        weight = window * np.clip(1 - (off / reach) ** 2, 1e-3, None) ** 2
    return fitted[1]
