import numpy as np
import pytest

from roadsight.placement.sensors.poses import Turn, local_from_sensor
from roadsight.placement.sensors.rays import beam_directions
from roadsight.placement.sensors.sensors import Sensor, load_sensors
from roadsight.placement.sight.detectors import Criteria, detector_of
from roadsight.placement.sight.kinds import Box
from roadsight.placement.sight.posed import Panorama
from roadsight.placement.sight.shapes import beams_on
from roadsight.placement.sight.sight import Sight, count_beams

SENSOR = Sensor(
    azimuth_step_deg=1.0, elevation_min_deg=-60, elevation_max_deg=10, channels=36, range_m=60
)
CAR = Box(4.5, 1.8, 1.5)
POSITION = np.array([3.0, -2.0, 5.0])


def literal(range_m, directions, position, feet, box, max_range_m):
    """Beams that enter a box nearer than the scene, each tested on its own in the box's frame."""
    found = []
    for x, y, z, heading in feet:
        axes = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
        low = np.array([-box.length_m / 2, -box.width_m / 2, 0.0])
        high = np.array([box.length_m / 2, box.width_m / 2, box.height_m])
        start = position - np.array([x, y, z])
        start = np.array([*(axes @ start[:2]), start[2]])
        count = 0
        for row in range(directions.shape[0]):
            for column in range(directions.shape[1]):
                way = directions[row, column].astype(float)
                way = np.array([*(axes @ way[:2]), way[2]])
                with np.errstate(divide="ignore"):
                    one, two = (low - start) / way, (high - start) / way
                enter = max(np.minimum(one, two).max(), 0.0)
                leave = np.maximum(one, two).min()
                scene = range_m[row, column]
                if 0 < enter < min(leave, max_range_m) and (scene == 0 or enter < scene):
                    count += 1
        found.append(count)
    return np.array(found)


def boxes(rng, count=12):
    place = rng.uniform((-25, -25, -1.0), (25, 25, 1.0), (count, 3))
    return np.column_stack([place, rng.uniform(-np.pi, np.pi, count)])


@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize("box", [CAR, Box(0.5, 0.5, 1.7), Box(9.1, 2.4, 3.4)])
def test_beams_are_those_of_a_literal_count(tilted, box):
    rng = np.random.default_rng(4)
    feet = boxes(rng)
    tilt = local_from_sensor(0.0, Turn(0.0, 4.0, -3.0)) if tilted else None
    scene = np.where(rng.random(SENSOR.shape) < 0.5, rng.uniform(5, 40, SENSOR.shape), 0.0)
    scene = scene.astype(np.float32)
    found = beams_on(scene, SENSOR, POSITION, 30.0, tilt, feet, box, 50.0, False)[:, 0]
    directions = beam_directions(SENSOR, 30.0, tilt)
    expected = literal(scene, directions, POSITION, feet, box, 50.0)
    # Within this distance a box may span more than the 64 beams that are looked at.
    around_m = np.linalg.norm([box.length_m, box.width_m, box.height_m]) / 2
    near = np.hypot(*(feet[:, :2] - POSITION[:2]).T) < 2.2 * around_m + 1
    np.testing.assert_array_equal(found[~near], expected[~near])
    np.testing.assert_allclose(found[near], expected[near], rtol=0.05)
    assert expected[~near].sum() > 20


def test_a_box_is_hidden_by_a_wall_and_seen_over_a_low_one():
    foot = np.array([[20.0, 0.0, 0.0, 0.0]])
    position = np.array([0.0, 0.0, 3.0])
    free = np.zeros(SENSOR.shape, np.float32)
    wall = np.full(SENSOR.shape, 10.0, np.float32)
    assert beams_on(free, SENSOR, position, 0.0, None, foot, CAR, 50.0, False)[0, 0] > 0
    assert beams_on(wall, SENSOR, position, 0.0, None, foot, CAR, 50.0, False)[0, 0] == 0


def test_a_car_across_shows_more_than_one_along():
    along = np.array([[20.0, 0.0, 0.0, 0.0]])
    across = np.array([[20.0, 0.0, 0.0, np.pi / 2]])
    free, position = np.zeros(SENSOR.shape, np.float32), np.array([0.0, 0.0, 1.0])
    counts = [
        beams_on(free, SENSOR, position, 0.0, None, foot, CAR, 50.0, False)[0, 0]
        for foot in (along, across)
    ]
    assert counts[1] > 1.5 * counts[0]


def test_footprints_never_add_and_converge_to_lines():
    wide = load_sensors("config/sensors.yaml")["OS-32"]
    feet, free = boxes(np.random.default_rng(1)), np.zeros(wide.shape, np.float32)
    pose = (POSITION, 10.0, None)
    lines = beams_on(free, wide, *pose, feet, CAR, 50.0, False)[:, 0]
    shares = beams_on(free, wide, *pose, feet, CAR, 50.0, True)[:, 0]
    assert (shares <= lines + 1e-9).all()
    assert shares.sum() > 0.7 * lines.sum()


def test_mounted_and_posed_sensors_agree():
    """The same boxes through the depth map and through a panorama."""
    feet = boxes(np.random.default_rng(2))
    free = np.zeros(SENSOR.shape, np.float32)
    mounted = count_beams(free, SENSOR, POSITION, 0.0, feet, CAR, Sight(50.0))
    detector = detector_of(SENSOR, Criteria(8, 1.0))
    panorama = Panorama(free, SENSOR, POSITION, 0.0)
    posed = detector.measure(panorama, np.eye(3), feet, CAR, Sight(50.0))
    np.testing.assert_allclose(posed, mounted, rtol=0.02, atol=2)


@pytest.mark.parametrize("name", ["camera-8mp", "radar-77ghz", "Avia"])
def test_every_kind_measures_boxes(name):
    sensor = load_sensors("config/sensors.yaml")[name]
    detector = detector_of(sensor, Criteria(8, 10.0))
    free = np.zeros(SENSOR.shape, np.float32)
    panorama = Panorama(free, SENSOR, np.array([0.0, 0.0, 5.0]), 0.0)
    foot = np.array([[30.0, 0.0, 0.0, 0.5]])
    down = local_from_sensor(0.0, Turn(0.0, -8.0, 0.0))
    sight = Sight(sensor.range_m)
    large = detector.measure(panorama, down, foot, Box(9.1, 2.4, 3.4), sight)
    small = detector.measure(panorama, down, foot, Box(0.5, 0.5, 1.7), sight)
    assert large[0] >= small[0] > 0
