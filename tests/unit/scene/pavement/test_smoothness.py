import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.base.errors import InputError
from roadsight.scene.pavement.fpfh import (
    fit_smoothness,
    fpfh,
    is_smooth,
    local_intensity,
    nearest_neighbours,
    two_tones,
    upward_normals,
)


@pytest.fixture
def two_kinds(rng):
    """Histograms, variation and intensity of 600 smooth, dark and 400 rough, bright points."""
    smooth = np.arange(1000) < 600
    histograms = rng.uniform(0, 20, (1000, 33)).astype(np.float32)
    histograms[smooth, 5] += 150
    histograms[~smooth, 2:9] += 30
    variation = np.where(smooth, 0.002, 0.04) * rng.uniform(0.5, 1.5, 1000)
    intensity = np.where(smooth, 20.0, 60.0) + rng.normal(0, 4, 1000)
    return smooth, histograms, variation, intensity


@pytest.mark.parametrize("with_intensity", [True, False])
def test_the_two_kinds_are_told_apart(two_kinds, with_intensity):
    smooth, histograms, variation, intensity = two_kinds
    model = fit_smoothness(histograms, variation, intensity if with_intensity else None, 1.5, 1)
    assert (is_smooth(model, histograms, variation, intensity) == smooth).mean() > 0.99


def test_unused_intensity_has_no_say_in_the_classes(two_kinds):
    _, histograms, variation, intensity = two_kinds
    model = fit_smoothness(histograms, variation, None, 1.5, 1)
    expected = is_smooth(model, histograms, variation, intensity)
    for other in (-intensity, np.zeros(1000), np.full(1000, np.nan), 1e9 * intensity):
        assert (is_smooth(model, histograms, variation, other) == expected).all()


def test_intensity_decides_where_the_shapes_are_alike(rng):
    """A lawn as flat as the road: asphalt is the darker one."""
    road = np.arange(1000) % 2 == 0
    histograms = rng.uniform(0, 5, (1000, 33)).astype(np.float32)
    variation = rng.uniform(0.01, 0.011, 1000)
    intensity = np.where(road, 10.0, 40.0) + rng.normal(0, 2, 1000)
    model = fit_smoothness(histograms, variation, intensity, 1.5, 1)
    assert (is_smooth(model, histograms, variation, intensity) == road).mean() > 0.99


def test_a_few_dazzling_returns_do_not_hide_the_intensity_of_the_others(rng):
    road = np.arange(1000) % 2 == 0
    histograms = rng.uniform(0, 5, (1000, 33)).astype(np.float32)
    variation = rng.uniform(0.01, 0.011, 1000)
    intensity = np.where(road, 10.0, 40.0) + rng.normal(0, 2, 1000)
    intensity[:9] = 60_000
    model = fit_smoothness(histograms, variation, intensity, 1.5, 1)
    assert (is_smooth(model, histograms, variation, intensity) == road)[9:].mean() > 0.99


def test_a_constant_intensity_is_no_cue(two_kinds):
    smooth, histograms, variation, _ = two_kinds
    constant = np.full(1000, 7.3)
    model = fit_smoothness(histograms, variation, constant, 1.5, 1)
    assert (is_smooth(model, histograms, variation, constant) == smooth).mean() > 0.99


def test_points_without_a_normal_are_never_smooth_and_never_fitted(two_kinds):
    smooth, histograms, variation, intensity = two_kinds
    isolated = np.arange(1000) % 10 == 0
    histograms, variation = histograms.copy(), variation.copy()
    histograms[isolated], variation[isolated] = 0, np.nan
    model = fit_smoothness(histograms, variation, intensity, 1.5, 1)
    without = fit_smoothness(
        histograms[~isolated], variation[~isolated], intensity[~isolated], 1.5, 1
    )
    np.testing.assert_array_equal(model.centres, without.centres)
    found = is_smooth(model, histograms, variation, intensity)
    assert not found[isolated].any()
    assert (found == smooth)[~isolated].mean() > 0.99


def test_the_seed_alone_decides_chance(two_kinds):
    _, histograms, variation, intensity = two_kinds
    first, second = (fit_smoothness(histograms, variation, intensity, 1.5, 3) for _ in range(2))
    assert first.smooth == second.smooth
    assert first.centres.tobytes() == second.centres.tobytes()


@pytest.mark.parametrize("slope", [0.0, 0.07])
def test_ground_that_is_the_same_everywhere_is_smooth(rng, slope):
    """A perfect plane: one class only, and nothing in it is rough."""
    x, y = rng.uniform(0, 9, (2, 300))
    xyz = np.column_stack([x, y, slope * x])
    distance, near = nearest_neighbours(xyz, 10)
    normals, variation = upward_normals(xyz, near)
    histograms = fpfh(xyz, normals, distance, near)
    model = fit_smoothness(histograms, variation, None, 1.5, 1)
    assert is_smooth(model, histograms, variation, np.zeros(300)).all()


@pytest.mark.parametrize("n", [0, 1, 20])
def test_ground_without_two_usable_points_is_refused(n):
    variation = np.full(n, np.nan)
    variation[:1] = 0.1
    with pytest.raises(InputError, match="no ground with a surface"):
        fit_smoothness(np.zeros((n, 33), np.float32), variation, None, 1.5, 1)


class TestLocalIntensity:
    def test_is_the_median_of_a_point_and_its_neighbours(self):
        near = np.array([[1, 2], [0, 2], [-1, -1], [0, -1]])
        found = local_intensity(np.array([1.0, 5.0, 100.0, 8.0]), near)
        assert found.tolist() == [5.0, 5.0, 100.0, 4.5]

    def test_no_points(self):
        assert local_intensity(np.empty(0), np.empty((0, 3), np.int64)).shape == (0,)


@given(
    middle=st.floats(1.0, 60_000.0), spread=st.floats(0.01, 0.3), share=st.floats(0.2, 0.8),
    apart=st.floats(6.0, 20.0), seed=st.integers(0, 2**16),
)  # fmt: skip
@settings(max_examples=25, deadline=None)
def test_one_gaussian_is_one_tone_and_two_far_apart_are_two(middle, spread, share, apart, seed):
    rng = np.random.default_rng(seed)
    one = rng.normal(middle, spread * middle, 4000)
    assert not two_tones(one, 1)
    second = rng.random(4000) < share
    assert two_tones(one + second * apart * spread * middle, 1)


def test_equal_intensities_are_one_tone():
    assert not two_tones(np.full(50, 7.0), 1)


@pytest.fixture
def ground():
    """Smooth and rough ground whose shapes differ; its histograms, variation and who is smooth."""
    rng = np.random.default_rng(5)
    smooth = np.arange(4000) < 2600
    histograms = np.zeros((4000, 33), np.float32)
    histograms[:, 5], histograms[:, 20] = np.where(smooth, 100, 40), np.where(smooth, 20, 80)
    histograms += rng.normal(0, 4, histograms.shape)
    variation = np.where(smooth, 0.001, 0.02) * rng.lognormal(0, 0.3, 4000)
    return histograms, variation, smooth


def test_one_tone_only_takes_its_outliers_from_smooth_ground(ground):
    histograms, variation, smooth = ground
    rng = np.random.default_rng(6)
    tones = rng.normal(200, 30, 4000)
    bright = np.zeros(4000, bool)
    bright[:100] = True  # a garden as smooth as the street
    tones[bright] = 380
    model = fit_smoothness(histograms, variation, tones, 1.5, 1, judge=True)
    found = is_smooth(model, histograms, variation, tones)
    assert np.isinf(model.intensity_scale)
    assert not found[bright | ~smooth].any()
    assert found[smooth & ~bright].mean() > 0.93
    stated = fit_smoothness(histograms, variation, tones, 1.5, 1)
    assert np.isfinite(stated.intensity_scale)


def test_two_tones_part_the_ground_but_not_its_roughest(ground):
    histograms, variation, _ = ground
    rng = np.random.default_rng(7)
    road = rng.random(4000) < 0.5
    # Shape says nothing here; woods are as dark as the road, and rough.
    histograms = np.repeat(histograms[:1], 4000, axis=0) + rng.normal(0, 4, (4000, 33))
    woods = road & (rng.random(4000) < 0.1)
    variation = np.where(woods, 0.02, 0.001) * rng.lognormal(0, 0.3, 4000)
    tones = np.where(road, 40, 200) + rng.normal(0, 10, 4000)
    model = fit_smoothness(histograms.astype(np.float32), variation, tones, 1.5, 1, judge=True)
    found = is_smooth(model, histograms.astype(np.float32), variation, tones)
    assert np.isfinite(model.intensity_scale)
    assert not found[woods | ~road].any()
    assert found[road & ~woods].mean() > 0.9


def test_without_intensity_nothing_is_judged(ground):
    histograms, variation, _ = ground
    judged = fit_smoothness(histograms, variation, None, 1.5, 1, judge=True)
    plain = fit_smoothness(histograms, variation, None, 1.5, 1)
    np.testing.assert_array_equal(judged.centres, plain.centres)
    assert judged.roughest == np.inf
