import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.studio.cloud_tiles import (
    CELLS_M,
    LEVELS,
    RECORD,
    level_of_points,
    pack_points,
    scaled_intensity,
)


def levels_slowly(xyz):
    """The same point by point."""
    level = np.full(len(xyz), LEVELS - 1)
    rest = list(range(len(xyz)))
    for number, cell in enumerate(CELLS_M):
        taken = set()
        for row in list(rest):
            key = tuple(np.floor(xyz[row] / cell).astype(int))
            if key not in taken:
                taken.add(key)
                level[row] = number
                rest.remove(row)
    return level


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 300), st.sampled_from([0.3, 2.0, 40.0]))
def test_levels_as_point_by_point(seed, count, extent):
    rng = np.random.default_rng(seed)
    xyz = (rng.random((count, 3)) * extent - 0.4 * extent).astype(np.float32)
    np.testing.assert_array_equal(level_of_points(xyz), levels_slowly(xyz))


def test_coarse_levels_are_sparse_and_reach_everywhere(rng):
    xyz = np.column_stack([rng.random((20_000, 2)) * 10, np.zeros(20_000)]).astype(np.float32)
    level = level_of_points(xyz)
    assert (level == 0).sum() == 7 * 7
    corners = xyz[level == 0][:, :2]
    assert corners.min() < 1.6 and corners.max() > 8.4


def test_packed_points_come_back(rng):
    xyz = (rng.random((500, 3)) * [50, 50, 12] + [100, -200, 30]).astype(np.float32)
    low, high = xyz.min(axis=0).astype(float), xyz.max(axis=0).astype(float)
    height = np.where(np.arange(500) == 3, np.nan, xyz[:, 2] - 30.0)
    ground = rng.random(500) < 0.5
    classes = rng.integers(0, 20, 500).astype(np.uint8)
    packed = pack_points(xyz, low, high, height, classes, classes, ground)
    assert packed.dtype == RECORD and RECORD.itemsize == 12
    back = packed["xyz"] / 65535 * (high - low) + low
    assert np.abs(back - xyz).max() < 1e-3
    assert packed["height_cm"][3] == 0
    assert np.abs(packed["height_cm"][4:] / 100 - height[4:]).max() <= 0.0051
    np.testing.assert_array_equal(packed["ground"], ground)


@pytest.mark.parametrize("heights", [1e9, -1e9, np.inf, -np.inf])
def test_impossible_heights_stay_in_range(heights):
    one = np.zeros((1, 3), np.float32)
    byte = np.zeros(1, np.uint8)
    packed = pack_points(
        one, np.zeros(3), np.zeros(3), np.array([heights]), byte, byte, byte.astype(bool)
    )
    assert abs(int(packed["height_cm"][0])) == 32767


def test_intensity_is_spread_over_bytes():
    scaled = scaled_intensity(np.array([0, 102, 510, 65535], np.uint16), 510.0)
    assert scaled.tolist() == [0, 51, 255, 255]
    assert scaled_intensity(np.array([0, 1], np.uint16), 0.0).tolist() == [0, 255]
