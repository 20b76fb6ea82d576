import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.placement.sensors.light import contrast_range_m
from roadsight.placement.sensors.poses import AS_MOUNTED, Turn, local_from_sensor
from roadsight.placement.sensors.rays import beam_directions, rosette_raster
from roadsight.placement.sensors.sensors import Camera, Radar, Rosette, Sensor
from roadsight.placement.sight.detection import count_hits
from roadsight.placement.sight.detectors import Criteria, detector_of
from roadsight.placement.sight.kinds import Cylinder
from roadsight.placement.sight.posed import Panorama, scene_range_m
from roadsight.placement.sight.shapes import count_shared_hits
from roadsight.placement.sight.sight import Sight
from roadsight.stages.placement.render_scans import rosette_directions
from tests.helpers.analytic_scene import HEIGHT_M, RADIUS_M, Trace, panorama_of, scene_ranges

ORIGIN = np.array([1.0, -2.0, 6.0])
BOXES = (
    (np.array([12.0, -1.0, 0.0]), np.array([13.0, 4.0, 4.5])),
    (np.array([6.0, 4.0, 0.0]), np.array([16.0, 4.5, 1.0])),
)
SHAPE = Cylinder(RADIUS_M, HEIGHT_M)
CAMERA = Camera(kind="camera", columns_px=320, rows_px=240, hfov_deg=60, min_pixels=8, range_m=90)
ROSETTE = Rosette(kind="rosette", field_deg=70.4, points_per_s=2e5, frame_s=0.5, range_m=120)
AVIA = Rosette(
    kind="rosette", field_deg=60, lasers=6, lasers_span_deg=6, points_per_s=2e5, frame_s=0.5,
    range_m=120,
)  # fmt: skip
RADAR = Radar(
    kind="radar",
    zones=[
        {"half_angle_deg": 15, "range_m": 160, "resolution_deg": 2.0},
        {"half_angle_deg": 50, "range_m": 60, "resolution_deg": 5.0},
    ],
    elevation_min_deg=-25,
)
SPINNING = Sensor(
    azimuth_step_deg=0.4, elevation_min_deg=-30, elevation_max_deg=10, channels=81, range_m=100,
    divergence_mrad=(4.0, 2.0), aperture_mm=10,
)  # fmt: skip
CRITERIA = Criteria(min_beams=8, rcs_m2=0.16)
POSE = st.tuples(
    st.floats(-170, 170), st.builds(Turn, st.floats(-60, 60), st.floats(-35, 5), st.floats(-30, 30))
)


def feet_before(rng, rotation, count=12):
    """Feet on the plane, most of them where the sensor looks."""
    ahead = rotation[:2, 0] / max(np.hypot(*rotation[:2, 0]), 1e-6)
    along, beside = rng.uniform(3, 45, count), rng.uniform(-15, 15, count)
    xy = ORIGIN[:2] + along[:, None] * ahead + beside[:, None] * np.array([-ahead[1], ahead[0]])
    return np.column_stack([xy, np.zeros(count)])


def measured(sensor, panorama, rotation, feet, sight=None):
    found = detector_of(sensor, CRITERIA).measure(
        panorama, rotation, feet, SHAPE, sight or Sight(sensor.range_m)
    )
    return np.asarray(found)


def camera_directions(camera, rotation):
    """Every pixel's direction in the local frame, written out."""
    focal = camera.columns_px / 2 / np.tan(np.radians(camera.hfov_deg / 2))
    right, down = np.meshgrid(
        np.arange(camera.columns_px) + 0.5 - camera.columns_px / 2,
        np.arange(camera.rows_px) + 0.5 - camera.rows_px / 2,
    )
    rays = np.stack([np.full(right.shape, focal), -right, -down], axis=-1).reshape(-1, 3)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True) @ rotation.T


class TestCamera:
    @settings(max_examples=10, deadline=None)
    @given(POSE, st.integers(0, 999))
    def test_pixels_equal_a_trace_of_every_pixel(self, pose, seed):
        rotation = local_from_sensor(*pose)
        feet = feet_before(np.random.default_rng(seed), rotation)
        found = measured(CAMERA, panorama_of(ORIGIN, step_deg=0.5), rotation, feet)
        trace = Trace(ORIGIN, camera_directions(CAMERA, rotation), (), CAMERA.range_m)
        expected = [trace.sees(foot).sum() for foot in feet]
        small = np.asarray(expected) < 200  # larger ones are sampled
        np.testing.assert_allclose(found[small], np.asarray(expected)[small], atol=1.01)
        np.testing.assert_allclose(found, expected, rtol=0.12, atol=1.01)

    def test_occlusion_by_the_scene_equals_the_trace_but_for_borders(self):
        rotation = local_from_sensor(0.0, Turn(10, -15, 5))
        rng = np.random.default_rng(4)
        feet = np.column_stack([rng.uniform(5, 40, 200), rng.uniform(-8, 12, 200), np.zeros(200)])
        for low, high in BOXES:
            inside = (feet[:, :2] > low[:2] - 0.3) & (feet[:, :2] < high[:2] + 0.3)
            feet = feet[~inside.all(axis=1)]
        found = measured(CAMERA, panorama_of(ORIGIN, BOXES, step_deg=0.1), rotation, feet)
        trace = Trace(ORIGIN, camera_directions(CAMERA, rotation), BOXES, CAMERA.range_m)
        expected = np.array([trace.sees(foot).sum() for foot in feet])
        everything = np.array([trace.meets(foot).sum() for foot in feet])
        assert (expected == 0)[everything > 0].sum() > 20  # some are hidden
        assert ((expected > 0) & (expected < everything)).sum() > 2  # some are half hidden
        assert np.abs(found - expected).sum() < 0.03 * everything.sum()
        seen, truly = found >= CAMERA.min_pixels, expected >= CAMERA.min_pixels
        assert (seen != truly).mean() < 0.02

    def test_nothing_outside_the_field_of_view_or_the_range(self):
        rotation = local_from_sensor(0.0, AS_MOUNTED)
        feet = np.array([[-20.0, -2, 4], [1.0, 20, 4], [101.0, -2, 6], [41.0, -2, 5.7]])
        found = measured(CAMERA, panorama_of(ORIGIN), rotation, feet)
        assert found[:3].tolist() == [0, 0, 0]
        assert found[3] > 0

    def test_fog_takes_contrast(self):
        assert contrast_range_m(3.912 / 200) == pytest.approx(200)
        assert contrast_range_m(0.0) == np.inf


class TestSpinning:
    @settings(max_examples=10, deadline=None)
    @given(POSE, st.integers(0, 999))
    def test_beams_of_a_turned_sensor_equal_a_trace_of_every_beam(self, pose, seed):
        rotation = local_from_sensor(*pose)
        feet = feet_before(np.random.default_rng(seed), rotation)
        found = measured(SPINNING, panorama_of(ORIGIN, step_deg=0.5), rotation, feet)
        rays = beam_directions(SPINNING, 0.0).reshape(-1, 3).astype(np.float64) @ rotation.T
        trace = Trace(ORIGIN, rays, (), SPINNING.range_m)
        expected = [trace.sees(foot).sum() for foot in feet]
        np.testing.assert_allclose(found, expected, atol=1.01)

    def test_as_mounted_it_counts_as_its_own_depth_map_does(self):
        rng = np.random.default_rng(2)
        depth = np.where(rng.random(SPINNING.shape) < 0.3, rng.uniform(3, 60, SPINNING.shape), 0)
        feet = rng.uniform(-1, 1, (200, 3)) * (50, 50, 0.3)
        # Its own beams as the panorama, so that nothing is between them.
        own = Panorama(depth.astype(np.float32), SPINNING, ORIGIN, 25.0)
        rotation = local_from_sensor(25.0, AS_MOUNTED)
        lines = measured(SPINNING, own, rotation, feet)
        plain = count_hits(own.range_m, SPINNING, ORIGIN, 25.0, feet, RADIUS_M, HEIGHT_M)
        assert np.abs(lines - plain).sum() <= 0.02 * plain.sum()
        wide = measured(SPINNING, own, rotation, feet, Sight(100.0, footprints=True))
        shares = count_shared_hits(
            own.range_m, SPINNING, ORIGIN, 25.0, None, feet, RADIUS_M, HEIGHT_M, 100.0
        )
        assert np.abs(wide - shares).sum() <= 0.02 * shares.sum()
        assert wide.sum() < lines.sum()


class TestRosette:
    @pytest.mark.parametrize("sensor", [ROSETTE, AVIA], ids=["one laser", "six lasers"])
    def test_expected_points_are_the_mean_of_traced_frames_of_any_phase(self, sensor):
        rotation = local_from_sensor(0.0, Turn(5, -15, 20))
        rng = np.random.default_rng(1)
        feet = np.column_stack([rng.uniform(6, 40, 40), rng.uniform(-10, 6, 40), np.zeros(40)])
        found = measured(sensor, panorama_of(ORIGIN, BOXES, step_deg=0.1), rotation, feet)
        frames = [
            Trace(ORIGIN, rosette_directions(sensor, phases) @ rotation.T, BOXES, sensor.range_m)
            for phases in rng.uniform(0, 2 * np.pi, (6, 2))
        ]
        counts = np.array([[frame.sees(foot).sum() for foot in feet] for frame in frames])
        expected = counts.mean(axis=0)
        assert (expected > 20).sum() > 10
        assert found.sum() == pytest.approx(expected.sum(), rel=0.02)
        np.testing.assert_allclose(found, expected, rtol=0.1, atol=5)

    def test_all_points_of_a_frame_are_in_its_raster_and_density_is_that_of_the_pattern(self):
        raster = rosette_raster(ROSETTE)
        assert raster.weight.sum() == pytest.approx(ROSETTE.points)
        rays = rosette_directions(ROSETTE, (0.3, 1.7))
        angle = np.degrees(np.arccos(rays[:, 0]))
        assert angle.max() <= ROSETTE.field_deg / 2 + 1e-6
        radius = np.hypot(*np.meshgrid(raster.u, raster.v))
        for limit in (3.0, 10.0, 20.0, 30.0, 34.0):
            share = raster.weight[radius < limit].sum() / ROSETTE.points
            assert share == pytest.approx((angle < limit).mean(), abs=0.01)

    def test_twice_the_time_gathers_twice_the_points(self):
        rotation, feet = local_from_sensor(0.0, AS_MOUNTED), np.array([[16.0, -2, 5.8]])
        longer = ROSETTE.model_copy(update={"frame_s": 1.0})
        once, twice = (
            measured(sensor, panorama_of(ORIGIN), rotation, feet) for sensor in (ROSETTE, longer)
        )
        assert twice == pytest.approx(2 * once)


class TestRadar:
    def test_the_radar_equation_gives_the_range_of_a_free_target(self):
        # On the axis: 160 m (0.16 / 10)^(1/4) = 56.9 m.
        reach = 160 * (0.16 / 10) ** 0.25
        for distance, expected in ((reach - 0.5, True), (reach + 0.5, False)):
            feet = np.array([[ORIGIN[0] + distance, ORIGIN[1], ORIGIN[2] - 0.3]])
            echo = measured(RADAR, panorama_of(ORIGIN), np.eye(3), feet)
            assert bool(detector_of(RADAR, CRITERIA).sees(echo)[0]) is expected
            assert echo[0] == pytest.approx((reach / distance) ** 4, rel=1e-2) or not expected

    def test_every_target_equals_a_trace_of_fine_rays(self):
        rotation = local_from_sensor(0.0, Turn(0, -5, 0))
        rng = np.random.default_rng(8)
        feet = np.column_stack([rng.uniform(8, 70, 60), rng.uniform(-25, 25, 60), np.zeros(60)])
        found = measured(RADAR, panorama_of(ORIGIN, BOXES, step_deg=0.1), rotation, feet)
        for foot, echo in zip(feet, found, strict=True):
            assert echo == pytest.approx(_slow_echo(foot, rotation), rel=0.15, abs=0.02)

    def test_a_cell_wider_than_a_lane_does_not_count(self):
        narrow = RADAR.model_copy(update={"widest_cell_m": 0.5})
        feet = np.array([[ORIGIN[0] + 20, ORIGIN[1], 5.7], [ORIGIN[0] + 10, ORIGIN[1], 5.7]])
        echo = measured(narrow, panorama_of(ORIGIN), np.eye(3), feet)
        assert echo[0] == 0  # 20 m x 2 degrees = 0.7 m
        assert echo[1] > 1


def _slow_echo(foot, rotation):
    """The echo of one target, from rays every 0.05 degrees through it."""
    middle = foot + np.array([0, 0, HEIGHT_M / 2]) - ORIGIN
    range_m = np.linalg.norm(middle)
    azimuth, elevation = np.arctan2(middle[1], middle[0]), np.arcsin(middle[2] / range_m)
    spread = np.radians(np.arange(-4, 4, 0.05))
    a, e = (part.ravel() for part in np.meshgrid(azimuth + spread, elevation + spread))
    rays = np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    in_sensor = rays @ rotation
    up = np.degrees(np.arcsin(in_sensor[:, 2]))
    side = np.degrees(np.abs(np.arctan2(in_sensor[:, 1], in_sensor[:, 0])))
    rays = rays[(up > -25) & (up < 10) & (side < 50)]
    trace = Trace(ORIGIN, rays, BOXES, np.inf)
    seen, met = trace.sees(foot), trace.meets(foot)
    if not met.any():
        return 0.0
    ahead, left, _ = middle @ rotation
    angle = np.degrees(abs(np.arctan2(left, ahead)))
    reach = max(
        (
            zone.range_m
            for zone in RADAR.zones
            if angle <= zone.half_angle_deg and range_m * np.radians(zone.resolution_deg) <= 3.5
        ),
        default=0.0,
    )
    echo = (reach / range_m) ** 4 * 0.16 / 10 * seen.sum() / met.sum()
    farthest = 160 * (0.16 / 10) ** 0.25
    return echo if range_m < farthest else 0.0


def test_the_panorama_between_its_beams_is_the_plane():
    panorama = panorama_of(ORIGIN, step_deg=1.0)
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(500, 3))
    rays[:, 2] = -np.abs(rays[:, 2]) - 0.05
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    exact = scene_ranges(ORIGIN, rays, ())
    near = exact < 60
    slopes = np.tan(np.radians(panorama.sensor.elevation_deg))
    found = [scene_range_m(panorama.range_m, slopes, -np.pi, tuple(ray)) for ray in rays[near]]
    np.testing.assert_allclose(found, exact[near], rtol=2e-3)
