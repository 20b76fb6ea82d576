import numpy as np
import pytest

from roadsight.placement.sensors.poses import Turn, local_from_sensor
from roadsight.placement.sensors.rays import beam_directions
from roadsight.placement.sensors.sensors import load_sensors
from roadsight.placement.sight.detectors import Criteria, detector_of
from roadsight.placement.sight.kinds import Box, Cylinder
from roadsight.placement.sight.posed import Panorama
from roadsight.placement.sight.sight import Sight, beams_by_height, count_beams
from tests.unit.placement.sight.test_boxes import CAR, POSITION, SENSOR, boxes

BANDS = 4
PERSON = Box(0.5, 0.5, 1.7)
POST = Cylinder(0.25, 1.2)


def scene(rng):
    ranges = np.where(rng.random(SENSOR.shape) < 0.5, rng.uniform(5, 40, SENSOR.shape), 0.0)
    return ranges.astype(np.float32)


def literal(range_m, directions, position, feet, shape, max_range_m):
    """Height over the foot at which each beam enters, by small steps along it, in bands."""
    counts = np.zeros((len(feet), BANDS), int)
    steps = np.arange(0.0, max_range_m, 0.002)
    for number, foot in enumerate(feet):
        middle = foot[:3] + np.array([0, 0, shape.height_m / 2]) - position
        around = 3.0
        for row, column in np.ndindex(*directions.shape[:2]):
            way = directions[row, column].astype(float)
            ahead = middle @ way
            if ahead < -around or np.linalg.norm(middle - ahead * way) > around:
                continue
            near = steps[np.abs(steps - ahead) < around]
            points = position + near[:, None] * way - foot[:3]
            inside = (points[:, 2] > 0) & (points[:, 2] < shape.height_m)
            if isinstance(shape, Box):
                cosine, sine = np.cos(foot[3]), np.sin(foot[3])
                inside &= np.abs(points[:, :2] @ [cosine, sine]) < shape.length_m / 2
                inside &= np.abs(points[:, :2] @ [-sine, cosine]) < shape.width_m / 2
            else:
                inside &= np.hypot(points[:, 0], points[:, 1]) < shape.radius_m
            if inside.any():
                first = int(np.argmax(inside))
                met = range_m[row, column]
                if met == 0 or near[first] < met:
                    share = points[first, 2] / shape.height_m
                    counts[number, min(int(share * BANDS), BANDS - 1)] += 1
    return counts


@pytest.mark.parametrize("shape", [PERSON, POST])
@pytest.mark.parametrize("tilted", [False, True])
def test_bands_are_those_of_a_walk_along_every_beam(shape, tilted):
    rng = np.random.default_rng(6)
    feet = boxes(rng, 6)
    feet = feet if isinstance(shape, Box) else np.ascontiguousarray(feet[:, :3])
    tilt = local_from_sensor(0.0, Turn(0.0, 4.0, -3.0)) if tilted else None
    ranges = scene(rng)
    sight = Sight(50.0)
    found = beams_by_height(ranges, SENSOR, POSITION, 30.0, feet, shape, sight, BANDS, tilt)
    directions = beam_directions(SENSOR, 30.0, tilt)
    expected = literal(ranges, directions, POSITION, feet, shape, 50.0)
    assert found.shape == (6, BANDS)
    # The walk sees a corner, or the border of two bands, to two millimetres.
    assert np.abs(found - expected).sum() <= 2
    assert expected.sum() > 20


@pytest.mark.parametrize("name", ["OS-32", "OS-64"])
@pytest.mark.parametrize("shape", [CAR, PERSON, POST])
@pytest.mark.parametrize("wide", [False, True])
def test_bands_add_up_to_what_detection_counts(name, shape, wide):
    sensor = load_sensors("config/sensors.yaml")[name]
    rng = np.random.default_rng(3)
    feet = boxes(rng, 40)
    feet = feet if isinstance(shape, Box) else np.ascontiguousarray(feet[:, :3])
    size_m = shape if isinstance(shape, Box) else (shape.radius_m, shape.height_m)
    free, sight = np.zeros(sensor.shape, np.float32), Sight(45.0, wide, curved=True)
    pose = (free, sensor, POSITION, 20.0, feet)
    together = count_beams(*pose, size_m, sight)
    parts = beams_by_height(*pose, shape, sight, BANDS)
    if isinstance(shape, Box):
        np.testing.assert_allclose(parts.sum(axis=1), together, rtol=1e-12)
    else:  # the closed form decides beams that just graze a cylinder in its own way
        near = np.abs(parts.sum(axis=1) - together)
        assert near.max() <= (4.0 if wide else 2.0)
        assert near.sum() <= 0.005 * together.sum()
    np.testing.assert_allclose(
        beams_by_height(*pose, shape, sight, 1)[:, 0], parts.sum(axis=1), rtol=1e-12
    )


@pytest.mark.parametrize("name", ["OS-32", "Avia", "camera-8mp"])
def test_detectors_in_poses_tell_the_same_by_height(name):
    sensor = load_sensors("config/sensors.yaml")[name]
    detector = detector_of(sensor, Criteria(8, 1.0))
    rng = np.random.default_rng(5)
    panorama = Panorama(scene(rng), SENSOR, np.array([0.0, 0.0, 5.0]), 0.0)
    feet = np.array([[12.0, 1.0, 0.0, 0.5], [25.0, -3.0, 0.2, 1.0], [30.0, 4.0, -0.5, 0.0]])
    down = local_from_sensor(0.0, Turn(0.0, -12.0, 0.0))
    asked = (panorama, down, feet, PERSON, Sight(sensor.range_m))
    parts = detector.by_height(*asked, BANDS)
    np.testing.assert_allclose(parts.sum(axis=1), detector.measure(*asked), rtol=1e-9)
    assert (parts >= 0).all()
    assert (parts[0] > 0).all()


def test_mounted_and_posed_sensors_agree_by_height():
    free = np.zeros(SENSOR.shape, np.float32)
    feet = boxes(np.random.default_rng(2))
    mounted = beams_by_height(free, SENSOR, POSITION, 0.0, feet, PERSON, Sight(50.0), BANDS)
    detector = detector_of(SENSOR, Criteria(8, 1.0))
    panorama = Panorama(free, SENSOR, POSITION, 0.0)
    posed = detector.by_height(panorama, np.eye(3), feet, PERSON, Sight(50.0), BANDS)
    np.testing.assert_allclose(posed, mounted, rtol=0.02, atol=1)


def test_a_low_sensor_sees_the_side_and_a_high_one_the_top():
    foot, free = np.array([[6.0, 0.0, 0.0, 0.0]]), np.zeros(SENSOR.shape, np.float32)
    low, high = (
        beams_by_height(free, SENSOR, [0.0, 0.0, z], 0.0, foot, CAR, Sight(50.0), BANDS)[0]
        for z in (1.0, 9.0)
    )
    assert low[0] > 0
    assert high[-1] / high.sum() > low[-1] / low.sum()
