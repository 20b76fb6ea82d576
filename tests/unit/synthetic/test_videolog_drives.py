from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.geometry.cameras import attitude_deg, cam_from_world, wrap_deg
from roadsight.geometry.north import SiteNorth
from roadsight_worlds.rural.image_names import image_names
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.videolog import (
    GpsNoise,
    attitude_of,
    drifting,
    mounted,
    random_drives,
    shots,
    vehicle_rotation,
)
from roadsight_worlds.rural.videolog_tables import camera_table, videolog_table


@pytest.fixture(scope="module")
def site():
    return build_rural(5, 400.0, detail=0.01)


def test_gps_noise_has_the_stated_spread_and_memory():
    rng = np.random.default_rng(1)
    noise = GpsNoise(0.7, 100.0, 0.2)
    errors = np.array([noise.draw(8.0 * np.arange(126), rng) for _ in range(400)])
    assert errors.std() == pytest.approx(np.hypot(0.7, 0.2), rel=0.03)
    assert abs(errors.mean()) < 0.03
    later = (errors[:, 25:] * errors[:, :-25]).mean()  # 200 m on
    assert later == pytest.approx(0.49 * np.exp(-2.0), abs=0.03)
    step = np.diff(errors, axis=1).std()
    wanted = np.sqrt(2 * 0.49 * (1 - np.exp(-0.08)) + 2 * 0.04)
    assert step == pytest.approx(wanted, rel=0.03)


@settings(max_examples=50, deadline=None)
@given(st.floats(0, 360), st.floats(-10, 10), st.floats(-10, 10), st.floats(-60, 60))
def test_a_camera_turned_about_the_vertical_of_another(heading, pitch, roll, yaw):
    base = cam_from_world(heading, pitch, roll)
    np.testing.assert_allclose(mounted(base, 0.0, 0.0, 0.0), base, atol=1e-12)
    side = mounted(base, yaw, 0.0, 0.0)
    np.testing.assert_allclose(side[1], base[1], atol=1e-12)  # they share down
    np.testing.assert_allclose(side @ side.T, np.eye(3), atol=1e-12)
    level = mounted(cam_from_world(heading, 0.0, 0.0), yaw, pitch, roll)
    got = attitude_deg(level)
    assert wrap_deg(got[0] - heading - yaw) == pytest.approx(0.0, abs=1e-9)
    assert got[1:] == pytest.approx((pitch, roll), abs=1e-9)


def test_vehicle_leans_with_the_road(site):
    for forward, way in ((True, 1.0), (False, -1.0)):
        heading, pitch, roll = attitude_deg(vehicle_rotation(site, forward, 100.0, -way * 1.6, 0.0))
        turn = 90.0 - np.degrees(site.line.heading(100.0)) + (0.0 if forward else 180.0)
        assert wrap_deg(heading - turn) == pytest.approx(0.0, abs=1e-6)
        assert pitch == pytest.approx(way * np.degrees(np.arctan(site.line.grade(100.0))), abs=0.02)
        assert roll == pytest.approx(-np.degrees(np.arctan(0.02)), abs=0.01)  # right side down


def test_places_follow_the_lane_at_even_steps(site):
    for drive in random_drives(5):
        places = shots(site, drive, 5)
        assert len(places) == int(400.0 / drive.step_m) + 1
        assert [p.sequence for p in places] == list(range(1, len(places) + 1))
        xyz = np.array([p.cameras["front"].position_m for p in places])
        station, offset = site.line.road(xyz[:, :2]).T
        way = 1.0 if drive.forward else -1.0
        np.testing.assert_allclose(np.diff(station), way * drive.step_m, atol=1e-3)
        assert ((-way * offset > 1.2) & (-way * offset < 2.0)).all()
        above = xyz[:, 2] - site.ground.height(station, offset)
        assert above.mean() == pytest.approx(drive.mount.height_m, abs=0.02)
        assert 0.005 < above.std() < 0.04


def test_the_mount_shows_against_the_track(site):
    drive = random_drives(5)[0]
    places = shots(site, drive, 5)
    xy = np.array([p.cameras["front"].position_m[:2] for p in places])
    track = np.degrees(np.arctan2(*(xy[2:] - xy[:-2]).T))
    heading = np.array([attitude_of(p.cameras["front"])[0] for p in places[1:-1]])
    yaw = wrap_deg(heading - track)
    assert yaw.mean() == pytest.approx(drive.mount.yaw_deg, abs=0.2)
    assert 0.15 < yaw.std() < 0.6
    for view, turn in drive.views.items():
        front, side = (p.cameras[v].rotation[2] for p in places[:1] for v in ("front", view))
        assert np.degrees(np.arccos(min(front @ side, 1.0))) == pytest.approx(abs(turn), abs=1e-6)
    assert 0.0 < drive.intrinsics.hfov_deg - drive.views["right"] < 3.0


def test_the_table_is_what_a_videolog_gives(site):
    drives = random_drives(5)
    places = [p for d in drives for p in shots(site, d, 5)]
    table = videolog_table(site, places)
    assert table["image"].is_unique and not table.isna().any().any()
    assert (table.loc[table["route"] == drives[1].route, "left_image"] == "").all()
    gps = SiteNorth(site.frame()).to_local(table["latitude"], table["longitude"])
    np.testing.assert_allclose(gps, [p.gps_xy_m for p in places], atol=1e-3)
    true = np.array([p.cameras["front"].position_m[:2] for p in places])
    assert 0.3 < np.hypot(*(gps - true).T).mean() < 3.0


def test_the_truth_table_agrees_with_itself(site):
    places = shots(site, random_drives(5)[0], 5)
    table = camera_table(site, places)
    assert len(table) == 3 * len(places) and table["image"].is_unique
    angles = table[["heading_grid_deg", "pitch_deg", "roll_deg"]].to_numpy().T
    names = [f"cam_from_world_r{i}{j}" for i in range(3) for j in range(3)]
    np.testing.assert_allclose(
        cam_from_world(*angles).reshape(-1, 9), table[names].to_numpy(), atol=1e-9
    )
    native = table[["easting_usft", "northing_usft", "height_usft"]].to_numpy()
    local = table[["x_m", "y_m", "z_m"]].to_numpy()
    np.testing.assert_allclose(site.frame().to_local(native), local, atol=1e-6)
    turn = wrap_deg(table["heading_true_deg"] - table["heading_grid_deg"])
    assert (np.abs(turn + 2.4) < 0.05).all()  # convergence at 83.16 degrees west


def test_drives_repeat_and_differ_by_seed(site):
    assert random_drives(5) == random_drives(5) != random_drives(6)
    one, two = (shots(site, random_drives(5)[0], 5) for _ in range(2))
    np.testing.assert_array_equal(one[7].gps_xy_m, two[7].gps_xy_m)
    np.testing.assert_array_equal(one[7].cameras["left"].rotation, two[7].cameras["left"].rotation)


def test_unkind_drives_differ_in_what_they_say_alone(site):
    kind, unkind = (
        random_drives(5, principal_point_px=px, gps=gps)
        for px, gps in ((0.0, None), (15.0, drifting(3.0)))
    )
    for one, other in zip(kind, unkind, strict=True):
        assert other.intrinsics.cx_px - one.intrinsics.cx_px == 15.0
        assert other.intrinsics.cy_px - one.intrinsics.cy_px == 15.0
        assert other.intrinsics.focal_px == one.intrinsics.focal_px
        assert other.mount == one.mount
        true, stated = (
            np.array([shot.gps_xy_m - shot.cameras["front"].position_m[:2] for shot in places])
            for places in (shots(site, one, 5), shots(site, other, 5))
        )
        assert np.abs(true - stated).max() > 0.5


def test_a_drift_stays_within_its_bound_for_19_of_20_places():
    rng = np.random.default_rng(2)
    gps = replace(drifting(3.0), white_sigma_m=0.0)
    errors = np.array([gps.draw(8.0 * np.arange(126), rng) for _ in range(400)])
    assert (np.abs(errors) < 3.0).mean() == pytest.approx(0.954, abs=0.02)


@pytest.mark.parametrize("every", [1, 3])
def test_names_of_images_are_known_before_they_are_taken(site, every):
    taken = [[shot.name() for shot in shots(site, drive, 5)] for drive in random_drives(5)]
    assert image_names(site.length_m, every) == [name for one in taken for name in one[::every]]
