"""Pole axes in the views of one place, and the LiDAR's pole-like columns around it.

Road edges cannot tell a place along a bend from a turn of the camera: a circle looks the same from
everywhere on it. A column of a few centimetres that the image shows as a pole can.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.kernels import compiled
from roadsight.poles.alignment.kernel import DEGREE, NEAR_M, camera
from roadsight.poles.alignment.pose import TURNS
from roadsight.poles.images.views import VIEWS

POSE = 8  # How many of the unknowns move what is observed: all before the insets
# Half steps of the numeric derivatives: metres, degrees, the logarithm of the focal length, px
_STEPS = np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-5, 1e-2])
# A side view whose yaw is less certain than this is not used: its axes would fit too many columns
_BLIND_DEG = 1.0


@dataclass(frozen=True)
class PoleAxes:
    """Axes of the poles of one place, each in one of its views.

    Attributes
    ----------
    view : (n,) number in `VIEWS`. middle_px : (n, 2) from the view's principal point.
    foot_px, top_px : (n,) rows of the ends, from the principal point.
    scale : (n,) focal length of the view, as a multiple of the front camera's.
    sigma_px : (n,) of an axis across. foot_visible, top_cut : (n,) bool.
    slope : (n,) columns to the right per row down.
    """

    view: Ints
    middle_px: Floats
    foot_px: Floats
    top_px: Floats
    scale: Floats
    sigma_px: Floats
    foot_visible: Bools
    top_cut: Bools
    slope: Floats

    def __len__(self) -> int:
        return len(self.view)

    def seen_by(self, view: str) -> Ints:
        """Numbers of the axes in a view."""
        return np.flatnonzero(self.view == VIEWS.index(view))


@dataclass(frozen=True)
class Columns:
    """Columns around one place.

    Attributes
    ----------
    foot_m : (n, 3) feet of the axes, local metres. top_m : (n,) height of the tops above these.
    sigma_m : (n,) of a place, each axis. open_top : (n,) whether they may be higher than that.
    """

    foot_m: Floats
    top_m: Floats
    sigma_m: Floats
    open_top: Bools


@dataclass(frozen=True)
class Landmarks:
    """What one place has of landmarks."""

    axes: PoleAxes
    columns: Columns


@dataclass(frozen=True)
class Turns:
    """Yaw of the views from the front view, clockwise.

    Attributes
    ----------
    deg, sigma_deg : (3,) in the order of `VIEWS`; a sigma of infinity: the view cannot be used.
    """

    deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sigma_deg: tuple[float, float, float] = (0.0, np.inf, np.inf)

    @classmethod
    def of(cls, unknowns: Floats, covariance: Floats) -> Turns:
        """Turns of unknowns (k,) with their covariance (k, k)."""
        sigma = np.sqrt(np.diag(covariance)[TURNS:])
        left, right = (float(s) if s < _BLIND_DEG else np.inf for s in sigma)
        deg = 0.0, float(unknowns[TURNS]), float(unknowns[TURNS + 1])
        return cls(deg, (0.0, left, right))

    def known(self, view: Ints) -> Bools:
        """Which of the axes (n,) are in a view whose yaw is known."""
        return np.isfinite(np.array(self.sigma_deg)[view])


@dataclass(frozen=True)
class LandmarkNoise:
    """What an axis and its ends are worth.

    Parameters
    ----------
    axis_px, axis_share : one sigma of an axis across: pixels, and share of the pole's width.
    foot_px : sigma of a visible foot's and an end's row. ground_m, top_m : sigma of the ground
        under a column and of its highest return.
    nearest_m, farthest_m : range of columns. clutter : what an axis without a column costs
        (log-likelihood).
    """

    axis_px: float = 0.35
    axis_share: float = 0.05
    foot_px: float = 3.0
    ground_m: float = 0.15
    top_m: float = 0.5
    nearest_m: float = 4.0
    farthest_m: float = 200.0
    clutter: float = 7.0


@dataclass(frozen=True)
class MatchedLandmarks:
    """Axes that were given a column, as the kernel takes them.

    Attributes
    ----------
    pairs : (k, 2) numbers of axis and column. observed : (k, 7) as `observed_rows`.
    mapped : (k, 4) as `mapped_rows`. sigma_rad : (k,) of the bearings.
    """

    pairs: Ints
    observed: Floats
    mapped: Floats
    sigma_rad: Floats

    def part(self, kept: Bools) -> MatchedLandmarks:
        """Some of them."""
        return MatchedLandmarks(
            self.pairs[kept], self.observed[kept], self.mapped[kept], self.sigma_rad[kept]
        )


def observed_rows(axes: PoleAxes) -> Floats:
    """Rows (n, 7): middle u, v, foot row, top row (pixels), focal scale, view, further turn."""
    ends = axes.foot_px, axes.top_px, axes.scale, axes.view, np.zeros(len(axes))
    return np.column_stack([axes.middle_px, *ends])


def mapped_rows(columns: Columns, origin_m: Floats) -> Floats:
    """Rows (m, 4): x, y, height of foot and of top, from an origin."""
    foot = columns.foot_m - origin_m
    return np.column_stack([foot, foot[:, 2] + columns.top_m])


@compiled(error_model="numpy")
def measure(unknowns: Floats, start: Floats, observed: Floats, mapped: Floats) -> Floats:
    """Rows (k, 5) of axis against column, pair by pair.

    Bearing of the axis from the column's (radians, clockwise), row of the foot and of the top from
    those that the column would have (pixels, NaN behind the camera), distance (m), and the turn
    that one pixel across makes (radians).
    """
    turn, _, centre, _ = camera(start, unknowns)
    focal = np.exp(unknowns[6])
    rows = np.empty((len(observed), 5))
    for i in range(len(observed)):
        f = focal * observed[i, 4]
        view = int(observed[i, 5])
        aside = observed[i, 6] + (unknowns[TURNS - 1 + view] * DEGREE if view else 0.0)
        c, s = np.cos(aside), np.sin(aside)
        # A side view has an optical axis of its own, which its yaw stands for.
        x = (observed[i, 0] - (0.0 if view else unknowns[7])) / f
        y = observed[i, 1] / f
        right, down, ahead = c * x + s, y, c - s * x
        east = turn[0, 0] * right + turn[1, 0] * down + turn[2, 0] * ahead
        north = turn[0, 1] * right + turn[1, 1] * down + turn[2, 1] * ahead
        dx, dy = mapped[i, 0] - centre[0], mapped[i, 1] - centre[1]
        rows[i, 0] = np.arctan2(east * dy - north * dx, east * dx + north * dy)
        for end in range(2):
            dz = mapped[i, 2 + end] - centre[2]
            right = turn[0, 0] * dx + turn[0, 1] * dy + turn[0, 2] * dz
            down = turn[1, 0] * dx + turn[1, 1] * dy + turn[1, 2] * dz
            ahead = turn[2, 0] * dx + turn[2, 1] * dy + turn[2, 2] * dz
            depth = s * right + c * ahead
            row = observed[i, 2 + end] - f * down / depth
            rows[i, 1 + end] = row if depth > NEAR_M else np.nan
        rows[i, 3] = np.sqrt(dx * dx + dy * dy)
        rows[i, 4] = 1.0 / (f * (1.0 + x * x))
    return rows


@compiled(error_model="numpy")
def slopes(unknowns: Floats, start: Floats, observed: Floats, mapped: Floats) -> Floats:
    """Derivatives (k, 3, n) of bearing, foot and top of `measure` by the unknowns (n,)."""
    found = np.zeros((len(observed), 3, len(unknowns)))
    moved = unknowns.copy()
    sides = observed[:, 5].max() > 0 if len(observed) else False
    for a in range(len(unknowns)):
        if POSE <= a < TURNS or (a >= TURNS and not sides):
            continue
        step = _STEPS[a] if a < POSE else _STEPS[3]  # Side views turn as the front view does.
        moved[a] = unknowns[a] + step
        high = measure(moved, start, observed, mapped)
        moved[a] = unknowns[a] - step
        low = measure(moved, start, observed, mapped)
        moved[a] = unknowns[a]
        for k in range(len(observed)):
            for b in range(3):
                found[k, b, a] = (high[k, b] - low[k, b]) / (2.0 * step)
    return found


@compiled(error_model="numpy")
def landmark_misfit(
    unknowns: Floats,
    start: Floats,
    observed: Floats,
    mapped: Floats,
    sigma_rad: Floats,
    scale: float,
    sloping: bool,
) -> tuple[float, Floats, Floats, Floats]:
    """Robust misfit of the bearings (Geman and McClure), as `kernel.misfit` for edges.

    Returns
    -------
    cost, normal matrix (k, k), gradient (k,), and residuals (n,) in standard deviations
    """
    size = len(unknowns)
    normal, gradient = np.zeros((size, size)), np.zeros(size)
    gap = measure(unknowns, start, observed, mapped)[:, 0] / sigma_rad
    c2 = scale * scale
    cost = 0.0
    for i in range(len(gap)):
        cost += 0.5 * c2 * gap[i] ** 2 / (c2 + gap[i] ** 2)
    if not sloping or len(gap) == 0:
        return cost, normal, gradient, gap
    slope = slopes(unknowns, start, observed, mapped)
    for i in range(len(gap)):
        weight = (c2 / (c2 + gap[i] ** 2)) ** 2
        for a in range(size):
            by = slope[i, 0, a] / sigma_rad[i]
            gradient[a] += weight * by * gap[i]
            for b in range(size):
                normal[a, b] += weight * by * slope[i, 0, b] / sigma_rad[i]
    return cost, normal, gradient, gap
