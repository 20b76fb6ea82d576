import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from roadsight_worlds.casting import primitives as prim
from roadsight_worlds.casting.primitives import BOX, CYLINDER, ELLIPSOID, RECTANGLE, TUBE, Bodies
from tests.helpers.kernels import from_python

STEP_M, REACH_M = 1e-3, 12.0
ray_body, body_normal = from_python(prim.ray_body), from_python(prim.body_normal)
ray_box, ray_cylinder = from_python(prim.ray_box), from_python(prim.ray_cylinder)
ray_ellipsoid, ray_rectangle = from_python(prim.ray_ellipsoid), from_python(prim.ray_rectangle)
ray_tube = from_python(prim.ray_tube)


def implicit(kind, p, half):
    """Zero on the surface, negative inside; for open surfaces also where the surface exists."""
    q, everywhere = np.abs(p), np.ones(len(p), bool)
    if kind == BOX:
        return np.max(q - half, axis=1), everywhere
    if kind == ELLIPSOID:
        return np.sum((p / half) ** 2, axis=1) - 1.0, everywhere
    around = np.hypot(p[:, 0], p[:, 1]) - half[0]
    if kind == CYLINDER:
        return np.maximum(around, q[:, 2] - half[2]), everywhere
    if kind == TUBE:
        return around, q[:, 2] <= half[2]
    return p[:, 2], (q[:, 0] <= half[0]) & (q[:, 1] <= half[1])


def sampled_range(kind, origin, direction, half):
    """First crossing by brute force, or infinity."""
    t = np.arange(2 * prim.MIN_RANGE_M, REACH_M, STEP_M)
    value, counts = implicit(kind, origin + t[:, None] * direction, half)
    crossings = np.flatnonzero(
        (np.sign(value[:-1]) != np.sign(value[1:])) & (counts[:-1] | counts[1:])
    )
    for i in crossings:

        def side(x):
            return implicit(kind, (origin + x * direction)[None], half)[0][0]

        root = brentq(side, t[i], t[i + 1], xtol=1e-13)
        if implicit(kind, (origin + root * direction)[None], half)[1][0]:
            return root
    return math.inf


def one_body(kind, half, centre=(0.0, 0.0, 0.0), rotation=None):
    rotation = np.eye(3) if rotation is None else rotation
    return Bodies(
        np.array([kind], np.int8), np.array([centre], float), np.array([rotation]),
        np.array([half], float), np.zeros(1, np.int32),
    )  # fmt: skip


HALVES = {
    RECTANGLE: (1.5, 0.8, 0.0), BOX: (1.5, 0.8, 0.4), CYLINDER: (0.7, 0.7, 1.2),
    TUBE: (0.7, 0.7, 1.2), ELLIPSOID: (1.5, 0.8, 0.4),
}  # fmt: skip


@pytest.mark.parametrize("kind", list(HALVES))
def test_ranges_equal_dense_sampling_from_outside_and_inside(kind, rng):
    half = np.array(HALVES[kind])
    hits = 0
    for trial in range(200):
        rotation = Rotation.random(rng=rng).as_matrix()
        centre = rng.uniform(-50, 50, 3)
        spread = 0.4 if trial % 3 == 0 else 4.0  # every third ray starts inside or very near
        local = rng.uniform(-spread, spread, 3) * np.where(half > 0, half, 1.0)
        target = rng.uniform(-1.1, 1.1, 3) * half
        unit = (target - local) / np.linalg.norm(target - local)
        origin, direction = centre + rotation @ local, rotation @ unit
        bodies = one_body(kind, half, centre, rotation)
        found = ray_body(bodies, 0, *origin, *direction)
        expected = sampled_range(kind, local, unit, half)
        if math.isinf(expected) and not math.isinf(found):
            # The sampling steps over chords shorter than a millimetre, or the end of its reach.
            later = ray_body(bodies, 0, *(origin + (found + 2e-6) * direction), *direction)
            assert later < STEP_M or found > REACH_M - STEP_M
            continue
        assert found == pytest.approx(expected, abs=1e-9)
        hits += math.isfinite(expected)
        if math.isfinite(expected):
            point = origin + found * direction
            normal = np.array(body_normal(bodies, 0, *point))
            normal = rotation.T @ normal / np.linalg.norm(normal)
            check_normal(kind, local + found * unit, normal, half)
    assert hits > 100


def check_normal(kind, point, normal, half):
    """The normal is along the gradient of the implicit function, up to sign."""
    step = 1e-6
    gradient = np.array(
        [
            implicit(kind, (point + step * axis)[None], half)[0][0]
            - implicit(kind, (point - step * axis)[None], half)[0][0]
            for axis in np.eye(3)
        ]
    )
    gradient /= np.linalg.norm(gradient)
    if abs(abs(gradient @ normal) - 1.0) > 1e-6:  # only where two faces meet
        assert kind in (BOX, CYLINDER)
        gaps = np.sort(half - np.abs(point)) if kind == BOX else None
        assert gaps is None or gaps[1] < 3 * step


@pytest.mark.parametrize("kind", list(HALVES))
def test_a_body_behind_the_origin_is_not_met(kind):
    assert math.isinf(ray_body(one_body(kind, HALVES[kind]), 0, 0.1, 0.1, 5.0, 0.0, 0.0, 1.0))


def test_closed_forms():
    unit = (1.0, 0.0, 0.0)
    assert ray_box(-5, 0, 0, *unit, 1, 1, 1) == 4.0
    assert ray_box(0, 0, 0, *unit, 1, 1, 1) == 1.0  # from inside, to the inner face
    assert ray_cylinder(-5, 0, 0, *unit, 0.5, 1) == 4.5
    assert ray_cylinder(0, 0, 5, 0.0, 0.0, -1.0, 0.5, 1) == 4.0  # onto the cap
    assert ray_ellipsoid(-5, 0, 0, *unit, 2, 1, 1) == 3.0
    assert ray_rectangle(0, 0, 3, 0.0, 0.0, -1.0, 1, 1) == 3.0
    diagonal = math.sqrt(0.5)
    assert ray_tube(0, 0, 0, diagonal, 0.0, diagonal, 2.0, 3.0) == pytest.approx(2 / diagonal)


def test_grazing_counts_and_just_beside_does_not():
    y = math.nextafter(1.0, 2.0)
    assert ray_box(-5, 1.0, 0, 1.0, 0.0, 0.0, 1, 1, 1) == 4.0
    assert math.isinf(ray_box(-5, y, 0, 1.0, 0.0, 0.0, 1, 1, 1))
    assert ray_cylinder(-5, 1.0, 0, 1.0, 0.0, 0.0, 1, 1) == 5.0
    assert math.isinf(ray_cylinder(-5, y, 0, 1.0, 0.0, 0.0, 1, 1))
    assert ray_ellipsoid(-5, 1.0, 0, 1.0, 0.0, 0.0, 1, 1, 1) == 5.0
    assert math.isinf(ray_ellipsoid(-5, y, 0, 1.0, 0.0, 0.0, 1, 1, 1))
    assert ray_rectangle(1.0, 1.0, 3, 0.0, 0.0, -1.0, 1, 1) == 3.0
    assert math.isinf(ray_rectangle(y, 0, 3, 0.0, 0.0, -1.0, 1, 1))


def test_parallel_rays():
    assert math.isinf(ray_rectangle(-5, 0, 0, 1.0, 0.0, 0.0, 1, 1))  # within its plane
    assert math.isinf(ray_tube(0, 0, -9, 0.0, 0.0, 1.0, 1, 1))  # along its axis
    assert math.isinf(ray_box(-5, 0, 1.5, 1.0, 0.0, 0.0, 1, 1, 1))
    assert math.isinf(ray_cylinder(2, 0, -9, 0.0, 0.0, 1.0, 1, 1))


def test_a_ray_that_starts_on_a_surface_does_not_meet_it_there():
    assert math.isinf(ray_box(1.0, 0, 0, 1.0, 0.0, 0.0, 1, 1, 1))
    assert ray_box(-1.0, 0, 0, 1.0, 0.0, 0.0, 1, 1, 1) == 2.0
    assert math.isinf(ray_rectangle(0, 0, 0, 0.0, 0.0, 1.0, 1, 1))
    assert ray_ellipsoid(-1.0, 0, 0, 1.0, 0.0, 0.0, 1, 1, 1) == 2.0


def test_a_tube_is_seen_through_its_ends_from_outside():
    into = np.array([0.2, 0.0, -1.0]) / math.hypot(0.2, 1.0)
    found = ray_tube(0, 0, 2.0, *into, 0.5, 1.0)
    assert found == pytest.approx(0.5 / into[0])  # enters by the open end, meets the inner face


@pytest.mark.parametrize("kind", list(HALVES))
def test_extents_hold_the_body_tightly(kind, rng):
    half = np.array(HALVES[kind])
    angle, height = rng.uniform(0, 2 * np.pi, 40_000), rng.uniform(-1, 1, 40_000)
    if kind in (BOX, RECTANGLE):
        local = rng.choice([-1.0, 1.0], (40_000, 3)) * half
    elif kind == ELLIPSOID:
        around = np.sqrt(1 - height**2)
        local = np.column_stack([around * np.cos(angle), around * np.sin(angle), height]) * half
    else:
        local = np.column_stack([np.cos(angle), np.sin(angle), np.sign(height)]) * half
    rotation = Rotation.random(rng=rng).as_matrix()
    extent = prim.body_extent_m(one_body(kind, half, rotation=rotation))[0]
    reached = np.abs(local @ rotation.T).max(axis=0)
    assert np.all(reached <= extent + 1e-12)
    assert reached == pytest.approx(extent, abs=0.01)
