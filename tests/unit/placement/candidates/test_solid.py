import numpy as np
import pandas as pd
import pytest
from scipy.spatial import cKDTree

from roadsight.base.sections.placement import Candidates
from roadsight.placement.candidates.candidates import (
    REACH_M,
    Surroundings,
    has_measured_ground,
    stack_candidates,
)
from roadsight_worlds.casting.alignment import heading_at, plan_point
from roadsight_worlds.casting.materials import TruthClass
from roadsight_worlds.highway.highway import build_highway
from roadsight_worlds.highway.mobile_scanner import scan

SETTINGS = Candidates(height_step_m=1.0)


def plate(x, y, height, step=0.2):
    """Points of a level plate over x and y limits."""
    xs, ys = np.arange(*x, step), np.arange(*y, step)
    grid = np.stack(np.meshgrid(xs, ys), -1).reshape(-1, 2)
    return np.column_stack([grid, np.full(len(grid), height)])


def wall(x, y, z, step=0.2):
    """Points of an upright wall along y at x."""
    grid = np.stack(np.meshgrid(np.arange(*y, step), np.arange(*z, step)), -1).reshape(-1, 2)
    return np.column_stack([np.full(len(grid), x), grid])


def around(points):
    near = np.hypot(*points[:, :2].T) <= REACH_M
    return Surroundings(points[near][:, :2], points[near][:, 2])


class TestRoofs:
    def test_a_ceiling_on_both_sides_of_a_wall_is_a_roof(self):
        ceiling = np.concatenate([plate((0.4, 5), (-5, 5), 6.6), plate((-5, -0.4), (-5, 5), 6.6)])
        assert around(ceiling).roof_m(4.0) == pytest.approx(6.6)

    def test_a_crown_a_gantry_and_wires_are_none(self, rng):
        way = rng.normal(size=(4000, 3))
        crown = 2.5 * way / np.linalg.norm(way, axis=1, keepdims=True) + [0, 0, 8]
        gantry = plate((-0.4, 0.4), (-5, 5), 6.2)
        wires = plate((-0.02, 0.02), (-5, 5), 8.0)
        for points in (crown, gantry, wires):
            assert around(points).roof_m(4.0) == np.inf

    def test_what_is_below_the_lowest_sensor_is_no_roof(self):
        assert around(plate((-5, 5), (-5, 5), 3.0)).roof_m(4.0) == np.inf


class TestWalls:
    def test_between_two_faces_of_a_wall(self):
        faces = np.concatenate([wall(x, (-5, 5), (0, 7)) for x in (-0.4, 0.4)])
        enclosed, near_m = around(faces).walled(np.array([5.0, 9.0]))
        assert enclosed.tolist() == [True, False]
        assert near_m.tolist() == pytest.approx([0.4, REACH_M], abs=0.05)

    def test_beside_a_wall_and_in_a_corner(self):
        straight = wall(0.7, (-5, 5), (0, 7))
        corner = np.concatenate([straight, straight[:, [1, 0, 2]]])
        for points in (straight, corner):
            assert not around(points).walled(np.array([5.0]))[0].any()


def test_ground_is_measured_or_it_is_not():
    ground = plate((0, 20), (0, 5), 0.0)[:, :2]
    xy = np.array([[10.0, 2.0], [10.0, 5.5], [10.0, 7.0], [30.0, 2.0]])
    assert has_measured_ground(xy, ground).tolist() == [True, True, False, False]
    # Two points in a square metre: a mast may stand 1.4 m from the next one.
    thin = plate((0, 20), (0, 5), 0.0, step=0.71)[:, :2]
    assert has_measured_ground(np.array([[10.0, 6.0]]), thin).all()
    assert not has_measured_ground(xy, np.empty((0, 2))).any()


class Road:
    """A scanned road with wires, a canopy, a gantry and a tunnel, and its candidates."""

    def __init__(self):
        self.highway = build_highway(seed=1, length_m=100.0, overhead=True)
        rng = np.random.default_rng(1)
        chunks = list(scan(self.highway, 1_200_000, rng))
        self.xyz_m = np.concatenate([chunk.xyz_m for chunk in chunks]).astype(np.float64)
        truth = np.concatenate([chunk.truth_class for chunk in chunks])
        ground = np.isin(truth, [TruthClass.ROAD, TruthClass.GROUND])
        self.ground_xy_m, self.ground_z_m = self.xyz_m[ground][:, :2], self.xyz_m[ground][:, 2]
        self.ground = cKDTree(self.ground_xy_m)
        self.open_m = self.highway.tunnel_start_m

    def positions(self, stations, offset):
        alignment = self.highway.alignment
        places = [plan_point(alignment, station, offset) for station in stations]
        table = pd.DataFrame(places, columns=["x", "y"])
        table["key"] = [f"s{station:06.2f}" for station in stations]
        table["station_m"] = stations
        near = self.ground.query(table[["x", "y"]].to_numpy())[1]
        table["ground_z_m"] = self.ground_z_m[near]
        table["yaw_deg"] = np.degrees(heading_at(alignment, 0.0))
        return table.assign(edge="e", mount="edge")

    def candidates(self, stations, offset, whole=True):
        positions = self.positions(stations, offset)
        if whole:
            xy = positions[["x", "y"]].to_numpy()
            positions = positions[has_measured_ground(xy, self.ground_xy_m)].reset_index(drop=True)
        xy = positions[["x", "y"]].to_numpy()
        near = cKDTree(xy).query(self.xyz_m[:, :2], distance_upper_bound=REACH_M)
        points = self.xyz_m[np.isfinite(near[0])]
        index = near[1][np.isfinite(near[0])]
        heights = points[:, 2] - positions["ground_z_m"].to_numpy()[index]
        return stack_candidates(positions, points, heights, SETTINGS, points if whole else None)


@pytest.fixture(scope="module")
def road():
    return Road()


def heights_at(table, station):
    here = np.isclose(table["station_m"], station, atol=0.01)
    return np.sort(table["height_m"][here].to_numpy())


class TestRoadWithOverheads:
    """Cases i to iv of the published heights, on scanned wires, roofs and beams."""

    offset = 12.95

    def test_in_the_open_all_heights_are_free(self, road):
        table = road.candidates([0.40 * road.open_m], self.offset)
        assert len(heights_at(table, 0.40 * road.open_m)) >= 6

    def test_a_sensor_hangs_below_wires_and_above_them(self, road):
        station = 0.30 * road.open_m
        heights = heights_at(road.candidates([station], self.offset), station)
        plane = road.highway.terrain.height_m + road.highway.terrain.grade * station
        foot = road.positions([station], self.offset)["ground_z_m"].iloc[0]
        wires = plane + 8.0 - foot
        assert (heights < wires - 0.4).any()
        assert (heights > wires + 0.4).any()
        assert (np.abs(heights - wires) > 0.4).all()

    def test_none_is_in_or_above_a_canopy(self, road):
        station = 0.50 * road.open_m
        plane = road.highway.terrain.height_m + road.highway.terrain.grade * station
        foot = road.positions([station], self.offset)["ground_z_m"].iloc[0]
        underside = plane + 5.2 - foot
        heights = heights_at(road.candidates([station], self.offset), station)
        assert (heights < underside).all()

    def test_a_gantry_leaves_room_below_and_above(self, road):
        station = 0.75 * road.open_m
        plane = road.highway.terrain.height_m + road.highway.terrain.grade * station
        foot = road.positions([station], self.offset)["ground_z_m"].iloc[0]
        low, high = plane + 6.2 - foot, plane + 7.0 - foot
        heights = heights_at(road.candidates([station], self.offset), station)
        assert (heights < low).any()
        assert not ((heights > low - 0.4) & (heights < high + 0.0)).any()

    def test_none_stands_in_the_wall_between_two_bores(self, road):
        inside = np.arange(road.open_m + 1.0, 99.0, 2.0)
        published = road.candidates(inside, 0.0, whole=False)
        assert len(published) > 0
        assert len(road.candidates(inside, 0.0)) == 0

    def test_sensors_in_a_bore_stay(self, road):
        inside = np.arange(road.open_m + 2.0, 98.0, 4.0)
        table = road.candidates(inside, 11.5)
        assert table["station_m"].nunique() == len(inside)
        assert table["height_m"].max() < 6.6
