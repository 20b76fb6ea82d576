"""The line that the vehicle drove: headings, and which side of it a point lies on."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Floats
from roadsight.base.kernels import compiled


def sides_of_track(points_xy_m: ArrayLike, track_xy_m: ArrayLike) -> NDArray[np.int8]:
    """Side of the track on which points lie: -1 left, +1 right, 0 on it or unknown.

    The nearest piece of the track decides; at a corner, the piece that sees the point more
    squarely. Points beyond either end of the track belong to no piece: they are unknown, and so
    is every point when the track has no length.

    Parameters
    ----------
    points_xy_m : (n, 2) local metres. track_xy_m : (m, 2) in the order of travel.
    """
    points = np.asarray(points_xy_m, np.float64).reshape(-1, np.shape(points_xy_m)[-1])[:, :2]
    track = _distinct(np.asarray(track_xy_m, np.float64)[:, :2])
    if len(points) == 0 or len(track) < 2:
        return np.zeros(len(points), np.int8)
    origin = track[0]
    return _sides(points - origin, track - origin)


def _distinct(track_m: Floats) -> Floats:
    """Track without standing still."""
    moved = np.ones(len(track_m), bool)
    moved[1:] = np.hypot(*np.diff(track_m, axis=0).T) > 1e-6
    return track_m[moved]


@compiled(error_model="numpy")
def _sides(points: Floats, track: Floats) -> NDArray[np.int8]:
    sides = np.zeros(len(points), np.int8)
    last = len(track) - 2
    for i in range(len(points)):
        x, y = points[i]
        nearest, squareness = np.inf, -1.0
        for k in range(last + 1):
            east, north = track[k + 1] - track[k]
            square_m2 = east * east + north * north
            dx, dy = x - track[k, 0], y - track[k, 1]
            share = (dx * east + dy * north) / square_m2
            beyond = (k == 0 and share < 0.0) or (k == last and share > 1.0)
            part = min(1.0, max(0.0, share))
            gap2 = (dx - part * east) ** 2 + (dy - part * north) ** 2
            cross = (east * dy - north * dx) / np.sqrt(square_m2)
            # At a corner both pieces are equally near, but for rounding.
            tie = abs(gap2 - nearest) <= 1e-9 * (1.0 + gap2)
            if (gap2 < nearest and not tie) or (tie and abs(cross) > squareness):
                nearest, squareness = min(gap2, nearest), abs(cross)
                sides[i] = 0 if beyond or abs(cross) < 1e-9 else (-1 if cross > 0 else 1)
    return sides


def extended_track(track_xy_m: ArrayLike, ahead_m: float) -> Floats:
    """Track (n, 2) continued straight on at both ends; a track without length stays as it is."""
    track = _distinct(np.asarray(track_xy_m, np.float64)[:, :2])
    if len(track) < 2:
        return track
    start, end = track[0] - track[1], track[-1] - track[-2]
    before = track[0] + ahead_m * start / np.hypot(*start)
    after = track[-1] + ahead_m * end / np.hypot(*end)
    return np.concatenate([before[None], track, after[None]])


def track_headings_deg(
    track_xy_m: ArrayLike, fallback_deg: ArrayLike, reach_m: float = 25.0
) -> Floats:
    """Directions of travel of parabolas through the positions around each, clockwise from north.

    Parameters
    ----------
    track_xy_m : (n, 2) of one route in the order of travel.
    fallback_deg : (n,) what to take where the vehicle stood.
    reach_m : path before and after that is used, at least one position each way where there is.
    """
    track = np.asarray(track_xy_m, np.float64)
    heading = np.array(fallback_deg, np.float64)
    path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(track, axis=0).T))])
    for i in range(len(track)):
        near = np.abs(path - path[i]) <= reach_m
        near[max(i - 1, 0) : i + 2] = True
        step = path[near] - path[i]
        if np.ptp(step) < 0.5:
            continue
        moved = track[near] - track[i]
        order = 2 if near.sum() >= 4 else 1
        terms = step[:, None] ** np.arange(order + 1)
        slope = np.linalg.lstsq(terms, moved, rcond=None)[0][1]
        # Place by path has slope 1, and far less where noise goes to and fro.
        if np.hypot(*slope) > 0.1:
            heading[i] = np.degrees(np.arctan2(slope[0], slope[1])) % 360.0
    return heading
