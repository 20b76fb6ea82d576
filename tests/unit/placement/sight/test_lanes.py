import numpy as np
import pandas as pd
import pytest
import shapely

from roadsight.io.records.placement_tables import read_detections, read_traffic, write_detections
from roadsight.io.records.tables import write_table
from roadsight.placement.sight.detection import availability
from roadsight.placement.sight.lanes import free_shares, lanes_abreast, rasterise_lanes, trace_lanes
from roadsight.placement.sight.passing import CAR, TRUCK, expected_in_the_way
from roadsight_worlds.highway.highway import build_highway
from roadsight_worlds.highway.truth import digitised_edges, truth_layers

LANE_M = 3.5


def carriageway(low, high, length=200.0):
    return shapely.box(-length, low, length, high)


def straight_lanes(*middles):
    """Lanes along x at z = 0."""
    parts = []
    for number, y in enumerate(middles):
        x = np.arange(-200.0, 200.0, 2.0)
        table = pd.DataFrame({"lane": number, "station_m": x + 200, "x": x, "y": y, "z": 0.0})
        parts.append(table.assign(along_x=1.0, along_y=0.0, road=0))
    return pd.concat(parts, ignore_index=True)


class TestTracing:
    def test_two_carriageways_of_two_lanes(self):
        pavement = shapely.MultiPolygon([carriageway(1, 11.75), carriageway(-11.75, -1)])
        edges = [shapely.LineString([(-200, 12.5), (200, 12.5)])]
        lanes = trace_lanes(edges, pavement, LANE_M)
        middles = lanes.groupby("lane")["y"].agg(["min", "max"])
        np.testing.assert_allclose(middles["min"], middles["max"])
        expected = [-6.375 - 1.75, -6.375 + 1.75, 6.375 - 1.75, 6.375 + 1.75]
        np.testing.assert_allclose(sorted(middles["min"]), expected, atol=1e-9)

    def test_the_other_edge_adds_no_lane_twice(self):
        pavement = shapely.MultiPolygon([carriageway(-4, 4)])
        one = shapely.LineString([(-200, 5), (200, 5)])
        other = shapely.LineString([(-190, -5), (190, -5)])
        alone = trace_lanes([one], pavement, LANE_M)
        both = trace_lanes([one, other], pavement, LANE_M)
        pd.testing.assert_frame_equal(alone, both)
        assert alone["lane"].nunique() == 2

    def test_a_curve_keeps_its_lanes_apart(self):
        ring = (
            shapely.Point(0, 0).buffer(104.3, 128).difference(shapely.Point(0, 0).buffer(95.7, 128))
        )
        edge = shapely.Point(0, 0).buffer(105, 128).exterior
        lanes = trace_lanes([edge], shapely.MultiPolygon([ring]), LANE_M)
        radius = np.hypot(lanes["x"], lanes["y"])
        assert sorted(set(lanes["lane"])) == [0, 1]
        means = radius.groupby(lanes["lane"]).mean()
        np.testing.assert_allclose(sorted(means), [98.25, 101.75], atol=0.1)
        assert (radius.groupby(lanes["lane"]).agg(np.ptp) < 0.2).all()

    def test_a_footpath_is_no_lane(self):
        edges = [shapely.LineString([(-50, 3), (50, 3)])]
        assert trace_lanes(edges, shapely.MultiPolygon([carriageway(0, 2)]), LANE_M).empty


def edge(y, start=-200.0, end=200.0):
    return shapely.LineString([(start, y), (end, y)])


class TestRoads:
    """The traffic of a road is counted once, whatever edges its lanes were traced from."""

    @pytest.mark.parametrize("overhang_m", [0.0, 15.0])
    def test_a_two_lane_road_with_one_edge_longer_than_the_other(self, overhang_m):
        pavement = shapely.MultiPolygon([carriageway(-4, 4, 300)])
        # Bent by a little, so that the second edge does not meet the first one's lanes everywhere.
        bent = shapely.LineString([(-200 - overhang_m, -5), (0, -5.4), (200 - 2 * overhang_m, -5)])
        lanes = trace_lanes([edge(5), bent], pavement, LANE_M)
        assert lanes["road"].unique().tolist() == [0]
        assert (lanes["x"].min() < -205) == (overhang_m > 0)
        assert lanes_abreast(lanes).tolist() == [2]

    def test_an_opposite_carriageway_out_of_reach_of_the_edge_is_of_the_same_road(self):
        pavement = shapely.MultiPolygon([carriageway(1, 11.75), carriageway(-39.75, -29)])
        lanes = trace_lanes([edge(12.5), edge(-40.5, -190)], pavement, LANE_M)
        assert lanes["lane"].nunique() == 4
        assert lanes_abreast(lanes).to_dict() == {0: 4}

    def test_part_of_the_opposite_carriageway_left_over(self):
        """It bends away from the longest edge, which sees it only along a part of the road."""
        low = [(-200, -5), (0, -5), (200, -30), (200, -38.5), (0, -13.5), (-200, -13.5)]
        pavement = shapely.MultiPolygon([carriageway(2.5, 11), shapely.Polygon(low)])
        other = shapely.LineString([(-190, -14), (0, -14), (200, -39)])
        lanes = trace_lanes([edge(12), other], pavement, LANE_M)
        assert lanes["lane"].nunique() > 4
        assert lanes_abreast(lanes).to_dict() == {0: 4}

    def test_a_crossing_and_a_far_road_have_traffic_of_their_own(self):
        crossing = shapely.box(30, -60, 38, 60)
        parts = [carriageway(-4, 4).difference(crossing), crossing, carriageway(-150, -142)]
        pavement = shapely.MultiPolygon([p for part in parts for p in shapely.get_parts(part)])
        across = shapely.LineString([(29, -58), (29, 58)])
        lanes = trace_lanes([edge(5), across, edge(-151, -180)], pavement, LANE_M)
        assert sorted(lanes["road"].unique()) == [0, 1, 2]
        assert lanes_abreast(lanes).to_dict() == {0: 2, 1: 2, 2: 2}

    def test_the_generated_divided_highway_is_one_road_of_four_lanes(self):
        highway = build_highway(seed=1, length_m=100.0)
        edges = list(digitised_edges(highway, np.random.default_rng(1)).geometry)
        parts = truth_layers(highway)["pavement"].geometry.to_numpy()
        pavement = shapely.multipolygons(shapely.get_parts(parts))
        lanes = trace_lanes(edges, pavement, LANE_M)
        assert lanes_abreast(lanes).to_dict() == {0: 4}
        for line in edges:  # whichever edges there are
            assert lanes_abreast(trace_lanes([line], pavement, LANE_M)).to_dict() == {0: 4}


class TestFreeShares:
    @pytest.mark.parametrize("target", [(40.0, 9.0, 0.3), (-60.0, 12.0, 0.3), (0.0, 20.0, 0.3)])
    @pytest.mark.parametrize("vehicle", [CAR, TRUCK])
    def test_straight_lanes_have_the_closed_form(self, target, vehicle):
        middles = (1.75, 5.25)
        per_m = np.array([[0.01], [0.02]])
        traffic = rasterise_lanes(straight_lanes(*middles), per_m, (vehicle,))
        sensor = np.array([0.0, -2.0, 6.0])
        expected = sum(
            expected_in_the_way(sensor, target, y, float(rate), vehicle)
            for y, rate in zip(middles, per_m[:, 0], strict=True)
        )
        free = free_shares(traffic, sensor, np.array([target]))
        # The raster of half a metre knows a vehicle's side to a quarter of a metre.
        assert -np.log(free[0]) == pytest.approx(expected, abs=0.03 + 0.1 * expected)

    def test_vehicles_behind_the_target_hide_nothing(self):
        traffic = rasterise_lanes(straight_lanes(8.75), np.array([[0.5]]), (TRUCK,))
        free = free_shares(traffic, np.array([0.0, 0, 6]), np.array([[20.0, 3.0, 0.3]]))
        assert free[0] == 1.0

    def test_a_target_keeps_its_own_place(self):
        # Straight across, no vehicle of the target's own lane stands between.
        traffic = rasterise_lanes(straight_lanes(5.25), np.array([[0.05]]), (TRUCK,))
        own = free_shares(traffic, np.array([0.0, 0, 6]), np.array([[0.0, 5.25, 0.3]]))
        assert own[0] == pytest.approx(1.0, abs=1e-3)
        beyond = free_shares(traffic, np.array([0.0, 0, 6]), np.array([[0.0, 8.0, 0.3]]))
        assert beyond[0] == pytest.approx(np.exp(-0.05 * TRUCK.length_m), rel=0.02)

    def test_more_traffic_hides_more(self):
        targets = np.random.default_rng(0).uniform(-1, 1, (100, 3)) * (80, 6, 0.3)
        free = [
            free_shares(
                rasterise_lanes(
                    straight_lanes(-5.25, -1.75, 1.75, 5.25), np.full((4, 1), rate), (CAR,)
                ),
                np.array([0.0, -10, 5]),
                targets,
            )
            for rate in (0.005, 0.02)
        ]
        assert (free[1] <= free[0]).all()
        assert free[1].mean() < free[0].mean() < 1


def test_traffic_is_read_as_written(tmp_path):
    lanes = straight_lanes(1.75, 5.25)
    lanes["cars_per_m"], lanes["trucks_per_m"] = 0.01 * (1 + lanes["lane"]), 0.002
    write_table(tmp_path / "lanes.parquet", lanes, {"availability": 0.95})
    traffic = read_traffic(tmp_path / "lanes.parquet")
    assert traffic.availability == 0.95
    np.testing.assert_allclose(traffic.lanes.per_m, [[0.01, 0.002], [0.02, 0.002]])


def test_availability_of_several_sensors(tmp_path):
    rows = [("a", "t1", 9, 0.9), ("b", "t1", 9, 0.8), ("b", "t2", 9, 0.95), ("c", "t3", 9, 1.0)]
    table = pd.DataFrame(rows, columns=["candidate", "target", "hits", "availability"])
    write_detections(tmp_path / "d.parquet", table, {"sensor": "S"})
    found = read_detections([tmp_path / "d.parquet"])
    shares = availability(found, {("S", "a"), ("S", "b")}, pd.Series(["t1", "t2", "t3"]))
    np.testing.assert_allclose(shares, [1 - 0.1 * 0.2, 0.95, 0.0], atol=1e-6)
