"""How far a beam carries: reflectivity, rain and fog in the lidar equation.

The power that returns from a surface that fills the beam falls with its reflectivity, with the
square of its range and, both ways, with the extinction of the air (for example Wojtanowski et al.
2014, "Comparison of 905 nm and 1550 nm semiconductor laser rangefinders' performance deterioration
due to adverse environmental conditions", Opto-Electronics Review 22, Eq. 1).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.placement.sensors.sensors import AnySensor, Rosette, Sensor

# Visibility from which on the air counts as clear (WMO-No. 8: the haze limit is 5 km).
CLEAR_M = 20_000.0
_CONTRAST = 3.912  # minus the logarithm of 2 %, the contrast that is just seen (Koschmieder)
_REFERENCE_NM = 550.0  # wavelength at which visibility is defined: that of the eye
# Extinction, 1/m, below which ranges stay as they are: in r = W(a R) / a, both sides of the
# quotient go to 0, and at 0 it has no value.
_CLEAR_PER_M = 1e-12


def rain_extinction_per_m(rain_mm_h: float) -> float:
    """Extinction coefficient of rain, 1/m: 0.365 R^0.63 per km.

    Drops are much larger than the wavelength, so that each takes twice its cross-section out of the
    beam; the drops' sizes are those of Marshall and Palmer (1948, "The distribution of raindrops
    with size", Journal of Meteorology 5): N(D) = 8000 exp(-4.1 R^-0.21 D) per m3 and mm. The
    integral over them has this closed form.

    Raises
    ------
    InputError : the rain rate is negative.
    """
    if not rain_mm_h >= 0:
        raise InputError("must not be negative", where="rain_mm_h", found=rain_mm_h)
    # pi N0 / L^3 with L = 4.1 R^-0.21 per mm: 2 (pi / 4) N0 (2 / L^3) 1e-6 m2 per mm2.
    return float(np.pi * 8000.0 * 1e-6 / 4.1**3 * rain_mm_h**0.63)


def fog_extinction_per_m(visibility_m: float, wavelength_nm: float) -> float:
    """Extinction coefficient of fog or haze, 1/m, at a wavelength.

    Kim, McArthur and Korevaar (2001), "Comparison of laser beam propagation at 785 nm and 1550 nm
    in fog and haze for optical wireless communications", Proc. SPIE 4214, Eqs. 6 and 8: Kruse's law
    with an exponent that ends at zero in dense fog.

    Raises
    ------
    InputError : the visibility is not positive.
    """
    if not visibility_m > 0:
        raise InputError("must be positive", where="visibility_m", found=visibility_m)
    km = visibility_m / 1000
    if km > 50:
        exponent = 1.6
    elif km > 6:
        exponent = 1.3
    elif km > 1:
        exponent = 0.16 * km + 0.34
    else:
        exponent = max(km - 0.5, 0.0)
    return float(_CONTRAST / visibility_m * (wavelength_nm / _REFERENCE_NM) ** -exponent)


def wavelength_nm(sensor: AnySensor) -> float:
    """Wavelength at which a LiDAR or a camera sees, nm."""
    return sensor.wavelength_nm if isinstance(sensor, Sensor | Rosette) else _REFERENCE_NM


def reflectivity_range_m(sensor: Sensor | Rosette, reflectivity: ArrayLike) -> Floats:
    """Range at which a surface of a reflectivity returns as much as the sensor needs.

    Range grows with the square root of the reflectivity, through the datasheet's range at 10 %
    where it gives one, and no farther than the stated range.

    Parameters
    ----------
    reflectivity : 0 to 1, any shape; what reflects nothing is seen from nowhere.
    """
    known_m, at = sensor.range_m, sensor.range_reflectivity
    if sensor.range_10_m is not None:
        known_m, at = sensor.range_10_m, 0.1
    return np.minimum(known_m * np.sqrt(np.asarray(reflectivity) / at), sensor.range_m)


def range_in_air_m(clear_range_m: ArrayLike, extinction_per_m: float) -> Floats:
    """Range at which the signal is as weak as at ``clear_range_m`` in clear air.

    Solves r exp(a r) = R for r: r = W(a R) / a with Lambert's W.

    Parameters
    ----------
    clear_range_m : R, any shape. extinction_per_m : a, not negative.
    """
    clear = np.asarray(clear_range_m, np.float64)
    if extinction_per_m < _CLEAR_PER_M:
        return clear
    from scipy.special import lambertw  # noqa: PLC0415  # slow to load

    return np.asarray(lambertw(extinction_per_m * clear).real / extinction_per_m)


def contrast_range_m(extinction_per_m: float) -> float:
    """Range at which air leaves 2 % of a contrast (Koschmieder): infinite in clear air."""
    return _CONTRAST / extinction_per_m if extinction_per_m > 0 else np.inf


EARTH_RADIUS_M = 6_371_000.0  # mean radius (IUGG)
REFRACTION = 0.13  # coefficient of refraction, Gauss' mean value of geodetic practice


def rise_m(distance_m: ArrayLike) -> Floats:
    """How far a level beam has risen above the level surface through its start.

    d^2 (1 - k) / (2 R): the Earth curves away below it and refraction bends it back by a part k.

    Parameters
    ----------
    distance_m : horizontal distance, any shape.
    """
    distance = np.asarray(distance_m, np.float64)
    return np.asarray((1 - REFRACTION) * distance**2 / (2 * EARTH_RADIUS_M))
