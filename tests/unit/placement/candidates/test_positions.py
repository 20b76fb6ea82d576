import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from shapely import LineString, MultiPolygon, Point, box

from roadsight.placement.candidates.candidates import near_gaps, positions_along

ROAD = MultiPolygon([box(0, 0, 100, 10)])
COLUMNS = {"key", "x", "y", "yaw_deg", "edge", "station_m", "mount"}


def edges(*lines, kind="edge"):
    names = [f"e{n:02d}" for n in range(len(lines))]
    return gpd.GeoDataFrame({"edge": names, "kind": kind}, geometry=list(lines))


def test_positions_stand_at_whole_steps_and_face_the_road():
    found = positions_along(edges(LineString([(0, -0.5), (10, -0.5)])), ROAD, 4.0)
    assert set(found) == COLUMNS
    assert found["station_m"].tolist() == [0, 4, 8]
    assert found["x"].tolist() == [0, 4, 8]
    assert found["y"].tolist() == [-0.5] * 3
    np.testing.assert_allclose(found["yaw_deg"], 90)
    assert found["key"].tolist() == ["e00-s0000.00", "e00-s0004.00", "e00-s0008.00"]
    assert (found["mount"] == "edge").all()


def test_a_length_of_whole_steps_has_a_position_at_its_end():
    found = positions_along(edges(LineString([(0, 0), (0.1 + 0.2, 0)])), ROAD, 0.1)
    assert len(found) == 4


def test_halving_the_spacing_keeps_the_old_positions_and_their_names():
    line = LineString([(0, 0), (30, 8), (55, 8)])
    coarse, fine = (positions_along(edges(line), ROAD, spacing) for spacing in (4.0, 2.0))
    assert set(coarse["key"]) <= set(fine["key"])
    kept = fine.set_index("key").loc[coarse["key"]].reset_index()
    pd.testing.assert_frame_equal(kept[coarse.columns], coarse)


@pytest.mark.parametrize("spacing", [4.0 / 32, 3.0 / 32, 0.25])
def test_names_stay_unique_at_the_finest_spacing(spacing):
    found = positions_along(edges(LineString([(0, 0), (40, 0)])), ROAD, spacing)
    assert found["key"].is_unique


def test_direction_follows_a_bend():
    arc = LineString(Point(0, 0).buffer(50, quad_segs=90).exterior.coords[:180])
    found = positions_along(edges(arc), MultiPolygon([Point(0, 0).buffer(49.5)]), 4.0)
    inward = np.degrees(np.arctan2(-found["y"], -found["x"]))
    off = (found["yaw_deg"] - inward + 180) % 360 - 180
    assert np.abs(off).max() < 2


@pytest.mark.parametrize("radius", [9.6, 9.75, 10.0, 10.1])  # the last step is 0.3 to 3.5 m
def test_a_ring_has_no_two_positions_at_its_seam(radius):
    ring = LineString(Point(0, 0).buffer(radius, quad_segs=64).exterior.coords)
    found = positions_along(edges(ring, kind="median"), ROAD, 4.0)
    xy = found[["x", "y"]].to_numpy()
    gap = np.hypot(*(xy - np.roll(xy, 1, axis=0)).T)
    assert gap.min() > 1.9
    assert gap.max() < 6.0
    assert (found["mount"] == "median").all()


def test_an_edge_shorter_than_the_spacing_has_one_position():
    assert positions_along(edges(LineString([(0, 0), (1, 0)])), ROAD, 4.0)["x"].tolist() == [0]


def test_each_edge_starts_anew_under_its_own_name():
    lines = [LineString([(0, 0), (4, 0)]), LineString([(0, 9), (4, 9)])]
    found = positions_along(edges(*lines), ROAD, 4.0)
    assert found["edge"].tolist() == ["e00", "e00", "e01", "e01"]
    assert found["key"].is_unique


def test_no_edges_give_no_positions():
    found = positions_along(edges(), ROAD, 4.0)
    assert len(found) == 0
    some = positions_along(edges(LineString([(0, 0), (9, 0)])), ROAD, 4.0)
    assert found.dtypes.to_dict() == some.dtypes.to_dict()
    assert near_gaps(found, np.zeros((1, 2)), 5.0).shape == (0,)


def test_near_gaps_are_those_within_the_radius(rng):
    table = pd.DataFrame(rng.uniform(0, 100, (300, 2)), columns=["x", "y"])
    gaps = rng.uniform(0, 100, (7, 2))
    distance = np.hypot(*(table.to_numpy()[:, None] - gaps[None]).transpose(2, 0, 1)).min(axis=1)
    assert (near_gaps(table, gaps, 12.0) == (distance <= 12.0)).all()
    assert near_gaps(table, gaps, 12.0).any()
    assert not near_gaps(table, np.empty((0, 2)), 12.0).any()
    assert near_gaps(table.iloc[:0], gaps, 12.0).shape == (0,)


def test_the_radius_itself_is_near():
    table = pd.DataFrame({"x": [3.0], "y": [4.0]})
    assert near_gaps(table, np.zeros((1, 2)), 5.0).tolist() == [True]
