"""Log-likelihood ratio of projected samples and its slopes, compiled.

The pose moves from where it starts by along, lateral (right), up (metres; along and right of the
start's heading) and yaw, pitch, roll (degrees). Axes and angles as in `geometry.cameras`.
"""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Floats, Floats32, Ints
from roadsight.base.kernels import compiled

SIZE = 6
"""Along, lateral, up, yaw, pitch, roll."""
_NEAREST_M = 0.5
"""Samples nearer than this, or behind the camera, are in no image."""
_RADIANS = np.pi / 180.0


@compiled()
def turned(heading: float, pitch: float, roll: float) -> Floats:
    """Rotation cam_from_world and its slopes by heading, pitch and roll: (4, 3, 3); radians."""
    sin_h, cos_h = np.sin(heading), np.cos(heading)
    sin_p, cos_p = np.sin(pitch), np.cos(pitch)
    sin_r, cos_r = np.sin(roll), np.cos(roll)
    level = np.array(
        [
            [cos_h, -sin_h, 0.0],
            [sin_p * sin_h, sin_p * cos_h, -cos_p],
            [sin_h * cos_p, cos_h * cos_p, sin_p],
        ]
    )
    by_heading = np.array(
        [
            [-sin_h, -cos_h, 0.0],
            [sin_p * cos_h, -sin_p * sin_h, 0.0],
            [cos_h * cos_p, -sin_h * cos_p, 0.0],
        ]
    )
    out = np.empty((4, 3, 3))
    for k in range(3):
        out[0, 0, k] = cos_r * level[0, k] - sin_r * level[1, k]
        out[0, 1, k] = sin_r * level[0, k] + cos_r * level[1, k]
        out[0, 2, k] = level[2, k]
        out[1, 0, k] = cos_r * by_heading[0, k] - sin_r * by_heading[1, k]
        out[1, 1, k] = sin_r * by_heading[0, k] + cos_r * by_heading[1, k]
        out[1, 2, k] = by_heading[2, k]
        out[2, 0, k] = -sin_r * level[2, k]
        out[2, 1, k] = cos_r * level[2, k]
        out[2, 2, k] = -level[1, k]
        out[3, 0, k] = -out[0, 1, k]
        out[3, 1, k] = out[0, 0, k]
        out[3, 2, k] = 0.0
    return out


@compiled()
def score(  # noqa: PLR0912
    offsets: Floats,
    pose: Floats,
    lens: Floats,
    xyz_m: Floats,
    field: Ints,
    weight: Floats,
    tile: Ints,
    tiles: int,
    fields: Floats32,
    slopes: bool,
) -> tuple[float, Floats, Floats]:
    """Sum of the samples' log-likelihood ratios, its gradient by tile, Fisher's information.

    Parameters
    ----------
    offsets : (6,) from the pose, see above. pose : (6,) x, y, z (m), heading, pitch, roll (rad).
    lens : (3,) focal length, principal point u, v; px of the fields.
    xyz_m : (n, 3) samples. field, weight, tile : (n,) which field each looks up, how much it
        counts, and which part of the image it is in. tiles : how many parts there are.
    fields : (f, h, w), see `poles.images.evidence`. slopes : False: the sum alone.

    Returns
    -------
    sum, gradient (tiles, 6), information (6, 6); samples outside the image count nothing
    """
    total = 0.0
    gradient = np.zeros((tiles, SIZE))
    information = np.zeros((SIZE, SIZE))
    turns = turned(
        pose[3] + offsets[3] * _RADIANS,
        pose[4] + offsets[4] * _RADIANS,
        pose[5] + offsets[5] * _RADIANS,
    )
    north, east = np.cos(pose[3]), np.sin(pose[3])
    # Rows: along, right and up in the world.
    axes = np.array([[east, north, 0.0], [north, -east, 0.0], [0.0, 0.0, 1.0]])
    centre = np.empty(3)
    for k in range(3):
        moved = offsets[0] * axes[0, k] + offsets[1] * axes[1, k] + offsets[2] * axes[2, k]
        centre[k] = pose[k] + moved
    focal = lens[0]
    rotation = turns[0]
    motion = np.zeros((3, 3))
    for r in range(3):
        for j in range(3):
            for k in range(3):
                motion[r, j] += rotation[r, k] * axes[j, k]
    high, broad = fields.shape[1], fields.shape[2]
    row = np.empty(SIZE)
    away = np.empty(3)
    for i in range(len(xyz_m)):
        for k in range(3):
            away[k] = xyz_m[i, k] - centre[k]
        x = rotation[0, 0] * away[0] + rotation[0, 1] * away[1] + rotation[0, 2] * away[2]
        y = rotation[1, 0] * away[0] + rotation[1, 1] * away[1] + rotation[1, 2] * away[2]
        z = rotation[2, 0] * away[0] + rotation[2, 1] * away[1] + rotation[2, 2] * away[2]
        if z < _NEAREST_M:
            continue
        u, v = lens[1] + focal * x / z, lens[2] + focal * y / z
        if not (u >= 0 and v >= 0 and u < broad - 1 and v < high - 1):
            continue
        a, b = int(u), int(v)
        right, down = u - a, v - b
        own = fields[field[i]]
        share_00, share_01 = (1 - right) * (1 - down), right * (1 - down)
        share_10, share_11 = (1 - right) * down, right * down
        total += weight[i] * (
            share_00 * own[b, a]
            + share_01 * own[b, a + 1]
            + share_10 * own[b + 1, a]
            + share_11 * own[b + 1, a + 1]
        )
        if not slopes:
            continue
        # Central differences at the four pixels, as smooth as the field itself.
        a_0, a_3 = max(a - 1, 0), min(a + 2, broad - 1)
        b_0, b_3 = max(b - 1, 0), min(b + 2, high - 1)
        by_u = 0.5 * (
            share_00 * (own[b, a + 1] - own[b, a_0])
            + share_01 * (own[b, a_3] - own[b, a])
            + share_10 * (own[b + 1, a + 1] - own[b + 1, a_0])
            + share_11 * (own[b + 1, a_3] - own[b + 1, a])
        )
        by_v = 0.5 * (
            share_00 * (own[b + 1, a] - own[b_0, a])
            + share_01 * (own[b + 1, a + 1] - own[b_0, a + 1])
            + share_10 * (own[b_3, a] - own[b, a])
            + share_11 * (own[b_3, a + 1] - own[b, a + 1])
        )
        by_x, by_y = by_u * focal / z, by_v * focal / z
        by_z = -(by_x * x + by_y * y) / z
        for j in range(3):
            row[j] = -(by_x * motion[0, j] + by_y * motion[1, j] + by_z * motion[2, j])
            turn = turns[j + 1]
            turn_x = turn[0, 0] * away[0] + turn[0, 1] * away[1] + turn[0, 2] * away[2]
            turn_y = turn[1, 0] * away[0] + turn[1, 1] * away[1] + turn[1, 2] * away[2]
            turn_z = turn[2, 0] * away[0] + turn[2, 1] * away[1] + turn[2, 2] * away[2]
            row[3 + j] = (by_x * turn_x + by_y * turn_y + by_z * turn_z) * _RADIANS
        for j in range(SIZE):
            gradient[tile[i], j] += weight[i] * row[j]
            for k in range(j + 1):
                information[j, k] += weight[i] * row[j] * row[k]
    for j in range(SIZE):
        for k in range(j):
            information[k, j] = information[j, k]
    return total, gradient, information
