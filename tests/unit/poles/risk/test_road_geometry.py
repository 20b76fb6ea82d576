import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from roadsight.poles.risk.road_geometry import COLUMNS, road_geometry
from roadsight.poles.risk.roads import Road, Roads, RouteTracks, road_along, roads_of
from roadsight.poles.risk.roadside import Surroundings, bends_at
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.videolog import random_drives, shots

STEP_M = 0.25
"""Between the points of an edge."""


def across_errors(n, kind, rng):
    """How far each of n points of an edge lies off: independent, or as those of a scan's contours.

    Edges of the generated airborne scan are 3.4 cm off, a fifth of it (of the variance) by itself,
    the rest alike over 6 m.
    """
    if kind == "independent":
        return rng.normal(0, 0.05, n)
    keep = np.exp(-STEP_M / 6.0)
    slow = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.normal(0, 0.031, n))
    return slow + rng.normal(0, 0.015, n)


@pytest.fixture(
    scope="module", params=[(1, "independent"), (2, "independent"), (1, "scan"), (2, "scan")]
)
def found(request):
    """A generated road, its geometry and the true stations of the rows."""
    seed, errors = request.param
    site, rng = build_rural(seed, 500.0, detail=0.01), np.random.default_rng(1)
    places = [s for drive in random_drives(site.seed) for s in shots(site, drive, site.seed)]
    rows = [(s.route, s.sequence, *s.gps_xy_m) for s in places]
    frames = pd.DataFrame(rows, columns=["route", "sequence", "x", "y"])
    half, along = site.ground.section.pavement_m, np.arange(-20, 520, STEP_M)
    sides = [side * half + across_errors(len(along), errors, rng) for side in (1, -1)]
    edges = np.concatenate([site.line.plan(along, side) for side in sides])

    def height(x, y):
        exact = site.height(np.column_stack([x, y]))
        return exact + rng.normal(0, 0.02, exact.shape)

    geometry = road_geometry(roads_of(RouteTracks(frames), edges).roads[0], height)
    inner = geometry.iloc[7:-7].reset_index(drop=True)  # fits lean on both sides
    return site, inner, site.line.road(inner[["x", "y"]].to_numpy())[:, 0]


def test_radii_are_within_five_percent(found):
    site, geometry, station = found
    exact = np.gradient(site.line.heading_rad, site.line.station_m)
    curvature = np.interp(station, site.line.station_m, exact)
    near = np.abs(site.line.station_m[:, None] - station) < 8
    change = [np.ptp(exact[own]) for own in near.T]
    bent = np.abs(curvature) > 1 / 600
    arc = bent & (np.array(change) < 0.02 * np.abs(curvature))
    with np.errstate(invalid="ignore"):  # straight and exactly so
        off = np.abs(geometry["radius_m"].to_numpy() * np.abs(curvature) - 1)
    assert arc.sum() > 10
    assert np.quantile(off[arc], 0.95) < 0.05
    assert np.quantile(off[bent], 0.9) < 0.07  # transitions and all
    assert (geometry["bend"][bent] == np.where(curvature[bent] > 0, "left", "right")).all()
    sigmas = (geometry["curvature_per_km"] / 1000 - curvature) / (
        geometry["sigma_curvature_per_km"] / 1000
    )
    assert 0.5 < np.sqrt((sigmas**2).mean()) < 2


@pytest.mark.parametrize(("radius_m", "turn_deg"), [(30, 90), (60, 60), (60, 90), (100, 60)])
def test_tight_bends_that_are_shorter_than_the_longest_fit(radius_m, turn_deg):
    s = np.arange(0, 400, STEP_M)
    ease = radius_m / 3
    ends = 150 + np.cumsum([0, ease, np.radians(turn_deg) * radius_m - ease, ease])
    curvature = np.interp(s, ends, np.array([0, 1, 1, 0]) / radius_m)
    heading = np.cumsum(curvature) * STEP_M
    line = np.column_stack([np.cumsum(np.cos(heading)), np.cumsum(np.sin(heading))]) * STEP_M
    left, rng = np.column_stack([-np.sin(heading), np.cos(heading)]), np.random.default_rng(1)
    sides = [side * 3.5 + across_errors(len(s), "scan", rng) for side in (1, -1)]
    edges = np.concatenate([line + left * side[:, None] for side in sides])
    geometry = road_geometry(road_along(line[::4], edges, "a"), None, 1.0)
    gap = np.hypot(*np.moveaxis(geometry[["x", "y"]].to_numpy()[:, None] - line[None], 2, 0))
    station = s[gap.argmin(axis=1)]
    arc = (station > ends[1]) & (station < ends[2])
    off = np.abs(geometry["radius_m"].to_numpy()[arc] / radius_m - 1)
    assert arc.sum() > 25
    assert np.median(off) < 0.05
    assert (geometry["bend"][arc] == "left").all()


def test_a_road_shorter_than_a_fit_is_fitted_as_a_whole():
    turn = np.arange(0, 41) / 150
    line = 150 * np.column_stack([np.sin(turn), 1 - np.cos(turn)])
    three = np.full(41, 3.0)
    road = Road("a", ("a",), "", line, np.arange(41.0), three, three)
    assert road_geometry(road, None)["radius_m"].to_numpy() == pytest.approx(150, rel=0.02)


def test_grades_are_within_0_2_percent(found):
    site, geometry, station = found
    error = geometry["grade_percent"] - 100 * site.line.grade(station)
    assert np.abs(error).max() < 0.2
    assert 0.4 < np.sqrt(((error / geometry["sigma_grade_percent"]) ** 2).mean()) < 1.5
    assert geometry["z"].to_numpy() == pytest.approx(site.line.height(station), abs=0.1)


def test_widths_and_cross_slopes(found):
    site, geometry, _ = found
    width = geometry["paved_width_m"] - 2 * site.ground.section.pavement_m
    assert np.abs(width).max() < 0.2
    for side in ("left", "right"):
        slope = geometry[f"cross_slope_{side}_percent"]
        assert slope.mean() == pytest.approx(-2, abs=0.1)
        assert np.abs(slope + 2).max() < 1.2


def test_a_straight_level_road_without_edges_or_heights():
    x = np.arange(0, 201.0)
    nan = np.full(201, np.nan)
    road = Road("a", ("a",), "", np.column_stack([x, 0 * x]), x, nan, nan)
    geometry = road_geometry(road, None, 10.0)
    assert tuple(geometry.columns) == COLUMNS
    assert geometry["station_m"].tolist() == list(range(0, 201, 10))
    assert np.isinf(geometry["radius_m"]).all()
    assert (geometry["bend"] == "straight").all()
    assert (geometry["heading_deg"] == 90).all()
    unknown = ["grade_percent", "paved_width_m", "cross_slope_left_percent"]
    assert geometry[unknown].isna().all().all()


def test_a_road_too_short_for_a_fit_is_unknown_not_straight():
    x = np.arange(0, 7.0)
    nan = np.full(7, np.nan)
    geometry = road_geometry(Road("a", ("a",), "", np.column_stack([x, 0 * x]), x, nan, nan), None)
    assert geometry[["radius_m", "curvature_per_km"]].isna().all().all()
    assert geometry["bend"].tolist() == ["", ""]
    roads = Roads([Road("a", ("a",), "", np.column_stack([x, 0 * x]), x, nan, nan)])
    bends = bends_at(Surroundings(roads), roads.locate(np.array([[3.0, 5.0]])))
    assert (bends["radius_m"].tolist(), bends["outside"].tolist()) == ([np.inf], [False])


def test_noise_of_a_straight_road_is_no_bend():
    x, rng = np.arange(0, 600, STEP_M), np.random.default_rng(1)
    sides = [side * 3.5 + across_errors(len(x), "scan", rng) for side in (1, -1)]
    edges = np.concatenate([np.column_stack([x, side]) for side in sides])
    geometry = road_geometry(road_along(np.column_stack([x, 0 * x])[::4], edges, "a"), None)
    assert (geometry["curvature_per_km"].abs() > 0.2).any()  # which alone is a radius of 5 km
    straight = geometry["bend"] == "straight"
    assert straight.mean() > 0.9
    assert (np.isinf(geometry["radius_m"]) == straight).all()


def test_exact_circles_and_measures_that_are_longer_than_the_plan():
    turn = np.arange(0, 301) / 150
    line = 150 * np.column_stack([np.sin(turn), 1 - np.cos(turn)])
    three = np.full(301, 3.0)
    road = Road("a", ("a",), "", line, 1000 + 1.02 * np.arange(301.0), three, three)
    geometry = road_geometry(road, lambda x, y: 150 * np.arctan2(x, 150 - y) * 0.05).iloc[8:-8]
    assert geometry["radius_m"].to_numpy() == pytest.approx(150, rel=2e-3)
    assert (geometry["bend"] == "left").all()
    assert geometry["grade_percent"].to_numpy() == pytest.approx(5, abs=0.01)
    assert geometry["paved_width_m"].to_numpy() == pytest.approx(6)
