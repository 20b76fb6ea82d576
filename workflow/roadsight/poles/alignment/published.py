"""The pole study's alignment: Nelder-Mead from a camera that a person registered (section 3.2.4).

Where the study's text leaves a number open, it is that of the authors' public code. Lengths are
feet and angles degrees, as there, because the step with which the simplex begins and the tolerance
with which it ends depend on the unit. Pixels are the image's own whole numbers; distances in pixels
are stated for the study's images, 1200 px high, and scaled with the height.

A camera is six parameters in the axes of OpenGL (x right, y up, z back): p_camera = R p + t, where
p is in the axes of the image's own line of travel and R = Rz Ry Rx. Parameters are t (feet) and the
angles about x, y and z (degrees). The field of view stays that of the baseline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from roadsight.base.arrays import Floats
from roadsight.base.kernels import compiled
from roadsight.base.sections.poles import AlignmentLimits
from roadsight.geometry.cameras import attitude_deg, cam_from_world
from roadsight.poles.alignment.pose import FOCAL
from roadsight.poles.images.views import scale_of

FOOT_M = 0.3048
# Range of the LiDAR edge points that are compared (authors' code)
NEAREST_M, FARTHEST_M = 40 * FOOT_M, 800 * FOOT_M
# How far a parameter may be from the baseline's, m and degrees (1.1 ft, 0.11; authors' code)
PUBLISHED_BOUNDS = (AlignmentLimits().bound_m, AlignmentLimits().bound_deg)
# Edge pixels that far off or farther along either axis are no partners (authors' code)
WINDOW_PX = 300.0
_FIRST_WINDOW_PX = 50.0  # The same when the baseline is judged (authors' code)
_NO_PARTNER = 1e6  # Cost of a side without points, pixels or any pair (authors' code)
# A baseline whose cost and distances are below these is taken as it is (authors' code)
_GOOD_COST, _GOOD_PX = 1400.0, 150.0
_ITERATIONS = 1000
# Bounds of parameters (feet, degrees) where the baseline is far off (authors' code)
_MENDED = np.array([[-10, 10], [-11, 11], [-18, 18], [-2, 2], [-3, 3], [-2, 2]], float)
_WIDE_ROAD_PX = 500.0  # Width of edges along a row from which its ends are compared (authors' code)
_GL_FROM_CV = np.diag([1.0, -1.0, -1.0])
# From right, up, back to right, ahead, up
_LEVEL_FROM_GL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class Axes:
    """Axes of one image's line of travel.

    Attributes
    ----------
    origin_m : (3,) where the videolog puts the camera, on the road; local metres.
    rotation : (3, 3) whose rows are right, up (square to the line) and back.
    """

    origin_m: Floats
    rotation: Floats

    @classmethod
    def along(cls, origin_m: ArrayLike, direction: ArrayLike) -> Axes:
        """Axes whose back is against a direction (3,)."""
        back = -np.asarray(direction, np.float64) / np.linalg.norm(direction)
        up = np.array([0.0, 0.0, 1.0]) - back[2] * back
        up /= np.linalg.norm(up)
        return cls(np.asarray(origin_m, np.float64), np.stack([np.cross(up, back), up, back]))

    def feet(self, xyz_m: Floats) -> Floats:
        """Points (n, 3) in these axes, feet."""
        return (xyz_m - self.origin_m) @ self.rotation.T / FOOT_M


@dataclass(frozen=True)
class Edges:
    """What is compared in one image, sides apart (left, right).

    Attributes
    ----------
    points_ft : (n, 3) of each side, LiDAR road edges in the image's `Axes`.
    pixels : (m, 2) of each side, whole pixels of road edges in the image, sorted by row.
    size_px : width and height of the image.
    """

    points_ft: tuple[Floats, Floats]
    pixels: tuple[Floats, Floats]
    size_px: tuple[int, int]


def nelder_mead(
    edges: Edges,
    start: Floats,
    focal_px: float,
    number: int,
    bounds: tuple[float, float] = PUBLISHED_BOUNDS,
) -> tuple[Floats, float]:
    """Parameters (6,) of one image, feet and degrees, and their cost.

    Those of the baseline, where its edges fit; else by Nelder-Mead.

    Parameters
    ----------
    start : (6,) of the baseline, the same for all images of a size. focal_px : fixed.
    number : of the image in its route, from 0. bounds : as `bounds_of`.
    """
    first = (_FIRST_WINDOW_PX, _FIRST_WINDOW_PX)
    cost = alignment_cost(edges, start, focal_px, first)
    x_px, y_px = apart = extents_apart(edges, start, focal_px)
    if cost < _GOOD_COST and x_px < _GOOD_PX and y_px < _GOOD_PX:
        return start, cost
    window = window_of(apart)
    limits = bounds_of(start, number, cost, apart, bounds)
    result = minimize(
        lambda parameters: alignment_cost(edges, parameters, focal_px, window),
        np.clip(start, *limits.T),
        method="Nelder-Mead",
        bounds=limits,
        options={"maxiter": _ITERATIONS},
    )
    return result.x, float(result.fun)


def bounds_of(
    start: Floats,
    number: int,
    cost: float,
    apart_px: tuple[float, float],
    bounds: tuple[float, float] = PUBLISHED_BOUNDS,
) -> Floats:
    """Bounds (6, 2) of the parameters, feet and degrees (authors' code).

    The wide ones are about zero and not about the baseline; they are in the same axes as the
    parameters, so that nothing is turned.

    Parameters
    ----------
    start : (6,) baseline. number : of the image in its route, from 0. cost, apart_px : of the
        baseline, px of an image 1200 px high. bounds : m and degrees.
    """
    late = number > 11
    turn_deg = bounds[1]
    if late and cost > 2000.0:
        turn_deg = 0.2 if cost < 3000.0 else 0.5
    reach = np.repeat([bounds[0] / FOOT_M, turn_deg], 3)
    found = np.column_stack([start - reach, start + reach])
    x_px, y_px = apart_px
    if late and not (x_px < 100.0 and y_px < 100.0):
        wide = np.array([x_px > 90.0, *[y_px > 90.0] * 5])
        found[wide] = _MENDED[wide]
    return found


def window_of(apart_px: tuple[float, float]) -> tuple[float, float]:
    """Window along u and v for edges whose ends are so far apart (authors' code)."""
    x_px, y_px = (px + 200.0 if px > WINDOW_PX else WINDOW_PX for px in apart_px)
    return x_px, y_px


def extents_apart(edges: Edges, parameters: Floats, focal_px: float) -> tuple[float, float]:
    """How far the ends of both kinds of edges are apart along u and v, px of an image 1200 px high.

    Along v, the upper ends. Along u, the larger distance of left and right ends on the lowest row
    on which both are 500 px wide; without such a row the (signed) distance of the left ends, as in
    the authors' code. NaN where no edge point is in the image.
    """
    scale, pixels = scale_of(edges.size_px[1]), np.concatenate(edges.pixels)
    sides = [projected(side, parameters, focal_px, edges.size_px) for side in edges.points_ft]
    uv = np.concatenate(sides)
    uv = uv[((uv >= 0) & (uv <= edges.size_px)).all(axis=1)]
    if not len(uv) or not len(pixels):
        return float("nan"), float("nan")
    y_px = abs(pixels[:, 1].min() - uv[:, 1].min()) / scale
    for row in np.intersect1d(pixels[:, 1], uv[:, 1])[::-1]:
        on_row = (kind[kind[:, 1] == row, 0] for kind in (pixels, uv))
        ends = np.array([(u.min(), u.max()) for u in on_row])
        if np.ptp(ends, axis=1).min() >= _WIDE_ROAD_PX * scale:
            return float(np.abs(ends[0] - ends[1]).max() / scale), float(y_px)
    return float((uv[:, 0].min() - pixels[:, 0].min()) / scale), float(y_px)


def alignment_cost(
    edges: Edges, parameters: Floats, focal_px: float, window_px: tuple[float, float]
) -> float:
    """Sum over both sides of the mean squared distance, px2 of an image 1200 px high.

    A point counts by its nearest pixel of its side within the window, wherever it is projected; a
    point without one by its largest distance along an axis to any pixel of its side, not squared.
    """
    scale = scale_of(edges.size_px[1])
    return sum(
        _side_cost(projected(points, parameters, focal_px, edges.size_px), pixels, window_px, scale)
        for points, pixels in zip(edges.points_ft, edges.pixels, strict=True)
    )


def _side_cost(
    points: Floats, pixels: Floats, window_px: tuple[float, float], scale: float
) -> float:
    if not len(points) or not len(pixels):
        return _NO_PARTNER
    squares = window_squares(points, pixels, window_px[0] * scale, window_px[1] * scale)
    alone = ~np.isfinite(squares)
    if alone.all():
        return _NO_PARTNER
    squares /= scale**2
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    lost = points[alone]
    squares[alone] = np.maximum(np.abs(lost - low), np.abs(lost - high)).max(axis=1) / scale
    return float(squares.mean())


@compiled(error_model="numpy")
def window_squares(points: Floats, pixels: Floats, wide_px: float, high_px: float) -> Floats:
    """Squared distance (n,) of points to the nearest pixel in their window, infinite without one.

    Parameters
    ----------
    points : (n, 2). pixels : (m, 2), sorted by row (`by_row`). wide_px, high_px : a pixel is in the
        window if it is less than this far off along u and v.
    """
    found = np.full(len(points), np.inf)
    rows = pixels[:, 1].copy()
    for i in range(len(points)):
        u, v = points[i]
        best = np.inf
        first = np.searchsorted(rows, v)
        # Rows are followed up and down until they alone are farther than the best pixel.
        for way in (-1, 1):
            j = first - 1 if way < 0 else first
            while 0 <= j < len(rows):
                dv = abs(rows[j] - v)
                if dv >= high_px or dv * dv >= best:
                    break
                du = abs(pixels[j, 0] - u)
                if du < wide_px:
                    best = min(best, du * du + dv * dv)
                j += way
        found[i] = best
    return found


def projected(
    points_ft: Floats, parameters: Floats, focal_px: float, size_px: tuple[int, int]
) -> Floats:
    """Whole pixels (n, 2) of points; far outside of the image where they are not ahead."""
    turn = Rotation.from_euler("xyz", parameters[3:], degrees=True).as_matrix()
    x, y, z = (points_ft @ turn.T + parameters[:3]).T
    ahead = -z > 0
    reach = np.where(ahead, -z, np.nan)
    middle = (np.asarray(size_px, np.float64) - 1.0) / 2.0
    uv = middle + focal_px * np.column_stack([x / reach, -y / reach])
    return np.where(ahead[:, None], whole_pixels(uv), -99_999.0)


def whole_pixels(uv_px: ArrayLike) -> Floats:
    """Whole pixels (n, 2) in which places lie, cut towards zero as in the authors' code.

    There a pixel begins at its whole number; here that is its middle.
    """
    return np.asarray(np.trunc(np.asarray(uv_px, np.float64) + 0.5), np.float64)


def by_row(pixels: Floats) -> Floats:
    """Pixels (m, 2) by row and then by column, as `window_squares` takes them."""
    return np.ascontiguousarray(pixels[np.lexsort((pixels[:, 0], pixels[:, 1]))])


def start_of(unknowns: Floats) -> tuple[Floats, float]:
    """Parameters (6,) and focal length in pixels of a registered camera.

    Parameters
    ----------
    unknowns : (SIZE,) of `pose.UNKNOWNS`; against the line of travel where others take them
        against the road.
    """
    along, lateral, height, yaw, pitch, roll, log_focal = unknowns[: FOCAL + 1]
    rotation = _GL_FROM_CV @ cam_from_world(yaw, pitch, roll) @ _LEVEL_FROM_GL
    moved = -rotation @ np.array([lateral, height, -along]) / FOOT_M
    angles = Rotation.from_matrix(rotation).as_euler("xyz", degrees=True)
    return np.concatenate([moved, angles]), float(np.exp(log_focal))


def pose_in(axes: Axes, parameters: Floats) -> dict[str, float]:
    """Position (local metres) and attitude of a camera, by the names of the cameras' table."""
    rotation = Rotation.from_euler("xyz", parameters[3:], degrees=True).as_matrix()
    position = axes.origin_m - axes.rotation.T @ rotation.T @ parameters[:3] * FOOT_M
    heading, pitch, roll = attitude_deg(_GL_FROM_CV @ rotation @ axes.rotation)
    names = ("x", "y", "z", "heading_deg", "pitch_deg", "roll_deg")
    return dict(zip(names, map(float, (*position, heading, pitch, roll)), strict=True))
