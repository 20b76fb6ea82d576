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
from roadsight.poles.alignment.kernel import camera

_DEGREE = np.pi / 180.0
"""Radians in a degree."""
POSED = 6
"""How many of the unknowns place and turn a camera; the lens's follow."""


@compiled_part(error_model="numpy")
def _rays(
    pixels: Floats, start: Floats, unknowns: Floats, turn: Floats, turns: Floats
) -> tuple[Floats, Floats]:
    """Rays (n, 3) in the world, as long as they reach the plane at 1, and derivatives (n, 5, 3).

    They are by yaw, pitch, roll (degrees), the logarithm of the focal length and the principal
    point's column.
    """
    focal = np.exp(unknowns[6])
    rays, moved = np.empty((len(pixels), 3)), np.empty((len(pixels), 5, 3))
    for i in range(len(pixels)):
        x = (pixels[i, 0] - start[6] - unknowns[7]) / focal
        y = (pixels[i, 1] - start[7]) / focal
        for k in range(3):
            rays[i, k] = x * turn[0, k] + y * turn[1, k] + turn[2, k]
            for a in range(3):
                moved[i, a, k] = x * turns[a, 0, k] + y * turns[a, 1, k] + turns[a, 2, k]
            # A longer lens draws a ray towards the axis.
            moved[i, 3, k] = turn[2, k] - rays[i, k]
            moved[i, 4, k] = -turn[0, k] / focal
    return rays, moved


@compiled_part(error_model="numpy")
def _cross(a: Floats, b: Floats) -> Floats:
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


@compiled_part(error_model="numpy")
def _along(row: Floats, start: Floats, moves: Floats, by_centre: Floats) -> None:
    """Fill the derivatives by the place, which also turns a camera with its road."""
    for a in range(3):
        row[a] = moves[a] @ by_centre
    row[0] += (start[10] * row[3] + start[11] * row[4]) / _DEGREE


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
    turn1, turns1, centre1, moves1 = camera(starts[0], unknowns[0])
    turn2, turns2, centre2, moves2 = camera(starts[1], unknowns[1])
    rays1, moved1 = _rays(pixels[:, :2], starts[0], unknowns[0], turn1, turns1)
    rays2, moved2 = _rays(pixels[:, 2:], starts[1], unknowns[1], turn2, turns2)
    base = centre2 - centre1
    sigma = sigma_px / np.exp(0.5 * (unknowns[0][6] + unknowns[1][6]))
    normal, gradient = np.zeros((14, 14)), np.zeros(14)
    residuals = np.empty(len(pixels))
    row = np.empty(14)
    for i in range(len(pixels)):
        side1, side2 = _cross(base, rays1[i]), _cross(rays2[i], base)
        plane = _cross(rays1[i], rays2[i])
        # What moves a pixel lies in its image: the part along the optical axis does not count.
        ahead1, ahead2 = turn1[2] @ side2, turn2[2] @ side1
        flat1, flat2 = side2 - ahead1 * turn1[2], side1 - ahead2 * turn2[2]
        # Two cameras at one place have a residual of 0, not of 0 / 0.
        size = np.sqrt(flat1 @ flat1 + flat2 @ flat2) + 1e-300
        gap = (base @ plane) / size
        residual = gap / sigma
        residuals[i] = residual
        # The size moves, too: without its part, the shortest baseline would fit best.
        near1, near2 = _cross(flat2, base), _cross(base, flat1)
        for a in range(5):
            here = moved1[i, a] @ (side2 - gap / size * near1)
            there = moved2[i, a] @ (side1 - gap / size * near2)
            if a < 3:
                here += gap / size * ahead1 * (turns1[a, 2] @ side2)
                there += gap / size * ahead2 * (turns2[a, 2] @ side1)
                row[3 + a], row[9 + a] = here / size, there / size
            else:
                row[9 + a] = (here + there) / size
        row[12] += gap  # A pixel is a smaller angle.
        longer = _cross(rays1[i], flat2) + _cross(flat1, rays2[i])
        by_base = (plane - gap / size * longer) / size
        _along(row[:6], starts[0], moves1, -by_base)
        _along(row[6:12], starts[1], moves2, by_base)
        weight = (scale * scale / (scale * scale + residual * residual)) ** 2
        for a in range(14):
            slope = row[a] / sigma
            gradient[a] += weight * slope * residual
            for b in range(a + 1):
                normal[a, b] += weight * slope * row[b] / sigma
    for a in range(14):
        for b in range(a):
            normal[b, a] = normal[a, b]
    return normal, gradient, residuals
