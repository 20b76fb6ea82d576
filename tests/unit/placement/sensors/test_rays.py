import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.placement.sensors.rays import (
    beam_directions,
    local_from_sensor,
    returns_xyz_m,
    sensor_from_local,
    sensor_from_spherical,
    spherical_from_sensor,
)
from roadsight.placement.sensors.sensors import Sensor

SENSOR = Sensor(azimuth_step_deg=30, elevations_deg=(-40, -3, 0, 25), range_m=100)
angles = st.floats(-720, 720)
coordinates = st.tuples(*[st.floats(-1e4, 1e4)] * 3)


def test_sensor_x_points_along_yaw():
    ahead = sensor_from_local([10, 25, 3], [10, 20, 1], yaw_deg=90)
    assert ahead == pytest.approx([5, 0, 2])


@given(coordinates, coordinates, angles)
def test_frames_are_inverse(point, position, yaw_deg):
    there = sensor_from_local(point, position, yaw_deg)
    assert local_from_sensor(there, position, yaw_deg) == pytest.approx(point, abs=1e-7)


@given(coordinates)
def test_angles_are_inverse(point):
    back = sensor_from_spherical(*spherical_from_sensor(point))
    assert back == pytest.approx(point, abs=1e-8)


def test_degenerate_points_have_angles():
    points = [[0, 0, 0], [0, 0, 2], [0, 0, -2], [-1, 0, 0], [-1, -0.0, 0]]
    azimuth, elevation, range_m = spherical_from_sensor(points)
    assert azimuth.tolist() == [0, 0, 0, 180, -180]
    assert elevation.tolist() == [0, 90, -90, 0, 0]
    assert range_m.tolist() == [0, 2, 2, 1, 1]


def test_elevation_is_exact_near_the_zenith():
    _, elevation, _ = spherical_from_sensor([1e-6, 0, 1.0])
    assert 90 - elevation == pytest.approx(np.degrees(1e-6), rel=1e-6)


@pytest.mark.parametrize("yaw_deg", [0, 33.3, 180, -270])
def test_directions_are_the_sensor_frame_turned_by_yaw(yaw_deg):
    directions = beam_directions(SENSOR, yaw_deg)
    assert directions.shape == (4, 12, 3)
    expected = local_from_sensor(
        sensor_from_spherical(SENSOR.azimuth_deg, SENSOR.elevation_deg[:, None], 1.0), 0, yaw_deg
    )
    np.testing.assert_allclose(directions, expected, atol=1e-6)


@pytest.mark.parametrize("leaning", [False, True])
def test_directions_of_some_beams_are_those_of_all(rng, leaning):
    wanted = rng.uniform(size=SENSOR.shape) < 0.4
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]]) if leaning else None
    found = beam_directions(SENSOR, 20.0, tilt, wanted)
    np.testing.assert_allclose(found, beam_directions(SENSOR, 20.0, tilt)[wanted], atol=1e-7)


def test_returns_lie_on_their_beams():
    depth = np.zeros(SENSOR.shape, np.float32)
    depth[1, 7], depth[3, 0] = 20.0, 5.0
    points = returns_xyz_m(depth, SENSOR, [100, 200, 5], yaw_deg=45)
    directions = beam_directions(SENSOR, 45)
    expected = [[100, 200, 5] + 20 * directions[1, 7], [100, 200, 5] + 5 * directions[3, 0]]
    np.testing.assert_allclose(points, expected, atol=1e-5)
    assert len(returns_xyz_m(np.zeros(SENSOR.shape, np.float32), SENSOR, [0, 0, 0], 0)) == 0
