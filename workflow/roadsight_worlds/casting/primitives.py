"""Closed-form ray intersections with the bodies that scenes are built from, float64.

Every body stands in its own frame: centre at the origin, axes along x, y, z, three half sizes.
A ray enters that frame by a rotation, so that any body may point anywhere. Bodies are surfaces:
a ray that starts inside one meets its inner face. Ranges that are not above `MIN_RANGE_M` do not
count, so that a ray may start on a surface. A ray that only touches a body meets it; one that runs
within the plane of a rectangle does not.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats, Ints32
from roadsight_worlds.casting.kernel import kernel

MIN_RANGE_M = 1e-6  # Hits no further than this are the surface that the ray starts on.
RECTANGLE, BOX, CYLINDER, TUBE, ELLIPSOID = range(5)


class Bodies(NamedTuple):
    """Packed bodies; row i of every array belongs to body i.

    Parameters
    ----------
    kind : (n,) int8: RECTANGLE (in its x, y plane), BOX, CYLINDER (about z, with caps), TUBE (about
        z, open ends) or ELLIPSOID.
    centre_m : (n, 3) local metres.
    scene_from_body : (n, 3, 3) rotations.
    half_m : (n, 3) half sizes; a cylinder or tube has its radius in the first two.
    object_id : (n,) int32, the object of the scene that the body is part of.
    """

    kind: NDArray[np.int8]
    centre_m: Floats
    scene_from_body: Floats
    half_m: Floats
    object_id: Ints32


@kernel
def _slab(start: float, step: float, half: float) -> tuple[float, float]:
    """Ranges between which ``|start + t step| <= half``; an empty interval has near > far."""
    if step == 0.0:
        if abs(start) <= half:
            return -math.inf, math.inf
        return math.inf, -math.inf
    a, b = (-half - start) / step, (half - start) / step
    return min(a, b), max(a, b)


@kernel
def _first(near: float, far: float) -> float:
    """The nearer of two crossings of a closed surface that lies ahead."""
    if near > far:
        return math.inf
    if near > MIN_RANGE_M:
        return near
    return far if far > MIN_RANGE_M else math.inf


@kernel
def ray_rectangle(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, hx: float, hy: float
) -> float:
    """Range to the rectangle |x| <= hx, |y| <= hy in the plane z = 0; infinity if missed."""
    if dz == 0.0:
        return math.inf
    t = -oz / dz
    inside = abs(ox + t * dx) <= hx and abs(oy + t * dy) <= hy
    return t if inside and t > MIN_RANGE_M else math.inf


@kernel
def ray_box(
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    hx: float,
    hy: float,
    hz: float,
) -> float:
    """Range to the box with half sizes hx, hy, hz; infinity if missed."""
    near_x, far_x = _slab(ox, dx, hx)
    near_y, far_y = _slab(oy, dy, hy)
    near_z, far_z = _slab(oz, dz, hz)
    return _first(max(near_x, near_y, near_z), min(far_x, far_y, far_z))


@kernel
def _round_interval(
    along: float, speed2: float, closest2: float, radius2: float
) -> tuple[float, float]:
    """Ranges between which a ray is within a radius; ``along`` is the range of closest approach."""
    if closest2 > radius2:
        return math.inf, -math.inf
    reach = math.sqrt((radius2 - closest2) / speed2)
    return along - reach, along + reach


@kernel
def _disc_interval(
    ox: float, oy: float, dx: float, dy: float, radius: float
) -> tuple[float, float]:
    """Ranges between which a ray is within ``radius`` of the z axis."""
    speed2 = dx * dx + dy * dy
    if speed2 == 0.0:
        if ox * ox + oy * oy <= radius * radius:
            return -math.inf, math.inf
        return math.inf, -math.inf
    cross = ox * dy - oy * dx
    along = -(ox * dx + oy * dy) / speed2
    return _round_interval(along, speed2, cross * cross / speed2, radius * radius)


@kernel
def ray_cylinder(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, radius: float, hz: float
) -> float:
    """Range to the capped cylinder about z with half height hz; infinity if missed."""
    near, far = _disc_interval(ox, oy, dx, dy, radius)
    low, high = _slab(oz, dz, hz)
    return _first(max(near, low), min(far, high))


@kernel
def ray_tube(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, radius: float, hz: float
) -> float:
    """Range to the open tube about z with half height hz; infinity if missed."""
    if dx == 0.0 and dy == 0.0:
        return math.inf  # along the axis: never through the shell
    near, far = _disc_interval(ox, oy, dx, dy, radius)
    if near > far:
        return math.inf
    if near > MIN_RANGE_M and abs(oz + near * dz) <= hz:
        return near
    return far if far > MIN_RANGE_M and abs(oz + far * dz) <= hz else math.inf


@kernel
def ray_ellipsoid(
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    hx: float,
    hy: float,
    hz: float,
) -> float:
    """Range to the ellipsoid with half axes hx, hy, hz; infinity if missed."""
    ox, oy, oz, dx, dy, dz = ox / hx, oy / hy, oz / hz, dx / hx, dy / hy, dz / hz
    speed2 = dx * dx + dy * dy + dz * dz
    along = -(ox * dx + oy * dy + oz * dz) / speed2
    cx, cy, cz = ox + along * dx, oy + along * dy, oz + along * dz
    near, far = _round_interval(along, speed2, cx * cx + cy * cy + cz * cz, 1.0)
    return _first(near, far)


@kernel
def into_body(bodies: Bodies, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Vector of the scene in the frame of body ``i`` (rotation only)."""
    r = bodies.scene_from_body
    return (
        r[i, 0, 0] * x + r[i, 1, 0] * y + r[i, 2, 0] * z,
        r[i, 0, 1] * x + r[i, 1, 1] * y + r[i, 2, 1] * z,
        r[i, 0, 2] * x + r[i, 1, 2] * y + r[i, 2, 2] * z,
    )


@kernel
def ray_body(
    bodies: Bodies, i: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> float:
    """Range along a ray of the scene to body ``i``; infinity if missed."""
    c = bodies.centre_m
    px, py, pz = into_body(bodies, i, ox - c[i, 0], oy - c[i, 1], oz - c[i, 2])
    ux, uy, uz = into_body(bodies, i, dx, dy, dz)
    hx, hy, hz = bodies.half_m[i, 0], bodies.half_m[i, 1], bodies.half_m[i, 2]
    kind = bodies.kind[i]
    if kind == BOX:
        return ray_box(px, py, pz, ux, uy, uz, hx, hy, hz)
    if kind == ELLIPSOID:
        return ray_ellipsoid(px, py, pz, ux, uy, uz, hx, hy, hz)
    if kind == CYLINDER:
        return ray_cylinder(px, py, pz, ux, uy, uz, hx, hz)
    if kind == TUBE:
        return ray_tube(px, py, pz, ux, uy, uz, hx, hz)
    return ray_rectangle(px, py, pz, ux, uy, uz, hx, hy)


@kernel
def _normal_in_body(
    kind: int, x: float, y: float, z: float, hx: float, hy: float, hz: float
) -> tuple[float, float, float]:
    """Normal, of any length, at a point on a body in the body's frame."""
    if kind == ELLIPSOID:
        return x / (hx * hx), y / (hy * hy), z / (hz * hz)
    if kind == TUBE or (kind == CYLINDER and hx - math.hypot(x, y) <= hz - abs(z)):
        return x, y, 0.0
    if kind == BOX:
        gap_x, gap_y, gap_z = hx - abs(x), hy - abs(y), hz - abs(z)
        if gap_x <= gap_y and gap_x <= gap_z:
            return 1.0, 0.0, 0.0
        if gap_y <= gap_z:
            return 0.0, 1.0, 0.0
    return 0.0, 0.0, 1.0


@kernel
def body_normal(bodies: Bodies, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Normal, of any length and either side, of body ``i`` at a scene point on it.

    On the edge of a box or cylinder the face of the lower axis decides, the side before the cap.
    """
    c, h = bodies.centre_m, bodies.half_m
    px, py, pz = into_body(bodies, i, x - c[i, 0], y - c[i, 1], z - c[i, 2])
    nx, ny, nz = _normal_in_body(bodies.kind[i], px, py, pz, h[i, 0], h[i, 1], h[i, 2])
    r = bodies.scene_from_body
    return (
        r[i, 0, 0] * nx + r[i, 0, 1] * ny + r[i, 0, 2] * nz,
        r[i, 1, 0] * nx + r[i, 1, 1] * ny + r[i, 1, 2] * nz,
        r[i, 2, 0] * nx + r[i, 2, 1] * ny + r[i, 2, 2] * nz,
    )


def body_extent_m(bodies: Bodies) -> Floats:
    """Half sizes (n, 3) of the axis-parallel boxes around the bodies, metres."""
    rotation, half = np.abs(bodies.scene_from_body), bodies.half_m[:, None, :]
    boxes = (rotation * half).sum(axis=2)
    ellipsoids = np.sqrt(((rotation * half) ** 2).sum(axis=2))
    across = np.sqrt((rotation[:, :, :2] ** 2).sum(axis=2)) * bodies.half_m[:, :1]
    cylinders = across + rotation[:, :, 2] * bodies.half_m[:, 2:]
    kind = bodies.kind[:, None]
    round_ones = np.where(kind == ELLIPSOID, ellipsoids, cylinders)
    return np.where((kind == BOX) | (kind == RECTANGLE), boxes, round_ones)
