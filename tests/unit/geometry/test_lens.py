import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from roadsight.base.errors import InputError
from roadsight.geometry.lens import RadialLens

SIZE = 640, 416


def pixels(rng, count=500, margin=0.0):
    return rng.uniform([-margin, -margin], np.add(SIZE, margin), (count, 2))


@given(st.floats(-0.4, 0.4), st.floats(-0.2, 0.2))
def test_undistorting_inverts_distorting(k1, k2):
    lens = RadialLens.centred(k1, k2, *SIZE)
    uv = pixels(np.random.default_rng(1))
    radius = np.hypot(*(uv - [lens.cx_px, lens.cy_px]).T) / lens.scale_px
    # At the fold itself two points become one: the inverse loses half of the digits there.
    inside = radius < 0.98 * lens.turning_radius
    assume(inside.any())
    np.testing.assert_allclose(lens.undistort(lens.distort(uv[inside])), uv[inside], atol=1e-8)


def test_is_the_model_of_opencv(rng):
    focal = 500.0
    lens = RadialLens.centred(-0.3, 0.09, *SIZE, focal)
    matrix = np.array([[focal, 0, lens.cx_px], [0, focal, lens.cy_px], [0, 0, 1.0]])
    uv = pixels(rng)
    points = np.column_stack([(uv - [lens.cx_px, lens.cy_px]) / focal, np.ones(len(uv))])
    coefficients = np.array([-0.3, 0.09, 0.0, 0.0])
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, coefficients)
    np.testing.assert_allclose(lens.distort(uv), expected[:, 0], atol=1e-9)


def test_the_inverse_by_bisection(rng):
    lens = RadialLens.centred(-0.15, 0.01, *SIZE)
    shown = pixels(rng, 40)
    centre = np.array([lens.cx_px, lens.cy_px])
    for uv, found in zip(shown, lens.undistort(shown), strict=True):
        way = uv - centre
        low, high = 0.0, lens.turning_radius * lens.scale_px / np.hypot(*way)
        for _ in range(80):
            middle = 0.5 * (low + high)
            at = np.hypot(*(lens.distort([centre + middle * way])[0] - centre))
            low, high = (middle, high) if at < np.hypot(*way) else (low, middle)
        np.testing.assert_allclose(found, centre + low * way, atol=1e-7)


def test_the_fold_is_where_the_slope_vanishes():
    # 1 + 3 k1 r^2 = 0
    assert RadialLens(-0.12, 0.0, 1.0, 0, 0).turning_radius == pytest.approx(1 / np.sqrt(0.36))
    assert RadialLens(0.1, 0.0, 1.0, 0, 0).turning_radius == np.inf
    assert RadialLens(-0.3, 0.2, 1.0, 0, 0).turning_radius == np.inf  # 9 k1^2 < 20 k2
    r = RadialLens(0.2, -0.3, 1.0, 0, 0).turning_radius
    assert 1 + 3 * 0.2 * r**2 - 5 * 0.3 * r**4 == pytest.approx(0, abs=1e-12)
    tiny = RadialLens(-0.12, -1e-18, 1.0, 0, 0).turning_radius
    assert tiny == pytest.approx(1 / np.sqrt(0.36), rel=1e-12)


def test_nothing_is_shown_beyond_the_fold():
    lens = RadialLens.centred(-0.5, 0.0, *SIZE)
    edge = lens.turning_radius * (1 + lens.k1 * lens.turning_radius**2) * lens.scale_px
    found = lens.undistort(
        [[lens.cx_px + 0.999 * edge, lens.cy_px], [lens.cx_px + 1.001 * edge, lens.cy_px]]
    )
    assert np.isfinite(found[0]).all()
    assert np.isnan(found[1]).all()
    beyond = lens.cx_px + 1.001 * lens.turning_radius * lens.scale_px
    assert np.isnan(lens.distort([[beyond, lens.cy_px]])).all()


def test_no_distortion_changes_nothing_and_the_centre_stays(rng):
    uv = pixels(rng, 100, margin=2000.0)
    np.testing.assert_allclose(RadialLens(0, 0, 381.0, 0.0, 0.0).undistort(uv), uv, rtol=1e-14)
    lens = RadialLens.centred(-0.2, 0.03, *SIZE)
    centre = [[lens.cx_px, lens.cy_px]]
    np.testing.assert_array_equal(lens.distort(centre), centre)
    np.testing.assert_array_equal(lens.undistort(centre), centre)


def test_displacement_at_the_corner():
    lens = RadialLens.centred(-0.1, 0.0, *SIZE)
    half = 0.5 * np.hypot(*SIZE)
    true_px = half - lens.corner_px(*SIZE)  # shown at the corner, truly farther out
    assert true_px > half
    assert true_px * (1 - 0.1 * (true_px / half) ** 2) == pytest.approx(half)


def test_lenses_that_fold_the_image_are_refused():
    RadialLens.centred(-0.1, 0.0, *SIZE).check(*SIZE, "here")
    with pytest.raises(InputError, match="folds them"):
        RadialLens.centred(-0.6, 0.0, *SIZE).check(*SIZE, "here")
    with pytest.raises(InputError, match="no lens"):
        RadialLens.centred(float("nan"), 0.0, *SIZE).check(*SIZE, "here")
