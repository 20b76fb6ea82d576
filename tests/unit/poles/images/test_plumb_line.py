import cv2
import numpy as np
import pytest

from roadsight.geometry.lens import RadialLens
from roadsight.poles.drive.drive_profile import upright_curves
from roadsight.poles.images.plumb_line import bow, doubt, fit_lens
from roadsight.poles.images.views import source_places, straightened

SIZE = 640, 416


def lines(rng, lens, count=40, noise_px=0.1):
    """Upright lines all over the image as the lens shows them."""
    curves = []
    for _ in range(count):
        u, tilt = rng.uniform(10, 630), rng.normal(0, 3)
        v = np.arange(*np.sort(rng.choice([20, 120, 250, 390], 2, replace=False)), 1.0)
        straight = np.column_stack([u + tilt * (v - 208) / 208, v])
        curves.append(lens.distort(straight) + rng.normal(0, noise_px, (len(v), 2)) * [1, 0])
    return curves


def test_bow_of_a_parabola():
    t = np.linspace(-1, 1, 201)
    curve = np.column_stack([100 + 3.0 * t**2, 200 + 150 * t])
    assert abs(bow(curve)) == pytest.approx(3.0, rel=1e-3)
    assert bow(curve) == pytest.approx(-bow(curve * [-1, 1]), rel=1e-9)
    assert bow(curve[:, ::-1] @ np.diag([1.0, -1.0])) == pytest.approx(bow(curve), rel=1e-9)
    assert bow(np.zeros((5, 2))) == bow(np.zeros((1, 2))) == 0.0


@pytest.mark.parametrize("k", [(-0.08, 0.0), (-0.03, 0.0), (0.05, 0.0), (-0.1, 0.02)])
def test_finds_the_lens(rng, k):
    lens = RadialLens.centred(*k, *SIZE)
    found = fit_lens(lines(rng, lens), *SIZE)
    assert found.corner_px == pytest.approx(lens.corner_px(*SIZE), abs=4 * found.sigma_px)
    assert found.sigma_px < 6.0
    assert found.curves >= 30


def test_sigma_is_that_of_repeated_measurements(rng):
    lens = RadialLens.centred(-0.05, 0.0, *SIZE)
    found = [fit_lens(lines(rng, lens, 20, 0.3), *SIZE) for _ in range(12)]
    errors = np.array([f.corner_px for f in found]) - lens.corner_px(*SIZE)
    assert np.sqrt(np.mean(errors**2)) < 1.5 * np.median([f.sigma_px for f in found])


def test_crooked_trunks_do_not_bend_the_lens(rng):
    lens = RadialLens.centred(-0.08, 0.0, *SIZE)
    curves = lines(rng, lens, 30)
    for curve in curves[::3]:
        curve[:, 0] += rng.uniform(8, 20) * np.linspace(-1, 1, len(curve)) ** 2
    found = fit_lens(curves, *SIZE)
    assert found.corner_px == pytest.approx(lens.corner_px(*SIZE), abs=max(4 * found.sigma_px, 2))


def test_one_stretch_of_crooked_things_shows_in_the_jackknife(rng):
    lens = RadialLens.centred(0.0, 0.0, *SIZE)
    curves = lines(rng, lens, 16)
    groups = np.arange(16)
    plain = fit_lens(curves, *SIZE, groups).sigma_px
    for curve in curves[:6]:
        middle = np.sign(curve[0, 0] - 320)
        curve[:, 0] += middle * 1.5 * np.linspace(-1, 1, len(curve)) ** 2
    assert fit_lens(curves, *SIZE, groups).sigma_px > 1.2 * plain


@pytest.mark.parametrize(
    ("k1", "stretches", "told"),
    [(-0.1, 16, ""), (-0.1, 3, "too few"), (0.0, 16, "within three standard deviations")],
)
def test_a_lens_from_too_little_is_not_to_be_used(rng, k1, stretches, told):
    """Lines of two or three stretches may agree by chance, however many there are."""
    curves = lines(rng, RadialLens.centred(k1, 0.0, *SIZE), 48)
    found = doubt(fit_lens(curves, *SIZE, np.arange(48) % stretches))
    assert told in found and bool(found) == bool(told)


def test_few_lines_say_nothing(rng):
    curves = lines(rng, RadialLens.centred(-0.1, 0.0, *SIZE), 7)
    assert fit_lens(curves, *SIZE) is None
    assert fit_lens([], *SIZE) is None


def picture(lens, posts=(60, 150, 300, 420, 520, 600)):
    """Dark posts before a bright sky, as a lens shows them."""
    fine = 4
    straight = np.full((SIZE[1] * fine, SIZE[0] * fine), 210, np.uint8)
    for u in posts:
        straight[20 * fine : 400 * fine, u * fine : (u + 7) * fine] = 60
    small = cv2.resize(straight, SIZE, interpolation=cv2.INTER_AREA)
    uv = np.indices(SIZE[::-1], np.float64)[::-1].reshape(2, -1).T
    places = lens.undistort(uv).astype(np.float32).reshape(*SIZE[::-1], 2)
    return cv2.remap(
        small, places[..., 0], places[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )


def test_outlines_of_posts_are_traced():
    curves = upright_curves(picture(RadialLens.centred(0.0, 0.0, *SIZE)))
    assert len(curves) == 12
    edges = sorted(float(np.median(curve[:, 0])) for curve in curves)
    assert edges[0] == pytest.approx(59.5, abs=0.15)
    assert edges[1] == pytest.approx(66.5, abs=0.15)
    assert max(abs(bow(curve)) for curve in curves) < 0.1
    assert upright_curves(np.full((100, 100, 3), 90, np.uint8)) == []


def test_a_picture_tells_its_lens():
    lens = RadialLens.centred(-0.06, 0.0, *SIZE)
    found = fit_lens(upright_curves(picture(lens)), *SIZE)
    assert found.corner_px == pytest.approx(lens.corner_px(*SIZE), abs=3 * found.sigma_px)
    assert abs(found.corner_px) > 5 * found.sigma_px


@pytest.mark.parametrize("shape", [(416, 640), (256, 320)])
def test_straightened_maps_have_straight_posts(shape):
    lens = RadialLens.centred(-0.08, 0.0, *SIZE)
    bent = cv2.resize(picture(lens), shape[::-1], interpolation=cv2.INTER_AREA)
    before = max(abs(bow(curve)) for curve in upright_curves(bent))
    fixed = straightened(bent, source_places(lens, SIZE, shape), smooth=True)
    curves = upright_curves(fixed)
    assert len(curves) >= 8
    assert max(abs(bow(curve)) for curve in curves) < 0.15 < 0.5 * before


def test_straightening_keeps_classes_and_leaves_nothing_where_nothing_was_seen():
    lens = RadialLens.centred(0.1, 0.0, *SIZE)  # pincushion: corners come from beyond the image
    mask = np.full(SIZE[::-1], 4, np.uint8)
    fixed = straightened(mask, source_places(lens, SIZE, SIZE[::-1]))
    assert set(np.unique(fixed)) == {0, 4}
    assert fixed[0, 0] == 0
    assert fixed[200, 320] == 4
    none = RadialLens.centred(0.0, 0.0, *SIZE)
    rng = np.random.default_rng(1)
    depth = rng.integers(0, 65535, (52, 80)).astype(np.uint16)
    np.testing.assert_array_equal(straightened(depth, source_places(none, SIZE, (52, 80))), depth)
