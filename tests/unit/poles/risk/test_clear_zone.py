"""Curve factors and runout lengths against rows of the guide that are public."""

import numpy as np
import pytest

from roadsight.poles.risk.clear_zone import curve_factor
from roadsight.poles.risk.shielding import runout_m

KMH = {40: 60, 45: 70, 50: 80, 55: 90, 60: 100, 65: 110}
"""Columns of the metric table for those of the table in miles an hour."""


@pytest.mark.parametrize(
    ("radius_ft", "factors"),
    [
        (2860, {40: 1.1, 45: 1.1, 50: 1.1}),
        (1641, {40: 1.1, 45: 1.2, 50: 1.2, 55: 1.3, 60: 1.3, 65: 1.4}),
        (1430, {40: 1.2, 45: 1.2, 50: 1.3, 55: 1.3, 60: 1.4}),
        (380, {40: 1.5}),
    ],
)
def test_curve_factors_are_those_of_the_table_in_feet(radius_ft, factors):
    for mph, factor in factors.items():
        found = curve_factor([0.3048 * radius_ft], KMH[mph], [True])[0]
        # Other rows than the metric table's: the next smaller radius may give a tenth more.
        assert found == pytest.approx(factor, abs=0.101)


def test_no_curve_factor_beyond_900_m_or_inside():
    assert curve_factor([901.0, 200.0, np.nan], 100, [True, False, True]).tolist() == [1, 1, 1]


def test_runout_length_that_is_public():
    assert runout_m(100, 7000) == 76
