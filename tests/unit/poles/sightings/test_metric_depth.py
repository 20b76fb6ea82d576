import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.poles.sightings.distances import ground_distance_m
from roadsight.poles.sightings.metric_depth import balancing_weights, fit_metric_depth, fuse_depths

TRUE_C1 = 6.0
TRUE_C2 = -0.2


def points(rng: np.random.Generator, count: int = 400, noise: float = 0.0):
    z = rng.uniform(4, 60, count)
    return TRUE_C1 / z + TRUE_C2 + rng.normal(0, noise, count), z


def test_exact_points_give_exact_coefficients_and_depths(rng):
    d, z = points(rng)
    fit = fit_metric_depth(d, z)
    assert fit.reason == ""
    assert (fit.c1, fit.c2) == pytest.approx((TRUE_C1, TRUE_C2), abs=1e-6)
    assert np.allclose(fit.depth_m(d)[0], z, rtol=1e-6)
    assert (fit.near_m, fit.far_m) == (z.min(), z.max())


def test_a_third_of_wrong_points_does_no_harm_where_least_squares_fails(rng):
    d, z = points(rng, noise=0.002)
    wrong = rng.random(len(d)) < 0.33
    d[wrong] += rng.uniform(0.2, 2.0, wrong.sum())
    fit = fit_metric_depth(d, z)
    plain = np.linalg.lstsq(np.column_stack([1 / z, np.ones(len(z))]), d, rcond=None)[0]
    assert abs(fit.c1 - TRUE_C1) < 0.05
    assert abs(plain[0] - TRUE_C1) > 0.3 or abs(plain[1] - TRUE_C2) > 0.2


def test_fit_in_inverse_depth_beats_fit_in_depth_under_noise(rng):
    errors = []
    for _ in range(20):
        d, z = points(rng, 200, noise=0.01)
        errors.append(fit_metric_depth(d, z).c1 - TRUE_C1)
    assert abs(np.mean(errors)) < 0.03


@settings(max_examples=25, deadline=None)
@given(st.floats(0.1, 1000), st.floats(-100, 100), st.floats(0.1, 10))
def test_scale_and_shift_of_the_network_and_units_do_not_matter(scale, shift, unit):
    rng = np.random.default_rng(5)
    d, z = points(rng, 150, noise=0.005)
    here = fit_metric_depth(d, z).depth_m(d[:20])
    there = fit_metric_depth(d * scale + shift, z * unit).depth_m(d[:20] * scale + shift)
    known = np.isfinite(here[0]) & np.isfinite(there[0])
    assert known.sum() > 10
    assert np.allclose(there[0][known], here[0][known] * unit, rtol=1e-3)
    assert np.allclose(there[1][known], here[1][known] * unit, rtol=1e-2)


def test_near_the_pole_of_the_relation_depth_is_unknown(rng):
    d, z = points(rng, noise=0.005)
    fit = fit_metric_depth(d, z)
    guarded, sigma = fit.depth_m([fit.c2, fit.c2 + 1e-6, fit.c2 - 0.5, np.nan, TRUE_C1 / 10 - 0.2])
    assert np.isnan(guarded[:4]).all()
    assert np.isnan(sigma[:4]).all()
    assert guarded[4] == pytest.approx(10, rel=0.02)


def test_sigma_covers_the_error_and_grows_with_distance(rng):
    scores, sigmas = [], []
    for _ in range(30):
        d, z = points(rng, 300, noise=0.004)
        fit = fit_metric_depth(d, z)
        new = TRUE_C1 / np.array([8.0, 20.0, 40.0]) + TRUE_C2 + rng.normal(0, 0.004, 3)
        found, sigma = fit.depth_m(new)
        scores.append((found - [8, 20, 40]) / sigma)
        sigmas.append(sigma)
    assert 0.5 < np.nanstd(scores) < 1.6
    assert (np.diff(np.nanmean(sigmas, axis=0)) > 0).all()


def test_what_cannot_be_fitted_says_why(rng):
    z = np.linspace(5, 50, 50)
    assert "points" in fit_metric_depth([1, 2], [3, 4]).reason
    assert "one distance" in fit_metric_depth(1 / z, np.full(50, 9.0)).reason
    assert "constant" in fit_metric_depth(np.ones(50), z).reason
    assert "towards the camera" in fit_metric_depth(z, z).reason
    bad = fit_metric_depth(np.ones(50), z)
    assert np.isnan(bad.depth_m([0.3])[0]).all()
    spoilt = fit_metric_depth(np.r_[TRUE_C1 / z, np.nan, 1.0], np.r_[z, 3.0, -2.0])
    assert spoilt.c1 == pytest.approx(TRUE_C1, abs=1e-6)


def test_weights_balance_near_and_far(rng):
    z = np.r_[rng.uniform(5, 6, 900), rng.uniform(40, 50, 10)]
    weights = balancing_weights(z)
    near, far = weights[z < 10].sum(), weights[z > 10].sum()
    assert 0.3 < near / far < 3
    assert len(balancing_weights(np.empty(0))) == 0


def test_ray_meets_flat_ground_where_trigonometry_says():
    down = np.radians([2.0, 5.0, 20.0])
    rays = np.column_stack([np.cos(down), np.zeros(3), -np.sin(down)])

    def level(x, y):
        return np.zeros(len(x))

    found = ground_distance_m([3, 4, 2.0], rays, level)
    assert found == pytest.approx(2.0 / np.tan(down), abs=1e-6)
    upwards = ground_distance_m([3, 4, 2.0], np.array([[1.0, 0, 0.1], [0, 0, -1.0]]), level)
    assert np.isnan(upwards).all()
    assert np.isnan(
        ground_distance_m([0, 0, 2.0], rays, lambda x, y: np.full(len(x), np.nan))
    ).all()


def test_ray_meets_the_first_of_two_hills():
    def hills(x, y):
        return 2.0 * np.exp(-(((x - 20) / 3) ** 2)) + 4.0 * np.exp(-(((x - 50) / 3) ** 2))

    ray = np.array([[1.0, 0.0, -0.02]])
    found = float(ground_distance_m([0, 0, 2.0], ray, hills)[0])
    assert found < 20
    assert float(hills(np.array([found]), 0)[0]) == pytest.approx(2.0 - 0.02 * found, abs=0.05)


def test_agreeing_depths_are_averaged_by_their_sureness():
    depth, sigma, used = fuse_depths([10.0, 11.0, np.nan], [1.0, 2.0, np.nan])
    assert depth == pytest.approx((10 / 1 + 11 / 4) / (1 + 1 / 4))
    assert sigma == pytest.approx(np.sqrt(1 / 1.25))
    assert used.tolist() == [True, True, False]


def test_the_one_that_disagrees_is_left_out():
    depth, _, used = fuse_depths([20.0, 21.0, 45.0], [1.0, 1.0, 1.0])
    assert depth == pytest.approx(20.5)
    assert used.tolist() == [True, True, False]
    depth, sigma, used = fuse_depths([20.0, 40.0], [1.0, 3.0])
    assert (depth, used.tolist()) == (20.0, [True, False])
    assert sigma == pytest.approx(10.0)
    depth, sigma, used = fuse_depths([np.nan, np.nan], [1.0, 1.0])
    assert np.isnan(depth)
    assert not used.any()


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.tuples(st.floats(1, 100), st.floats(0.1, 20)), min_size=1, max_size=3), st.randoms()
)
def test_fusing_does_not_depend_on_the_order(pairs, random):
    depths, sigmas = zip(*pairs, strict=True)
    order = list(range(len(pairs)))
    random.shuffle(order)
    here = fuse_depths(depths, sigmas)
    there = fuse_depths([depths[i] for i in order], [sigmas[i] for i in order])
    if len(set(sigmas)) == len(sigmas) and len(set(depths)) == len(depths):
        assert there[0] == pytest.approx(here[0])
        assert there[1] == pytest.approx(here[1])
    assert min(depths) - 1e-9 <= here[0] <= max(depths) + 1e-9
