"""Misfit of points that two images share, with its derivatives by both poses, compiled.

A point that two cameras see lies in one plane with both centres. How far it is from that is an
angle that turns with either camera, whatever the point's distance, so that two images of the same
trees and houses tell how the camera turned between them far better than each image tells where it
looks.
"""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.base.kernels import compiled, compiled_part
from roadsight.poles.alignment.kernel import DEGREE, camera

POSED = 6  # How many of the unknowns place and turn a camera; the lens's follow
_Vector = tuple[float, float, float]
# Turn, its derivatives, centre and its derivatives, as `camera` gives them
_Camera = tuple[Floats, Floats, Floats, Floats]


@compiled(error_model="numpy")
def shared_misfit(
    unknowns: tuple[Floats, Floats],
    starts: tuple[Floats, Floats],
    pixels: Floats,
    sigma_px: float,
    scale: float,
) -> tuple[Floats, Floats, Floats]:
    """Linearised robust misfit (Geman and McClure) of points that two images share.

    The residual is Sampson's, in pixels: t . (d1 x d2) over its slope by the four coordinates, with
    rays d1, d2 and the baseline t. As angles, errors are less where rays are oblique, so that a
    shorter lens fits better: on four generated drives by 16 to 25 sigmas of what their points tell.

    Parameters
    ----------
    unknowns, starts : of both images, as `pose.UNKNOWNS` and `Start.vector` from one origin.
    pixels : (n, 4) u, v in the one and in the other. sigma_px : of a pixel, each axis.
    scale : residual in standard deviations beyond which a point no longer counts.

    Returns
    -------
    normal matrix (14, 14) and gradient (14,) by the six numbers of either pose, the logarithm of
    the focal length and the principal point's column that both share, and residuals (n,)
    """
    cameras = camera(starts[0], unknowns[0]), camera(starts[1], unknowns[1])
    base, axis1, axis2, rays1, rays2 = _seen(cameras, unknowns, starts, pixels)
    (_, turns1, _, moves1), (_, turns2, _, moves2) = cameras
    sigma = sigma_px / np.exp(0.5 * (unknowns[0][6] + unknowns[1][6]))
    normal, gradient = np.zeros((14, 14)), np.zeros(14)
    residuals = np.empty(len(pixels))
    row = np.empty(14)
    for i in range(len(pixels)):
        ray1, ray2 = _vector(rays1[i], 0), _vector(rays2[i], 0)
        side1, side2, flat1, flat2, size = _planes(base, ray1, ray2, axis1, axis2)
        plane = _cross(ray1, ray2)
        gap = _dot(base, plane) / size
        residual = gap / sigma
        residuals[i] = residual
        # The size moves, too: without its part, the shortest baseline would fit best.
        share = gap / size
        near1 = _less(side2, share, _cross(flat2, base))
        near2 = _less(side1, share, _cross(base, flat1))
        ahead1, ahead2 = share * _dot(axis1, side2), share * _dot(axis2, side1)
        for a in range(5):
            here = _dot(_vector(rays1[i], 1 + a), near1)
            there = _dot(_vector(rays2[i], 1 + a), near2)
            if a < 3:
                here += ahead1 * _dot(_vector(turns1[a], 2), side2)
                there += ahead2 * _dot(_vector(turns2[a], 2), side1)
                row[3 + a], row[9 + a] = here / size, there / size
            else:
                row[9 + a] = (here + there) / size
        row[12] += gap  # A pixel is a smaller angle.
        longer = _less(plane, share, _cross(ray1, flat2))
        x, y, z = _less(longer, share, _cross(flat1, ray2))
        _along(row[:6], starts[0], moves1, (-x / size, -y / size, -z / size))
        _along(row[6:12], starts[1], moves2, (x / size, y / size, z / size))
        weight = (scale * scale / (scale * scale + residual * residual)) ** 2
        for a in range(14):
            slope = weight * row[a] / sigma
            gradient[a] += slope * residual
            slope /= sigma
            for b in range(14):
                normal[a, b] += slope * row[b]
    return normal, gradient, residuals


@compiled(error_model="numpy")
def shared_residuals(
    unknowns: tuple[Floats, Floats], starts: tuple[Floats, Floats], pixels: Floats, sigma_px: float
) -> Floats:
    """Residuals (n,) of points that two images share, as of `shared_misfit`."""
    cameras = camera(starts[0], unknowns[0]), camera(starts[1], unknowns[1])
    base, axis1, axis2, rays1, rays2 = _seen(cameras, unknowns, starts, pixels)
    sigma = sigma_px / np.exp(0.5 * (unknowns[0][6] + unknowns[1][6]))
    residuals = np.empty(len(pixels))
    for i in range(len(pixels)):
        ray1, ray2 = _vector(rays1[i], 0), _vector(rays2[i], 0)
        size = _planes(base, ray1, ray2, axis1, axis2)[4]
        residuals[i] = _dot(base, _cross(ray1, ray2)) / size / sigma
    return residuals


@compiled_part(error_model="numpy")
def _seen(
    cameras: tuple[_Camera, _Camera],
    unknowns: tuple[Floats, Floats],
    starts: tuple[Floats, Floats],
    pixels: Floats,
) -> tuple[_Vector, _Vector, _Vector, Floats, Floats]:
    """Baseline, both optical axes, and the rays of both images as `_rays` gives them."""
    (turn1, turns1, centre1, _), (turn2, turns2, centre2, _) = cameras
    apart = centre2 - centre1
    rays1 = _rays(pixels[:, :2], starts[0], unknowns[0], turn1, turns1)
    rays2 = _rays(pixels[:, 2:], starts[1], unknowns[1], turn2, turns2)
    base = (apart[0], apart[1], apart[2])
    return base, _vector(turn1, 2), _vector(turn2, 2), rays1, rays2


@compiled_part(error_model="numpy")
def _rays(pixels: Floats, start: Floats, unknowns: Floats, turn: Floats, turns: Floats) -> Floats:
    """Rays in the world that reach to the plane at 1, each before its derivatives (n, 6, 3).

    They are by yaw, pitch, roll (degrees), the logarithm of the focal length and the principal
    point's column.
    """
    focal = np.exp(unknowns[6])
    rays = np.empty((len(pixels), 6, 3))
    for i in range(len(pixels)):
        x = (pixels[i, 0] - start[6] - unknowns[7]) / focal
        y = (pixels[i, 1] - start[7]) / focal
        for k in range(3):
            rays[i, 0, k] = x * turn[0, k] + y * turn[1, k] + turn[2, k]
            for a in range(3):
                rays[i, 1 + a, k] = x * turns[a, 0, k] + y * turns[a, 1, k] + turns[a, 2, k]
            # A longer lens draws a ray towards the axis.
            rays[i, 4, k] = turn[2, k] - rays[i, 0, k]
            rays[i, 5, k] = -turn[0, k] / focal
    return rays


@compiled_part(error_model="numpy")
def _planes(
    base: _Vector, ray1: _Vector, ray2: _Vector, axis1: _Vector, axis2: _Vector
) -> tuple[_Vector, _Vector, _Vector, _Vector, float]:
    """Normals of the planes of baseline and rays, the same flat in their images, and their size."""
    side1, side2 = _cross(base, ray1), _cross(ray2, base)
    # What moves a pixel lies in its image: the part along the optical axis does not count.
    flat1 = _less(side2, _dot(axis1, side2), axis1)
    flat2 = _less(side1, _dot(axis2, side1), axis2)
    # Two cameras at one place have a residual of 0, not of 0 / 0.
    size = np.sqrt(_dot(flat1, flat1) + _dot(flat2, flat2)) + 1e-300
    return side1, side2, flat1, flat2, size


@compiled_part(error_model="numpy")
def _along(row: Floats, start: Floats, moves: Floats, by_centre: _Vector) -> None:
    """Fill the derivatives by the place, which also turns a camera with its road."""
    for a in range(3):
        row[a] = _dot(_vector(moves, a), by_centre)
    row[0] += (start[10] * row[3] + start[11] * row[4]) / DEGREE


@compiled_part(error_model="numpy")
def _vector(rows: Floats, a: int) -> _Vector:
    """Numbers, not a view of an array: three of them need no memory of their own."""
    return rows[a, 0], rows[a, 1], rows[a, 2]


@compiled_part(error_model="numpy")
def _dot(a: _Vector, b: _Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled_part(error_model="numpy")
def _less(a: _Vector, times: float, b: _Vector) -> _Vector:
    return a[0] - times * b[0], a[1] - times * b[1], a[2] - times * b[2]


@compiled_part(error_model="numpy")
def _cross(a: _Vector, b: _Vector) -> _Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
