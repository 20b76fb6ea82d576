import json

import numpy as np
import pytest

from roadsight.geometry.frames import Frame

FEET = 0.3048
SURVEY_FEET = 1200 / 3937


def test_metres_are_moved_and_feet_are_scaled_by_hand():
    frame = Frame((1000.0, 2000.0, 100.0), FEET, SURVEY_FEET)
    local = frame.to_local([[1010.0, 1990.0, 103.937]])
    np.testing.assert_allclose(local, [[3.048, -3.048, 3.937 * 1200 / 3937]], rtol=1e-12)


def test_plan_coordinates_alone_are_accepted():
    frame = Frame((10.0, 20.0, 30.0), FEET)
    np.testing.assert_allclose(frame.to_local([11.0, 22.0]), [FEET, 2 * FEET])
    np.testing.assert_allclose(frame.to_native([FEET, 2 * FEET]), [11.0, 22.0])


@pytest.mark.parametrize("shape", [(3,), (0, 3), (5, 3), (2, 4, 3), (2, 4, 2)])
def test_there_and_back_keeps_shape_and_place(rng, shape):
    frame = Frame((635_610.25, 4_852_440.5, 412.0), FEET, SURVEY_FEET)
    native = rng.uniform(-500, 500, shape) + np.array(frame.origin)[: shape[-1]]
    local = frame.to_local(native)
    assert local.shape == shape
    assert local.dtype == np.float64
    np.testing.assert_allclose(frame.to_native(local), native, rtol=0, atol=2e-9)


def test_float32_input_is_widened_before_the_origin_is_taken_away():
    frame = Frame((5_000_000.0, 0.0, 0.0))
    local = frame.to_local(np.array([[5_000_001.0, 0.0, 0.0]], np.float32))
    assert local[0, 0] == 1.0


def test_local_float32_keeps_a_tenth_of_a_millimetre_at_5000_km():
    frame = Frame((5_000_000.0, 5_000_000.0, 0.0))
    native = np.array([5_000_812.3456, 5_000_123.4567, 98.7654])
    back = frame.to_native(frame.to_local(native).astype(np.float32))
    np.testing.assert_allclose(back, native, rtol=0, atol=1e-4)
    assert abs(float(np.float32(native[0])) - native[0]) > 0.1  # what storing native would lose


def test_json_content_comes_back_and_other_keys_are_ignored():
    frame = Frame((1.5, -2.0, 3.0), FEET, 1.0, 'LOCAL_CS["x"]')
    content = json.loads(json.dumps(frame.to_dict() | {"points": 5}))
    assert Frame.from_dict(content) == frame
    assert Frame.from_dict(json.loads(json.dumps(Frame((0.0, 0.0, 0.0)).to_dict()))).crs_wkt is None
