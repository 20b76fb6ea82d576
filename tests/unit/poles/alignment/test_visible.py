import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.geometry.cameras import cam_from_world
from roadsight.poles.alignment.visible import (
    BRIGHT_SIDE,
    BRIGHT_TOP,
    FLAT,
    FOOT,
    MARK,
    SIDE,
    TALL,
    TOP,
    SceneCloud,
    depth_edges,
    front_returns,
    hidden_cells,
    intensity_contrast,
    nearest_returns,
    visible_samples,
)
from tests.helpers.dense_street import LENS, SIZE, DenseStreet

POSE = np.array([1.0, 2.0, 1.7, 3.0, -1.0, 0.5])
TURN = cam_from_world(*POSE[3:])
PIXELS = LENS.vector(1.0)


@pytest.fixture(scope="module")
def street():
    return DenseStreet().cloud(0.4)


def seen(cloud, pose=POSE):
    return visible_samples(cloud, cam_from_world(*pose[3:]), pose[:3], PIXELS, SIZE)


def test_the_nearest_return_wins_a_cell(street):
    rows, columns = (int(np.ceil(size / 3)) for size in SIZE)
    depth, number, uvz, cell = nearest_returns(street.xyz_m, TURN, POSE[:3], PIXELS, rows, columns)
    slow = np.full((rows, columns), np.inf)
    for i, (x, y, z) in enumerate((street.xyz_m - POSE[:3]) @ TURN.T):
        if not 2 <= z <= 80:
            assert cell[i] == -1
            continue
        u, v = PIXELS[1] + PIXELS[0] * x / z, PIXELS[2] + PIXELS[0] * y / z
        a, b = int(np.floor((u + 0.5) / 3)), int(np.floor((v + 0.5) / 3))
        if 0 <= a < columns and 0 <= b < rows:
            assert cell[i] == b * columns + a
            slow[b, a] = min(slow[b, a], z)
    np.testing.assert_allclose(depth, slow, rtol=1e-12)
    filled = np.isfinite(depth)
    np.testing.assert_array_equal(number >= 0, filled)
    np.testing.assert_allclose(uvz[number[filled], 2], depth[filled])


def test_front_returns_are_the_outermost_of_the_front_surface(street):
    rows, columns = (int(np.ceil(size / 3)) for size in SIZE)
    depth, _, uvz, cell = nearest_returns(street.xyz_m, TURN, POSE[:3], PIXELS, rows, columns)
    ends, mean = front_returns(depth, uvz, cell, street.intensity)
    random = np.random.default_rng(0)
    for own in random.choice(np.unique(cell[cell >= 0]), 60, replace=False):
        b, a = divmod(int(own), columns)
        inside = np.flatnonzero((cell == own) & (uvz[:, 2] <= depth[b, a] * 1.02 + 0.2))
        u, v = uvz[inside, 0], uvz[inside, 1]
        expected = inside[[u.argmin(), u.argmax(), v.argmin(), v.argmax()]]
        np.testing.assert_array_equal(ends[b, a], expected)
        assert mean[b, a] == pytest.approx(street.intensity[inside].mean())


def test_hidden_cells_and_depth_edges_as_their_words_say():
    random = np.random.default_rng(3)
    depth = random.choice([np.inf, 5.0, 9.0, 20.0], (14, 17))
    hidden = hidden_cells(depth)
    number = np.where(np.isfinite(depth), np.arange(depth.size).reshape(depth.shape), -1)
    ends = np.repeat(number[..., None], 4, axis=2)
    height = random.choice([0.0, 0.05, 1.0], depth.size)
    kinds, points = depth_edges(depth, ends, number, hidden, height)
    expected = []
    for b, a in np.argwhere(np.isfinite(depth)):
        z = depth[b, a]
        limit = z * 0.95 - 0.3
        around = [
            [depth[b, a - k] for k in (1, 2, 3) if a - k >= 0],
            [depth[b, a + k] for k in (1, 2, 3) if a + k < 17],
            [depth[b - k, a] for k in (1, 2, 3) if b - k >= 0],
            [depth[b + k, a] for k in (1, 2, 3) if b + k < 14],
        ]
        near = [any(other < limit for other in side) for side in around]
        assert hidden[b, a] == ((near[0] and near[1]) or (near[2] and near[3]))
        if hidden[b, a]:
            continue
        ways = [(0, -1), (0, 1), (-1, 0)]
        for kind, (down, right) in zip((SIDE, SIDE, TOP), ways, strict=True):
            for k in (1, 2, 3):
                r, c = b + k * down, a + k * right
                if not (0 <= r < 14 and 0 <= c < 17):
                    break
                if not np.isfinite(depth[r, c]) or hidden[r, c]:
                    continue
                tall = height[number[b, a]] > 0.25
                if depth[r, c] > z + 0.05 * z + 0.5 and tall:
                    expected.append((kind, number[b, a]))
                same = abs(depth[r, c] - z) < 0.05 * z + 0.5
                low = abs(height[number[b, a]]) < 0.15
                if kind == TOP and low and same and height[number[r, c]] > 0.25:
                    expected.append((FOOT, number[b, a]))
                break
    assert sorted(zip(kinds, points, strict=True)) == sorted(expected)


def test_a_street_shows_samples_of_every_kind_where_they_belong():
    cloud = DenseStreet().cloud(0.15)
    kinds, points = seen(cloud)
    assert set(range(8)) == set(kinds)
    assert (cloud.height_m[points[kinds == FLAT]] < 0.1).all()
    assert (cloud.height_m[points[kinds == TALL]] > 0.5).all()
    # The outermost point of a cell may lie below its nearest one.
    assert (cloud.height_m[points[np.isin(kinds, (SIDE, TOP))]] > 0.25).mean() > 0.95
    mark = cloud.xyz_m[points[kinds == MARK]]
    # Beside the road feet of bright walls are marks as well.
    middle = mark[np.abs(mark[:, 0]) < 2.4]
    assert len(middle) > 10 and (np.abs(middle[:, 0]) < 0.1).mean() > 0.7


def test_one_intensity_alone_tells_neither_markings_nor_edges_of_brightness():
    street = DenseStreet()
    xyz, _ = street.points(0.3)
    cloud = SceneCloud.of(xyz, np.full(len(xyz), 7.0), np.zeros(len(xyz)))
    kinds, _ = seen(cloud)
    assert not np.isin(kinds, (MARK, BRIGHT_SIDE, BRIGHT_TOP)).any()
    assert (kinds == SIDE).any()


def test_nothing_in_view_gives_nothing():
    far = SceneCloud.of(np.array([[1e3, 1e3, 0.0]]), np.ones(1), np.zeros(1))
    for cloud in (far, SceneCloud.joined([])):
        kinds, points = seen(cloud)
        assert len(kinds) == len(points) == 0


def test_points_without_ground_below_are_left_out():
    xyz = np.array([[0.0, 5.0, 0.0], [0.0, 6.0, 2.0]])
    cloud = SceneCloud.of(xyz, np.ones(2), np.array([0.0, np.nan]))
    assert len(cloud.xyz_m) == 1
    assert len(SceneCloud.joined([cloud, cloud]).height_m) == 2


@given(st.floats(0.1, 1000.0), st.integers(0, 2**31))
@settings(max_examples=25, deadline=None)
def test_contrast_does_not_know_the_unit_of_intensity(unit, seed):
    random = np.random.default_rng(seed)
    xyz = random.uniform(0, 6, (600, 3))
    level, ground = random.gamma(3.0, 10.0, 600), random.random(600) < 0.8
    found = intensity_contrast(xyz, level, ground)
    np.testing.assert_allclose(intensity_contrast(xyz, unit * level, ground), found, rtol=1e-6)
    assert not found[~ground].any() and np.isfinite(found).all()
