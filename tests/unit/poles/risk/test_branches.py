import numpy as np
import pandas as pd
import pytest
import shapely

from roadsight.poles.risk.roads import RouteTracks
from roadsight.poles.risk.scenarios import ScenarioSettings, classify_places, find_branches
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.rural_truth import rural_layers
from tests.helpers.rated_poles import track

_LENGTH_M = 400.0


def box(x, y):
    return shapely.box(x[0], y[0], x[1], y[1])


def cells_of(shape, step_m=0.3):
    west, south, east, north = shape.bounds
    x, y = np.meshgrid(np.arange(west, east, step_m), np.arange(south, north, step_m))
    inside = shapely.contains_xy(shape, x.ravel(), y.ravel())
    return np.column_stack([x.ravel(), y.ravel()])[inside]


@pytest.fixture(scope="module")
def street():
    """A road of 8 m with a driveway, a side road, a car park, and pavement apart from it."""
    tracks = RouteTracks(track(np.column_stack([np.arange(0, _LENGTH_M, 8.0), np.full(50, -1.8)])))
    shapes = {
        "road": box((0, _LENGTH_M), (-4, 4)),
        "driveway": box((60, 63.5), (4, 26)),
        "side road": box((160, 167), (-38, -4)),
        "car park": box((250, 290), (4, 30)),
        "apart": box((330, 360), (9, 15)),
    }
    station = np.arange(0, _LENGTH_M, 0.5)
    edges = np.concatenate([np.column_stack([station, np.full(len(station), y)]) for y in (-4, 4)])
    return tracks, cells_of(shapely.union_all(list(shapes.values()))), edges


def test_side_roads_driveways_and_car_parks_are_told_apart(street):
    branches = find_branches(*street)
    x, y = branches.xy_m.T
    road = (x > 160) & (x < 167) & (y < 0)
    assert (branches.road == road).all()
    for low, high in ((60, 63.5), (160, 167), (250, 290)):
        assert ((x > low) & (x < high)).sum() > 50
    assert not (x > 320).any()


def test_scenarios_follow_from_what_is_near(street):
    branches = find_branches(*street)
    places = np.array([[70.0, 8.0], [175.0, 8.0], [270.0, -8.0], [120.0, 8.0], [345.0, 6.0]])
    found = classify_places(places, street[0], branches, ScenarioSettings())
    assert found["intersection"].tolist() == [False, True, False, False, False]
    assert found["extraneous"].tolist() == [True, False, True, False, False]


def test_a_wider_road_and_a_missing_edge_are_no_branch(street):
    tracks, _, edges = street
    wide = cells_of(box((0, _LENGTH_M), (-5, 5)))
    assert len(find_branches(tracks, wide, edges).xy_m) == 0
    left_only = edges[edges[:, 1] > 0]
    right_side = cells_of(box((100, 110), (-30, 4)))
    assert len(find_branches(tracks, right_side, left_only).xy_m) == 0


def test_nothing_known_gives_no_branches(street):
    tracks, cells, edges = street
    none = np.empty((0, 2))
    nowhere = RouteTracks(track(np.zeros((1, 2))))
    for given in ((tracks, none, edges), (tracks, cells, none), (nowhere, cells, edges)):
        assert len(find_branches(*given).xy_m) == 0
    assert not find_branches(tracks, none, edges).near(np.zeros((2, 2)), 30.0, road=True).any()


@pytest.mark.parametrize("seed", [3, 4])
def test_branches_of_generated_roads_are_what_they_are(seed):
    site = build_rural(seed, 300.0)
    layers = rural_layers(site)
    stations = np.arange(0.0, 300.0, 8.0)
    lanes = [
        track(site.line.plan(stations, 1.6), "w"),
        track(site.line.plan(stations, -1.6)[::-1], "e"),
    ]
    edges = np.concatenate(
        [shapely.get_coordinates(line)[:, :2] for line in layers["edges"].geometry]
    )
    shapes = [*layers["pavement"].geometry, *layers["driveways"].geometry]
    branches = find_branches(
        RouteTracks(pd.concat(lanes)), cells_of(shapely.union_all(shapes)), edges
    )
    kinds = [*layers["pavement"]["kind"], *layers["driveways"]["kind"]]
    for kind, shape in zip(kinds, shapes, strict=True):
        own = shapely.contains_xy(shape, *branches.xy_m.T)
        if kind == "road":
            assert own.sum() < 0.02 * shape.area
        else:
            assert own.sum() > 30
            assert branches.road[own].all() == (kind == "side road")
