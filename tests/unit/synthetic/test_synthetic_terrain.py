import math

import numpy as np
import pytest
from scipy.interpolate import BSpline

from roadsight_worlds.casting import terrain as ground
from roadsight_worlds.casting.alignment import Alignment, heading_at, to_plan, to_road
from tests.helpers.kernels import from_python

CURVES = [1 / 600, -1 / 80, 0.0, 1e-9]


def alignment_of(curvature, heading=0.7):
    return Alignment(12.0, -5.0, math.cos(heading), math.sin(heading), curvature)


@pytest.fixture
def rough(rng):
    """Rough ground on a tight curve with a kinked profile."""
    return ground.Terrain(
        alignment_of(1 / 90), 20.0, 0.05, np.array([-9.0, -1.05, -1.0, 0.0, 4.0, 4.1]),
        np.array([-3.0, 0.12, 0.0, 0.0, -0.1, 1.0]), rng.uniform(-0.2, 0.2, (70, 90)), -1.0, -11.0,
        0.5, 0.25, 0.0, 30.0, -10.0, 10.0, 0,
    )  # fmt: skip


@pytest.mark.parametrize("curvature", CURVES)
def test_road_coordinates_go_both_ways(curvature, rng):
    alignment = alignment_of(curvature)
    road = np.column_stack([rng.uniform(-40, 60, 500), rng.uniform(-30, 30, 500)])
    plan = to_plan(alignment, road)
    assert to_road(alignment, plan) == pytest.approx(road, abs=1e-6 if curvature == 1e-9 else 1e-10)


def test_the_arc_is_an_arc():
    alignment = alignment_of(1 / 600)
    centre = np.array([12.0, -5.0]) + 600 * np.array([-math.sin(0.7), math.cos(0.7)])
    plan = to_plan(alignment, [[s, o] for s in (0.0, 50.0, 200.0) for o in (-10.0, 0.0, 10.0)])
    radii = np.linalg.norm(plan - centre, axis=1)
    assert radii == pytest.approx([610, 600, 590] * 3, abs=1e-9)  # left is towards the centre
    steps = to_plan(alignment, [[100.0, 0.0], [100.001, 0.0]])
    step = steps[1] - steps[0]
    assert math.atan2(step[1], step[0]) == pytest.approx(
        float(heading_at(alignment, 100.0)), abs=1e-5
    )


def test_almost_straight_is_straight(rng):
    road = np.column_stack([rng.uniform(-40, 60, 100), rng.uniform(-30, 30, 100)])
    straight, bent = to_plan(alignment_of(0.0), road), to_plan(alignment_of(1e-12), road)
    assert bent == pytest.approx(straight, abs=1e-3)


def reference_height(t, xy):
    """Height with SciPy's B-splines and interpolation."""
    station, offset = to_road(t.alignment, xy).T
    basis = BSpline.basis_element([-1.5, -0.5, 0.5, 1.5], extrapolate=False)
    rows, columns = np.indices(t.coefficient_m.shape)
    z = t.height_m + t.grade * station + np.interp(offset, t.profile_offset_m, t.profile_height_m)
    for i in range(len(xy)):
        u = (station[i] - t.first_station_m) / t.station_step_m - rows
        v = (offset[i] - t.first_offset_m) / t.offset_step_m - columns
        z[i] += np.nansum(basis(u) * basis(v) * t.coefficient_m)
    return z


def test_height_equals_scipy(rough, rng):
    road = np.column_stack([rng.uniform(0, 30, 60), rng.uniform(-10, 10, 60)])
    xy = to_plan(rough.alignment, road)
    assert ground.height_at(rough, xy) == pytest.approx(reference_height(rough, xy), abs=1e-12)


def test_there_is_no_ground_beyond_the_limits(rough):
    beyond = to_plan(rough.alignment, [[-0.01, 0.0], [30.01, 0.0], [5.0, 10.01], [5.0, -10.01]])
    assert np.isnan(ground.height_at(rough, beyond)).all()
    assert ground.height_at(rough, np.empty((0, 2))).shape == (0,)


def test_gradient_equals_differences(rough, rng):
    surface_gradient = from_python(ground.surface_gradient)
    offset = rng.uniform(-8.5, -1.5, 200)
    xy = to_plan(rough.alignment, np.column_stack([rng.uniform(1, 29, 200), offset]))
    step = 1e-6
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        rise = ground.height_at(rough, xy + shift) - ground.height_at(rough, xy - shift)
        slopes = [surface_gradient(rough, x, y)[axis] for x, y in xy]
        assert slopes == pytest.approx(rise / (2 * step), abs=1e-6)


def test_bounds_hold_everywhere_in_their_cells(rough, rng):
    cell = 0.8
    x, y = np.arange(10, 50, cell), np.arange(-25, 30, cell)
    bounds = ground.cell_bounds(rough, x, y, cell)
    column, row = rng.integers(len(x), size=60_000), rng.integers(len(y), size=60_000)
    inside = rng.uniform(-0.5, 0.5, (60_000, 2)) * cell
    xy = np.column_stack([x[column], y[row]]) + inside
    z = ground.height_at(rough, xy)
    exists = np.isfinite(z)
    assert exists.sum() > 5000
    at = row[exists], column[exists]
    assert np.all(z[exists] >= bounds.low_m[at])
    assert np.all(z[exists] <= bounds.high_m[at])
    surface_gradient = from_python(ground.surface_gradient)
    slopes = np.array([surface_gradient(rough, *p) for p in xy[exists]])
    off = np.hypot(slopes[:, 0] - bounds.slope_x[at], slopes[:, 1] - bounds.slope_y[at])
    assert np.all(off <= bounds.spread[at])


def test_bounds_are_empty_away_from_the_ground(rough):
    bounds = ground.cell_bounds(rough, np.array([500.0]), np.array([500.0]), 1.0)
    assert bounds.low_m[0, 0] > bounds.high_m[0, 0]
    centre = np.array([12.0, -5.0]) + 90 * np.array([-math.sin(0.7), math.cos(0.7)])
    at_centre = ground.cell_bounds(rough, centre[:1], centre[1:], 1.0)
    assert at_centre.low_m[0, 0] > at_centre.high_m[0, 0]
    assert np.isfinite(at_centre.spread).all()
