"""Points that two images of a drive both show: scale-invariant features, matched one to one."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import pandas as pd

from roadsight.base.arrays import Bytes, Floats, Floats32, Ints

_FEATURES = 3000
"""Points of an image at most, the strongest; time grows with the square. A wide lens every 16 m has
a fifth more right matches than with 1500 (at 0.8 of the second nearest one's distance)."""
_CONTRAST = 0.02
"""Half of OpenCV's threshold: fields and asphalt have little contrast."""
_CLEARER = 0.7
"""A match must be nearer than this share of the second nearest one's distance. Lowe takes 0.8, with
which a third of a wide lens's matches are wrong, most of them by a few pixels: the next branch."""
_LARGER = (0.7, 4.0)
"""How many times larger the next image may show a thing. Things come nearer along a road; a size is
measured to some tenths."""
_FARTHEST_M = 40.0
"""Images further apart show the same things too differently."""
_STANDING_M = 0.3
"""Images nearer than this have no baseline that a direction could be told from."""


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
