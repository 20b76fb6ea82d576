import numpy as np
import pytest

from roadsight.scene.pavement.reflectivity import ASPHALT, reflectivity_of, voxel_means


def test_pavement_is_asphalt_and_others_follow_in_proportion():
    found = reflectivity_of(np.array([100.0, 200.0, 0.0, 1e6]), np.array([90.0, 100.0, 5000.0]))
    np.testing.assert_allclose(found, [ASPHALT, 2 * ASPHALT, 0.0, 1.0])


def test_without_intensities_everything_is_asphalt():
    np.testing.assert_allclose(reflectivity_of(np.zeros(3), np.zeros(2)), ASPHALT)
    np.testing.assert_allclose(reflectivity_of(np.ones(3), np.empty(0)), ASPHALT)


def test_voxel_means_equal_the_slow_definition():
    rng = np.random.default_rng(0)
    xyz = rng.uniform(-2, 2, (500, 3)).astype(np.float32)
    intensity = rng.integers(0, 65535, 500).astype(np.uint16)
    groups: dict[tuple, list[int]] = {}
    for place, value in zip(np.floor(xyz.astype(float) / 0.5), intensity, strict=True):
        groups.setdefault(tuple(0.5 * (place + 0.5)), []).append(int(value))
    means = voxel_means(xyz, intensity)
    assert len(means) == len(groups)
    for row in means.itertuples():
        assert row.intensity == pytest.approx(np.mean(groups[row.x, row.y, row.z]), rel=1e-6)
