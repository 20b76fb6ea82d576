import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.geometry.cameras import (
    Intrinsics,
    attitude_deg,
    azimuth_deg,
    cam_from_world,
    compass_deg,
    pixel_directions,
    project,
    wrap_deg,
)

CAMERA = Intrinsics.from_field_of_view(640, 480, 60.0)


def test_level_camera_to_the_north() -> None:
    np.testing.assert_allclose(
        cam_from_world(0.0, 0.0, 0.0), [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-15
    )


def test_axes_turn_the_way_the_angles_say() -> None:
    east = cam_from_world(90.0, 0.0, 0.0)
    np.testing.assert_allclose(east[2], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(east[0], [0, -1, 0], atol=1e-15)
    assert cam_from_world(10.0, 5.0, 0.0)[2, 2] > 0  # nose up
    assert cam_from_world(10.0, 0.0, 5.0)[0, 2] > 0  # right side up


@given(st.floats(0, 359.99), st.floats(-89, 89), st.floats(-179, 179))
def test_attitude_inverts_rotation(heading: float, pitch: float, roll: float) -> None:
    rotation = cam_from_world(heading, pitch, roll)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    found = attitude_deg(rotation)
    assert abs(wrap_deg(found[0] - heading)) < 1e-9
    assert found[1] == pytest.approx(pitch, abs=1e-9)
    assert found[2] == pytest.approx(roll, abs=1e-9)


def test_rotations_of_many_cameras_at_once() -> None:
    headings = np.array([0.0, 123.0, 359.0])
    stack = cam_from_world(headings, 1.0, -2.0)
    for k, heading in enumerate(headings):
        np.testing.assert_allclose(stack[k], cam_from_world(heading, 1.0, -2.0))


def test_pixels_and_directions_are_inverse() -> None:
    rng = np.random.default_rng(3)
    rotation, position = cam_from_world(200.0, -3.0, 2.0), np.array([10.0, -20.0, 3.0])
    uv = rng.uniform([0, 0], [639, 479], (200, 2))
    points = position + pixel_directions(CAMERA, rotation, uv) * rng.uniform(1, 90, (200, 1))
    found, depth = project(CAMERA, rotation, position, points)
    np.testing.assert_allclose(found, uv, atol=1e-9)
    assert (depth > 0).all()


def test_a_point_to_the_right_and_above() -> None:
    uv, depth = project(CAMERA, cam_from_world(0, 0, 0), [0, 0, 0], [[1.0, 10.0, 1.0]])
    assert depth[0] == pytest.approx(10.0)
    assert uv[0, 0] > CAMERA.cx_px
    assert uv[0, 1] < CAMERA.cy_px


def test_points_behind_and_beside_have_no_pixel() -> None:
    uv, depth = project(
        CAMERA, cam_from_world(0, 0, 0), [0, 0, 0], [[0, -5.0, 0], [3.0, 0, 0], [0, 0, 0]]
    )
    assert np.isnan(uv).all()
    assert (depth <= 0).all()
    assert not CAMERA.contains(uv, margin_px=1e9).any()


def test_image_bounds_are_half_a_pixel_outside_the_outer_centres() -> None:
    inside = CAMERA.contains([[-0.5, -0.5], [639.4, 479.4], [639.5, 0], [0, -0.51]])
    assert inside.tolist() == [True, True, False, False]
    assert CAMERA.contains([[-10.0, 5.0]], margin_px=10).all()


def test_angles_wrap() -> None:
    assert wrap_deg(359.0 - 1.0) == pytest.approx(-2.0)
    assert wrap_deg(180.0) == -180.0
    assert compass_deg(-1e-20) == 0.0
    assert azimuth_deg([0, 0], [-1.0, 1.0]) == pytest.approx(315.0)
    assert np.isnan(azimuth_deg([1.0, 2.0], [1.0, 2.0]))


def test_field_of_view_round_trip() -> None:
    assert CAMERA.hfov_deg == pytest.approx(60.0)
