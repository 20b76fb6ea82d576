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
    (doubt,) = told
    assert (doubt.code, doubt.severity, doubt.limit) == ("barrier_without_edge", "doubt", 0)
    assert doubt.measured == pytest.approx(0.45, abs=0.01)
    assert "barrier rail (45%)" in doubt.message


def test_barriers_are_cut_where_they_cross_and_their_ends_are_objects():
    found, told = barriers_along(
        [np.array([[100.0, -5], [150, -5], [150, 5], [200, 5]]), np.array([[0.0, 90], [9, 90]])],
        ["bent", "far"],
        ROADS,
    )
    (doubt,) = told
    assert (doubt.code, doubt.limit) == ("barrier_without_road", 15)
    # From its edge, which is 3.5 m from the centreline.
    assert doubt.measured == pytest.approx(86.5)
    assert "barrier far lies along no road" in doubt.message
    assert sorted(barrier.side for barrier in found) == [-1, 1]
    ends = barrier_ends(rail(100, 300))
    assert ends["id"].tolist() == ["rail start", "rail end"]
    assert ends[["x", "y"]].to_numpy() == pytest.approx(np.array([[100, -5], [300, -5]]))
    assert (ends["kind"] == "barrier end").all()
    backwards = rail(300, 100)[0]
    assert backwards.station_m[0] == 100


BENT = np.array([[100.0, -5], [150, -5], [150, 5], [200, 5]])
"""Crosses the road."""


def test_many_barriers_of_other_roads_are_one_doubt():
    lines = [np.array([[0.0, y], [9, y]]) for y in (90.0, 60, 70, 80, 95)]
    _, (doubt,) = barriers_along(lines, [f"b{n}" for n in range(5)], ROADS)
    assert "barrier b0, b1, b2 and 2 more" in doubt.message
    assert doubt.measured == pytest.approx(56.5)
    _, (doubt,) = barriers_along(lines, ["b"] * 5, Roads([]))
    assert doubt.measured is None


@pytest.mark.parametrize("line", [BENT, BENT[::-1], np.array([[100.0, -5], [390, -5]])])
def test_only_ends_of_the_line_are_ends_not_cuts(line):
    half = np.where((X > 210) & (X < 330), np.nan, 3.5)
    road = Road("a", ("a",), "", ROADS.roads[0].xy_m, X, half, half)
    found, _ = barriers_along([line], ["rail"], Roads([road]))
    assert len(found) == 2
    ends = barrier_ends(found)
    assert sorted(ends["id"]) == ["rail end", "rail start"]
    places = ends.set_index("id").loc[["rail start", "rail end"], ["x", "y"]]
    assert places.to_numpy() == pytest.approx(line[[0, -1]])


def test_a_part_that_leaves_the_road_or_goes_round_has_no_end_there():
    away = np.array([[100.0, -5], [150, -5], [200, -90]])
    found, _ = barriers_along([away], ["rail"], ROADS)
    assert barrier_ends(found)["id"].tolist() == ["rail start"]
    ring = np.array([[100.0, -5], [150, -5], [150, -7], [100, -7], [100, -5]])
    found, _ = barriers_along([ring], ["ring"], ROADS)
    assert found
    assert barrier_ends(found).empty
