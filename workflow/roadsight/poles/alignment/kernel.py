"""Misfit of image edges and projected road edges with its derivatives, compiled.

Every image edge pixel is compared with the projected edge of its own side: the distance across
the edge at the nearest projected point, divided by what the pixel and the LiDAR are worth there.
Pixels cannot leave the image, so that a pose cannot improve by moving the road out of sight.
"""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.base.kernels import compiled, compiled_part

DEGREE = np.pi / 180.0  # Radians in a degree
# Points less far in front of the camera are not projected: near its plane they go to infinity
NEAR_M = 1.0
# Points in a box: smaller boxes are more boxes to compare, larger ones more distances in each
_BLOCK = 8


@compiled(error_model="numpy")
def misfit(  # noqa: PLR0912, PLR0915 - one pass over the pixels, compiled as a whole
    unknowns: Floats,
    start: Floats,
    edges: tuple[Floats, Floats, Floats, Floats],
    sides: Ints,
    pixels: Floats,
    groups: Ints,
    noise: Floats,
    scale: float,
    slopes: bool,
) -> tuple[float, Floats, Floats, Floats]:
    """Robust misfit of all pixels.

    minimise over the pose: sum of c^2 e^2 / (c^2 + e^2) / 2 (Geman and McClure), where e is the
    distance across the projected edge, in standard deviations, and c the scale.

    Parameters
    ----------
    unknowns : as `pose.UNKNOWNS`. start : `Start.vector`.
    edges : points, directions, inward normals (n, 3) and half lengths (n,), left ones first.
    sides : (3,) where left and right begin and end in ``edges``.
    pixels : (m, 2) u, v grouped: lane left, lane right, border left, border right.
    groups : (5,) where each group begins and ends.
    noise : (2, 4) of lanes and borders: one sigma of a pixel (px), of an edge across (m) and in
        height (m), and how much each pixel counts.
    scale : c, in standard deviations.
    slopes : whether to compute the derivatives.

    Returns
    -------
    cost, Gauss-Newton normal matrix (k, k), gradient (k,), and (m, 2) of each pixel: its signed
    distance in pixels (NaN without any edge) and in standard deviations.
    """
    size = len(unknowns)
    normal, gradient = np.zeros((size, size)), np.zeros(size)
    residuals = np.full((len(pixels), 2), np.inf)
    turn, turns, centre, moves = camera(start, unknowns)
    focal = np.exp(unknowns[6])
    middle = np.array([start[6] + unknowns[7], start[7]])
    row, used = np.empty(9), np.arange(9)
    offset = np.empty(3)
    cost = 0.0
    c2 = scale * scale
    for group in range(4):
        if groups[group] == groups[group + 1]:
            continue
        one = slice(sides[group % 2], sides[group % 2 + 1])
        xyz, along, inward, half = edges[0][one], edges[1][one], edges[2][one], edges[3][one]
        inset = unknowns[8 + group]
        used[8] = 8 + group
        own = noise[group // 2]
        pixel2, aside2, upward2, share = own[0] ** 2, own[1] ** 2, own[2] ** 2, own[3]
        rows = _project(xyz, along, inward, half, inset, turn, centre, focal, middle)
        boxes = _boxes(rows)
        for i in range(groups[group], groups[group + 1]):
            if len(rows) == 0:
                cost += 0.5 * share * c2
                continue
            near = rows[_nearest(rows, boxes, pixels[i, 0], pixels[i, 1])]
            du, dv = pixels[i, 0] - near[0], pixels[i, 1] - near[1]
            nu, nv = near[3], -near[2]
            across = nu * du + nv * dv
            # How far past the ends of its piece, with two pixels of slack, a pixel lies.
            beyond = max(0.0, abs(near[2] * du + near[3] * dv) - near[4] - 2.0)
            j, x, y, z = int(near[5]), near[6], near[7], near[8]
            # Image motion across the edge of a camera-frame motion (a, b, c) of the point.
            ka, kb = focal * nu / z, focal * nv / z
            kc = -(ka * x + kb * y) / z
            aside, upward = 0.0, 0.0
            for k in range(3):
                column = ka * turn[0, k] + kb * turn[1, k] + kc * turn[2, k]
                aside += column * inward[j, k]
                if k == 2:
                    upward = column
            variance = pixel2 + aside2 * aside**2 + upward2 * upward**2
            e2 = (across * across + beyond * beyond) / variance
            cost += 0.5 * share * c2 * e2 / (c2 + e2)
            residuals[i, 0] = across
            residuals[i, 1] = np.sqrt(e2)
            if not slopes:
                continue
            weight = share * (c2 / (c2 + e2)) ** 2 / variance
            for k in range(3):
                offset[k] = xyz[j, k] + inset * inward[j, k] - centre[k]
            for a in range(3):
                shift, swing = 0.0, 0.0
                for k in range(3):
                    column = ka * turn[0, k] + kb * turn[1, k] + kc * turn[2, k]
                    shift -= column * moves[a, k]
                    column = ka * turns[a, 0, k] + kb * turns[a, 1, k] + kc * turns[a, 2, k]
                    swing += column * offset[k]
                row[a], row[3 + a] = shift, swing
            # Further along the road the camera also turns with the road's bend and hump.
            row[0] += (start[10] * row[3] + start[11] * row[4]) / DEGREE
            row[6] = focal * (nu * x + nv * y) / z
            row[7] = nu
            row[8] = aside
            for a in range(9):
                pull = weight * row[a]
                gradient[used[a]] -= pull * across
                for b in range(a + 1):
                    normal[used[a], used[b]] += pull * row[b]
    for a in range(size):
        for b in range(a):
            normal[b, a] = normal[a, b]
    return cost, normal, gradient, residuals


@compiled(error_model="numpy")
def costs(
    trials: Floats,
    start: Floats,
    edges: tuple[Floats, Floats, Floats, Floats],
    sides: Ints,
    pixels: Floats,
    groups: Ints,
    noise: Floats,
    scale: float,
) -> Floats:
    """Misfit of many sets of unknowns (t, k)."""
    values = np.empty(len(trials))
    for t in range(len(trials)):
        values[t] = misfit(trials[t], start, edges, sides, pixels, groups, noise, scale, False)[0]
    return values


@compiled(error_model="numpy")
def camera(start: Floats, unknowns: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """cam_from_world, its derivatives by yaw, pitch, roll (degrees), centre, its derivatives."""
    heading = start[3] + start[10] * unknowns[0] + unknowns[3] * DEGREE
    pitch = start[4] + start[11] * unknowns[0] + unknowns[4] * DEGREE
    roll = start[5] + unknowns[5] * DEGREE
    turn = turned(heading, pitch, roll)
    for a in range(1, 4):
        for j in range(3):
            for k in range(3):
                turn[a, j, k] *= DEGREE
    north, east = np.cos(start[3]), np.sin(start[3])
    moves = np.array([[east, north, start[8]], [north, -east, start[9]], [0.0, 0.0, 1.0]])
    centre = start[:3] + unknowns[:3] @ moves
    return turn[0], turn[1:], centre, moves


@compiled(error_model="numpy")
def turned(heading: float, pitch: float, roll: float) -> Floats:
    """Rotation cam_from_world and its slopes by heading, pitch and roll: (4, 3, 3); radians."""
    sh, ch, sp, cp = np.sin(heading), np.cos(heading), np.sin(pitch), np.cos(pitch)
    sr, cr = np.sin(roll), np.cos(roll)
    level = np.array([[ch, -sh, 0.0], [sp * sh, sp * ch, -cp], [sh * cp, ch * cp, sp]])
    by_yaw = np.array([[-sh, -ch, 0.0], [sp * ch, -sp * sh, 0.0], [ch * cp, -sh * cp, 0.0]])
    turn = np.empty((4, 3, 3))
    for k in range(3):
        turn[0, 0, k] = cr * level[0, k] - sr * level[1, k]
        turn[0, 1, k] = sr * level[0, k] + cr * level[1, k]
        turn[0, 2, k] = level[2, k]
        turn[1, 0, k] = cr * by_yaw[0, k] - sr * by_yaw[1, k]
        turn[1, 1, k] = sr * by_yaw[0, k] + cr * by_yaw[1, k]
        turn[1, 2, k] = by_yaw[2, k]
        turn[2, 0, k] = -sr * level[2, k]
        turn[2, 1, k] = cr * level[2, k]
        turn[2, 2, k] = -level[1, k]
        turn[3, 0, k] = -turn[0, 1, k]
        turn[3, 1, k] = turn[0, 0, k]
        turn[3, 2, k] = 0.0
    return turn


@compiled_part(error_model="numpy")
def _project(
    xyz: Floats,
    along: Floats,
    inward: Floats,
    half: Floats,
    inset: float,
    turn: Floats,
    centre: Floats,
    focal: float,
    middle: Floats,
) -> Floats:
    """Rows of projected points by v: u, v, unit tangent (2), half length px, number, x, y, z."""
    rows = np.empty((len(xyz), 9))
    count = 0
    for j in range(len(xyz)):
        x, y, z = 0.0, 0.0, 0.0
        tx, ty, tz = 0.0, 0.0, 0.0
        for k in range(3):
            d = xyz[j, k] + inset * inward[j, k] - centre[k]
            x += turn[0, k] * d
            y += turn[1, k] * d
            z += turn[2, k] * d
            tx += turn[0, k] * along[j, k]
            ty += turn[1, k] * along[j, k]
            tz += turn[2, k] * along[j, k]
        if z < NEAR_M:
            continue
        tu, tv = focal * (tx - x / z * tz) / z, focal * (ty - y / z * tz) / z
        # A piece that points at the camera has no length in the image.
        length = max(np.sqrt(tu * tu + tv * tv), 1e-12)
        row = rows[count]
        row[0], row[1] = middle[0] + focal * x / z, middle[1] + focal * y / z
        row[2], row[3], row[4], row[5] = tu / length, tv / length, length * half[j], j
        row[6], row[7], row[8] = x, y, z
        count += 1
    rows = rows[:count]
    return rows[np.argsort(rows[:, 1], kind="mergesort")]


@compiled_part(error_model="numpy")
def _boxes(rows: Floats) -> Floats:
    """Least and greatest u and v (b, 4) of every few rows, which are sorted by v."""
    boxes = np.empty(((len(rows) + _BLOCK - 1) // _BLOCK, 4))
    for b in range(len(boxes)):
        first, last = b * _BLOCK, min((b + 1) * _BLOCK, len(rows)) - 1
        low = high = rows[first, 0]
        for k in range(first + 1, last + 1):
            low, high = min(low, rows[k, 0]), max(high, rows[k, 0])
        boxes[b, 0], boxes[b, 1], boxes[b, 2], boxes[b, 3] = (
            low,
            high,
            rows[first, 1],
            rows[last, 1],
        )
    return boxes


@compiled_part(error_model="numpy")
def _nearest(rows: Floats, boxes: Floats, u: float, v: float) -> int:
    """Row nearest to a pixel; rows are sorted by v, and there is at least one.

    Far down the road many points lie within few rows of pixels: boxes around a few of them each
    spare most of the distances.
    """
    high = min(int(np.searchsorted(boxes[:, 3], v)), len(boxes) - 1)
    low = high - 1
    best, found = np.inf, 0
    while low >= 0 or high < len(boxes):
        down = max(v - boxes[low, 3], 0.0) if low >= 0 else np.inf
        up = max(boxes[high, 2] - v, 0.0) if high < len(boxes) else np.inf
        apart = min(down, up)
        if apart * apart >= best:
            break
        if up <= down:
            b = high
            high += 1
        else:
            b = low
            low -= 1
        aside = max(boxes[b, 0] - u, u - boxes[b, 1], 0.0)
        if aside * aside + apart * apart >= best:
            continue
        for k in range(b * _BLOCK, min((b + 1) * _BLOCK, len(rows))):
            gap = (rows[k, 0] - u) ** 2 + (rows[k, 1] - v) ** 2
            if gap < best:
                best, found = gap, k
    return found
