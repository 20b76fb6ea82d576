"""Points that two images of a drive both show: scale-invariant features, matched one to one."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bytes, Floats, Floats32, Ints

# Points of an image at most, the strongest; time grows with the square. A wide lens every 16 m has
# a fifth more right matches than with 1500 (at 0.8 of the second nearest one's distance).
_FEATURES = 3000
_CONTRAST = 0.02  # Half of OpenCV's threshold: fields and asphalt have little contrast
# A match must be nearer than this share of the second nearest one's distance. Lowe takes 0.8, with
# which a third of a wide lens's matches are wrong, most of them by a few pixels: the next branch.
_CLEARER = 0.7
# How many times larger the next image may show a thing. Things come nearer along a road; a size is
# measured to some tenths.
_LARGER = (0.7, 4.0)
_FARTHEST_M = 40.0  # Images further apart show the same things too differently
_STANDING_M = 0.3  # Images nearer than this have no baseline that a direction could be told from


@dataclass(frozen=True)
class Features:
    """Distinct points of one image.

    Attributes
    ----------
    uv_px : (n, 2). descriptors : (n, 128) of unit length. size_px : (n,) of what they show.
    """

    uv_px: Floats
    descriptors: Floats32
    size_px: Floats


def features(image: Bytes) -> Features:
    """Points of an image (rows, columns[, 3]) that another image can show again.

    SIFT (D. Lowe, Distinctive image features from scale-invariant keypoints, IJCV 60, 2004), whose
    histograms are compared by their roots (R. Arandjelovic and A. Zisserman, CVPR 2012). Cameras on
    vehicles stay upright, so that points are described as they are, not turned to their steepest
    direction: what looks alike only when turned is no match.
    """
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    detector = cv2.SIFT.create(nfeatures=_FEATURES, contrastThreshold=_CONTRAST)
    # A point of several directions is found once for each of them.
    found = {(point.pt, point.size): point for point in detector.detect(grey, None)}
    for point in found.values():
        point.angle = 0.0
    points, histograms = detector.compute(grey, list(found.values()))
    if histograms is None or not len(points):
        return Features(np.empty((0, 2)), np.empty((0, 128), np.float32), np.empty(0))
    total = np.maximum(histograms.sum(axis=1, keepdims=True), 1e-9)
    uv = np.array([point.pt for point in points], np.float64)
    size_px = np.array([point.size for point in points], np.float64)
    return Features(uv, np.sqrt(histograms / total, dtype=np.float32), size_px)


def matched(one: Features, other: Features) -> Ints:
    """Numbers (k, 2) of points that are each other's nearest, by far nearer than the second.

    Parameters
    ----------
    other : of an image further along the road.
    """
    if min(len(one.uv_px), len(other.uv_px)) < 2:
        return np.empty((0, 2), np.int64)
    like = one.descriptors @ other.descriptors.T
    larger = other.size_px / one.size_px[:, None]
    sized = np.where((larger < _LARGER[0]) | (larger > _LARGER[1]), np.float32(-1.0), like)
    rows = np.arange(len(like))
    best = sized.argmax(axis=1)
    mutual = sized.argmax(axis=0)[best] == rows
    top = sized[rows, best]
    # The second best may be of any size: a point with one candidate of its own has a rival too.
    like[rows, best] = -1.0
    second = like.max(axis=1)
    apart, next_apart = (np.sqrt(np.maximum(2.0 - 2.0 * part, 0.0)) for part in (top, second))
    good = np.flatnonzero(mutual & (top > 0.0) & (apart < _CLEARER * next_apart))
    return np.column_stack([good, best[good]])


def consecutive(
    frames: pd.DataFrame,
) -> Iterator[tuple[Mapping[Hashable, Any], Mapping[Hashable, Any]]]:
    """Rows of usable images of a route that follow each other, of one size and some way apart.

    Parameters
    ----------
    frames : image, path, route, sequence, status, x, y (local metres), width_px, height_px.
    """
    good = frames[frames["status"] == "ok"]
    for _, drive in good.groupby(["route", "width_px", "height_px"], sort=True):
        rows = drive.sort_values("sequence", kind="stable").to_dict("records")
        for one, other in pairwise(rows):
            gap_m = float(np.hypot(other["x"] - one["x"], other["y"] - one["y"]))
            if _STANDING_M < gap_m <= _FARTHEST_M:
                yield one, other


# Yaw of a side view from what it shows of the front view of some metres before.
# What leaves the front view at its edge enters the side view. A point that both show spans a
# plane with the way between the two places, and the yaw must bring the side view's ray into that
# plane; so every match votes for a yaw, right ones for one. Nothing but the poses of the front
# view is needed: no pole, no cloud.

# Width of the bins in which votes are counted: wider than the votes' scatter of 0.2
_STEP_DEG = 0.5
_WIDEST_DEG = 120.0  # Yaws beyond this to either side do not count
_REFINED_DEG = 1.0  # Votes within this of the best bin are averaged
_RIVAL_DEG = 2.0  # Bins that are farther from the best one are its rivals
# Weight of the best yaw over that of its best rival, else the yaw stays unknown. On the generated
# rural road it is 10 at least for either side, in every sixth place.
_OVER_RIVAL = 3.0
_FEWEST = 12  # Votes that must agree on a yaw
# Standard deviation that many votes do not get below: errors of poses are shared
_LEAST_SIGMA_DEG = 0.02
# Standard deviation over median absolute deviation, of a normal distribution
_SIGMA_PER_MAD = 1.4826
# Sine of the angle at which a ray passes through its plane, above which a vote weighs no more
_SHARPEST = 0.3


@dataclass(frozen=True)
class Votes:
    """Yaws that matches speak for.

    Parameters
    ----------
    turn_deg : (k,) clockwise from the front view. weight : (k,) how sharply each is told.
    """

    turn_deg: Floats
    weight: Floats


def turn_votes(
    front_rays: ArrayLike, way_m: ArrayLike, side_rays: ArrayLike, front_from_world: ArrayLike
) -> Votes:
    """Yaws at which matched points lie in one plane with the way between two places.

    With the plane's normal m in the later front camera and a ray x of the side camera, the yaw a
    solves (m_x x_x + m_z x_z) cos a + (m_x x_z - m_z x_x) sin a + m_y x_y = 0: two yaws or none.

    Parameters
    ----------
    front_rays : (n, 3) of the earlier front view, local frame. way_m : (3,) from the earlier to the
        later place, metres. side_rays : (n, 3) of the same points in the side camera (right, down,
        ahead) at the later place. front_from_world : (3, 3) of the front camera there.
    """
    rays, sides = (np.asarray(part, np.float64).reshape(-1, 3) for part in (front_rays, side_rays))
    normal = np.cross(rays, np.asarray(way_m, np.float64))
    length = np.linalg.norm(normal, axis=1)
    good = length > 1e-9
    m = (normal[good] / length[good, None]) @ np.asarray(front_from_world, np.float64).T
    x = sides[good] / np.linalg.norm(sides[good], axis=1, keepdims=True)
    a, b = m[:, 0] * x[:, 0] + m[:, 2] * x[:, 2], m[:, 0] * x[:, 2] - m[:, 2] * x[:, 0]
    c = m[:, 1] * x[:, 1]
    sharp_2 = a**2 + b**2 - c**2
    met = sharp_2 > 0
    a, b, c, sharp = a[met], b[met], c[met], np.sqrt(sharp_2[met])
    middle, half = np.arctan2(b, a), np.arctan2(sharp, -c)
    turns = np.degrees(np.concatenate([middle - half, middle + half]))
    weight = np.minimum(np.concatenate([sharp, sharp]), _SHARPEST) ** 2
    return Votes((turns + 180.0) % 360.0 - 180.0, weight)


def agreed_turn(votes: Votes) -> tuple[float, float]:
    """Yaw that the votes agree on and its sigma, degrees; NaN and infinite where none is clear."""
    nothing = float("nan"), float("inf")
    inside = np.abs(votes.turn_deg) < _WIDEST_DEG
    turn, weight = votes.turn_deg[inside], votes.weight[inside]
    if len(turn) < _FEWEST:
        return nothing
    edges = np.arange(-_WIDEST_DEG, _WIDEST_DEG + _STEP_DEG, _STEP_DEG)
    count, _ = np.histogram(turn, edges, weights=weight)
    # Two bins together: a yaw on the border of two is no weaker than one in the middle.
    pair = count[:-1] + count[1:]
    best = int(pair.argmax())
    middle = edges[best + 1]
    rivals = np.abs(edges[1:-1] - middle) > _RIVAL_DEG
    near = np.abs(turn - middle) < _REFINED_DEG
    if near.sum() < _FEWEST or pair[best] < _OVER_RIVAL * pair[rivals].max(initial=0.0):
        return nothing
    order = np.argsort(turn[near], kind="stable")
    total = np.cumsum(weight[near][order])
    found = float(turn[near][order][np.searchsorted(total, 0.5 * total[-1])])
    scatter = _SIGMA_PER_MAD * float(np.median(np.abs(turn[near] - found)))
    return found, max(1.25 * scatter / np.sqrt(near.sum()), _LEAST_SIGMA_DEG)
