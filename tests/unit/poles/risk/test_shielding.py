"""Barriers: length of need on both sides, ends, what they do not shield."""

import numpy as np
import pytest

from roadsight.poles.risk.roads import Road, Roads
from roadsight.poles.risk.shielding import (
    Demand,
    barrier_ends,
    barriers_along,
    length_of_need_m,
    runout_m,
    shielding,
)

X = np.arange(0, 401.0)
ROADS = Roads(
    [Road("a", ("a",), "", np.column_stack([X, 0 * X]), X, np.full(401, 3.5), np.full(401, 3.5))]
)


def rail(low, high, y=-5.0, name="rail"):
    found, _ = barriers_along([np.array([[low, y], [high, y]])], [name], ROADS)
    return found


def demand(station_m=200.0, offset_m=4.5, side=1, **more):
    base = {"clear_zone_m": 6.0, "speed_kmh": 80.0, "aadt": 3000.0, "half_road_m": 3.5}
    base["from_low"] = side > 0
    return Demand(0, side, station_m, offset_m, **(base | more))


def test_runout_lengths_and_need():
    assert runout_m(80, 3000) == 49
    assert runout_m(81, 999) == 61
    assert runout_m(200, 1e6) == 143
    assert runout_m(110, 5000) == 101
    assert length_of_need_m(4.5, 1.5, 49) == pytest.approx(49 * 2 / 3)
    assert length_of_need_m(4.5, 5.0, 49) == 0


def test_a_barrier_that_starts_early_enough_shields():
    status, offset, why = shielding(demand(), rail(150, 230))
    assert (status, offset) == ("full", pytest.approx(1.5))
    assert "along its length of need" in why


@pytest.mark.parametrize(
    ("low", "high", "side", "status"),
    [
        (164.0, 230.0, 1, "partial"),  # 32.7 m and the terminal are needed before it
        (163.0, 230.0, 1, "full"),
        (201.0, 260.0, 1, "none"),
        (100.0, 203.0, 1, "partial"),  # it ends within its own terminal
        (170.0, 240.0, -1, "full"),  # on the left traffic comes from above
        (150.0, 230.0, -1, "partial"),
    ],
)
def test_length_of_need_is_upstream_of_the_object(low, high, side, status):
    found = shielding(demand(side=side), rail(low, high, y=-5.0 * side))
    assert found[0] == status
    mirrored = shielding(
        demand(side=side, from_low=side < 0), rail(400 - high, 400 - low, y=-5.0 * side)
    )
    assert mirrored[0] == status


def test_opposing_traffic_asks_for_barrier_beyond_the_object():
    wide = demand(clear_zone_m=9.0)
    assert shielding(wide, rail(150, 210))[0] == "partial"
    assert shielding(wide, rail(150, 230))[0] == "full"
    divided = demand(clear_zone_m=9.0, divided=True)
    assert shielding(divided, rail(150, 210))[0] == "full"
    unknown = {"clear_zone_m": 9.0, "half_road_m": np.nan}
    status, _, why = shielding(demand(**unknown), rail(100, 300))
    assert status == "partial"
    assert "width is unknown" in why
    assert shielding(demand(**unknown, divided=True), rail(150, 210))[0] == "full"
    assert shielding(demand(clear_zone_m=4.0, half_road_m=np.nan), rail(150, 210))[0] == "full"


def test_objects_before_close_behind_or_across():
    assert shielding(demand(offset_m=1.0), rail(100, 300))[0] == "none"
    status, _, why = shielding(demand(offset_m=2.0), rail(100, 300))
    assert status == "partial"
    assert "give way" in why
    assert shielding(demand(side=-1), rail(100, 300))[0] == "none"
    assert shielding(demand(), [*rail(190, 210), *rail(100, 300, name="long")])[0] == "full"


@pytest.mark.parametrize("gap", [(161, 240), (180, 220)])
def test_an_edge_that_is_unknown_for_a_while_is_taken_from_either_side(gap):
    half = np.where((gap[0] < X) & (gap[1] > X), np.nan, 3.5)
    road = Road("a", ("a",), "", ROADS.roads[0].xy_m, X, half, half)
    found, told = barriers_along([np.array([[100.0, -5], [300, -5]])], ["rail"], Roads([road]))
    assert told == []
    status, offset, _ = shielding(demand(), found)
    assert (status, offset) == ("full", pytest.approx(1.5))


def test_barriers_where_no_edge_is_known_are_told_and_count_for_nothing():
    half = np.where(X > 150, np.nan, 3.5)
    road = Road("a", ("a",), "", ROADS.roads[0].xy_m, X, half, half)
    found, told = barriers_along([np.array([[100.0, -5], [300, -5]])], ["rail"], Roads([road]))
    (barrier,) = found
    assert barrier.station_m[-1] == pytest.approx(210, abs=1)
    assert barrier.offset_m == pytest.approx(np.full(len(barrier.offset_m), 1.5))
    (message,) = told
    assert message.startswith("barrier rail: no edge of its road is known along 45% of it")


def test_barriers_are_cut_where_they_cross_and_their_ends_are_objects():
    found, told = barriers_along(
        [np.array([[100.0, -5], [150, -5], [150, 5], [200, 5]]), np.array([[0.0, 90], [9, 90]])],
        ["bent", "far"],
        ROADS,
    )
    assert told == ["barrier far lies along no road"]
    assert sorted(barrier.side for barrier in found) == [-1, 1]
    ends = barrier_ends(rail(100, 300))
    assert ends["id"].tolist() == ["rail start", "rail end"]
    assert ends[["x", "y"]].to_numpy() == pytest.approx(np.array([[100, -5], [300, -5]]))
    assert (ends["kind"] == "barrier end").all()
    backwards = rail(300, 100)[0]
    assert backwards.station_m[0] == 100
