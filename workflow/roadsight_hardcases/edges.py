"""The road's outline and edges, candidates along them, targets between them."""

from __future__ import annotations

import cv2
import geopandas as gpd
import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree
from shapely import LinearRing, LineString, MultiPolygon, Polygon

from roadsight.base.arrays import Numbers
from roadsight.base.errors import InputError
from roadsight.base.sections.placement import Candidates
from roadsight.base.sections.scene import PavementOutline
from roadsight.geometry.cameras import wrap_deg
from roadsight.placement.candidates.candidates import free_heights_m, positions_along
from roadsight.placement.candidates.targets import place_targets
from roadsight.scene.grids import Grid
from roadsight.scene.pavement.outline import outline_pavement
from roadsight.scene.splines import natural_spline
from roadsight_hardcases.case import Errors, fails, hard_case


def _arc(angle_rad: Numbers, radius_m: float = 50.0) -> Numbers:
    return radius_m * np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])


def _off_arc(xy: Numbers, radius_m: float = 50.0) -> float:
    return float(np.abs(np.hypot(*xy.T) - radius_m).max())


@hard_case("extract_pavement", bound=0.12, unit="m of the width")
def outline_through_cell_centres(rng: np.random.Generator) -> Errors:
    """Contours by OpenCV run through the middles of cells: a road is a cell too narrow."""
    width_m, length_m, settings = 6.0, 60.0, PavementOutline()
    xyz = rng.uniform(0, 1, (36_000, 3)) * [length_m, width_m, 0.01]
    grid = Grid.around(xyz[:, 0], xyz[:, 1], settings.outline_cell_m)
    cells = np.zeros(grid.shape, np.uint8)
    cells[grid.indices(*xyz[:, :2].T)[::-1]] = 1
    (contour,), _ = cv2.findContours(cells, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    naive_m2 = cv2.contourArea(contour) * settings.outline_cell_m**2
    ours_m2 = outline_pavement(xyz, np.ones(len(xyz), bool), settings).area
    return abs(naive_m2 / length_m - width_m), abs(ours_m2 / length_m - width_m)


@hard_case("build_edges", bound=0.5, unit="edges lost")
def spline_through_repeated_points(rng: np.random.Generator) -> Errors:
    """A double click repeats a point, and no spline has two values at one place."""
    points = np.repeat(_arc(np.linspace(0, 1.5, 8)), [1, 2, 1, 1, 3, 1, 1, 2], axis=0)
    chord = np.append(0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    naive = fails(CubicSpline, chord, points)
    ours = fails(natural_spline, points, 1.0)
    return naive, ours + (_off_arc(natural_spline(points, 1.0)[1]) > 0.5)


@hard_case("build_edges", bound=0.5, unit="m")
def edge_that_runs_north(rng: np.random.Generator) -> Errors:
    """y as a function of x is no curve where the road runs north and turns back."""
    points = _arc(np.linspace(-1.2, 1.3, 9))
    order = np.argsort(points[:, 0])
    x = np.linspace(points[:, 0].min(), points[:, 0].max(), 200)
    naive = np.column_stack([x, CubicSpline(*points[order].T, bc_type="natural")(x)])
    return _off_arc(naive), _off_arc(natural_spline(points, 1.0)[1])


@hard_case("build_edges", bound=1.0, unit="m")
def points_clicked_at_uneven_steps(rng: np.random.Generator) -> Errors:
    """A spline over the number of the point swings out where clicks are 1 m and 30 m apart."""
    points = _arc(np.array([0.0, 0.02, 0.62, 0.64, 1.24, 1.26, 1.9]))
    number = np.arange(len(points))
    naive = CubicSpline(number, points, bc_type="natural")(np.linspace(0, number[-1], 400))
    return _off_arc(naive), _off_arc(natural_spline(points, 1.0)[1])


@hard_case("build_edges", bound=0.5, unit="unexplained failures")
def edge_without_length(rng: np.random.Generator) -> Errors:
    """An edge of one place, clicked twice, has no direction."""
    points = np.zeros((2, 2))
    naive = fails(CubicSpline, np.zeros(2), points, expected=(InputError,))
    return naive, fails(natural_spline, points, 1.0, expected=(InputError,))


@hard_case("build_edges", bound=0.2, unit="m")
def edge_of_a_roundabout(rng: np.random.Generator) -> Errors:
    """A natural spline has free ends: where a closed edge meets itself, it has a corner."""
    points = _arc(np.linspace(0, 2 * np.pi, 9))
    points[-1] = points[0]
    chord = np.append(0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    naive = CubicSpline(chord, points, bc_type="natural")(np.linspace(0, chord[-1], 400))
    return _off_arc(naive), _off_arc(natural_spline(points, 1.0)[1])


@hard_case("place_candidates", bound=90.0, unit="deg")
def inner_edge_of_a_roundabout(rng: np.random.Generator) -> Errors:
    """Turned to the middle of the pavement, sensors on the island look away from the road."""
    turn = np.linspace(0, 2 * np.pi, 65)
    road = MultiPolygon([Polygon(_arc(turn, 20.0), [_arc(turn, 12.0)])])
    edge = LineString(_arc(turn, 11.9))
    found = positions_along(
        gpd.GeoDataFrame({"edge": ["e"], "kind": ["verge"]}, geometry=[edge]), road, 4.0
    )
    xy = found[["x", "y"]].to_numpy()
    outward_deg = np.degrees(np.arctan2(xy[:, 1], xy[:, 0]))
    east, north = (np.array(road.centroid.coords)[0] - xy).T
    naive_deg = np.degrees(np.arctan2(north, east))
    turned = [wrap_deg(deg - outward_deg) for deg in (naive_deg, found["yaw_deg"].to_numpy())]
    return np.abs(turned[0]).max(), np.abs(turned[1]).max()


@hard_case("place_candidates", bound=0.5, unit="positions that stand beside another one")
def ring_road_that_closes(rng: np.random.Generator) -> Errors:
    """The last station of a ring road is beside its first: one place is planned twice."""
    naive = ours = 0
    for radius_m in (100.0, 150.3, 203.7, 318.31):
        ring = LinearRing(_arc(np.linspace(0, 2 * np.pi, 721)[:-1], radius_m))
        edges = gpd.GeoDataFrame({"edge": ["e"], "kind": ["verge"]}, geometry=[ring])
        stations = np.arange(0, ring.length, 4.0)
        places = np.array([ring.interpolate(station).coords[0] for station in stations])
        found = positions_along(edges, MultiPolygon(), 4.0)[["x", "y"]].to_numpy()
        naive += _beside_another(places, 2.0)
        ours += _beside_another(found, 2.0) + (abs(len(found) - ring.length / 4.0) > 1)
    return naive, ours


def _beside_another(xy: Numbers, distance_m: float) -> int:
    return len(cKDTree(xy).query_pairs(distance_m))


@hard_case("place_candidates", bound=0.5, unit="heights too many or too few")
def heights_in_steps_of_a_tenth(rng: np.random.Generator) -> Errors:
    """The number of steps of a tenth, rounded down, often leaves out the highest height."""
    naive = ours = 0
    for high in np.arange(45, 101) / 10:
        settings = Candidates(height_min_m=4.0, height_max_m=float(high), height_step_m=0.1)
        true = round((high - 4.0) * 10) + 1
        naive += abs(int((high - 4.0) / 0.1) + 1 - true)
        ours += abs(len(free_heights_m(np.empty(0), settings)) - true)
    return naive, ours


@hard_case("densify_candidates", bound=0.5, unit="positions computed twice")
def stations_named_twice(rng: np.random.Generator) -> Errors:
    """Halved spacings reach the same station by other sums, and its name has other digits."""
    edges = gpd.GeoDataFrame(
        {"edge": ["e"], "kind": ["verge"]}, geometry=[LineString([(0, 0), (0, 60)])]
    )
    none, coarse, fine = MultiPolygon(), 0.6, 0.2
    tripled = np.cumsum(np.full(299, fine))[2::3]
    naive = len(set(np.cumsum(np.full(99, coarse)).tolist()) - set(tripled.tolist()))
    keys = [set(positions_along(edges, none, step)["key"]) for step in (coarse, fine)]
    return naive, len(keys[0] - keys[1])


@hard_case("place_targets", bound=0.02, unit="m")
def strays_above_the_pavement(rng: np.random.Generator) -> Errors:
    """A mean or least height of a cell follows the one bird above it or echo below it."""
    xy = rng.uniform(0, 20, (20_000, 2))
    z = rng.normal(0, 0.005, 20_000)
    stray = rng.choice(20_000, 200, replace=False)
    z[stray] = rng.choice([-2.0, 6.0], 200)
    cell = np.floor(xy[:, 1]).astype(int) * 20 + np.floor(xy[:, 0]).astype(int)
    naive = pd.Series(z).groupby(cell).mean().to_numpy()
    ours = place_targets(np.column_stack([xy, z]))["z"].to_numpy()
    return np.abs(naive).max(), np.abs(ours).max()
