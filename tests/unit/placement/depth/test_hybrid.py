import math

import numpy as np
import pytest

from roadsight.placement.depth.hybrid import hybrid_depth, preliminary_depth, reach_deg
from roadsight.placement.sensors.rays import sensor_from_local, spherical_from_sensor
from roadsight.placement.sensors.sensors import Sensor

AROUND = Sensor(azimuth_step_deg=9, elevations_deg=(-30, -20, -12, -6, -2, 0, 5), range_m=40)
PARTIAL = Sensor(
    azimuth_min_deg=120, azimuth_max_deg=255, azimuth_step_deg=4.5,
    elevations_deg=(-25, -10, -5, 0), range_m=30,
)  # fmt: skip


def cell_of(sensor, azimuth, elevation):
    """Row and column of a direction, or None outside the field of view."""
    edges = sensor.elevation_edges_deg
    rows = [r for r in range(sensor.rows) if edges[r] <= elevation < edges[r + 1]]
    column = int(((azimuth - sensor.azimuth_min_deg) % 360) / sensor.azimuth_cell_deg)
    full = sensor.azimuth_max_deg - sensor.azimuth_min_deg == 360
    column = column % sensor.columns if full else column
    return (rows[0], column) if rows and column < sensor.columns else None


def unit(azimuth, elevation):
    a, e = math.radians(azimuth), math.radians(elevation)
    return np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])


def algorithm_1(points, sensor, position, yaw_deg, min_cell_points, neighbours, fill=True):
    """Literal transcription of Algorithm 1, cell by cell and point by point."""
    azimuth, elevation, range_m = spherical_from_sensor(
        sensor_from_local(points, position, yaw_deg)
    )
    near = [i for i in range(len(points)) if 0 < range_m[i] < sensor.range_m]
    cells = {}
    for i in near:
        cells.setdefault(cell_of(sensor, azimuth[i], elevation[i]), []).append(i)
    depth = np.zeros(sensor.shape)
    for row in range(sensor.rows):
        for column in range(sensor.columns):
            members = cells.get((row, column), [])
            if len(members) >= min_cell_points or (members and not fill):
                depth[row, column] = min(range_m[i] for i in members)
            elif fill:
                beam = sensor.azimuth_deg[column], sensor.elevation_deg[row]
                ranked = []
                for i in near:
                    along = abs(azimuth[i] - beam[0]) % 360
                    along = min(along, 360 - along)
                    ranked.append((along**2 + (elevation[i] - beam[1]) ** 2, i))
                ranked = [i for gap, i in sorted(ranked) if gap <= reach_deg(sensor) ** 2]
                nearest = ranked[:neighbours]
                if nearest:
                    direction = unit(*beam)
                    away = [
                        np.linalg.norm(
                            np.cross(range_m[i] * unit(azimuth[i], elevation[i]), direction)
                        )
                        for i in nearest
                    ]
                    weights = 1 / np.array(away)
                    depth[row, column] = np.sum(weights * range_m[nearest]) / np.sum(weights)
    return depth


@pytest.fixture
def street(rng):
    """Ground, a wall and a few poles around (500, 800), with duplicates, unevenly dense."""
    ground = rng.normal(0, 12, (450, 3)) * [1, 1, 0]
    wall = np.column_stack([rng.uniform(-9, 9, 120), np.full(120, 11), rng.uniform(0, 4, 120)])
    pole = np.array([-6, -7, 0]) + rng.uniform(0, 1, (40, 3)) * [0.1, 0.1, 6]
    points = np.concatenate([ground, wall, pole, wall[:30], wall[:30]])
    return points + np.array([500, 800, 20])


@pytest.mark.parametrize(
    ("sensor", "yaw_deg"), [(AROUND, 137.7), (PARTIAL, 0.0)], ids=["full circle", "partial"]
)
def test_hybrid_equals_the_literal_algorithm(street, sensor, yaw_deg):
    position = [500.3, 799.1, 24.2]
    depth = hybrid_depth(street, sensor, position, yaw_deg, min_cell_points=5, neighbours=10)
    expected = algorithm_1(street, sensor, position, yaw_deg, 5, 10)
    assert ((depth > 0) == (expected > 0)).all()
    np.testing.assert_allclose(depth, expected, rtol=1e-5)
    assert (depth > 0).mean() > 0.5
    preliminary = preliminary_depth(street, sensor, position, yaw_deg)
    literal = algorithm_1(street, sensor, position, yaw_deg, 1, 10, fill=False)
    np.testing.assert_allclose(preliminary, literal, rtol=1e-6)


def test_few_points_are_used_as_they_are(street):
    position = [500, 800, 23]
    for n in (0, 1, 3):
        depth = hybrid_depth(street[:n], AROUND, position, 10.0)
        expected = algorithm_1(street[:n], AROUND, position, 10.0, 5, 10)
        np.testing.assert_allclose(depth, expected, rtol=1e-5)


def test_neighbours_cross_the_seam():
    """A cell left of +-180 degrees is filled from points right of it."""
    edge = 10 * unit(-179.2, 0.0)
    depth = hybrid_depth(edge[None], AROUND, [0, 0, 0], 0.0)
    row = list(AROUND.elevation_deg).index(0)
    assert depth[row, [0, 1, -1, -2]] == pytest.approx([10, 10, 10, 10])
    assert depth[row, 3:-3].max() == 0


def test_azimuth_of_180_degrees_falls_in_the_first_column():
    for y in (0.0, -0.0):
        depth = preliminary_depth(np.array([[-7.0, y, 0.0]]), AROUND, [0, 0, 0], 0.0)
        assert depth[5, 0] == 7
        assert np.count_nonzero(depth) == 1


def test_a_point_on_the_beam_decides_alone():
    beam = AROUND.azimuth_deg[20], AROUND.elevation_deg[3]
    points = np.array([8 * unit(*beam), 9 * unit(beam[0] + 1, beam[1])])
    assert hybrid_depth(points, AROUND, [0, 0, 0], 0.0)[3, 20] == pytest.approx(8)


def test_the_sky_stays_empty(rng):
    tree = np.column_stack([np.full(400, 10), rng.uniform(-1, 1, 400), rng.uniform(-3, -1, 400)])
    sensor = Sensor(
        azimuth_step_deg=2, elevation_min_deg=-20, elevation_max_deg=20, channels=21, range_m=50
    )
    depth = hybrid_depth(tree, sensor, [0, 0, 0], 0.0)
    top_deg = np.degrees(np.arctan2(-1, 10))
    assert depth[sensor.elevation_deg > top_deg + reach_deg(sensor)].max() == 0
    assert depth[sensor.elevation_deg < top_deg - 2].max() > 0


def test_points_without_direction_or_beyond_range_are_left_out():
    points = np.array([[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [39.99, 0, 0], [40.0, 0, 0]])
    depth = preliminary_depth(points[[0, 1, 2, 4]], AROUND, [0, 0, 0], 0.0)
    assert depth.max() == 0
    assert preliminary_depth(points, AROUND, [0, 0, 0], 0.0).max() == pytest.approx(39.99)
