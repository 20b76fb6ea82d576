import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Hazard
from roadsight.poles.risk.clear_zone import clear_zone_m, clear_zone_range, curve_factor
from roadsight.poles.risk.inventory import check_inventory
from roadsight.poles.risk.roads import Road

NAN = float("nan")
GOOD = [("SR1427", 0, 500, 80, 3000, 2), ("SR1427", 500, 1000, 90, 3500, 2)]


def inventory(*rows):
    columns = ["route", "from_m", "to_m", "speed_kmh", "aadt", "lanes"]
    return check_inventory(pd.DataFrame(list(rows), columns=columns), "inventory.csv")


def road(name="sr1427e", drives=("sr1427e", "sr1427w"), end_m=1000.0):
    x = np.arange(0, end_m + 1)
    line = np.column_stack([x, 0 * x])
    return Road(name, drives, "", line, x, 0 * x + 3, 0 * x + 3)


def test_values_by_station():
    known = inventory(*GOOD)
    route = known.route_of(road())
    assert route == "SR1427"
    found = known.at(route, np.array([0.0, 499, 501, 1000, 1200]))
    assert found["speed_low_kmh"].tolist() == [80, 80, 90, 90, 60]
    assert found["speed_high_kmh"].tolist() == [80, 80, 90, 90, 110]
    assert found["aadt_high"].tolist()[:4] == [3000, 3000, 3500, 3500]
    assert np.isnan(found["lanes"].iloc[-1])


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([GOOD[0], ("SR1427", 400, 1000, 90, 1, 2)], "overlap"),
        ([("a", 0, 900, 80, 1, 2), ("a", 100, 200, 80, 1, 2), ("a", 300, 400, 9, 1, 2)], "9"),
        ([("a", 0, 900, 80, 1, 2), ("a", 100, 200, 80, 1, 2), ("a", 300, 400, 80, 1, 2)], "1 more"),
        ([("SR1427", 500, 100, 90, 1, 2)], "measures fall"),
        ([("SR1427", NAN, 100, 90, 1, 2)], "from_m is no finite number"),
        ([("SR1427", 0, 100, 900, 1, 2)], "speed_kmh is impossible"),
        ([("SR1427", 0, 100, 90, -1, 2)], "aadt is impossible"),
    ],
)
def test_contradictions_are_refused(rows, message):
    with pytest.raises(InputError, match=message) as caught:
        inventory(*rows)
    assert "inventory.csv, row" in str(caught.value)


def test_a_table_without_segments_is_refused():
    with pytest.raises(InputError, match=r"inventory.csv: holds no segment"):
        inventory()


def test_what_lacks_is_unknown():
    lacking = inventory(("a", 0, 100, NAN, 500, 2), ("a", 300, 400, 80, NAN, NAN))
    filled = lacking.at("a", np.array([50.0, 250]), Hazard(aadt=700))
    assert filled["aadt_low"].tolist() == filled["aadt_high"].tolist() == [500, 700]
    found = lacking.at("a", np.array([50.0, 250]))
    assert found["speed_low_kmh"].tolist() == [60, 60]
    assert found["aadt_low"].tolist() == [500, 0]


def test_roads_that_an_inventory_does_not_name():
    two = inventory(*GOOD, ("NC12", 0, 9, 80, 1, 2))
    assert two.route_of(road("NC-12 NB", ("NC-12 NB",))) == "NC12"
    assert two.route_of(road("I40", ("I40",))) is None
    # One route in the file is not every road's.
    assert inventory(*GOOD).route_of(road("Elm Street", ("elm_1",))) is None


@pytest.mark.parametrize(
    ("name", "route"),
    [
        ("SR1427E", "SR1427"), ("I40-EB", "I40"), ("12_n", "12"), ("Main St W", "Main St"),
        ("Maine", None), ("Vines", None), ("Main", None),
    ],
)  # fmt: skip
def test_only_directions_are_left_out_of_names(name, route):
    names = ("SR1427", "I40", "12", "Main St", "Vine", "Mai")
    known = inventory(*[(one, 0, 500, 80, 3000, 2) for one in names])
    assert known.route_of(road(name, (name,))) == route


def test_names_that_differ_in_blanks_and_hyphens_are_refused():
    with pytest.raises(InputError, match=r"row 3.*differ in blanks.*SR1427 and SR-1427"):
        inventory(*GOOD, ("SR-1427", 1000, 1500, 80, 3000, 2))


def test_carriageways_are_known_by_station_and_checked():
    rows = pd.DataFrame({"route": "a", "from_m": [0.0, 100.0], "to_m": [100.0, 200.0]})
    known = check_inventory(rows.assign(carriageway=["one-way", ""]), "i.csv")
    found = known.at("a", np.array([50.0, 150, 300]))["carriageway"]
    assert found.tolist() == ["one-way", "", ""]
    assert inventory(*GOOD).at("SR1427", np.array([50.0]))["carriageway"].tolist() == [""]
    with pytest.raises(InputError, match=r"row 2.*carriageway.*found two.*two-way, divided"):
        check_inventory(rows.assign(carriageway=["", "two"]), "i.csv")


@pytest.mark.parametrize(
    ("radius_m", "speed", "factor"),
    [(900, 60, 1.1), (901, 110, 1), (300, 90, 1.5), (310, 80, 1.4), (250, 110, 1.5), (50, 60, 1.5)],
)
def test_curve_factors(radius_m, speed, factor):
    assert curve_factor([radius_m, radius_m], speed, [True, False]).tolist() == [factor, 1]
    assert curve_factor([np.inf, NAN], speed, [True, True]).tolist() == [1, 1]


@given(
    st.floats(40, 120), st.floats(0, 20), st.floats(0, 9000), st.floats(1, 3),
    st.floats(-0.6, 0.6), st.floats(0, 0.2), st.floats(60, 2000),
)  # fmt: skip
def test_ranges_hold_every_case_within(speed, faster, aadt, busier, slope, steeper, radius):
    speeds, traffic = (speed, speed + faster), (aadt, aadt * busier)
    low, high = clear_zone_range(speeds, traffic, (slope, slope + steeper), radius, True)
    for share in (0.0, 0.3, 1.0):
        at = speed + share * faster
        width = clear_zone_m(at, aadt + share * aadt * (busier - 1), [slope + share * steeper])[0]
        width *= curve_factor([radius], at, [True])[0]
        assert low - 1e-9 <= width <= high + 1e-9
    known = clear_zone_range((speed, speed), (aadt, aadt), (slope, slope))
    assert known[0] == known[1] == clear_zone_m(speed, aadt, [slope])[0]
