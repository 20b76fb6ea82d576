import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.placement.depth.surfel_lidar import SurfelLidar, risen
from roadsight.placement.sensors.poses import road_normals, tilt_rotation
from roadsight.placement.sensors.rays import as_seen_from, beam_directions, returns_xyz_m
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.detection import count_hits
from roadsight.placement.sight.kinds import Cylinder
from roadsight.placement.sight.shapes import CLEAN_SHARE, beams_on, count_shared_hits, overlap
from roadsight.placement.sight.sight import Sight, count_beams
from roadsight.scene.surfels import Surfels

SENSOR = Sensor(
    azimuth_step_deg=0.5, elevation_min_deg=-25, elevation_max_deg=10, channels=71, range_m=100,
    divergence_mrad=(4.0, 2.0), aperture_mm=10,
)  # fmt: skip
NOTHING = np.zeros(SENSOR.shape, np.float32)
SIZE = (0.25, 0.6)
POST = Cylinder(*SIZE)


def plane_surfels(slope_x=0.0, size_m=60.0, step_m=0.5):
    """A plane z = slope_x x of surfels."""
    axis = np.arange(-size_m, size_m, step_m) + step_m / 2
    x, y = (part.ravel() for part in np.meshgrid(axis, axis))
    centre = np.column_stack([x, y, slope_x * x])
    normal = np.array([-slope_x, 0, 1]) / np.hypot(slope_x, 1)
    return Surfels(
        centre.astype(np.float32),
        np.tile(normal, (len(x), 1)).astype(np.float32),
        np.full((len(x), 2), step_m / 2, np.float32),
    )


def normals():
    lean = st.floats(-0.12, 0.12)
    return st.tuples(lean, lean).map(
        lambda g: np.array([-g[0], -g[1], 1]) / np.hypot(1, np.hypot(*g))
    )


class TestTilt:
    @given(normals())
    def test_rotation_takes_the_vertical_to_the_normal_and_no_further(self, normal):
        rotation = tilt_rotation(normal)
        np.testing.assert_allclose(rotation @ [0, 0, 1], normal, atol=1e-12)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        # The smallest such rotation turns by the angle between the two.
        assert np.trace(rotation) == pytest.approx(1 + 2 * normal[2])

    def test_normals_of_a_plane_and_of_unknown_ground(self):
        def ground(x, y):
            return np.where(x > 50, np.nan, 0.05 * x - 0.02 * y + 7)

        places = np.array([[0.0, 0.0], [10.0, -3.0], [44.0, 0.0]])
        found = road_normals(places, np.array([0.0, 90.0, 0.0]), ground)
        expected = np.array([-0.05, 0.02, 1]) / np.linalg.norm([-0.05, 0.02, 1])
        np.testing.assert_allclose(found[:2], [expected, expected], atol=1e-12)
        np.testing.assert_array_equal(found[2], [0, 0, 1])

    def test_a_sensor_normal_to_a_slope_sees_what_a_level_one_sees_of_level_ground(self):
        slope = 0.08
        normal = np.array([-slope, 0, 1]) / np.hypot(slope, 1)
        mount = tilt_rotation(normal)
        level = SurfelLidar(plane_surfels()).depth_map(SENSOR, (0, 0, 5), 0.0)
        tilted = SurfelLidar(plane_surfels(slope)).depth_map(SENSOR, 5 * normal, 0.0, mount)
        near = (level > 0) & (level < 40)
        np.testing.assert_allclose(tilted[near], level[near], rtol=2e-3)

    def test_returns_lie_on_the_slope(self):
        slope = 0.08
        mount = tilt_rotation(np.array([-slope, 0, 1]) / np.hypot(slope, 1))
        lidar = SurfelLidar(plane_surfels(slope))
        depth = lidar.depth_map(SENSOR, (0, 0, 5), 30.0, mount)
        xyz = returns_xyz_m(depth, SENSOR, (0, 0, 5), 30.0, mount)
        np.testing.assert_allclose(xyz[:, 2], slope * xyz[:, 0], atol=2e-3)

    def test_without_a_tilt_directions_are_those_of_a_level_mount(self):
        np.testing.assert_array_equal(
            beam_directions(SENSOR, 20.0), beam_directions(SENSOR, 20.0, np.eye(3))
        )

    def test_points_as_seen_from_a_tilted_sensor(self):
        normal = np.array([0.03, -0.05, 1]) / np.linalg.norm([0.03, -0.05, 1])
        mount, position = tilt_rotation(normal), np.array([3.0, 4.0, 6.0])
        xyz = np.random.default_rng(0).uniform(-20, 20, (50, 3))
        seen = as_seen_from(xyz, position, mount, curved=False)
        # Turning a levelled beam by the mount leads back to the point.
        np.testing.assert_allclose((seen - position) @ mount.T + position, xyz, atol=1e-12)
        assert as_seen_from(xyz, position, None, curved=False) is xyz


def slow_count(depth, directions, position, foot, max_range_m):
    """Beams on one cylinder, every beam tried, in plain arithmetic."""
    foot = np.asarray(foot) - position
    radius, height = SIZE
    d = directions.reshape(-1, 3).astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        caps = np.sort(np.stack([foot[2] / d[:, 2], (foot[2] + height) / d[:, 2]]), axis=0)
    a = (d[:, :2] ** 2).sum(axis=1)
    b = d[:, :2] @ foot[:2]
    root = np.sqrt(np.maximum(b**2 - a * (foot[:2] @ foot[:2] - radius**2), 0))
    crosses = b**2 - a * (foot[:2] @ foot[:2] - radius**2) >= 0
    enter = np.maximum(np.maximum((b - root) / a, caps[0]), 0)
    leave = np.minimum((b + root) / a, caps[1])
    scene = depth.ravel()
    hit = crosses & (enter < leave) & (enter > 0) & (enter < max_range_m)
    return int((hit & ((scene == 0) | (enter < scene))).sum())


class TestTiltedHits:
    @settings(max_examples=25, deadline=None)
    @given(normals(), st.floats(-180, 180), st.integers(0, 1000))
    def test_counts_equal_the_slow_reference(self, normal, yaw_deg, seed):
        rng = np.random.default_rng(seed)
        mount, position = tilt_rotation(normal), np.array([1.0, 2.0, 5.0])
        feet = rng.uniform(-1, 1, (6, 3)) * (30, 30, 1)
        depth = np.where(rng.random(SENSOR.shape) < 0.3, rng.uniform(3, 60, SENSOR.shape), 0)
        depth = depth.astype(np.float32)
        found = beams_on(depth, SENSOR, position, yaw_deg, mount, feet, POST, 100.0, False)[:, 0]
        directions = beam_directions(SENSOR, yaw_deg, mount)
        assert found.tolist() == [slow_count(depth, directions, position, f, 100.0) for f in feet]

    def test_a_level_mount_counts_as_the_plain_kernel(self):
        feet = np.random.default_rng(3).uniform(-1, 1, (200, 3)) * (60, 60, 1)
        plain = count_hits(NOTHING, SENSOR, (0, 0, 6), 10.0, feet, *SIZE)
        level = beams_on(NOTHING, SENSOR, (0, 0, 6), 10.0, np.eye(3), feet, POST, 100.0, False)[
            :, 0
        ]
        # Single precision of the directions may move a beam across a silhouette.
        assert np.abs(plain - level).max() <= 1
        assert (plain != level).mean() < 0.05

    def test_a_shorter_range_hides_what_is_farther(self):
        feet = np.array([[20.0, 0, 0], [40.0, 0, 0]])
        for tilt in (None, np.eye(3)):
            hits = count_beams(
                NOTHING, SENSOR, (0, 0, 5), 0.0, feet, SIZE, Sight(max_range_m=30), tilt
            )
            assert hits[0] > 0
            assert hits[1] == 0


class TestFootprints:
    @settings(deadline=None)
    @given(st.floats(-2, 2), st.floats(0.01, 3), st.floats(-1, 0), st.floats(0.1, 1))
    def test_overlap_is_a_share_of_samples(self, middle, width, low, high):
        samples = middle + width * (np.arange(4000) + 0.5) / 4000 - width / 2
        inside = ((samples >= low) & (samples <= high)).mean()
        assert overlap(middle, width, low, high) == pytest.approx(inside, abs=1e-3)

    def test_thin_beams_count_as_lines(self):
        thin = SENSOR.model_copy(update={"divergence_mrad": (1e-9, 1e-9), "aperture_mm": 0.0})
        feet = np.random.default_rng(5).uniform(-1, 1, (200, 3)) * (60, 60, 1)
        shares = count_shared_hits(NOTHING, thin, (0, 0, 6), 0.0, None, feet, *SIZE, 100.0)
        hits = count_hits(NOTHING, thin, (0, 0, 6), 0.0, feet, *SIZE)
        np.testing.assert_allclose(shares, hits, atol=1e-2)

    def test_a_row_across_a_target_has_the_closed_form(self):
        # One channel at the target's middle; beams every 0.02 deg, footprint w, target width 2 r.
        fine = Sensor(
            azimuth_step_deg=0.02, elevations_deg=(0.0,), range_m=100, divergence_mrad=(4.0, 1e-6)
        )
        foot = np.array([[50.0, 0.0, -0.3]])
        shares = count_shared_hits(
            np.zeros(fine.shape, np.float32), fine, (0, 0, 0), 0.0, None, foot, *SIZE, 100.0
        )
        width, spacing = 0.004 * 50, np.radians(0.02) * 50
        # Whole beams on 2 r - w; on w / 2 at each side shares fall from 1 to one half.
        expected = (2 * SIZE[0] - width + 2 * width / 2 * 0.75) / spacing
        assert shares[0] == pytest.approx(expected, rel=0.02)

    def test_beams_wider_than_twice_the_target_return_nothing_clean(self):
        wide = SENSOR.model_copy(update={"divergence_mrad": (25.0, 1.0)})
        foot = np.array([[50.0, 0.0, 4.7]])
        assert 2 * SIZE[0] / (0.025 * 50) < CLEAN_SHARE
        count = count_shared_hits(NOTHING, wide, (0, 0, 5), 0.0, None, foot, *SIZE, 100.0)
        assert count[0] == 0
        assert count_hits(NOTHING, wide, (0, 0, 5), 0.0, foot, *SIZE)[0] > 0

    def test_wide_beams_never_count_for_more(self):
        feet = np.random.default_rng(6).uniform(-1, 1, (300, 3)) * (60, 60, 1)
        shares = count_shared_hits(NOTHING, SENSOR, (0, 0, 6), 0.0, None, feet, *SIZE, 100.0)
        hits = count_hits(NOTHING, SENSOR, (0, 0, 6), 0.0, feet, *SIZE)
        assert (shares <= hits + 1e-9).all()
        assert shares.sum() < 0.95 * hits.sum()


class TestCurvedBeams:
    def test_risen_beams_meet_what_is_higher_by_the_closed_form(self):
        directions = np.array([[1.0, 0, 0], [0, 0, -1.0]], np.float32)
        straight = risen(directions, np.array([2000.0, 5.0], np.float32))
        # 0.87 (2 km)^2 / (2 x 6371 km)
        assert straight[0, 2] * 2000 == pytest.approx(0.2731, rel=1e-3)
        np.testing.assert_allclose(straight[1], directions[1])

    def test_far_targets_lie_deeper(self):
        sight = Sight(max_range_m=100, curved=True)
        feet = np.array([[30.0, 5.0, 0.0]])
        plain = count_hits(NOTHING, SENSOR, (0, 0, 5), 0.0, feet, *SIZE)
        curved = count_beams(NOTHING, SENSOR, (0, 0, 5), 0.0, feet, SIZE, sight)
        np.testing.assert_array_equal(plain, curved)
        assert feet[0, 2] == 0.0
