"""Radial lens distortion: Brown's model with two coefficients, and its inverse.

A point that a pinhole camera would show at a distance ``r`` from the principal point appears at
``r (1 + k1 r^2 + k2 r^4)``, in the same direction (D. C. Brown, Close-range camera calibration,
Photogrammetric Engineering 37, 1971, equation 4 without decentring). Distances are measured in
units of ``scale_px``: the focal length for coefficients as OpenCV gives them, or any other length
where the focal length is not known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError

# Most steps of Newton's method. Bisection alone, to which it falls back, needs some 53 for all the
# bits of a double.
_STEPS = 60
# Pinhole distance over the distance shown, at most, where the image never turns back: there the
# lens shows a place at more than 4/9 of its pinhole distance, so that the bracket needs 9/4.
_WIDEST = 2.5


@dataclass(frozen=True)
class RadialLens:
    """Distortion about a centre.

    Parameters
    ----------
    k1, k2 : coefficients; positive moves points outwards (pincushion), negative inwards (barrel).
    scale_px : unit of distance. cx_px, cy_px : centre; pixel centres have whole coordinates.
    """

    k1: float
    k2: float
    scale_px: float
    cx_px: float
    cy_px: float

    @classmethod
    def centred(
        cls, k1: float, k2: float, width_px: int, height_px: int, scale_px: float | None = None
    ) -> RadialLens:
        """Lens about the middle of an image; the unit is half its diagonal unless given."""
        unit = 0.5 * float(np.hypot(width_px, height_px)) if scale_px is None else scale_px
        return cls(k1, k2, unit, (width_px - 1) / 2, (height_px - 1) / 2)

    @property
    def turning_radius(self) -> float:
        """Pinhole distance where the image turns back on itself, in units; infinite if nowhere."""
        return _turning_radius(self.k1, self.k2)

    def distort(self, uv_px: ArrayLike) -> Floats:
        """Pixels (n, 2) in the lens's image of pixels (n, 2) in the pinhole's image.

        NaN beyond the distance where the image turns back on itself: no real lens shows that.
        """
        xy, r2 = self._normalised(uv_px)
        factor = 1.0 + r2 * (self.k1 + self.k2 * r2)
        factor = np.where(r2 <= self.turning_radius**2, factor, np.nan)
        return self._pixels(xy * factor[:, None])

    def undistort(self, uv_px: ArrayLike) -> Floats:
        """Pixels (n, 2) in the pinhole's image of pixels (n, 2) in the lens's image.

        The inverse of `distort` to rounding, by Newton's method kept within a shrinking bracket;
        NaN for places that no point is shown at.
        """
        xy, r2 = self._normalised(uv_px)
        shown = np.sqrt(r2)
        safe = np.where(shown > 0.0, shown, 1.0)
        factor = np.where(shown > 0.0, _undone(self.k1, self.k2, shown) / safe, 1.0)
        return self._pixels(xy * factor[:, None])

    def displacement_px(self, uv_px: ArrayLike) -> Floats:
        """How far (n,) the lens moves what is shown at pixels (n, 2); positive is outwards."""
        uv = np.asarray(uv_px, np.float64).reshape(-1, 2)
        centre = np.array([self.cx_px, self.cy_px])
        true = np.linalg.norm(self.undistort(uv) - centre, axis=1)
        return np.linalg.norm(uv - centre, axis=1) - true

    def corner_px(self, width_px: int, height_px: int) -> float:
        """Displacement at the image corner farthest from the centre; NaN if nothing is there."""
        corners = [(u, v) for u in (-0.5, width_px - 0.5) for v in (-0.5, height_px - 0.5)]
        far = max(corners, key=lambda c: np.hypot(c[0] - self.cx_px, c[1] - self.cy_px))
        return float(self.displacement_px([far])[0])

    def check(self, width_px: int, height_px: int, where: str) -> None:
        """Refuse a lens that cannot have made an image of this size.

        Raises
        ------
        InputError : a coefficient is not finite, or the image turns back on itself within it.
        """
        if not np.isfinite([self.k1, self.k2, self.scale_px]).all() or self.scale_px <= 0:
            raise InputError("is no lens", where=where, found=f"k1 {self.k1}, k2 {self.k2}")
        if np.isnan(self.corner_px(width_px, height_px)):
            raise InputError(
                "cannot be the lens of these images: it folds them before their corner",
                where=where,
                found=f"k1 {self.k1:g}, k2 {self.k2:g}, {width_px} x {height_px} px",
                hint="give k1 and k2 with the focal length in pixels that they belong to",
            )

    def _normalised(self, uv_px: ArrayLike) -> tuple[Floats, Floats]:
        uv = np.asarray(uv_px, np.float64).reshape(-1, 2)
        xy = (uv - [self.cx_px, self.cy_px]) / self.scale_px
        return xy, np.einsum("ij,ij->i", xy, xy)

    def _pixels(self, xy: Floats) -> Floats:
        return xy * self.scale_px + [self.cx_px, self.cy_px]


def _turning_radius(k1: float, k2: float) -> float:
    """Smallest positive r with 1 + 3 k1 r^2 + 5 k2 r^4 = 0."""
    discriminant = 9.0 * k1 * k1 - 20.0 * k2
    if discriminant < 0.0:
        return np.inf
    # The form of the roots that loses nothing where k2 is small or none.
    denominator = float(-3.0 * k1 + np.sqrt(discriminant))
    return float(np.sqrt(2.0 / denominator)) if denominator > 0.0 else np.inf


def _undone(k1: float, k2: float, shown: Floats) -> Floats:
    """Pinhole distance (n,) of a distance shown (n,), in units; NaN beyond the last one shown."""
    turn = _turning_radius(k1, k2)
    # Where the image never turns back, 9 k1^2 < 20 k2. The factor 1 + k1 r^2 + k2 r^4 is least at
    # r^2 = -k1 / (2 k2), where it is 1 - k1^2 / (4 k2) and so above 1 - 5/9.
    high = np.full_like(shown, turn) if np.isfinite(turn) else _WIDEST * shown
    last = high * (1.0 + high**2 * (k1 + k2 * high**2))
    low, r = np.zeros_like(shown), np.minimum(shown, high)
    for _ in range(_STEPS):
        r2 = r * r
        excess = r * (1.0 + r2 * (k1 + k2 * r2)) - shown
        slope = 1.0 + r2 * (3.0 * k1 + 5.0 * k2 * r2)
        low, high = np.where(excess < 0, r, low), np.where(excess < 0, high, r)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = r - excess / slope
        inside = (step >= low) & (step <= high)
        after = np.where(inside, step, 0.5 * (low + high))
        if np.array_equal(after, r):
            break
        r = after
    return np.where(shown <= last, r, np.nan)
