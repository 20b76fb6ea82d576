import numpy as np
import pytest

from roadsight.placement.sensors.rays import beam_directions
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.detection import count_hits

FINE = Sensor(
    azimuth_step_deg=1, elevation_min_deg=-60, elevation_max_deg=60, channels=97, range_m=40
)
HALF = Sensor(
    azimuth_min_deg=100, azimuth_max_deg=250, azimuth_step_deg=0.75,
    elevations_deg=(-30, -12, -7, -3, -1, 0, 1, 2, 9), range_m=25,
)  # fmt: skip


def cylinder_range(origin, directions, foot, radius, height):
    """Exact ranges of rays from outside a solid, capped, upright cylinder; infinite if missed."""
    d, o = directions.astype(np.float64), np.asarray(origin, float) - foot
    best = np.full(d.shape[:-1], np.inf)
    with np.errstate(all="ignore"):
        a = d[..., 0] ** 2 + d[..., 1] ** 2
        b = o[0] * d[..., 0] + o[1] * d[..., 1]
        root = np.sqrt(b * b - a * (o[0] ** 2 + o[1] ** 2 - radius**2))
        for t in ((-b - root) / a, (-b + root) / a):
            z = o[2] + t * d[..., 2]
            best = np.where((t > 0) & (z >= 0) & (z <= height) & (t < best), t, best)
        for level in (0, height):
            t = (level - o[2]) / d[..., 2]
            x, y = o[0] + t * d[..., 0], o[1] + t * d[..., 1]
            best = np.where((t > 0) & (x * x + y * y <= radius**2) & (t < best), t, best)
    return best


def rendered_hits(depth, sensor, position, yaw_deg, targets, radius, height):
    """The paper's way: a depth map of each target alone, compared beam by beam with the scene's."""
    azimuth = np.radians(sensor.azimuth_deg + yaw_deg)
    elevation = np.radians(sensor.elevation_deg)[:, None]
    directions = np.stack(
        np.broadcast_arrays(
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ),
        axis=-1,
    )
    scene = np.where(depth > 0, depth, np.inf)
    hits = []
    for foot in targets:
        alone = cylinder_range(position, directions, foot, radius, height)
        hits.append(int(((alone < scene) & (alone < sensor.range_m)).sum()))
    return hits


@pytest.mark.parametrize("sensor", [FINE, HALF], ids=["full circle", "partial"])
def test_footprint_equals_rendered_targets(sensor, rng):
    total = 0
    for _ in range(12):
        position = rng.uniform([95, -55, -1], [105, -45, 9])
        yaw = rng.uniform(-400, 400)
        distance, angle = 45 * rng.random(120) ** 1.5, rng.uniform(0, 2 * np.pi, 120)
        targets = position + np.column_stack(
            [distance * np.cos(angle), distance * np.sin(angle), rng.uniform(-6, 3, 120)]
        )
        targets = targets[distance > 0.9]
        depth = rng.choice([0.0, 5.0, 15.0, 30.0], sensor.shape).astype(np.float32)
        hits = count_hits(depth, sensor, position, yaw, targets, 0.8, 1.7)
        expected = rendered_hits(depth, sensor, position, yaw, targets, 0.8, 1.7)
        assert hits.tolist() == expected
        total += hits.sum()
    assert total > 2000


def test_seam_of_the_azimuth_counts_both_sides():
    depth = np.zeros(FINE.shape, np.float32)
    behind = count_hits(depth, FINE, [0, 0, 1], 0, np.array([[-10.0, 0, 0]]), 0.5, 2.0)
    ahead = count_hits(depth, FINE, [0, 0, 1], 0, np.array([[10.0, 0, 0]]), 0.5, 2.0)
    assert behind[0] == ahead[0] > 20


def test_yaw_is_the_direction_of_sensor_x():
    depth = np.zeros(HALF.shape, np.float32)
    target = np.array([[10.0, 0, 0]])
    seen = [count_hits(depth, HALF, [0, 0, 0.5], yaw, target)[0] for yaw in (0, 90, 180, -90)]
    assert seen[0] == 0
    assert seen[2] > 0
    assert seen[1] == 0 or seen[3] == 0


def test_nearer_scene_hides_and_farther_scene_does_not():
    target = np.array([[10.0, 0, 0]])
    free = count_hits(np.zeros(FINE.shape, np.float32), FINE, [0, 0, 3], 0, target)[0]
    for wall_m, expected in ((5.0, 0), (20.0, free)):
        wall = np.full(FINE.shape, wall_m, np.float32)
        assert count_hits(wall, FINE, [0, 0, 3], 0, target)[0] == expected


def test_equal_ranges_are_the_scenes():
    sensor = Sensor(azimuth_step_deg=1, elevations_deg=(0,), range_m=40)
    target = np.array([[10.0, 0, -0.3]])
    exact = cylinder_range([0, 0, 0], beam_directions(sensor, 0.5)[0], target[0], 0.25, 0.6)
    depth = np.where(np.isfinite(exact), exact, 0)[None].astype(np.float32)
    assert np.isfinite(exact).sum() == 3
    assert count_hits(depth, sensor, [0, 0, 0], 0.5, target)[0] < 3
    assert count_hits(depth + np.float32(0.001), sensor, [0, 0, 0], 0.5, target)[0] == 3


def test_pavement_behind_the_foot_does_not_hide_it():
    directions = beam_directions(FINE, 0)
    ground = np.where(directions[..., 2] < 0, -4.0 / np.minimum(directions[..., 2], -1e-9), 0)
    ground[ground >= FINE.range_m] = 0
    target = np.array([[9.0, 2.0, 0]])
    on_ground = count_hits(ground.astype(np.float32), FINE, [0, 0, 4], 0, target)
    alone = count_hits(np.zeros(FINE.shape, np.float32), FINE, [0, 0, 4], 0, target)
    assert on_ground.tolist() == alone.tolist()


def test_sensor_in_on_above_and_below_a_target():
    depth = np.zeros(FINE.shape, np.float32)
    foot = np.array([[0.0, 0, 0]])

    def hits(x, z):
        return count_hits(depth, FINE, [x, 0, z], 0, foot, 0.25, 0.6)[0]

    assert hits(0, 0.3) == 0
    assert hits(0.1, 0.6) == 0
    steep = np.sum(np.degrees(np.arctan2(0.35, 0.25)) <= -FINE.elevation_deg)
    assert hits(0, 0.95) == steep * FINE.columns > 0
    assert hits(0, -0.35) == steep * FINE.columns
    assert hits(0.25, 0.3) == 0


def test_range_limit_and_no_targets():
    depth = np.zeros(FINE.shape, np.float32)
    targets = np.array([[40.5, 0, 0], [41.0, 0, 0], [90.0, 0, 0]])
    hits = count_hits(depth, FINE, [0, 0, 0.3], 0, targets, radius_m=1.0)
    assert (hits > 0).tolist() == [True, False, False]
    assert count_hits(depth, FINE, [0, 0, 0], 0, np.empty((0, 3))).shape == (0,)
