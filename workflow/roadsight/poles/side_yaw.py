"""Yaw of side views from what they share with the front view, where views overlap."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.geometry.cameras import Intrinsics
from roadsight.poles.stitching import side_intrinsics, turned

_COARSE_DEG, _FINE_DEG = 0.5, 0.05
_LEAST_OVERLAP_PX = 2000
_LEAST_AGREEMENT = 0.3

Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]


def estimate_yaw_deg(
    pairs: Iterable[Pair], front: Intrinsics, guess_deg: float, reach_deg: float = 10.0
) -> tuple[float, float]:
    """Yaw of a side view from the front view, clockwise, and how well the views agree there.

    The side view is turned into the front view (nothing but rotation lies between them) and the
    correlation of the two in their overlap, mean over the pairs, is searched on a coarse and then
    on a fine grid.

    Parameters
    ----------
    pairs : front and side BGR images of some places. front : the front camera. guess_deg : where
        to search, `reach_deg` to both sides.

    Returns
    -------
    yaw and correlation; NaN where the views do not overlap or agree nowhere (below 0.3)
    """
    grey = [(_edges(a), _edges(b)) for a, b in pairs]
    best, score = float("nan"), -1.0
    centre, reach = guess_deg, reach_deg
    for step in (_COARSE_DEG, _FINE_DEG):
        for yaw in centre + np.arange(-reach, reach + step / 2, step):
            here = [_agreement(a, b, front, float(yaw)) for a, b in grey]
            mean = float(np.mean(here)) if here else float("nan")
            if mean > score:
                best, score = float(yaw), mean
        if not np.isfinite(best):
            return float("nan"), float("nan")
        centre, reach = best, 2 * step
    return (best, score) if score >= _LEAST_AGREEMENT else (float("nan"), float("nan"))


def _edges(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Smoothed slope of brightness, so that exposure does not matter."""
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32), (0, 0), 2.0)
    return np.asarray(cv2.Sobel(grey, cv2.CV_32F, 1, 0), np.float32)


def _agreement(
    front_edges: NDArray[np.float32], side_edges: NDArray[np.float32], front: Intrinsics, yaw: float
) -> float:
    """Correlation in the overlap; NaN if it is too small or has no content."""
    side = side_intrinsics(front, side_edges.shape[1], side_edges.shape[0])
    side_from_front = _matrix(side) @ turned(np.eye(3), yaw) @ np.linalg.inv(_matrix(front))
    size = (front_edges.shape[1], front_edges.shape[0])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    seen = cv2.warpPerspective(np.ones_like(side_edges), side_from_front, size, flags=flags) > 0.99
    # Pixels behind the side camera would come back mirrored.
    columns = np.arange(size[0])
    angle = np.arctan2(columns - front.cx_px, front.focal_px) - np.radians(yaw)
    seen &= np.cos(angle) > 0.1
    if np.count_nonzero(seen) < _LEAST_OVERLAP_PX:
        return float("nan")
    drawn = cv2.warpPerspective(side_edges, side_from_front, size, flags=flags)
    a, b = front_edges[seen].astype(np.float64), np.asarray(drawn[seen], np.float64)
    a, b = a - a.mean(), b - b.mean()
    spread = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / spread if spread > 0 else float("nan")


def _matrix(camera: Intrinsics) -> NDArray[np.float64]:
    f, cx, cy = camera.focal_px, camera.cx_px, camera.cy_px
    return np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])
