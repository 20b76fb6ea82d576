import numpy as np
import pytest

from roadsight.placement.sensors.poses import Turn, local_from_sensor, tilt_rotation
from roadsight.placement.sensors.rays import NOT_CAST_M, spinning_raster
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.kinds import Box, Cylinder, room_for
from roadsight.placement.sight.posed import Panorama, weigh_by_height
from roadsight.placement.sight.sight import Sight, beams_wanted, count_beams

SHAPES = [Cylinder(0.25, 0.6), Cylinder(0.5, 1.0), Cylinder(0.3, 1.7), Box(4.5, 1.8, 1.5)]
WHOLE = Sensor(
    azimuth_step_deg=1, elevation_min_deg=-89, elevation_max_deg=89, channels=179, range_m=60
)
PART = Sensor(
    azimuth_min_deg=-200, azimuth_max_deg=-80, azimuth_step_deg=0.5,
    elevations_deg=(-40, -20, -15, -11, -7, -4, -3, -2, -1, 2), range_m=60,
    divergence_mrad=(3.0, 1.5), aperture_mm=10,
)  # fmt: skip


def scene(rng, sensor):
    """Ranges without any order: each beam matters."""
    return rng.choice([0.0, 3.0, 8.0, 20.0, 59.0], sensor.shape).astype(np.float32)


def feet(rng, place):
    """Targets around a place, one below it, one in it, one far away."""
    around = rng.uniform([-50, -50, -8, 0], [50, 50, -1, np.pi], (80, 4))
    special = [[0.05, 0.0, -5, 1], [0.1, 0.1, -0.3, 1], [180, 30, -5, 1], [-9, 1e-9, -5, 1]]
    return np.concatenate([around, special]) + np.array([*place, 0])


@pytest.mark.parametrize("sensor", [WHOLE, PART], ids=["whole", "part"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("slope", [None, (0.3, -0.2)])
@pytest.mark.parametrize("sight", [Sight(60.0), Sight(150.0, True, True)], ids=["plain", "wide"])
def test_counts_are_those_of_whole_maps(rng, sensor, shape, slope, sight):
    place, yaw_deg = np.array([3.0, -2.0, 5.0]), 37.0
    tilt = None if slope is None else tilt_rotation(np.array([*slope, 1.0]) / 1.06)
    targets = feet(rng, place)
    size_m = shape if isinstance(shape, Box) else (shape.radius_m, shape.height_m)
    targets = targets if isinstance(shape, Box) else targets[:, :3].copy()
    whole = scene(rng, sensor)
    wanted = beams_wanted(
        sensor, place, yaw_deg, targets, room_for(shape), tilt, curved=sight.curved
    )
    part = np.where(wanted, whole, np.float32(NOT_CAST_M))
    counts = [
        count_beams(ranges, sensor, place, yaw_deg, targets, size_m, sight, tilt)
        for ranges in (whole, part)
    ]
    assert counts[0].sum() > 0
    np.testing.assert_array_equal(*counts)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_panoramas_hold_what_poses_look_up(rng, shape):
    place = np.array([3.0, -2.0, 5.0])
    targets = feet(rng, place)
    targets = targets if isinstance(shape, Box) else targets[:, :3].copy()
    whole = scene(rng, WHOLE)
    wanted = beams_wanted(WHOLE, place, 0.0, targets, room_for(shape))
    part = np.where(wanted, whole, np.float32(NOT_CAST_M))
    raster = spinning_raster(PART)
    turned = local_from_sensor(20.0, Turn(70.0, 12.0, -3.0))
    seen = [
        weigh_by_height(
            Panorama(r, WHOLE, place, 0.0), raster, turned, targets, shape.packed, 60.0, None, 1
        )[:, 1]
        for r in (whole, part)
    ]
    assert seen[0].sum() > 0
    np.testing.assert_array_equal(*seen)


@pytest.mark.parametrize("away_m", [30.0, 80.0, 150.0])
def test_a_target_between_two_columns_of_a_panorama_is_found(rng, away_m):
    place = np.array([0.0, 0.0, 5.0])
    shape = Cylinder(0.25, 0.6)
    empty = np.zeros(WHOLE.shape, np.float32)
    narrow = Sensor(
        azimuth_step_deg=0.05, elevation_min_deg=-30, elevation_max_deg=0, channels=601, range_m=200
    )
    raster = spinning_raster(narrow)
    level = local_from_sensor(0.0, Turn(0.0, 0.0, 0.0))
    for azimuth in np.radians(np.linspace(10.0, 12.0, 21)):
        foot = np.array([[away_m * np.cos(azimuth), away_m * np.sin(azimuth), 0.0]])
        wanted = beams_wanted(WHOLE, place, 0.0, foot, room_for(shape))
        part = np.where(wanted, empty, np.float32(NOT_CAST_M))
        view = Panorama(part, WHOLE, place, 0.0)
        met, seen = weigh_by_height(view, raster, level, foot, shape.packed, 200.0, None, 1).T
        assert seen[0] == met[0] > 0


def test_what_would_need_a_beam_that_was_not_cast_is_unseen(rng):
    place = np.zeros(3)
    targets = feet(rng, place)[:, :3].copy()
    none = np.full(WHOLE.shape, NOT_CAST_M, np.float32)
    for sight in (Sight(60.0), Sight(60.0, True)):
        pose = (place, 0.0, targets)
        assert not count_beams(none, WHOLE, *pose, (0.25, 0.6), sight).any()


def test_a_road_beside_a_mast_takes_few_beams():
    across, along = np.meshgrid(np.arange(2, 12), np.arange(-40, 40))
    road = np.column_stack([across.ravel(), along.ravel(), np.zeros(across.size)]).astype(float)
    wanted = beams_wanted(WHOLE, [0.0, 0.0, 6.0], 0.0, road, room_for(Cylinder(0.25, 0.6)))
    assert 0.02 < wanted.mean() < 0.3
    assert not wanted[WHOLE.elevation_deg > 5].any()


def test_rooms_are_whole_steps_that_hold_the_shape():
    assert room_for(Cylinder(0.25, 0.6)) == room_for(Cylinder(0.5, 1.0)) == (0.5, 1.0)
    radius_m, height_m = room_for(Box(4.5, 1.8, 1.5))
    assert radius_m >= np.hypot(4.5, 1.8) / 2
    assert height_m >= 1.5
