import numpy as np
import pytest

from roadsight.evidence.exact_highway import ExactHighway, sees_in_pose, share_wrong
from roadsight.geometry.frames import Frame
from roadsight.placement.sensors.sensors import Camera, Sensor
from roadsight.stages.evidence.measure_precision import (
    largest_error_m,
    normal_error_deg,
    normals_of,
    stored,
)
from roadsight_worlds.casting.terrain import height_at
from roadsight_worlds.highway.highway import build_highway

SENSOR = Sensor(azimuth_step_deg=10, elevations_deg=(-60, -30, -5), range_m=40)


@pytest.fixture(scope="module")
def own() -> Frame:
    return build_highway(1, 60.0).frame()


@pytest.fixture(scope="module")
def exact(own: Frame) -> ExactHighway:
    return ExactHighway(build_highway(1, 60.0), own)


def above_the_road(exact: ExactHighway) -> np.ndarray:
    xy_m, height_m = exact.road_heights(1.0)
    middle = len(xy_m) // 3
    return np.array([*xy_m[middle], height_m[middle] + 5.0])


def test_heights_are_those_of_the_road(exact: ExactHighway) -> None:
    highway = build_highway(1, 60.0)
    xy_m, height_m = exact.road_heights(2.0)
    classes, surface_m = highway.ground_classes(xy_m), height_at(highway.terrain, xy_m)
    assert height_m == pytest.approx(surface_m)
    assert len(set(classes)) == 1


def test_another_local_origin_changes_nothing_but_the_numbers(own: Frame, exact) -> None:
    moved_by = np.array([120.0, -40.0, 7.0])
    frame = Frame(tuple(np.array(own.origin) + moved_by), crs_wkt=own.crs_wkt)
    moved = ExactHighway(build_highway(1, 60.0), frame)
    place = above_the_road(exact)
    there = moved.depth_map(SENSOR, place - moved_by, 30.0)
    assert there == pytest.approx(exact.depth_map(SENSOR, place, 30.0), abs=1e-4)
    assert moved.road_heights(5.0)[0] == pytest.approx(exact.road_heights(5.0)[0] - moved_by[:2])


def test_beams_down_to_the_road_have_the_length_of_the_slope(exact: ExactHighway) -> None:
    down = Sensor(azimuth_step_deg=90, elevations_deg=(-90.0, -89.9), range_m=40)
    range_m = exact.depth_map(down, above_the_road(exact), 0.0)
    assert range_m[0] == pytest.approx(5.0, abs=0.02)


def test_share_wrong_counts_ranges_and_missing_returns(exact: ExactHighway) -> None:
    place = above_the_road(exact)
    truth = exact.depth_map(SENSOR, place, 0.0)
    assert share_wrong(truth, truth) == 0.0
    seen = np.flatnonzero(truth.ravel())
    spoilt = truth.ravel().copy()
    spoilt[seen[0]] += 0.6
    spoilt[seen[1]] = 0.0
    spoilt[seen[2]] += 0.4
    found = share_wrong(spoilt.reshape(truth.shape), truth)
    assert found == pytest.approx(2 / truth.size)


def test_a_target_on_the_road_is_seen_from_above_and_not_from_below(exact: ExactHighway) -> None:
    fine = Sensor(
        azimuth_step_deg=0.5, elevation_min_deg=-80, elevation_max_deg=10, channels=90, range_m=60
    )
    place = above_the_road(exact)
    foot = place + np.array([4.0, 0.0, -5.0])
    assert exact.sees(fine, place, 0.0, foot[None]).tolist() == [True]
    assert exact.sees(fine, place - np.array([0, 0, 9.0]), 0.0, foot[None]).tolist() == [False]


ORIGIN = np.array([668_000.0, 3_547_000.0, 20.0])


def test_single_precision_of_the_world_loses_what_local_keeps(rng: np.random.Generator) -> None:
    local = rng.uniform(0, 3, (3000, 3)) * [1, 1, 0.01]
    native = ORIGIN + local
    world, near = (largest_error_m(native, o, single=True) for o in (np.zeros(3), ORIGIN))
    assert world > 0.1
    assert near < 1e-5
    assert largest_error_m(native, ORIGIN, single=False) < 1e-9
    assert stored(native, ORIGIN, single=False) == pytest.approx(local, abs=1e-6)
    exact = normals_of(local, 10)
    assert normal_error_deg(normals_of(stored(native, ORIGIN, True), 10), exact) < 0.1
    assert normal_error_deg(normals_of(stored(native, np.zeros(3), True), 10), exact) > 1.0


def test_a_lost_normal_is_ninety_degrees_off() -> None:
    up = np.tile([0.0, 0.0, 1.0], (4, 1))
    assert normal_error_deg(np.full((4, 3), np.nan), up) == pytest.approx(90.0)
    assert normal_error_deg(-up, up) == pytest.approx(0.0)


def test_a_pose_as_mounted_sees_what_the_sensor_sees_and_a_camera_only_ahead(exact) -> None:
    place = above_the_road(exact)
    xy_m, height_m = exact.road_heights(3.0)
    feet = np.column_stack([xy_m, height_m])
    lidar = Sensor(
        azimuth_step_deg=0.5, elevation_min_deg=-40, elevation_max_deg=5, channels=91, range_m=60
    )
    entry = dict(zip("xyz", place, strict=True)) | {
        "yaw_deg": 20.0,
        "pitch_deg": 0.0,
        "roll_deg": 0.0,
    }
    plain = exact.sees(lidar, place, 20.0, feet)
    assert 0.1 < plain.mean() < 0.9
    assert (sees_in_pose(exact, lidar, entry, feet) != plain).mean() < 0.02
    camera = Camera(
        kind="camera", columns_px=800, rows_px=600, hfov_deg=60, min_pixels=30, range_m=60
    )
    ahead = sees_in_pose(exact, camera, entry | {"pitch_deg": -20.0}, feet)
    axis = np.array([np.cos(np.radians(20)), np.sin(np.radians(20))])
    assert ahead.any()
    assert ((feet[ahead, :2] - place[:2]) @ axis > 0).all()
