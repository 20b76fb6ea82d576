import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.base.sections.poles import Hazard
from roadsight.poles.risk.clear_zone import clear_zone_m, slope_class
from roadsight.poles.risk.hazard import beside_travelled_way, rate_roadside, side_slopes
from roadsight.poles.risk.roads import RouteTracks, roads_of
from roadsight.poles.risk.roadside import Surroundings, edges_at
from roadsight.poles.risk.shielding import barriers_along
from tests.helpers.rated_poles import rate_poles

X = np.arange(0, 400, 0.3)
EDGES = np.concatenate([np.column_stack([X, np.full(len(X), y)]) for y in (-4.0, 4.0)])
TRACK = RouteTracks(
    pd.DataFrame({"route": "a", "sequence": range(51), "x": np.arange(0, 408, 8.0), "y": -1.5})
)

STATED = Hazard(design_speed_kmh=80, aadt=3000)


def poles_at(*places):
    xy = np.array(places, float)
    return pd.DataFrame({"x": xy[:, 0], "y": xy[:, 1], "sigma_major_m": 0.5})


@pytest.mark.parametrize(
    ("speed", "aadt", "slope", "width"),
    [
        (50, 500, 0.0, 3.0), (60, 7000, -0.2, 5.5), (65, 1000, 0.0, 5.0),
        (100, 10_000, -0.25, 13.5), (110, 3000, 0.3, 6.0), (130, 700, np.nan, 6.0),
        (80, 3000, -0.5, 8.0),
    ],
)  # fmt: skip
def test_cells_of_the_table(speed, aadt, slope, width):
    assert clear_zone_m(speed, aadt, [slope])[0] == width


@given(st.floats(30, 130), st.floats(0, 50_000), st.floats(-1, 1), st.floats(0, 40))
def test_faster_and_busier_roads_need_no_less(speed, aadt, slope, more):
    least = clear_zone_m(speed, aadt, [slope])
    assert clear_zone_m(speed + more, aadt, [slope]) >= least
    assert clear_zone_m(speed, aadt * (1 + more), [slope]) >= least


def test_slope_classes():
    slopes = [np.nan, 0.0, 0.2, -0.2, -0.3, -0.5]
    expected = ["unknown", "flat", "backslope", "recoverable", "non-recoverable", "critical"]
    assert slope_class(slopes).tolist() == expected


def line(x, y):
    return np.column_stack(np.broadcast_arrays(x, y)).astype(float)


def offsets(places, edges):
    roads = roads_of(TRACK, edges)
    return edges_at(roads, roads.locate(places), places, edges, 30.0)


def test_offsets_are_negative_on_the_road_and_unknown_far_away():
    places = np.array([[100.0, 7.0], [100.0, 3.0], [100.0, 90.0], [410.0, 7.0]])
    found = offsets(places, np.concatenate([EDGES, line(np.arange(400, 420, 0.3), 4.0)]))
    assert found.offset_m[[0, 1, 3]] == pytest.approx([3.0, -1.0, 3.0], abs=0.01)
    assert np.isnan(found.offset_m[2])
    assert found.place_m[:2] == pytest.approx(np.array([[100, 4], [100, 4]]), abs=0.2)
    assert found.outward[[0, 1, 3]] == pytest.approx(np.array([[0, 1]] * 3), abs=0.1)
    assert np.isnan(offsets(places, np.empty((0, 2))).offset_m).all()


@pytest.mark.parametrize("other_m", [8.0, 12.0, 18.0])
def test_pavement_beside_the_road_changes_no_offset(other_m, rng):
    beside = [line(X, y) for y in (-other_m - 6, -other_m, other_m, other_m + 6)]
    side = rng.choice([-1, 1], 200)
    places = np.column_stack([rng.uniform(20, 380, 200), side * rng.uniform(4.5, 25, 200)])
    alone, found = offsets(places, EDGES), offsets(places, np.concatenate([EDGES, *beside]))
    assert found.offset_m == pytest.approx(alone.offset_m, abs=0.05)
    assert found.outward == pytest.approx(alone.outward, abs=0.05)


def test_the_mouth_of_a_side_road_does_not_put_poles_on_the_road():
    mouth = (EDGES[:, 1] > 0) & (EDGES[:, 0] > 94) & (EDGES[:, 0] < 110)
    sides = [line(x, np.arange(4, 40, 0.3)) for x in (94.0, 110.0)]
    edges = np.concatenate([EDGES[~mouth], *sides])
    places = np.array([[102, 10.05], [102, 10.2], [97, 6], [108, 30], [102, 3.5]])
    assert offsets(places, edges).offset_m == pytest.approx(places[:, 1] - 4, abs=0.2)


@pytest.mark.parametrize("slope", [-0.3, 0.0, 0.2])
def test_side_slope_is_rise_over_run_away_from_the_road(slope):
    def height(x, y):
        return 50 + slope * (np.abs(y) - 4) + 0.0 * x

    places, feet = np.array([[10.0, 9.0], [10.0, -9.0]]), np.array([[10.0, 4.0], [10.0, -4.0]])
    assert side_slopes(feet, places, height, 0.5) == pytest.approx([slope, slope], abs=1e-9)


def test_side_slope_is_unknown_without_heights_or_room():
    place, foot = np.array([[10.0, 4.6]]), np.array([[10.0, 4.0]])
    assert np.isnan(side_slopes(foot, place, lambda x, y: x, 0.5)).all()
    assert np.isnan(side_slopes(foot, place + 9, lambda x, y: x * np.nan, 0.5)).all()
    assert np.isnan(side_slopes(foot * np.nan, place, lambda x, y: x, 0.5)).all()


def test_density_agrees_with_counting(rng):
    stations = rng.uniform(0, 400, 60)
    counted = rng.random(60) < 0.7
    poles = poles_at(*zip(stations, np.where(counted, 6.0, 20.0), strict=True))
    density = rate_poles(poles, EDGES, TRACK, None, STATED)["objects_per_km"]
    for own, value in zip(stations, density, strict=True):
        count = (np.abs(stations[counted] - own) <= 50).sum()
        length = min(own + 50, 400) - max(own - 50, 0)
        assert value == pytest.approx(count / length * 1000, rel=1e-3)


def test_what_is_rated_high_for_some_speed_and_traffic():
    """On level ground half the clear zone decides, also of the greatest that is possible."""
    poles = poles_at((50, 6), (130, 8), (210, 11.5), (290, 30))
    level = rate_poles(poles, EDGES, TRACK, lambda x, y: 0 * x, Hazard(dense_per_km=1e6))
    assert (level["clear_zone_greatest_m"] == 10.5).all()
    assert level["rating"].tolist() == ["medium", "medium", "medium", "low"]
    assert level["rating_greatest"].tolist() == ["high", "high", "medium", "low"]
    known = rate_poles(poles, EDGES, TRACK, lambda x, y: 0 * x, STATED)
    assert known["rating"].tolist() == known["rating_greatest"].tolist()


def test_the_travelled_way_is_told_by_who_knows_its_own_side():
    lanes = pd.DataFrame(
        {"left_m": 3.5, "right_m": 3.0, "sigma_left_m": np.nan, "sigma_right_m": 0.03,
         "left_from": "inventory", "right_from": "markings"}, index=range(3),
    )  # fmt: skip
    found = beside_travelled_way(np.array([-5.0, 5.0, np.nan]), lanes)
    assert found["travelled_way_from"].tolist() == ["inventory", "markings", ""]
    assert found["offset_travelled_way_m"] == pytest.approx([1.5, 2.0, np.nan], nan_ok=True)
    nobody = lanes.assign(left_m=np.nan, left_from="")
    found = beside_travelled_way(np.array([-5.0, 5.0, np.nan]), nobody)
    assert found["travelled_way_from"].tolist() == ["", "markings", ""]


def test_bends_widen_clear_zones_on_unknown_ground_too():
    angle = np.radians(np.arange(0, 60, 0.08))
    arc = np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    middle = np.array([0.0, 200.0])
    edges = np.concatenate([middle + r * (arc - [0, 1]) for r in (196.0, 204.0)])
    drive = 200 * arc[::50]
    frames = pd.DataFrame(drive, columns=["x", "y"]).assign(route="a", sequence=range(len(drive)))
    track = RouteTracks(frames)
    places = middle + np.array([[207.0], [193.0]]) * (arc[len(arc) // 2] - [0, 1])
    unknown = rate_poles(poles_at(*places), edges, track, None, STATED)
    level = rate_poles(poles_at(*places), edges, track, lambda x, y: 0 * x, STATED)
    assert unknown["curve_factor"].tolist() == [1.5, 1.0]
    for name in ("clear_zone_m", "clear_zone_least_m", "clear_zone_greatest_m", "rating"):
        assert unknown[name].tolist() == level[name].tolist()
    assert unknown["clear_zone_m"].tolist() == [8.25, 5.5]


class TestTraffic:
    """A pole on either side at 200 m, 4 m from the edge, 2.5 m behind rails on both sides."""

    def rated(self, carriageway, rails=(), left=False, flip=False, ground=None):
        frames = {"route": "a", "sequence": range(51), "x": np.arange(0, 408, 8.0), "y": -1.5}
        if flip:
            frames["x"] = frames["x"][::-1]
        tracks = RouteTracks(pd.DataFrame(frames))
        roads = roads_of(tracks, EDGES)
        lines = [line(np.array(ends), y) for ends in rails for y in (-5.5, 5.5)]
        barriers, told = barriers_along(lines, [f"r{n}" for n in range(len(lines))], roads)
        assert not told
        known = Surroundings(
            roads, ground, barriers=barriers, left_hand_traffic=left, carriageway=carriageway
        )
        poles = poles_at((200, -8), (200, 8))
        own = STATED.model_copy(update={"clear_zone_m": 9.0})
        table = rate_roadside(poles, EDGES, known, own).table
        return table.assign(y=poles["y"])

    def test_one_way_traffic_is_all_of_its_aadt(self):
        two, divided, one = (self.rated(way) for way in ("two-way", "divided", "one-way"))
        column = "exposure_greatest_vehicles_per_day"
        assert one[column].to_numpy() == pytest.approx(2 * two[column].to_numpy())
        assert divided[column].tolist() == two[column].tolist()
        assert one["carriageway"].tolist() == ["one-way"] * 2

    @pytest.mark.parametrize("left", [False, True])
    def test_opposing_traffic_asks_for_barrier_only_where_it_can_reach(self, left):
        # Beyond the pole as its own side's traffic sees it the rail ends at once.
        ahead = {-1.0: (100.0, 205.0), 1.0: (195.0, 300.0)}
        for way, expected in (("two-way", "partial"), ("divided", "full")):
            for side, ends in ahead.items():
                table = self.rated(way, [ends], left)
                own = table[table["y"] == (8.0 * side if not left else -8.0 * side)]
                assert own["shielded"].tolist() == [expected]

    @pytest.mark.parametrize("flip", [False, True])
    def test_one_way_traffic_comes_from_one_end_on_both_sides(self, flip):
        before = (195.0, 300.0) if flip else (100.0, 205.0)
        table = self.rated("one-way", [before], flip=flip)
        assert table["shielded"].tolist() == ["full", "full"]
        assert "none" not in self.rated("divided", [before], flip=flip)["shielded"].tolist()
        assert (self.rated("divided", [before], flip=flip)["shielded"] == "full").sum() == 1

    def test_a_barrier_lowers_the_hazard_rating_only_along_its_length_of_need(self):
        bare, partial, full = (
            self.rated("two-way", rails, ground=steep)["hazard_rating_1_to_7"].tolist()
            for rails in ((), [(190.0, 210.0)], [(10.0, 390.0)])
        )
        assert partial == bare == [6, 6]
        assert full == [4, 4]


def test_ratings():
    choice = STATED  # 5.5 m where flat
    rated = rate_poles(
        poles_at((50, 5), (150, 9), (250, 9.9), (350, 20), (200, 99)), EDGES, TRACK, None, choice
    )
    assert rated["rating"].tolist() == ["high", "medium", "medium", "low", "unknown"]
    assert rated["inside_clear_zone"].tolist() == [True, True, False, False, False]
    assert rated["side"].tolist()[:4] == [-1] * 4
    assert rated["clear_zone_m"].iloc[0] == 5.5


def test_what_nobody_states_is_a_range_and_no_guess():
    poles = poles_at((50, 5), (150, 9), (250, 9.9), (350, 20), (200, 99))
    rated = rate_poles(poles, EDGES, TRACK, None, Hazard())
    assert rated["clear_zone_least_m"].tolist() == [3.0] * 5
    assert rated["clear_zone_greatest_m"].tolist() == [10.5] * 5
    # Outside is what no speed and no traffic would put inside; 1 m is within half of the least.
    assert rated["rating"].tolist() == ["high", "medium", "medium", "low", "unknown"]
    assert "perhaps inside the clear zone of 3.0 to 10.5 m" in rated["reasons"].iloc[1]
    assert (rated["design_speed_least_kmh"] == 60).all()
    assert (rated["design_speed_greatest_kmh"] == 110).all()
    near = rated.iloc[:4]
    assert (near["exposure_least_vehicles_per_day"] == 0).all()
    assert (near["exposure_greatest_vehicles_per_day"] > 1000).all()
    slow = rate_poles(poles, EDGES, TRACK, None, Hazard(design_speed_kmh=60))
    assert slow["clear_zone_greatest_m"].tolist() == [5.0] * 5
    quiet = rate_poles(poles, EDGES, TRACK, None, Hazard(aadt=500))
    assert quiet["clear_zone_greatest_m"].tolist() == [6.0] * 5
    known = rate_poles(poles, EDGES, TRACK, None, STATED)
    assert (known["clear_zone_m"] >= rated["clear_zone_least_m"]).all()
    assert (known["clear_zone_m"] <= rated["clear_zone_greatest_m"]).all()


def steep(x, y):
    """A foreslope of 1V:2.5H either side of a level road."""
    return -0.4 * np.maximum(np.abs(y) - 4, 0) + 0.0 * x


def test_steep_slopes_and_crowds_raise_the_rating():
    choice = STATED
    assert rate_poles(poles_at((150, 9)), EDGES, TRACK, steep, choice)["rating"].tolist() == [
        "high"
    ]
    far = rate_poles(poles_at((150, 20)), EDGES, TRACK, steep, choice)
    assert far["rating"].tolist() == ["medium"]
    crowd = poles_at(*[(150 + 4 * n, 9) for n in range(8)])
    assert (rate_poles(crowd, EDGES, TRACK, None, choice)["rating"] == "high").all()


def test_no_poles_and_no_track():
    none = poles_at((0, 0)).iloc[:0]
    assert len(rate_poles(none, EDGES, TRACK, None, STATED)) == 0
    nowhere = RouteTracks(pd.DataFrame({"route": [], "sequence": [], "x": [], "y": []}))
    rated = rate_poles(poles_at((100, 7)), EDGES, nowhere, None, STATED)
    assert rated["offset_m"].iloc[0] == pytest.approx(3, abs=0.01)
    assert rated["side"].tolist() == [0]
