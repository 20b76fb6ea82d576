import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.base.sections.poles import Hazard
from roadsight.poles.risk.inventory import SAME_M, check_inventory
from roadsight.poles.risk.road_doubts import (
    edge_doubts,
    inventory_doubts,
    lane_doubts,
    traffic_doubts,
)
from roadsight.poles.risk.roads import Road, Roads
from roadsight.poles.risk.roadside import Surroundings, geometry_table

NAN = float("nan")
NOTHING = Hazard()
STATED = Hazard(design_speed_kmh=70, aadt=3000)
COLUMNS = ["route", "from_m", "to_m", "speed_kmh", "aadt", "lanes"]


def inventory(*rows):
    return check_inventory(pd.DataFrame(list(rows), columns=COLUMNS), "inventory.csv")


def road(name="a", start_m=0.0, end_m=1000.0, half_m=3.0):
    x = np.arange(start_m, end_m + 1)
    half = np.broadcast_to(half_m, x.shape).astype(float)
    return Road(name, (name,), "", np.column_stack([x, 0 * x]), x, half, half)


def told(known, *roads, lines=True, site=NOTHING):
    found = {doubt.code: doubt for doubt in inventory_doubts(known, roads, lines, site)}
    assert all(doubt.measured > doubt.limit for doubt in found.values() if lines)
    return found


def test_an_inventory_that_says_everything_is_not_doubted():
    known = inventory(("a", 0, 500, 80, 3000, 2), ("a", 500, 1000, 90, 3500, 2))
    assert told(known, road()) == {}


def test_one_speed_for_all_roads_is_noted_and_none_doubted_where_no_inventory_is_given():
    (note,) = traffic_doubts(STATED)
    assert (note.code, note.severity) == ("traffic_by_settings", "note")
    assert note.measured == "70 km/h, 3,000 vehicles a day"
    (doubt,) = traffic_doubts(NOTHING)
    assert (doubt.code, doubt.severity) == ("traffic_not_stated", "doubt")
    assert "no design speed (hazard.design_speed_kmh) and no traffic" in doubt.message
    note, doubt = traffic_doubts(Hazard(aadt=0))
    assert note.measured == "0 vehicles a day"
    assert "no traffic" not in doubt.message


@pytest.mark.parametrize(
    ("stated", "follows"),
    [
        ({}, "clear zones, ratings and exposure are ranges for 60 to 110 km/h and any traffic"),
        ({"aadt": 3000}, "clear zones and ratings are ranges for 60 to 110 km/h"),
        ({"design_speed_kmh": 70}, "clear zones, ratings and exposure are ranges for any traffic"),
        ({"clear_zone_m": 6}, "exposure is a range"),
        ({"clear_zone_m": 6, "aadt": 3000}, "barriers are judged by the longest runout lengths"),
        ({"clear_zone_m": 6, "runout_length_m": 90, "aadt": 3000}, None),
    ],
)
def test_only_what_lacks_is_told_with_what_follows(stated, follows):
    found = {doubt.code: doubt.message for doubt in traffic_doubts(Hazard(**stated))}
    if follows is None:
        assert "traffic_not_stated" not in found
    else:
        assert found["traffic_not_stated"].endswith(f": {follows}")


def test_an_inventory_s_lack_is_told_with_what_follows():
    known = inventory(("a", 0, 500, NAN, 500, 2), ("a", 500, 1000, 80, NAN, NAN))
    own = told(known, road(), site=Hazard(clear_zone_m=6, runout_length_m=90))
    assert own["inventory_without_speed"].severity == "note"
    assert "exposure is a range there" in own["inventory_without_aadt"].message
    own = told(known, road())
    assert (
        "clear zones and ratings are ranges for 60 to 110 km/h there"
        in own["inventory_without_speed"].message
    )
    assert "where markings do not show it" in own["inventory_without_lanes"].message


def painted(*offsets_m):
    x = np.tile(np.arange(0.0, 1000, 0.25), 4)
    image = np.repeat(np.arange(4), len(x) // 4).astype(str)
    return pd.concat([pd.DataFrame({"x": x, "y": y, "image": image}) for y in offsets_m])


@pytest.mark.parametrize(("stated", "metres"), [(2, 0), (4, 500), (NAN, 0)])
def test_markings_that_contradict_the_inventory_are_told(stated, metres):
    known = inventory(("a", 0, 500, 80, 3000, 2), ("a", 500, 1000, 80, 3000, stated))
    beside = Surroundings(Roads([road(half_m=3.5)]), inventory=known)
    assert lane_doubts(beside) == []
    beside = Surroundings(beside.roads, inventory=known, markings=painted(-3, 0, 3))
    found = lane_doubts(beside)
    assert [doubt.code for doubt in found] == ["lanes_contradicted"] * (metres > 0)
    for doubt in found:
        assert doubt.measured == pytest.approx(metres, abs=20)
        assert "a from 505 to 1000 m (2, not 4)" in doubt.message
    assert lane_doubts(Surroundings(beside.roads, markings=painted(-3, 0, 3))) == []


def test_without_an_edge_markings_tell_no_lanes_which_is_said():
    bare = road(half_m=NAN)
    table = geometry_table(Surroundings(Roads([bare]), markings=painted(-3, 0, 3)))
    assert table[["lanes", "travelled_left_m"]].isna().all(axis=None)
    (doubt,) = edge_doubts([bare])
    assert "markings there tell no lanes" in doubt.message


def test_what_the_site_states_fills_the_gaps_of_an_inventory():
    known = inventory(("a", 0, 100, NAN, 500, 2), ("a", 300, 1000, 80, NAN, 2))
    codes = {"inventory_gaps", "inventory_without_speed", "inventory_without_aadt"}
    found = told(known, road(), site=STATED)
    assert set(found) == codes
    assert {doubt.severity for doubt in found.values()} == {"note"}
    gap = found["inventory_gaps"].message
    assert "the site's 70 km/h and 3,000 vehicles a day hold there" in gap
    half = told(known, road(), site=Hazard(design_speed_kmh=70))
    assert {code for code, doubt in half.items() if doubt.severity == "doubt"} == {
        "inventory_gaps", "inventory_without_aadt",
    }  # fmt: skip


def test_what_lacks_along_the_road_is_one_doubt_each_and_elsewhere_none():
    known = inventory(
        ("a", 0, 100, NAN, 500, 2), ("a", 100, 200, NAN, 500, 2), ("a", 300, 1400, 80, NAN, NAN),
        ("far", 0, 100, NAN, NAN, NAN), ("far", 500, 600, NAN, NAN, NAN),
    )  # fmt: skip
    found = told(known, road())
    assert {code: doubt.measured for code, doubt in found.items()} == {
        "inventory_gaps": 100.0,
        "inventory_without_speed": 200.0,
        "inventory_without_aadt": 700.0,
        "inventory_without_lanes": 700.0,
    }
    assert "nothing for a from 200 to 300 m:" in found["inventory_gaps"].message
    assert "no speed for a from 0 to 200 m:" in found["inventory_without_speed"].message
    assert {code for code, doubt in found.items() if doubt.severity == "note"} == {
        "inventory_without_lanes"
    }


def test_an_inventory_of_other_measures_or_of_other_roads():
    (doubt,) = told(inventory(("a", 8000, 9000, 80, 1, 2)), road()).values()
    assert (doubt.code, doubt.measured) == ("inventory_gaps", 1000.0)
    assert "from 0 to 1000 m" in doubt.message
    assert "it states a from 8000 to 9000 m" in doubt.message
    roads = [road(name) for name in ("b", "c", "d", "e", "b")]
    (doubt,) = told(inventory(("a", 0, 1000, 80, 1, 2)), road(), *roads).values()
    assert (doubt.code, doubt.measured) == ("road_unnamed", 5000.0)
    assert "does not name road b, c, d and 1 more (it names a)" in doubt.message


def test_measures_that_nothing_places():
    found = told(inventory(("a", 0, 1000, 80, 1, 2)), road(), lines=False)
    (doubt,) = found.values()
    assert (doubt.code, doubt.measured, doubt.limit) == ("measures_from_first_image", 0, 1)


@given(st.lists(st.floats(-500, 1500), min_size=2, max_size=8, unique=True))
def test_gaps_and_segments_make_up_the_road(ends):
    ends = sorted(ends)
    rows = [("a", low, high, 80, 1, 2) for low, high in zip(ends[::2], ends[1::2], strict=False)]
    found = told(inventory(*rows), road()).get("inventory_gaps")
    stated = sum(max(min(high, 1000) - max(low, 0), 0) for _, low, high, *_ in rows)
    gap = found.measured if found else 0.0
    # Gaps up to `SAME_M` are none.
    assert 1000 - stated - SAME_M * (len(rows) + 1) - 0.1 <= gap <= 1000 - stated + 0.1


@pytest.mark.parametrize(("gap_m", "measured"), [(95, None), (150, 302), (None, 2002)])
def test_roads_without_an_edge_over_more_than_a_gap(gap_m, measured):
    x = np.arange(0, 1001.0)
    bare = np.ones(len(x), bool) if gap_m is None else np.abs(x - 500) <= gap_m / 2
    found = edge_doubts([road(), road("b", half_m=np.where(bare, NAN, 3.0))])
    assert [doubt.code for doubt in found] == ([] if measured is None else ["road_without_edge"])
    for doubt in found:
        assert doubt.measured == pytest.approx(measured, abs=4)
        assert "no edge of road b is known" in doubt.message
