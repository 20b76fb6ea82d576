"""Solids on level, stepped and sloping ground: exact casts, and clouds as scanners see them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WIDE_M, NEAR_M, FAR_M = 20.0, -8.0, 32.0
EYE = np.array([0.0, 0.0, 5.0])  # a sensor on a mast, 10 m from what stands in its way


@dataclass(frozen=True)
class Face:
    """A rectangle from a corner along two edges; of a solid, and seen by scanners, or not."""

    corner: np.ndarray
    along: np.ndarray
    aside: np.ndarray
    solid: bool = True
    seen: bool = True


def face(corner, along, aside, **kind):
    return Face(*(np.array(part, float) for part in (corner, along, aside)), **kind)


def ground(near_m=NEAR_M, far_m=FAR_M, z=0.0, rise=0.0):
    wide = [2 * WIDE_M, 0, 0]
    start = [-WIDE_M, near_m, z + rise * near_m]
    return face(start, wide, [0, far_m - near_m, rise * (far_m - near_m)], solid=False)


def box(half_m, y, thick_m, high_m, z=0.0, lean_m=0.0):
    """A box whose front and back lean inwards; its floor closes it, and no scanner sees that."""
    x, wide, up = -half_m, [2 * half_m, 0, 0], [0, 0, high_m]
    return [
        face([x, y, z], wide, [0, lean_m, high_m]),
        face([x, y + thick_m, z], wide, [0, -lean_m, high_m]),
        face([x, y + lean_m, z + high_m], wide, [0, thick_m - 2 * lean_m, 0]),
        face([x, y, z], wide, [0, thick_m, 0], seen=False),
        face([x, y, z], [0, thick_m, 0], up),
        face([-x, y, z], [0, thick_m, 0], up),
    ]


SCENES = {
    "barrier": [ground(), *box(12, 10, 0.6, 0.9)],
    "low wall": [ground(), *box(12, 10, 0.3, 0.6)],
    "thin wall": [ground(), *box(12, 10, 0.2, 1.5)],
    "high wall": [ground(), *box(12, 12, 0.4, 6.0)],
    "van": [ground(), *box(2.5, 10, 2.0, 2.2)],
    "parapet": [ground(), *box(12, 10, 0.9, 0.9, lean_m=0.25)],
    "barrier on a slope": [ground(rise=0.12), *box(12, 10, 0.6, 1.4, z=1.15)],
    "step": [
        ground(far_m=10.0),
        face([-WIDE_M, 10, 0], [2 * WIDE_M, 0, 0], [0, 0, 0.8]),
        ground(near_m=10.0, z=0.8),
    ],
}


def cast(scene, origins, ways):
    """Range (n,) of the first face, its number (-1: none), and where the beam leaves a solid."""
    ranges = np.full((len(scene), len(ways)), np.inf)
    for number, one in enumerate(scene):
        normal = np.cross(one.along, one.aside)
        with np.errstate(divide="ignore", invalid="ignore"):
            range_m = ((one.corner - origins) @ normal) / (ways @ normal)
            at = origins + range_m[:, None] * ways - one.corner
            u, v = (at @ edge / (edge @ edge) for edge in (one.along, one.aside))
        hit = (range_m > 1e-6) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
        ranges[number, hit] = range_m[hit]
    first = ranges.min(axis=0)
    which = np.where(np.isfinite(first), ranges.argmin(axis=0), -1)
    solid = np.array([one.solid for one in scene])
    inside = np.where(solid[:, None] & np.isfinite(ranges), ranges, -np.inf).max(axis=0)
    return first, which, np.maximum(first, inside)


def sampled(scene, per_m2, how, rng, noise_m=0.01):
    """A cloud of a scene.

    how : "random" and "lines" give ``per_m2`` points a square metre of each face, lines four times
        as dense along as across; "strips" are two flights whose beams lean 20 degrees to either
        side, with ``per_m2`` pulses a square metre of the plan together.
    """
    if how == "strips":
        parts = [_strip(scene, per_m2 / 2, side * np.radians(20), rng) for side in (-1, 1)]
    else:
        parts = [_on_face(scene, one, per_m2, how, rng) for one in scene if one.seen]
    xyz = np.concatenate(parts)
    return xyz + rng.normal(0, noise_m, xyz.shape)


def _strip(scene, per_m2, lean, rng):
    low, high = [-WIDE_M, NEAR_M - 10], [WIDE_M, FAR_M + 10]
    count = int(per_m2 * 2 * WIDE_M * (high[1] - low[1]))
    way = np.array([0, np.sin(lean), -np.cos(lean)])
    origins = np.column_stack([rng.uniform(low, high, (count, 2)), np.zeros(count)])
    origins -= way / np.cos(lean) * 50
    range_m, which, _ = cast(scene, origins, np.tile(way, (count, 1)))
    return (origins + np.minimum(range_m, 1e6)[:, None] * way)[which >= 0]


def _on_face(scene, one, per_m2, how, rng):
    wide, high = np.linalg.norm(one.along), np.linalg.norm(one.aside)
    if how == "random":
        u, v = rng.uniform(0, 1, (2, rng.poisson(per_m2 * wide * high)))
    else:
        across, along = 2 / np.sqrt(per_m2), 0.5 / np.sqrt(per_m2)
        turn, reach = rng.uniform(0, np.pi), np.hypot(wide, high)
        line, on = np.meshgrid(
            np.arange(-reach, reach, across) + rng.uniform(0, across),
            np.arange(-reach, reach, along),
        )
        on = on + rng.uniform(0, along, line.shape[1])
        u = (np.cos(turn) * on - np.sin(turn) * line).ravel() / wide + 0.5
        v = (np.sin(turn) * on + np.cos(turn) * line).ravel() / high + 0.5
        kept = (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
        u, v = u[kept], v[kept]
    xyz = one.corner + u[:, None] * one.along + v[:, None] * one.aside
    if not one.solid:  # no ground is seen below what stands on it
        up = np.tile([0.0, 0.0, 1.0], (len(xyz), 1))
        _, which, _ = cast(
            [other for other in scene if other.solid], xyz + np.array([0, 0, 1e-3]), up
        )
        xyz = xyz[which < 0]
    return xyz


def beams(step_deg=0.352, low_deg=-30.0, high_deg=12.0):
    """Directions (n, 3) of a sensor with the resolution of an OS1-128 that faces y."""
    azimuth = np.radians(np.arange(58.32, 121.68, step_deg))
    elevation = np.radians(np.arange(low_deg, high_deg, step_deg))
    az, el = (part.ravel() for part in np.meshgrid(azimuth, elevation))
    return np.column_stack([np.cos(az) * np.cos(el), np.sin(az) * np.cos(el), np.sin(el)])


def feet_on_ground(scene):
    """Places (n, 3) 1 m apart on the ground that nothing stands on."""
    x, y = (part.ravel() for part in np.meshgrid(np.arange(-16.0, 17), np.arange(3.0, 28)))
    above = np.column_stack([x, y, np.full(len(x), 50.0)])
    down_m, which, _ = cast(scene, above, np.tile([0.0, 0.0, -1.0], (len(x), 1)))
    free = (which >= 0) & ~np.array([one.solid for one in scene])[which]
    return np.column_stack([x, y, 50 - down_m])[free]


@dataclass(frozen=True)
class Shares:
    """Of the beams: passing the solid that they meet, stopped before anything, through ground."""

    leak: float
    early: float
    ground: float


def shares(scene, range_m, ways, off_m=0.5):
    """How a depth map of ``ways`` from `EYE` is off; the scene's rim does not count."""
    exact_m, which, left_m = cast(scene, np.tile(EYE, (len(ways), 1)), ways)
    solid = np.array([one.solid for one in scene])
    at = EYE + np.where(np.isfinite(exact_m), exact_m, 0.0)[:, None] * ways
    inside = (which >= 0) & (np.abs(at[:, 0]) < WIDE_M - 2) & (at[:, 1] < FAR_M - 4)
    stops, floor = inside & solid[which], inside & ~solid[which]
    below = range_m > exact_m + np.maximum(off_m, 0.05 * exact_m)
    return Shares(
        leak=float((range_m > left_m + off_m)[stops].mean()),
        early=float((range_m < exact_m - off_m).mean()),
        ground=float(below[floor].mean()),
    )
