import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.placement.sensors.sensors import (
    Camera,
    Radar,
    Rosette,
    Sensor,
    load_sensor,
    load_sensors,
    panorama_name,
    what_it_sees,
)

CAMERA = "kind: camera, range_m: 9, columns_px: 640, rows_px: 480, min_pixels: 20"
ROSETTE = "kind: rosette, range_m: 9, field_deg: 40, points_per_s: 1000"
ZONE = "{half_angle_deg: 9, range_m: 90, resolution_deg: 1}"


def write(tmp_path, text):
    path = tmp_path / "sensors.yaml"
    path.write_text(text)
    return path


def test_published_sensors_match_table_5(project):
    sensors = load_sensors(project / "config" / "sensors.yaml")
    table = {
        "table5-VLP-16": (16, -15, 15, 2.0, 100),
        "table5-Puck-32C": (32, -25, 15, 1.29, 200),
        "table5-OS-32": (32, -22.5, 22.5, 1.45, 120),
        "table5-OS-64": (64, -22.5, 22.5, 0.72, 120),
        "table5-OS-128": (128, -22.5, 22.5, 0.35, 120),
    }
    for name, (channels, low, high, step, range_m) in table.items():
        sensor = sensors[name]
        assert sensor.shape == (channels, 3600)
        assert (sensor.elevation_deg[0], sensor.elevation_deg[-1]) == (low, high)
        assert np.diff(sensor.elevation_deg) == pytest.approx(step, abs=0.01)
        assert (sensor.range_m, sensor.cost) == (range_m, 1.0)


def test_real_channel_table_is_dense_around_the_horizon(project):
    sensor = load_sensor(project / "config" / "sensors.yaml", "VLP-32C")
    steps = np.diff(sensor.elevation_deg)
    assert sensor.rows == 32
    assert steps.min() == pytest.approx(1 / 3, abs=0.001)
    assert steps.max() == pytest.approx(9.361)
    assert np.sum(np.abs(sensor.elevation_deg) < 4.1) >= 20


@pytest.mark.parametrize(
    ("name", "columns", "turns_hz", "points_per_s"),
    [
        ("VLP-16", 1800, 10, 300_000), ("VLP-32C", 1800, 10, 600_000),
        ("OS1-32", 2048, 10, 655_360), ("OS1-64", 2048, 10, 1_310_720),
        ("OS1-128", 2048, 10, 2_621_440), ("OS1-128-1024x20", 1024, 20, 2_621_440),
        ("OS1-64-512x20", 512, 20, 1_310_720),
    ],
)  # fmt: skip
def test_products_send_no_more_points_than_they_can(project, name, columns, turns_hz, points_per_s):
    sensor = load_sensors(project / "config/sensors.yaml")[name]
    assert (sensor.columns, sensor.rotation_hz) == (columns, turns_hz)
    assert sensor.points_per_s == points_per_s
    assert sensor.rows * sensor.columns * sensor.rotation_hz <= points_per_s
    assert sensor.source
    assert 0 < sensor.range_min_m < (sensor.range_10_m or sensor.range_m) <= sensor.range_m


def test_old_names_are_those_of_table_5(project):
    sensors = load_sensors(project / "config/sensors.yaml")
    for name in ("Puck-32C", "OS-32", "OS-64", "OS-128"):
        assert sensors[name] == sensors[f"table5-{name}"]


def test_a_product_with_more_points_than_it_sends_is_refused(tmp_path):
    product = "{range_m: 120, elevation_min_deg: -22.5, elevation_max_deg: 22.5, channels: 128"
    path = write(tmp_path, f"sensors: {{A: {product}, rotation_hz: 10, points_per_s: 2621440}}}}")
    with pytest.raises(InputError, match=r"sensor A.*4,608,000 points a second, more than the 2,6"):
        load_sensors(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("A: {like: B}", "like: no such sensor"),
        ("A: {like: B}, B: {like: A}", "like: a circle"),
        (
            "A: {range_m: 9, elevations_deg: [1], azimuth_step_deg: 1, columns_per_turn: 9}",
            "not both",
        ),
        ("A: {range_m: 9, range_min_m: 9, elevations_deg: [1]}", "range_min_m"),
    ],
)
def test_wrong_products_end_in_one_message(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        load_sensors(write(tmp_path, f"sensors: {{{text}}}"))


def test_a_sensor_like_another_may_say_the_same_in_another_way(tmp_path):
    base = (
        "A: {range_m: 9, azimuth_step_deg: 1, elevation_min_deg: 0, elevation_max_deg: 1,"
        " channels: 2}"
    )
    path = write(
        tmp_path, f"sensors: {{{base}, B: {{like: A, columns_per_turn: 90, elevations_deg: [5]}}}}"
    )
    assert load_sensors(path)["B"].shape == (1, 90)


def test_a_price_changes_nothing_that_is_seen():
    cheap, dear = (Sensor(elevations_deg=(0, 1), range_m=50, cost=cost) for cost in (1, 2))
    assert what_it_sees(cheap) == what_it_sees(dear)
    assert what_it_sees(cheap) != what_it_sees(Sensor(elevations_deg=(0, 1), range_m=51))


def test_beams_run_through_the_centres_of_their_cells():
    sensor = Sensor(azimuth_step_deg=90, elevations_deg=(-10, 0, 20), range_m=50)
    assert sensor.azimuth_deg.tolist() == [-135, -45, 45, 135]
    assert sensor.elevation_edges_deg.tolist() == [-15, -5, 10, 30]


def test_a_single_channel_has_a_square_cell():
    sensor = Sensor(azimuth_step_deg=2, elevations_deg=(5,), range_m=50)
    assert sensor.elevation_edges_deg.tolist() == [4, 6]
    same = Sensor(
        azimuth_step_deg=2, elevation_min_deg=0, elevation_max_deg=10, channels=1, range_m=50
    )
    assert same.elevation_deg.tolist() == [5]


def test_equal_definitions_are_equal_dictionaries():
    first = Sensor(elevations_deg=(0, 1), range_m=50)
    assert first.to_dict() == Sensor(elevations_deg=(0.0, 1.0), range_m=50.0).to_dict()
    assert Sensor(**first.to_dict()) == first


@pytest.mark.parametrize(
    ("definition", "message"),
    [
        ("range_m: 9, elevations_deg: [1], chanels: 3", "did you mean 'channels'"),
        ("range_m: 9, elevations_deg: [2, 1]", "must increase"),
        ("range_m: 9, elevations_deg: [1, 1]", "must increase"),
        ("range_m: 9, elevations_deg: []", "must increase"),
        ("range_m: 9, elevations_deg: [91]", "less than or equal to 90"),
        ("range_m: 9, elevations_deg: [.nan]", "elevations_deg"),
        ("range_m: 9, elevation_min_deg: 9, elevation_max_deg: 1, channels: 4", "must increase"),
        ("range_m: 9, elevation_min_deg: 9", "channels need elevations_deg"),
        ("range_m: 9, elevations_deg: [1], channels: 1", "excludes"),
        ("range_m: 9, elevations_deg: [1], azimuth_step_deg: 0", "greater than 0"),
        ("range_m: 9, elevations_deg: [1], azimuth_step_deg: 0.7", "must divide"),
        ("range_m: 9, elevations_deg: [1], azimuth_step_deg: 400", "must divide"),
        (
            "range_m: 9, elevations_deg: [1], azimuth_min_deg: 10, azimuth_max_deg: -10",
            "must be below",
        ),
        (
            "range_m: 9, elevations_deg: [1], azimuth_min_deg: -200, azimuth_max_deg: 200",
            "360 deg apart",
        ),
        ("range_m: 9, elevations_deg: [1], azimuth_step_deg: 0.00001", "beams are more than"),
        ("range_m: -9, elevations_deg: [1]", "greater than 0"),
        ("range_m: .inf, elevations_deg: [1]", "5000"),
        ("elevations_deg: [1]", "'range_m' is missing"),
        ("range_m: 9, elevations_deg: [1], kind: rotating", "spinning"),
        ("range_m: 9, kind: 3", "spinning, rosette, camera, radar"),
        (
            "kind: camera, range_m: 9, columns_px: 64, rows_px: 64, min_pixels: 1",
            "'hfov_deg' is mi",
        ),
        (f"{CAMERA}, hfov_deg: 170", "less than or equal to 150"),
        (f"{CAMERA}, hfov_deg: 60, channels: 4", "unknown key 'channels'"),
        (f"{CAMERA}, hfov_deg: .nan", "hfov_deg"),
        (f"{ROSETTE}, lasers: 0", "greater than or equal to 1"),
        (f"{ROSETTE}, points_per_sec: 1", "did you mean 'points_per_s'"),
        ("kind: radar, zones: []", "at least 1"),
        ("kind: radar, zones: [{half_angle_deg: 9, resolution_deg: 1}]", "0.range_m' is missing"),
        (f"kind: radar, zones: [{ZONE}, {ZONE}]", "must increase"),
        (f"kind: radar, zones: [{ZONE}], range_m: 99", "leave it out"),
        (f"kind: radar, zones: [{ZONE}], elevation_min_deg: 10", "must be below"),
    ],
)
def test_bad_definitions_end_in_one_message(tmp_path, definition, message):
    path = write(tmp_path, f"sensors: {{mine: {{{definition}}}}}")
    with pytest.raises(InputError, match=message) as error:
        load_sensors(path)
    assert "mine" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "needs a mapping 'sensors'"),
        ("sensors: {}", "defines no sensor"),
        ("sensors: [1]", "needs a mapping"),
        ("sensors: {a: 3}", "must be a mapping"),
        ("sensors: {a: {range_m: 9, elevations_deg: [1]}}\nsensor: 1", "did you mean 'sensors'"),
        ("sensors: {a b: {range_m: 9, elevations_deg: [1]}}", "appears in file names"),
        (
            "sensors: {panorama-1deg-9m: {range_m: 9, elevations_deg: [1]}}",
            "a sensor's name that is in use",
        ),
        ("sensors: {'': {range_m: 9, elevations_deg: [1]}}", "appears in file names"),
        ("sensors: {../a: {range_m: 9, elevations_deg: [1]}}", "appears in file names"),
    ],
)
def test_bad_files_end_in_one_message(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        load_sensors(write(tmp_path, text))


def test_unknown_sensor_is_told_the_nearest(project):
    with pytest.raises(InputError, match="did you mean 'OS-128'"):
        load_sensor(project / "config" / "sensors.yaml", "OS128")


def test_a_thinned_sensor_keeps_its_field_of_view_and_channels(project):
    sensor = load_sensors(project / "config/sensors.yaml")["OS-64"]
    thin = sensor.thinned(5)
    assert thin.shape == (64, 720)
    assert thin.azimuth_cell_deg == pytest.approx(0.5)
    assert thin.azimuth_deg == pytest.approx(sensor.azimuth_deg.reshape(-1, 5).mean(axis=1))
    assert sensor.thinned(1) == sensor
    with pytest.raises(InputError, match=r"azimuth_stride.*a divisor of 3600"):
        sensor.thinned(7)


def test_shipped_sensors_of_other_kinds_have_their_published_fields_of_view(project):
    sensors = load_sensors(project / "config/sensors.yaml")
    views = {name: s.half_view_deg for name, s in sensors.items() if not isinstance(s, Sensor)}
    assert views["Mid-40"] == pytest.approx((38.4 / 2, 38.4 / 2))
    assert views["Avia"] == pytest.approx((70.4 / 2, 77.2 / 2))
    assert isinstance(sensors["Avia"], Rosette)
    assert sensors["Avia"].points == pytest.approx(24_000)
    camera = sensors["camera-8mp"]
    assert isinstance(camera, Camera)
    # 25 px/m, at 1 m width and the focal length: the farthest place at which it detects.
    assert camera.focal_px / 25 == pytest.approx(133, abs=1)
    assert isinstance(sensors["radar-77ghz"], Radar)
    assert sensors["radar-77ghz"].range_m == 250


def test_a_sensor_without_a_depth_map_of_its_own_is_told(project):
    with pytest.raises(InputError, match=r"no depth map of its own.*camera.*spinning"):
        load_sensor(project / "config/sensors.yaml", "camera-8mp")


def test_a_panorama_looks_everywhere_below_the_horizon_and_its_name_says_all():
    name = panorama_name(0.5, 119.2)
    assert name == "panorama-0.5deg-120m"
    panorama = load_sensor("no file is needed", name)
    assert panorama.range_m == 120
    assert panorama.azimuth_cell_deg == 0.5
    assert panorama.elevation_deg[0] < -88.5
    steps = np.diff(panorama.elevation_deg)
    fine = panorama.elevation_deg[1:] > -19
    assert steps[fine] == pytest.approx(0.5)
    assert steps.max() < 4 * 0.5 * 1.05
