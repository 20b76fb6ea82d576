import numpy as np
import pandas as pd
import pytest
import shapely

from roadsight.poles.risk.roads import Roads, RouteTracks, road_along, roads_of
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.rural_truth import rural_layers
from roadsight_worlds.rural.videolog import random_drives, shots
from tests.helpers.rated_poles import track


@pytest.fixture(scope="module", params=[1, 2, 3])
def site(request):
    return build_rural(request.param, 500.0, detail=0.01)


@pytest.fixture(scope="module")
def frames(site):
    places = [s for drive in random_drives(site.seed) for s in shots(site, drive, site.seed)]
    rows = [(s.route, s.sequence, *s.gps_xy_m) for s in places]
    return pd.DataFrame(rows, columns=["route", "sequence", "x", "y"])


@pytest.fixture(scope="module")
def edges(site):
    """Points of the outline of road and side road, mouths and all, 5 cm off."""
    outline = shapely.union_all(rural_layers(site)["pavement"].geometry.to_numpy()).boundary
    along = np.arange(0, outline.length, 0.25)
    points = shapely.get_coordinates(shapely.line_interpolate_point(outline, along))
    return points + np.random.default_rng(2).normal(0, 0.05, points.shape)


def posts(site):
    """True station, offset (positive left) and place of the posts along the drive."""
    own = [p for p in site.poles if 0 < p.station_m < site.length_m]
    return (
        np.array([p.station_m for p in own]),
        np.array([p.offset_m for p in own]),
        np.array([p.xyz_m[:2] for p in own]),
    )


def test_both_drives_are_one_road_with_one_measure(site, frames, edges):
    station, offset, xy = posts(site)
    roads = roads_of(RouteTracks(frames), edges)
    assert [road.drives for road in roads.roads] == [("sr1427e", "sr1427w")]
    located = roads.locate(xy)
    assert (located.side == -np.sign(offset)).all()
    assert np.abs(np.abs(located.offset_m) - np.abs(offset)).max() < 0.15
    gap = located.station_m - station
    # The measure starts at the first image, whose place GPS tells to a metre or two.
    assert abs(gap.mean()) < 4
    assert np.abs(gap - gap.mean()).max() < 0.3


@pytest.mark.parametrize(("drive", "sign"), [("sr1427e", 1), ("sr1427w", -1)])
def test_either_drive_alone_tells_the_sides_along_itself(site, frames, edges, drive, sign):
    station, offset, xy = posts(site)
    located = roads_of(RouteTracks(frames[frames["route"] == drive]), edges).locate(xy)
    inside = (station > 20) & (station < site.length_m - 20)
    assert (located.side == -sign * np.sign(offset))[inside].all()
    gap = sign * located.station_m - station
    assert np.ptp(gap[inside]) < 0.6


def test_sides_hold_without_edges_too(site, frames):
    _, offset, xy = posts(site)
    located = roads_of(RouteTracks(frames), np.empty((0, 2))).locate(xy)
    assert (located.side == -np.sign(offset)).all()


def test_a_line_with_measures_is_the_measure(site, edges):
    station, _, xy = posts(site)
    at = np.arange(0, site.length_m + 1, 5.0)
    road = road_along(
        site.line.plan(at, 0.4)[::-1], edges, "sr1427", measures_m=(8000.0 + site.length_m, 8000.0)
    )
    located = Roads([road]).locate(xy)
    assert np.abs(located.station_m - 8000 - station).max() < 0.6


def test_crossing_and_distant_parallel_drives_are_roads_of_their_own():
    x = np.arange(0, 300, 8.0)
    east = track(np.column_stack([x, 0 * x]), "a")
    back = track(np.column_stack([x[::-1], 0 * x + 4]), "b")
    crossing = track(np.column_stack([0 * x + 150, x - 150]), "c")
    divided = track(np.column_stack([x[::-1], 0 * x + 25]), "d")
    roads = roads_of(RouteTracks(pd.concat([east, back, crossing, divided])), np.empty((0, 2)))
    assert sorted(road.drives for road in roads.roads) == [("a", "b"), ("c",), ("d",)]


def test_objects_beyond_the_ends_lie_straight_on():
    x = np.arange(0, 104, 8.0)
    roads = roads_of(RouteTracks(track(np.column_stack([x, 0 * x]), "a")), np.empty((0, 2)))
    located = roads.locate(np.array([[-10.0, 5], [112, -5], [50, 0], [900, 0]]))
    assert located.station_m == pytest.approx([-10, 112, 50, 96 + 60], abs=1e-6)
    assert located.offset_m[:3] == pytest.approx([-5, 5, 0], abs=1e-6)
    assert located.side[:3].tolist() == [-1, 1, 0]
    assert roads.roads[0].place(np.array([-10.0, 50]), 2.0) == pytest.approx(
        np.array([[-10, -2], [50, -2]]), abs=1e-6
    )


def test_no_drives_are_no_roads():
    none = RouteTracks(pd.DataFrame({"route": [], "sequence": [], "x": [], "y": []}))
    roads = roads_of(none, np.empty((0, 2)))
    located = roads.locate(np.zeros((2, 2)))
    assert len(roads) == 0
    assert located.road.tolist() == [-1, -1]
    assert located.side.tolist() == [0, 0]
    assert np.isnan(located.station_m).all()


@pytest.mark.parametrize("median_m", [1.0, 3.0, 4.8, 5.2])
@pytest.mark.parametrize("wave_m", [0.0, 0.3])
def test_a_line_between_two_carriageways_means_neither(median_m, wave_m):
    """It would jump from one to the other, or move onto one of them without a word."""
    low = shapely.box(0, -median_m / 2 - 8, 400, -median_m / 2)
    high = shapely.box(0, median_m / 2, 400, median_m / 2 + 8)
    edges = shapely.get_coordinates(
        [shapely.segmentize(part.boundary, 0.25) for part in (low, high)]
    )
    paved = shapely.union_all([low, high])
    x = np.arange(5.0, 396.0, 20.0)
    line = np.column_stack([x, wave_m * np.sin(x / 15)])
    assert np.isnan(road_along(line, edges, "a", paved=paved).left_m).all()
    beside = line + np.array([0, median_m / 2 + 9])  # a metre off the other side of one
    road = road_along(beside, edges, "a", paved=paved)
    assert np.nanmedian(road.left_m + road.right_m) == pytest.approx(8, abs=0.1)
