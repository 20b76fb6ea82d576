import pytest

from roadsight.poles.risk.clear_zone import clear_zone_m, curve_factor
from roadsight.poles.risk.shielding import runout_m

MPH = 1.609344


@pytest.mark.parametrize(
    ("mph", "kmh"), [(40, 60), (45, 80), (50, 80), (55, 90), (60, 100), (65, 110), (70, 110)]
)
def test_speeds_in_miles_an_hour_take_the_row_that_the_guide_prints_beside_them(mph, kmh):
    for aadt in (500, 1000, 3000, 9000):
        assert clear_zone_m(mph * MPH, aadt, [0.0]) == clear_zone_m(kmh, aadt, [0.0])


@pytest.mark.parametrize(
    ("mph", "kmh"), [(30, 50), (40, 60), (50, 80), (60, 100), (70, 110), (80, 130)]
)
def test_so_do_runout_lengths(mph, kmh):
    assert runout_m(mph * MPH, 12_000) == runout_m(kmh, 12_000)


@pytest.mark.parametrize(
    ("aadt", "width_m"), [(749, 5.5), (750, 7.5), (1499, 7.5), (1500, 9), (6000, 9), (6001, 10)]
)
def test_classes_of_traffic_begin_and_end_where_the_guide_says(aadt, width_m):
    assert clear_zone_m(100, aadt, [0.0])[0] == width_m


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
        found = curve_factor([0.3048 * radius_ft], mph * MPH, [True])[0]
        # Other rows than the metric table's: the next smaller radius may give a tenth more.
        assert found == pytest.approx(factor, abs=0.101)


@pytest.mark.parametrize(
    ("aadt", "length_m"),
    [(999, 61), (1000, 64), (4999, 64), (5000, 76), (7000, 76), (10_000, 76), (10_001, 91)],
)
def test_so_do_classes_of_traffic_of_runout_lengths(aadt, length_m):
    assert runout_m(100, aadt) == length_m
