import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from roadsight.scene.road_edges import (
    between_pixels,
    blocks,
    resampled,
    runs_of,
    smoothed,
    trimmed,
    windows_around,
)

seeds = st.integers(0, 10**6)


@given(seeds, st.integers(1, 60), st.floats(0.1, 5.0))
def test_smoothing_is_that_of_a_gaussian_taken_twice(seed, count, sigma):
    ring = np.random.default_rng(seed).normal(0, 9, (count, 2))
    once = ndimage.gaussian_filter1d(ring, sigma, axis=0, mode="wrap")
    twice = ndimage.gaussian_filter1d(once, sigma, axis=0, mode="wrap")
    np.testing.assert_allclose(smoothed(ring, sigma), 2 * once - twice, atol=1e-12)
    assert smoothed(ring, 0.0) is ring


@given(seeds, st.integers(1, 40), st.integers(0, 50))
def test_trimming_drops_what_is_near_a_gap_on_either_side(seed, count, places):
    keep = np.random.default_rng(seed).random(count) < 0.9
    window = ndimage.minimum_filter1d(keep.astype(np.uint8), 2 * places + 1, mode="wrap")
    np.testing.assert_array_equal(trimmed(keep, places), window > 0)


@given(seeds, st.integers(1, 30))
def test_runs_hold_each_kept_place_once_in_order(seed, count):
    keep = np.random.default_rng(seed).random(count) < 0.7
    runs = runs_of(keep)
    assert sorted(np.concatenate([[], *runs])) == np.flatnonzero(keep).tolist()
    for run in runs:
        assert (np.diff(run) % count == 1 % count).all()
        before, after = (run[0] - 1) % count, (run[-1] + 1) % count
        assert keep.all() or not (keep[before] or keep[after])


def test_steps_of_a_resampled_circle_are_equal():
    turn = np.sort(np.random.default_rng(3).uniform(0, 2 * np.pi, 2_000))
    ring = resampled(20 * np.column_stack([np.cos(turn), np.sin(turn)]), 0.5)
    step = np.hypot(*(np.roll(ring, -1, axis=0) - ring).T)
    assert len(ring) == 251
    np.testing.assert_allclose(step, 40 * np.pi / 251, rtol=1e-3)


@given(seeds, st.integers(1, 9), st.integers(1, 9))
def test_values_between_pixels_are_bilinear(seed, rows, columns):
    rng = np.random.default_rng(seed)
    image = rng.normal(0, 1, (rows, columns)).astype(np.float32)
    row, column = rng.uniform(-2, rows + 1, 50), rng.uniform(-2, columns + 1, 50)
    expected = ndimage.map_coordinates(
        image.astype(np.float64), [row, column], order=1, mode="nearest"
    )
    np.testing.assert_allclose(between_pixels(image, row, column), expected, atol=1e-6)


@given(seeds, st.integers(1, 25), st.integers(1, 25), st.integers(1, 9), st.integers(0, 4))
def test_blocks_give_what_the_whole_image_gives(seed, rows, columns, size, halo):
    image = np.random.default_rng(seed).integers(0, 99, (rows, columns))
    window = 2 * halo + 1
    found = np.full(image.shape, -1)
    for inner, outer, core in blocks(image.shape, size, halo):
        assert (found[inner] == -1).all()
        part = ndimage.maximum_filter(image[outer], window, mode="constant", cval=-1)
        found[inner] = part[core]
    whole = ndimage.maximum_filter(image, window, mode="constant", cval=-1)
    np.testing.assert_array_equal(found, whole)


@given(seeds, st.integers(1, 25), st.integers(1, 25), st.integers(1, 9), st.integers(0, 4))
def test_windows_hold_all_that_lies_around_their_places(seed, rows, columns, size, halo):
    rng = np.random.default_rng(seed)
    image = rng.normal(0, 1, (rows, columns))
    place = rng.uniform(0, [rows - 1, columns - 1], (rng.integers(0, 40), 2))
    seen = np.zeros(len(place), int)
    for own, window in windows_around(place, image.shape, size, halo):
        seen[own] += 1
        start = np.array([part.start for part in window])
        part = image[window]
        assert max(part.shape) <= size + 1 + 2 * halo
        near = np.maximum(np.floor(place[own]) - halo, 0)
        far = np.minimum(np.floor(place[own]) + 1 + halo, np.subtract(image.shape, 1))
        assert (near >= start).all() and (far < start + part.shape).all()
        found, expected = (
            between_pixels(part, *(place[own] - start).T),
            between_pixels(image, *place[own].T),
        )
        np.testing.assert_allclose(found, expected, atol=1e-12)
    assert (seen == 1).all()
