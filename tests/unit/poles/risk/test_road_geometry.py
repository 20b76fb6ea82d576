"""Radius, grade, cross-slope and width against the exact ones of generated roads."""

import numpy as np
import pandas as pd
import pytest

from roadsight.poles.risk.road_geometry import COLUMNS, road_geometry
from roadsight.poles.risk.roads import Road, roads_of
from roadsight.poles.risk.scenarios import RouteTracks
from roadsight.synthetic.rural.rural_road import build_rural
from roadsight.synthetic.rural.videolog import random_drives, shots


@pytest.fixture(scope="module", params=[1, 2])
def found(request):
    """A generated road, its geometry and the true stations of the rows."""
    site, rng = build_rural(request.param, 500.0, detail=0.01), np.random.default_rng(1)
    places = [s for drive in random_drives(site.seed) for s in shots(site, drive, site.seed)]
    rows = [(s.route, s.sequence, *s.gps_xy_m) for s in places]
    frames = pd.DataFrame(rows, columns=["route", "sequence", "x", "y"])
    half, along = site.ground.section.pavement_m, np.arange(-20, 520, 0.25)
    edges = np.concatenate([site.line.plan(along, side * half) for side in (1, -1)])
    edges += rng.normal(0, 0.05, edges.shape)

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
    assert off[arc].max() < 0.05
    assert np.quantile(off[bent], 0.9) < 0.05  # transitions and all
    assert (geometry["bend"][bent] == np.where(curvature[bent] > 0, "left", "right")).all()
    sigmas = (geometry["curvature_per_km"] / 1000 - curvature) / (
        geometry["sigma_curvature_per_km"] / 1000
    )
    assert 0.5 < np.sqrt((sigmas**2).mean()) < 2


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
