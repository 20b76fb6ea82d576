"""Radial lens distortion from lines that are straight in the world (the plumb-line method).

D. C. Brown, Close-range camera calibration, Photogrammetric Engineering 37, 1971: an undistorted
image of a straight line is straight. Each line gives one number, the bow that is left in it, so
that the many pixels of a crooked trunk do not outvote three straight poles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats, Ints
from roadsight.geometry.lens import RadialLens

# One standard deviation of k1 and k2, in units of half the image's diagonal: wide angles of action
# cameras reach a third in k1
_PRIOR = np.array([0.5, 0.05])
_TRACED_PX = 0.15  # What tracing adds to the bow of a straight outline, one standard deviation
_CROOKED = 0.002  # Bow of a straight thing as a share of its length: 2 mm in a metre
# Values of k1 from which the best start is taken; the robust misfit may have several minima
_SCAN = np.linspace(-0.4, 0.4, 161)
_STEP = 1e-4  # Step of the numeric derivatives by k1 and k2
_ROUNDS = 30  # Steps, and halvings of one step, at most
_SCALE = 3.0  # Standard deviations beyond which a curve hardly counts
_FEWEST = 8  # Curves that a lens needs, with any stretch of the drive left out, too
_FEWEST_STRETCHES = 4  # Stretches that the jackknife needs
# A lens that moves the corner by less than so many standard deviations may be none
CERTAIN_SIGMAS = 3.0
_GROUPS = 8  # Stretches of a drive, each left out once by the jackknife
_TOLERANCE = 1e-6  # A step of k1 and k2 below this ends the descent


@dataclass(frozen=True)
class LensEstimate:
    """A lens with what is known of it.

    Attributes
    ----------
    lens : in units of half the image's diagonal. corner_px, sigma_px : displacement at the corner
    and its standard deviation. curves : lines that agree. bow_px : their median bow before.
    """

    lens: RadialLens
    corner_px: float
    sigma_px: float
    curves: int
    bow_px: float


def fit_lens(
    curves: Sequence[Floats], width_px: int, height_px: int, groups: ArrayLike | None = None
) -> LensEstimate | None:
    """Lens under which the curves are straightest, robustly; None for fewer than eight curves.

    minimise over k1 and k2: sum of c^2 e^2 / (c^2 + e^2) / 2 (Geman and McClure) + the prior,
    where e is the bow left in a line divided by what a straight thing's outline may bow.

    Parameters
    ----------
    curves : (n, 2) pixels each. groups : number of the image of each curve, in the order of the
        drive. One crooked trunk shows in several images: the standard deviation is at least that
        of the jackknife over eight stretches of the drive.
    """
    if len(curves) < _FEWEST:
        return None
    size = width_px, height_px
    k, spread, normal = _solve(curves, size)
    lens = _lens(k, size)
    corner = lens.corner_px(*size)
    by_k = np.array([(_corner(k + d, size) - corner) / _STEP for d in np.eye(2) * _STEP])
    sigma = float(np.sqrt(by_k @ np.linalg.inv(normal) @ by_k))
    if groups is not None:
        sigma = max(sigma, _jackknife_px(curves, np.asarray(groups), size))
    agree = np.abs(_bows(curves, k, size) / _sigmas(curves) / spread) < _SCALE
    before = np.median(np.abs([bow(c) for c, good in zip(curves, agree, strict=True) if good]))
    return LensEstimate(lens, corner, sigma, int(agree.sum()), float(before))


def _solve(curves: Sequence[Floats], size: tuple[int, int]) -> tuple[Floats, float, Floats]:
    """k1 and k2, noise against the expected one, normal matrix; from the best k1 of a scan."""
    sigma = _sigmas(curves)
    first = _slopes(curves, np.zeros(2), size)[:, 0] / sigma
    scan = np.abs(_bows(curves, np.zeros(2), size) / sigma + first * _SCAN[:, None]) ** 2
    k = np.array([_SCAN[np.argmin((scan / (_SCALE**2 + scan)).sum(axis=1))], 0.0])
    k = _within(np.zeros(2), k, size)
    for _ in range(_ROUNDS):
        left = _bows(curves, k, size) / sigma
        spread = max(1.0, 1.4826 * float(np.median(np.abs(left))))
        slopes = _slopes(curves, k, size) / sigma[:, None] / spread
        weight = (_SCALE**2 / (_SCALE**2 + (left / spread) ** 2)) ** 2
        normal = slopes.T @ (weight[:, None] * slopes) + np.diag(_PRIOR**-2.0)
        gradient = slopes.T @ (weight * left / spread) + k / _PRIOR**2
        step = np.linalg.solve(normal, -gradient)
        k = _within(k, step, size)
        if np.abs(step).max() < _TOLERANCE:
            break
    return k, spread, normal


def _jackknife_px(curves: Sequence[Floats], groups: Ints, size: tuple[int, int]) -> float:
    """Standard deviation of the corner's displacement over stretches that are left out."""
    stretch = np.unique(groups, return_inverse=True)[1].ravel()
    stretch = stretch * _GROUPS // (int(stretch.max()) + 1)
    corners = []
    for number in np.unique(stretch):
        kept = [curve for curve, own in zip(curves, stretch, strict=True) if own != number]
        if len(kept) < _FEWEST:
            return np.inf
        corners.append(_corner(_solve(kept, size)[0], size))
    count = len(corners)
    # Two or three stretches agree by chance.
    enough = count >= _FEWEST_STRETCHES
    return float(np.sqrt((count - 1) * np.var(corners))) if enough else np.inf


def _within(k: Floats, step: Floats, size: tuple[int, int]) -> Floats:
    """As much of a step, halved, as leaves a lens that shows the whole image with some to spare."""
    for _ in range(_ROUNDS):
        trial = k + step
        # In half diagonals: the corners lie at 1.
        if _lens(trial, size).turning_radius > 1.5:
            return trial
        step = 0.5 * step
    return k


def _slopes(curves: Sequence[Floats], k: Floats, size: tuple[int, int]) -> Floats:
    columns = [
        (_bows(curves, k + d, size) - _bows(curves, k - d, size)) / (2 * _STEP)
        for d in np.eye(2) * _STEP
    ]
    return np.column_stack(columns)


def _bows(curves: Sequence[Floats], k: Floats, size: tuple[int, int]) -> Floats:
    lens = _lens(k, size)
    ends = np.cumsum([len(curve) for curve in curves])[:-1]
    return np.array([bow(part) for part in np.split(lens.undistort(np.concatenate(curves)), ends)])


def _corner(k: Floats, size: tuple[int, int]) -> float:
    return _lens(k, size).corner_px(*size)


def _lens(k: Floats, size: tuple[int, int]) -> RadialLens:
    return RadialLens.centred(float(k[0]), float(k[1]), *size)


def _sigmas(curves: Sequence[Floats]) -> Floats:
    """What the outline of a straight thing may bow (n,), pixels."""
    length = np.array([np.hypot(*(curve[-1] - curve[0])) for curve in curves])
    return np.hypot(_TRACED_PX, _CROOKED * length)


def bow(curve: ArrayLike) -> float:
    """Bow of a curve (n, 2): how far its middle lies to the right of its ends' chord, in pixels.

    By least squares over all points, so that every one of them counts.
    """
    points = np.asarray(curve, np.float64)
    along = points[-1] - points[0]
    length = float(np.hypot(*along))
    if len(points) < 3 or length == 0.0:
        return 0.0
    along = along / length
    offset = points - points[0]
    t = 2.0 * (offset @ along) / length - 1.0
    across = offset @ np.array([-along[1], along[0]])
    base = np.column_stack([np.ones_like(t), t, t * t])
    return float(np.linalg.lstsq(base, across, rcond=None)[0][2])


def doubt(estimate: LensEstimate) -> str:
    """Why a lens must not be used, or "" if it may be."""
    if not np.isfinite(estimate.sigma_px):
        return "too few upright outlines, or in too few stretches of the drive"
    if abs(estimate.corner_px) <= CERTAIN_SIGMAS * estimate.sigma_px:
        return "within three standard deviations of none"
    return ""
