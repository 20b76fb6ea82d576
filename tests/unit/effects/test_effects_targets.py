import json

import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.base.sections.sensing import Targets
from roadsight.config.schema import Settings
from roadsight.effects.quantities import PLACEMENT, SETTINGS, Circumstances
from roadsight.evidence.metrics import METRICS
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.kinds import KINDS, Box, Cylinder, shape_of
from roadsight.stages.evidence import measure_tradeoff
from roadsight.stages.evidence.measure_tradeoff import refuse_other_targets

SENSOR = Sensor(
    elevation_min_deg=-20, elevation_max_deg=20, channels=129, range_m=1000, range_10_m=900,
    divergence_mrad=(3.0, 1.5),
)  # fmt: skip
BEAM = np.radians(0.1) * np.radians(40 / 128)
CONFIG = {"sites": ["tradeoffs_highway"], "sensors_file": "config/sensors.yaml", "overrides": {}}
TINY = {"kind": "box", "length_m": 0.1, "width_m": 0.05, "height_m": 0.08}


def value(effect, targets, **sections):
    settings = Settings.model_validate({"targets": targets} | sections)
    known = settings.model_dump(mode="json", include=SETTINGS)
    return PLACEMENT[effect](Circumstances({}, {}, known, {"S": SENSOR}, {})).value


def useful_m(width_m, height_m):
    return np.sqrt(width_m * height_m / (8 * BEAM))


def seen_width_m(length_m, width_m):
    """Mean over headings of the width of a box, corner by corner."""
    heading = np.linspace(0, np.pi, 20_000, endpoint=False)
    corners = np.array([[i * length_m, j * width_m] for i in (-0.5, 0.5) for j in (-0.5, 0.5)])
    across = corners @ np.array([np.cos(heading), np.sin(heading)])
    return float(np.ptp(across, axis=0).mean())


class TestShapes:
    def test_settings_give_the_shape(self):
        assert shape_of(Targets().model_dump()) == Cylinder(0.25, 0.6)
        assert shape_of(Targets(**TINY).model_dump()) == Box(0.1, 0.05, 0.08)
        for kind, box in KINDS.items():
            assert shape_of(Targets(kind=kind, height_m=9.0).model_dump()) == box

    @pytest.mark.parametrize("box", [*KINDS.values(), Box(0.1, 0.05, 0.08)])
    def test_the_mean_width_is_that_over_all_headings(self, box):
        assert box.mean_width_m == pytest.approx(seen_width_m(box.length_m, box.width_m), rel=1e-4)


@pytest.mark.parametrize(
    ("targets", "width_m", "height_m"),
    [
        ({}, 0.5, 0.6),
        ({"kind": "truck"}, seen_width_m(9.14, 2.44), 3.35),
        # Sizes of other kinds count for nothing.
        ({"kind": "truck", "radius_m": 0.1, "height_m": 0.1}, seen_width_m(9.14, 2.44), 3.35),
        (TINY, seen_width_m(0.1, 0.05), 0.08),
    ],
)
class TestQuantities:
    def test_beams_are_as_wide_as_where_targets_are_just_seen(self, targets, width_m, height_m):
        beam_m = 3e-3 * min(useful_m(width_m, height_m), 1000.0) + SENSOR.aperture_mm / 1000
        assert value("partial_hits", targets) == pytest.approx(beam_m / width_m, rel=1e-3)

    def test_dark_targets_cost_range_where_beams_are_dense_enough(self, targets, width_m, height_m):
        far_m = min(useful_m(width_m, height_m), 1000.0)
        found = value("reflectivity", targets, conditions={"target_reflectivity": 0.01})
        dark_m = 900 * np.sqrt(0.1)
        assert found == pytest.approx(1 - min(far_m, dark_m) / far_m, rel=1e-3)


def test_low_targets_are_hidden_by_vehicles_more_often():
    road = {"conditions": {"aadt": 60_000.0, "truck_share": 0.3}}
    kinds = ({}, {"kind": "pedestrian"}, {"kind": "truck"})
    chances = [value("moving_vehicles", targets, **road) for targets in kinds]
    assert 0.0 < chances[2] < chances[1] < chances[0]


class TestMetrics:
    @pytest.mark.parametrize("metric", ["targets_lost", "detections_wrong"])
    @pytest.mark.parametrize(
        "other",
        [
            {"kind": "truck"}, {"radius_m": 0.3}, {"height_m": 1.0}, {"min_beams": 4},
            {"rcs_m2": 1.0},
        ],
    )  # fmt: skip
    def test_truth_of_the_default_targets_does_not_judge_others(self, metric, other):
        (key, found), *_ = other.items()
        with pytest.raises(
            InputError, match=rf"metric {metric}: judges the default .*{key}"
        ) as told:
            refuse_other_targets(["sensors", metric], Targets(**other).model_dump())
        assert f"found targets.{key}: {found}; allowed: targets.{key}: " in str(told.value)

    def test_what_does_not_look_at_targets_is_measured_with_any(self):
        rest = [name for name, metric in METRICS.items() if not metric.default_targets]
        refuse_other_targets(rest, Targets(kind="truck", min_beams=1).model_dump())
        refuse_other_targets(METRICS, Targets(cell_size_m=2.0, length_m=9.0).model_dump())

    def test_the_stage_refuses_before_anything_runs(self, project, monkeypatch, tmp_path, capsys):
        monkeypatch.chdir(project)
        arguments = ["--site", "tradeoffs_highway", "--config", json.dumps(CONFIG)]
        arguments += ["--changes", json.dumps({"targets": {"kind": "deer"}})]
        arguments += ["--metrics", "targets_lost", "--work", str(tmp_path / "work")]
        assert measure_tradeoff.main([*arguments, "--out", str(tmp_path / "out.json")]) == 2
        assert "targets.kind: deer" in capsys.readouterr().err
        assert not (tmp_path / "work").exists()
