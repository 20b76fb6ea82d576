import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq

from roadsight.base.errors import InputError
from roadsight.placement.sensors.light import (
    EARTH_RADIUS_M,
    REFRACTION,
    fog_extinction_per_m,
    rain_extinction_per_m,
    range_in_air_m,
    reflectivity_range_m,
    rise_m,
)
from roadsight.placement.sensors.sensors import Sensor

ROWS = {"elevation_min_deg": -15, "elevation_max_deg": 15, "channels": 16}


@pytest.mark.parametrize("rain_mm_h", [0.5, 5.0, 50.0])
def test_rain_is_the_integral_over_the_drops(rain_mm_h):
    def shadow(diameter_mm):
        drops_per_m3_mm = 8000 * np.exp(-4.1 * rain_mm_h**-0.21 * diameter_mm)
        return 2 * np.pi / 4 * (diameter_mm / 1000) ** 2 * drops_per_m3_mm

    extinction, _ = quad(shadow, 0, 40)
    assert rain_extinction_per_m(rain_mm_h) == pytest.approx(extinction, rel=1e-6)


def test_rain_is_of_the_size_of_measured_attenuation():
    # Recommendation ITU-R P.1814: 1.076 R^0.67 dB/km (Carbonneau) and 1.58 R^0.63 (Japan).
    for rain_mm_h in (5.0, 25.0, 100.0):
        db_per_km = 4343 * rain_extinction_per_m(rain_mm_h)
        assert 1.0 < db_per_km / (1.076 * rain_mm_h**0.67) < 1.6
        assert 0.9 < db_per_km / (1.58 * rain_mm_h**0.63) < 1.1


def test_dry_air():
    assert rain_extinction_per_m(0.0) == 0.0


def test_fog_at_the_reference_wavelength_leaves_two_percent_at_the_visibility():
    for visibility_m in (100.0, 800.0, 3000.0, 10_000.0, 80_000.0):
        left = np.exp(-fog_extinction_per_m(visibility_m, 550) * visibility_m)
        assert left == pytest.approx(0.02, rel=1e-3)


def test_dense_fog_is_grey_and_haze_is_not():
    assert fog_extinction_per_m(300, 1550) == fog_extinction_per_m(300, 550)
    # 3.912 / 10 km (1550 / 550)^-1.3
    assert fog_extinction_per_m(10_000, 1550) == pytest.approx(1.0173e-4, rel=1e-3)


@given(st.floats(1, 500), st.floats(1e-6, 0.1))
def test_range_in_air_solves_the_lidar_equation(clear_m, extinction):
    found = range_in_air_m(clear_m, extinction)
    reference = brentq(lambda r: r * np.exp(extinction * r) - clear_m, 0, clear_m, xtol=1e-12)
    assert found == pytest.approx(reference, rel=1e-9)


def test_clear_air_costs_nothing():
    assert range_in_air_m(120.0, 0.0) == 120.0


def test_reflectivity():
    stated = Sensor(**ROWS, range_m=120, range_10_m=40)
    law = Sensor(**ROWS, range_m=100, range_reflectivity=0.8)
    assert reflectivity_range_m(stated, 0.1) == pytest.approx(40)
    assert reflectivity_range_m(stated, 0.4) == pytest.approx(80)
    assert reflectivity_range_m(stated, 1.0) == 120
    assert reflectivity_range_m(law, 0.2) == pytest.approx(50)
    np.testing.assert_allclose(reflectivity_range_m(law, [0.0, 0.05]), [0, 25])


def test_a_level_beam_rises_as_over_a_sphere():
    # Without refraction: sqrt(R^2 + d^2) - R.
    for distance_m in (100.0, 5000.0):
        sphere = np.hypot(EARTH_RADIUS_M, distance_m) - EARTH_RADIUS_M
        assert rise_m(distance_m) == pytest.approx((1 - REFRACTION) * sphere, rel=1e-5)


def test_impossible_weather():
    with pytest.raises(InputError, match="rain_mm_h"):
        rain_extinction_per_m(-1)
    with pytest.raises(InputError, match="visibility_m"):
        fog_extinction_per_m(0, 905)
