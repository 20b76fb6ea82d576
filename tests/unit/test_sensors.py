import numpy as np
import pytest

from roadsight.errors import InputError
from roadsight.placement.sensors import Sensor, load_sensor, load_sensors


def write(tmp_path, text):
    path = tmp_path / "sensors.yaml"
    path.write_text(text)
    return path


def test_published_sensors_match_table_5(project):
    sensors = load_sensors(project / "config" / "sensors.yaml")
    table = {
        "VLP-16": (16, -15, 15, 2.0, 100),
        "Puck-32C": (32, -25, 15, 1.29, 200),
        "OS-32": (32, -22.5, 22.5, 1.45, 120),
        "OS-64": (64, -22.5, 22.5, 0.72, 120),
        "OS-128": (128, -22.5, 22.5, 0.35, 120),
    }
    for name, (channels, low, high, step, range_m) in table.items():
        sensor = sensors[name]
        assert sensor.shape == (channels, 3600)
        assert (sensor.elevation_deg[0], sensor.elevation_deg[-1]) == (low, high)
        assert np.diff(sensor.elevation_deg) == pytest.approx(step, abs=0.01)
        assert (sensor.range_m, sensor.cost) == (range_m, 1.0)


def test_real_channel_table_is_dense_around_the_horizon(project):
    sensor = load_sensor(project / "config" / "sensors.yaml", "Puck-32C-channels")
    steps = np.diff(sensor.elevation_deg)
    assert sensor.rows == 32
    assert steps.min() == pytest.approx(1 / 3, abs=0.001)
    assert steps.max() == pytest.approx(9.361)
    assert np.sum(np.abs(sensor.elevation_deg) < 4.1) >= 20


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
