"""Clear zones, side slopes, density and rating."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.poles.risk.clear_zone import clear_zone_m, slope_class
from roadsight.poles.risk.hazard import (
    HazardSettings,
    edge_offsets,
    objects_per_km,
    rate_poles,
    side_slopes,
)
from roadsight.poles.risk.scenarios import RouteTracks

X = np.arange(0, 400, 0.3)
EDGES = np.concatenate([np.column_stack([X, np.full(len(X), y)]) for y in (-4.0, 4.0)])
TRACK = RouteTracks(
    pd.DataFrame({"route": "a", "sequence": range(51), "x": np.arange(0, 408, 8.0), "y": -1.5})
)


def poles_at(*places):
    xy = np.array(places, float)
    return pd.DataFrame({"x": xy[:, 0], "y": xy[:, 1], "sigma_major_m": 0.5})


@pytest.mark.parametrize(
    ("speed", "aadt", "slope", "width"),
    [
        (50, 500, 0.0, 3.0),
        (60, 7000, -0.2, 5.5),
        (65, 1000, 0.0, 5.0),
        (100, 10_000, -0.25, 13.5),
        (110, 3000, 0.3, 6.0),
        (130, 700, np.nan, 6.0),
        (80, 3000, -0.5, 8.0),
    ],
)
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


def test_offsets_are_negative_on_the_road_and_unknown_far_away():
    places = np.array([[100.0, 7.0], [100.0, 3.0], [100.0, 90.0]])
    offset_m, foot = edge_offsets(places, EDGES, TRACK, 30.0)
    assert offset_m[:2] == pytest.approx([3.0, -1.0], abs=0.01)
    assert np.isnan(offset_m[2])
    assert foot[0] == pytest.approx([100, 4], abs=0.2)
    assert np.isnan(edge_offsets(places, np.empty((0, 2)), TRACK, 30.0)[0]).all()


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
    places = np.column_stack([stations, np.full(60, 6.0)])
    counted = rng.random(60) < 0.7
    piece, station_m, _ = TRACK.locate(places)
    density = objects_per_km(TRACK, piece, station_m, counted, 100.0)
    for own, value in zip(stations, density, strict=True):
        count = (np.abs(stations[counted] - own) <= 50).sum()
        length = min(own + 50, 400) - max(own - 50, 0)
        assert value == pytest.approx(count / length * 1000, rel=1e-6)


def test_ratings():
    choice = HazardSettings()  # 80 km/h, 3000 a day: 5.5 m where flat
    rated = rate_poles(
        poles_at((50, 5), (150, 9), (250, 9.9), (350, 20), (200, 99)), EDGES, TRACK, None, choice
    )
    assert rated["rating"].tolist() == ["high", "medium", "medium", "low", "unknown"]
    assert rated["inside_clear_zone"].tolist() == [True, True, False, False, False]
    assert rated["side"].tolist()[:4] == [-1] * 4
    assert rated["clear_zone_m"].iloc[0] == 5.5


def test_steep_slopes_and_crowds_raise_the_rating():
    choice = HazardSettings()

    def steep(x, y):
        return -0.4 * (np.abs(y) - 4) + 0.0 * x

    assert rate_poles(poles_at((150, 9)), EDGES, TRACK, steep, choice)["rating"].tolist() == [
        "high"
    ]
    far = rate_poles(poles_at((150, 20)), EDGES, TRACK, steep, choice)
    assert far["rating"].tolist() == ["medium"]
    crowd = poles_at(*[(150 + 4 * n, 9) for n in range(8)])
    assert (rate_poles(crowd, EDGES, TRACK, None, choice)["rating"] == "high").all()


def test_no_poles_and_no_track():
    none = poles_at((0, 0)).iloc[:0]
    assert len(rate_poles(none, EDGES, TRACK, None, HazardSettings())) == 0
    nowhere = RouteTracks(pd.DataFrame({"route": [], "sequence": [], "x": [], "y": []}))
    rated = rate_poles(poles_at((100, 7)), EDGES, nowhere, None, HazardSettings())
    assert rated["offset_m"].iloc[0] == pytest.approx(3, abs=0.01)
    assert rated["side"].tolist() == [0]
