import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError

from roadsight.base.errors import InputError
from roadsight.placement.candidates.mounting import (
    Mounting,
    building_cost,
    cable_lengths_m,
    may_be_built,
)


@pytest.fixture
def candidates():
    return pd.DataFrame(
        {
            "candidate": list("abcd"), "mount": ["edge", "edge", "median", "pole"],
            "x": [0.0, 100.0, 200.0, 300.0], "y": 0.0, "height_m": [4.0, 6.0, 6.0, 5.0],
            "off_pavement_m": [0.4, 3.0, 0.4, 0.2], "wall_m": [2.0, 0.6, 2.0, 0.5],
        }
    )  # fmt: skip


CABINETS = pd.DataFrame({"id": ["k1", "k2"], "x": [0.0, 290.0], "y": [30.0, 0.0]})


def test_without_rules_all_are_built_for_nothing(candidates):
    assert may_be_built(candidates, Mounting(), None).all()
    assert (building_cost(candidates, Mounting(), None) == 0).all()


@pytest.mark.parametrize(
    ("rules", "allowed"),
    [
        ({"offset_min_m": 0.5}, "bd"),
        ({"clear_zone_m": 2.0}, "abcd"),
        ({"clear_zone_m": 2.0, "unshielded": "forbid"}, "bd"),
        ({"median": "forbid"}, "abd"),
        # Near the pavement a sensor hangs above the vehicles, on an old pole as well.
        ({"clearance_m": 5.1}, "bc"),
        ({"clearance_m": 4.9}, "bcd"),
        ({"wall_distance_m": 1.0}, "acd"),
        ({"cable_max_m": 95.0}, "acd"),
    ],
)
def test_rules(candidates, rules, allowed):
    rules = Mounting(**rules)
    cable_m = cable_lengths_m(candidates, CABINETS, rules, "cabinets")
    found = may_be_built(candidates, rules, cable_m)
    assert "".join(candidates["candidate"][found]) == allowed


def test_costs_add_up(candidates):
    rules = Mounting(
        mast_cost=2.0, mast_cost_per_m=0.1, foundation_cost=0.5, clear_zone_m=1.0,
        shielding_cost=3.0, cable_cost_per_m=0.01,
    )  # fmt: skip
    cable_m = cable_lengths_m(candidates, CABINETS, rules, "cabinets")
    assert cable_m == pytest.approx([30.0, np.hypot(100, 30), 90.0, 10.0])
    expected = [2.9 + 3 + 0.3, 3.1 + 0.01 * np.hypot(100, 30), 3.1 + 3 + 0.9, 0.1]
    assert building_cost(candidates, rules, cable_m) == pytest.approx(expected)


def test_a_cabinet_off_the_site_is_one_message(candidates):
    far = CABINETS.assign(x=[0.0, 50_000.0])
    with pytest.raises(InputError, match=r"cabinet k2 lies off the site.*CRS"):
        cable_lengths_m(candidates, far, Mounting(), "cabinets.geojson")


def test_cables_that_cost_need_a_cabinet(candidates):
    with pytest.raises(InputError, match=r"no cabinet is known.*placement.cabinets"):
        cable_lengths_m(candidates, None, Mounting(cable_cost_per_m=1), "mounting")
    assert cable_lengths_m(candidates, None, Mounting(), "mounting") is None


def test_a_rule_of_no_sense_is_refused():
    with pytest.raises(ValidationError):
        Mounting(median="maybe")
