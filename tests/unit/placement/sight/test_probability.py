import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.base.sections.sensing import Targets
from roadsight.placement.sensors.sensors import load_sensors
from roadsight.placement.sight.detectors import CameraDetector, Criteria, detector_of
from roadsight.placement.sight.probability import Curve, Curves, found_by_plan

LIDAR = Curve(*Targets().lidar_curve)
CAMERA = Curve(*Targets().camera_curve)
SENSORS = load_sensors("config/sensors.yaml")


def test_the_settings_have_the_published_curves():
    assert Targets().min_probability == 0
    found = LIDAR.probability([0, 1, 5, 9, 10, 1e6])
    np.testing.assert_allclose(found, [0, 0.659, 0.90364, 0.99298, 1, 1], atol=1e-5)
    assert [LIDAR.needed(p) for p in (0.5, 0.659, 0.9, 0.95, 1.0)] == [1, 1, 5, 7, 10]
    assert CAMERA.needed(0.5) == 530


@given(st.floats(0.01, 2), st.floats(-2, 1), st.floats(0.01, 1), st.integers(0, 10**6))
def test_the_number_needed_is_the_fewest_that_suffice(slope, offset, asked, number):
    curve = Curve(slope, offset)
    needed = curve.needed(asked)
    assert needed >= 1
    if needed < 10**8:
        assert curve.probability(needed) >= asked
        assert needed == 1 or curve.probability(needed - 1) < asked
    assert 0 <= curve.probability(number) <= curve.probability(number + 1) <= 1


def test_a_slope_that_never_gets_there_needs_more_than_anybody_has():
    assert Curve(0.001, -10).needed(1.0) >= 10**8


def literal(hits, curves):
    """Target by target and sensor by sensor."""
    best, together = [], []
    for column in hits.T:
        shares = [
            min(max(c.slope * np.log(h) + c.offset, 0), 1)
            for h, c in zip(column, curves, strict=True)
            if c is not None and h > 0
        ]
        if shares:
            best.append(max(shares))
            together.append(1 - np.prod([1 - p for p in shares]))
    return best, together


def test_a_plan_is_what_a_count_by_hand_says():
    rng = np.random.default_rng(2)
    hits = rng.integers(0, 40, (4, 60)) * (rng.random((4, 60)) < 0.4)
    curves = [Curve(0.1, 0.3), None, Curve(0.05, 0.4), Curve(0.1, 0.3)]
    found = found_by_plan(hits, curves)
    best, together = literal(hits, curves)
    assert found["targets"] == len(best) < 60
    assert (found["least"], found["mean"]) == (
        pytest.approx(min(best)),
        pytest.approx(np.mean(best)),
    )
    independent = found["independent"]
    assert independent["least"] == pytest.approx(min(together))
    assert independent["mean"] == pytest.approx(np.mean(together))


def test_radars_have_no_curve():
    curves = Curves(LIDAR, CAMERA)
    assert curves.of(SENSORS["OS-64"]) == curves.of(SENSORS["Avia"]) == LIDAR
    assert curves.of(SENSORS["camera-8mp"]) == CAMERA
    assert curves.of(SENSORS["radar-77ghz"]) is None
    assert found_by_plan(np.ones((1, 3)), [None]) is None
    assert found_by_plan(np.zeros((1, 3)), [LIDAR]) == {"targets": 0}


def test_cameras_take_the_pixels_that_are_asked():
    camera = SENSORS["camera-8mp"]
    usual, asked = (detector_of(camera, Criteria(8, 1.0, n)) for n in (None, 530))
    assert isinstance(usual, CameraDetector)
    pixels = np.array([187.0, 188.0, 529.0, 530.0])
    assert usual.sees(pixels).tolist() == [False, True, True, True]
    assert asked.sees(pixels).tolist() == [False, False, False, True]
