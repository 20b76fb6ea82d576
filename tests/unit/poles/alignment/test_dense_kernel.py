import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.geometry.cameras import cam_from_world
from roadsight.poles.alignment.dense import SIZE, score
from roadsight.poles.alignment.kernel import turned

POSE = np.array([1.0, 2.0, 1.7, *np.radians([80.0, 1.0, -2.0])])
LENS = np.array([300.0, 160.0, 60.0])
SHAPE = (120, 320)


def scene(count: int = 400):
    """Places before the camera, all in the image of the second return, and smooth fields."""
    random = np.random.default_rng(1)
    ahead = random.uniform(5, 30, count)
    side, up = random.uniform(-8, 8, count), random.uniform(-1.5, 2, count)
    east, north = np.sin(POSE[3]), np.cos(POSE[3])
    xyz = POSE[:3] + np.column_stack([ahead * east + side * north, ahead * north - side * east, up])
    v, u = np.indices(SHAPE)
    waves = [np.sin(u / 25.0) * np.cos(v / 20.0), np.cos(u / 31.0 + v / 17.0)]
    return np.ascontiguousarray(xyz), np.array(waves, np.float32)


def scored(offsets, xyz, field, weight, tile, tiles, fields, slopes=True):
    return score(offsets, POSE, LENS, xyz, field, weight, tile, tiles, fields, slopes)


def slow_sum(xyz, field, weight, fields):
    total = 0.0
    for place, own, counts in zip(xyz, field, weight, strict=True):
        x, y, z = cam_from_world(80.0, 1.0, -2.0) @ (place - POSE[:3])
        u, v = LENS[1] + LENS[0] * x / z, LENS[2] + LENS[0] * y / z
        if z < 0.5 or not (0 <= u < SHAPE[1] - 1 and 0 <= v < SHAPE[0] - 1):
            continue
        a, b = int(u), int(v)
        f, g = u - a, v - b
        q = fields[own, b : b + 2, a : a + 2].astype(float)
        total += counts * ((1 - g) * (q[0] @ [1 - f, f]) + g * (q[1] @ [1 - f, f]))
    return total


@pytest.mark.parametrize("angles", [(80.0, 1.0, -2.0), (359.0, -10.0, 4.0), (190.0, 25.0, 0.0)])
def test_the_rotation_is_that_of_geometry(angles):
    np.testing.assert_allclose(turned(*np.radians(angles))[0], cam_from_world(*angles), atol=1e-12)


@given(st.floats(0, 360), st.floats(-40, 40), st.floats(-20, 20), st.integers(0, 2))
@settings(max_examples=40, deadline=None)
def test_the_rotation_turns_as_differences_say(heading, pitch, roll, axis):
    angles = np.radians([heading, pitch, roll])
    step = np.zeros(3)
    step[axis] = 1e-6
    slope = (turned(*(angles + step))[0] - turned(*(angles - step))[0]) / 2e-6
    np.testing.assert_allclose(turned(*angles)[1 + axis], slope, atol=1e-7)


def test_the_score_is_the_sum_over_samples_in_the_image():
    xyz, fields = scene()
    random = np.random.default_rng(2)
    field, weight = random.integers(0, 2, len(xyz)), random.uniform(0, 1, len(xyz))
    behind = np.array([POSE[:3] - [5.0, 1.0, 0.0]])
    xyz, field, weight = np.vstack([xyz, behind]), np.append(field, 0), np.append(weight, 9.0)
    found = scored(np.zeros(SIZE), xyz, field, weight, np.zeros(len(xyz), int), 1, fields)
    assert found[0] == pytest.approx(slow_sum(xyz, field, weight, fields), rel=1e-6)


def test_the_gradient_is_that_of_differences():
    xyz, fields = scene(150)
    xyz = xyz[np.hypot(*(xyz - POSE[:3])[:, :2].T) > 18]
    args = xyz, np.zeros(len(xyz), int), np.ones(len(xyz)), np.zeros(len(xyz), int), 1, fields
    gradient = scored(np.zeros(SIZE), *args)[1].sum(axis=0)
    for k, step in enumerate([0.02, 0.02, 0.02, 0.05, 0.05, 0.05]):
        offsets = np.zeros(SIZE)
        offsets[k] = step
        ends = scored(offsets, *args)[0], scored(-offsets, *args)[0]
        # Samples that leave the image between the two ends are a step of the sum.
        assert gradient[k] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=0.1, abs=1.5)


def test_tiles_share_the_gradient_and_information_is_that_of_the_samples():
    xyz, fields = scene()
    count = len(xyz)
    field, weight = np.zeros(count, int), np.full(count, 0.5)
    whole = scored(np.zeros(SIZE), xyz, field, weight, np.zeros(count, int), 1, fields)
    parts = scored(np.zeros(SIZE), xyz, field, weight, np.arange(count) % 7, 7, fields)
    np.testing.assert_allclose(parts[1].sum(axis=0), whole[1][0], atol=1e-9)
    alone = scored(np.zeros(SIZE), xyz, field, weight, np.arange(count), count, fields)
    rows = alone[1] / 0.5
    np.testing.assert_allclose(whole[2], 0.5 * rows.T @ rows, atol=1e-6)
    assert np.linalg.eigvalsh(whole[2])[0] > -1e-9


def test_without_slopes_only_the_sum_is_there():
    xyz, fields = scene()
    count = len(xyz)
    args = xyz, np.zeros(count, int), np.ones(count), np.zeros(count, int), 1, fields
    total, gradient, information = scored(np.zeros(SIZE), *args, slopes=False)
    assert total == scored(np.zeros(SIZE), *args)[0]
    assert not gradient.any() and not information.any()
