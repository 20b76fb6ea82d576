import numpy as np
import pytest
from shapely import LineString

from roadsight.placement.plans.handover import (
    data_rates,
    frames_per_s,
    handover,
    overlaps,
    stations_m,
)
from roadsight.placement.sensors.sensors import load_sensors
from roadsight.report.site.plan_view import data_view


def test_handover_counts_targets_by_sensors():
    found = handover(np.array([0, 1, 1, 2, 3]))
    assert found["share_seen_by_two"] == 0.4
    assert found["mean_sensors"] == 1.4
    assert found["targets_by_sensors"] == [1, 2, 1, 1]
    assert handover(np.empty(0, np.int64))["share_seen_by_two"] == 0


def test_overlaps_are_counted_between_neighbours_along_the_road():
    stations = np.arange(0.5, 20)  # a target a metre, two abreast
    stations = np.concatenate([stations, stations])
    reach = {0: (10, 20), 1: (0, 8), 2: (5, 14)}  # numbers are out of order along the road
    seen = np.array([(stations >= low) & (stations < high) for low, high in reach.values()])
    found = overlaps(seen, stations, np.array([15.0, 4.0, 9.0]), 1.0)
    assert [(f["sensor"], f["next"], f["length_m"], f["targets"]) for f in found] == [
        (1, 2, 3.0, 6),
        (2, 0, 4.0, 8),
    ]
    assert overlaps(seen[:1], stations, np.array([1.0]), 1.0) == []


def test_stations_run_along_the_longest_edge():
    edges = [LineString([(0, 0), (5, 0)]), LineString([(0, 10), (100, 10)])]
    places = np.array([[3.0, 2.0], [70.0, 0.0], [-30.0, 4.0], [145.0, 12.0]])
    np.testing.assert_allclose(stations_m(edges, places), [3, 70, -30, 145])


def test_the_road_goes_on_past_the_rounded_corners_of_its_edge():
    corner = [(6 * np.cos(a), 6 - 6 * np.sin(a)) for a in np.radians([0, 30, 60, 90])]
    edge = LineString([*corner[:-1], (0, 0), (-60, 0)])
    at = stations_m([edge], np.array([[-100.0, 1.0], [-20.0, 1.0]]))
    np.testing.assert_allclose(np.diff(at), -80)
    ring = LineString([(0, 0), (9, 0), (9, 9), (0, 9), (0, 0)])
    np.testing.assert_allclose(stations_m([ring], np.array([[4.0, -5.0], [-3.0, 4.0]])), [4, 32])


def test_a_loop_that_its_continuation_crosses_keeps_its_own_stations():
    turn = np.radians(np.arange(0, 271, 5))
    loop = np.column_stack([150 + 40 * np.sin(turn), 40 - 40 * np.cos(turn)])
    edge = LineString([(0, 0), *loop, (110, -20)])
    along = np.arange(2.0, edge.length - 2, 7.0)
    places = np.array([edge.interpolate(at).coords[0] for at in along])
    crossed = np.abs(places - [110, 0]).max(axis=1) < 5
    assert crossed.any()
    np.testing.assert_allclose(stations_m([edge], places), along, atol=1e-6)


def test_rates_of_every_kind():
    sensors = load_sensors("config/sensors.yaml")
    assert data_rates(sensors["OS-128"], 10)["points_per_s"] == 128 * 3600 * 10
    assert data_rates(sensors["Avia"], 10)["points_per_s"] == sensors["Avia"].points_per_s
    camera = sensors["camera-8mp"]
    pixels = camera.columns_px * camera.rows_px
    assert data_rates(camera, 10) == {"pixels_per_s": pixels * 10}
    assert data_rates(sensors["radar-77ghz"], 10) == {}
    assert frames_per_s(sensors["Avia"], 10) == pytest.approx(1 / sensors["Avia"].frame_s)
    assert frames_per_s(camera, 10) == 0


def test_the_report_lists_sensors_along_the_road():
    sensor = {"pixels_per_s": 0.0, "road_points_per_s": 1e5, "sensor": "OS-64"}
    data = {
        **handover(np.array([1, 2])),
        "mean_overlap_m": 12.0,
        "points_per_s": 4.6e6,
        "pixels_per_s": 0.0,
        "road_points_per_s": 2e5,
        "sensors": [
            sensor | {"candidate": "b", "along_road_m": 30.0, "points_per_s": 2.3e6},
            sensor
            | {
                "candidate": "a",
                "along_road_m": 5.0,
                "points_per_s": 2.3e6,
                "overlap_with_next_m": 12,
            },
        ],
    }
    plan = {
        "data": data,
        "sensors": [{"candidate": "a", "number": 2}, {"candidate": "b", "number": 1}],
    }
    view = data_view(plan)
    assert [row["number"] for row in view["sensors"]] == [2, 1]
    assert len(view["rows"]) == 5  # no pixels
    assert view["sensors"][1]["overlap"] == ""
    assert data_view({"sensors": []}) is None
