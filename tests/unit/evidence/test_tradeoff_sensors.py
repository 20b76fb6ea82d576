import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from roadsight.base.errors import InputError
from roadsight.base.sections.placement import Poses
from roadsight.base.sections.run import Sample
from roadsight.config.schema import Settings
from roadsight.evidence.exact_highway import ExactHighway
from roadsight.evidence.metrics import METRICS
from roadsight.evidence.placement_metrics import Results
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.placement.sensors.sensors import AimedSensor, Sensor, load_sensors
from roadsight.stages.evidence import measure_tradeoff
from roadsight.stages.evidence.measure_tradeoff import refuse_sensors_without_maps
from roadsight_worlds.highway.highway import build_highway

LENGTH_M = 60.0
AS_MOUNTED = Poses().spinning.model_dump()
CONFIG = {"sites": ["tradeoffs_highway"], "sensors_file": "config/sensors.yaml", "overrides": {}}


@pytest.fixture
def sensors(project):
    return load_sensors(project / "config/sensors.yaml")


@pytest.fixture(scope="module")
def road(tmp_path_factory):
    """Results with a target every 4 m of the road, the place above it, and the exact scene."""
    folder = tmp_path_factory.mktemp("road")
    frame = build_highway(1, LENGTH_M).frame()
    write_json(folder / "scene/frame.json", frame.to_dict())
    exact = ExactHighway(build_highway(1, LENGTH_M), frame)
    xy_m, height_m = exact.road_heights(4.0)
    feet = pd.DataFrame({"x": xy_m[:, 0], "y": xy_m[:, 1], "z": height_m})
    feet["target"] = [f"t{row}" for row in range(len(feet))]
    write_table(folder / "placement/targets.parquet", feet)
    x, y, z = map(float, feet[["x", "y", "z"]].to_numpy()[len(feet) // 3])
    return folder, {"x": x, "y": y, "z": z + 6.0}


def results_of(folder, known, **sample):
    """Results in a folder, whose plan ``p`` may place the known sensors."""
    scene = Sample(length_m=LENGTH_M, **sample)
    return Results(folder, folder, Settings(seed=1), scene, "p", known)


def lost(road, sensors, *chosen):
    """Share of the targets that chosen sensors miss; each is a name with a pose or none."""
    folder, place = road
    entries = [{"sensor": name, "yaw_deg": 20.0, **place, **pose} for name, pose in chosen]
    targets = len(read_table(folder / "placement/targets.parquet"))
    solution = {"excluded": [], "covered_targets": targets, "sensors": entries}
    write_json(folder / "placement/p/solution.json", solution)
    known = {name: sensors[name] for name, _ in chosen}
    return METRICS["targets_lost"].value(results_of(folder, known))


@pytest.mark.parametrize("name", ["Avia", "camera-8mp", "radar-77ghz"])
def test_what_aimed_sensors_lose_is_measured(road, sensors, name):
    down, up = ({"pitch_deg": pitch, "roll_deg": 0.0} for pitch in (-15.0, 80.0))
    assert isinstance(sensors[name], AimedSensor)
    assert 0.0 < lost(road, sensors, (name, down)) < 1.0
    assert lost(road, sensors, (name, up)) == 1.0


def test_mixed_plans_see_what_any_of_their_sensors_sees(road, sensors):
    level = {"pitch_deg": 0.0, "roll_deg": 0.0}
    camera, lidar = ("camera-8mp", {"pitch_deg": -15.0, "roll_deg": 0.0}), ("OS-64", level)
    alone = [lost(road, sensors, one) for one in (camera, lidar)]
    both = lost(road, sensors, camera, lidar)
    assert both <= min(alone)
    assert both >= sum(alone) - 1 - 1e-12
    assert lost(road, sensors, ("OS-64", {})) == pytest.approx(alone[1], abs=0.03)


class TestCoverageOfTheRoad:
    """What a plan claims and what its sensors see, of the same carriageways."""

    def measured(self, road, sensors, metric, excluded=(), chosen=True):
        folder, place = road
        entries = [{"sensor": "OS-64", "yaw_deg": 20.0, **place}] if chosen else []
        covered = len(read_table(folder / "placement/targets.parquet")) - len(excluded)
        solution = {"excluded": list(excluded), "covered_targets": covered, "sensors": entries}
        write_json(folder / "placement/p/solution.json", solution)
        return METRICS[metric].value(results_of(folder, {"OS-64": sensors["OS-64"]}))

    def test_what_no_sensor_sees_is_unseen(self, road, sensors):
        assert self.measured(road, sensors, "road_unseen", chosen=False) == 1.0
        seen = self.measured(road, sensors, "road_unseen")
        lost = self.measured(road, sensors, "targets_lost")
        assert 0.0 < seen < 1.0
        assert seen == pytest.approx(lost, abs=0.06)  # the targets are a coarser grid of the road

    def test_only_cells_of_claimed_targets_are_claimed(self, road, sensors):
        targets = read_table(road[0] / "placement/targets.parquet")["target"]
        every = self.measured(road, sensors, "road_unclaimed")
        # A target every 4 m claims one to four of the 16 cells around it.
        assert 1 - 4 / 16 - 0.02 < every < 1 - 1 / 16 + 0.02
        half = self.measured(road, sensors, "road_unclaimed", excluded=targets[::2])
        assert 1 - half == pytest.approx((1 - every) / 2, abs=0.03)
        assert self.measured(road, sensors, "road_unclaimed", excluded=targets) == 1.0

    def test_targets_on_a_roof_claim_nothing_of_the_road_below(self, road, sensors):
        path = road[0] / "placement/targets.parquet"
        targets, before = read_table(path), self.measured(road, sensors, "road_unclaimed")
        roof = targets.assign(z=targets["z"] + 8.0 * (targets.index % 2))
        write_table(path, roof)
        after = self.measured(road, sensors, "road_unclaimed")
        write_table(path, targets)
        assert 1 - after == pytest.approx((1 - before) / 2, abs=0.03)

    def test_what_a_plan_with_a_budget_claims_is_not_known(self, road, sensors):
        folder, _ = road
        solution = {"excluded": [], "covered_targets": 3, "sensors": []}
        write_json(folder / "placement/p/solution.json", solution)
        for metric in ("targets_lost", "road_unclaimed"):
            with pytest.raises(InputError, match=r"plan p: leaves targets unseen .* found 3 of"):
                METRICS[metric].value(results_of(folder, {"OS-64": sensors["OS-64"]}))


def test_the_truth_is_of_the_scene_that_was_generated(road):
    usual, steep = (results_of(road[0], {}, grade=grade).scene for grade in (0.0, 0.05))
    rise_m = [np.ptp(scene.road_heights(4.0)[1]) for scene in (usual, steep)]
    assert rise_m[1] - rise_m[0] == pytest.approx(0.05 * LENGTH_M, rel=0.2)


METRICS_OF_MAPS = ["beams_wrong", "range_rmse_m", "detections_wrong", "detections_false"]


class TestRefusals:
    @pytest.mark.parametrize("metric", METRICS_OF_MAPS)
    def test_maps_are_asked_of_spinning_lidars_only(self, sensors, metric):
        aimed = {name: sensors[name] for name in ("radar-77ghz", "camera-8mp")}
        told = rf"metric {metric}: reads depth maps .* found radar-77ghz, camera-8mp"
        with pytest.raises(InputError, match=told):
            refuse_sensors_without_maps(["sensors", metric], aimed, AS_MOUNTED)
        refuse_sensors_without_maps([metric], aimed | {"OS-64": sensors["OS-64"]}, AS_MOUNTED)

    @pytest.mark.parametrize("metric", METRICS_OF_MAPS)
    def test_turned_lidars_have_no_maps_of_their_own(self, sensors, metric):
        turned = AS_MOUNTED | {"pitch_deg": [-10.0, 0.0]}
        with pytest.raises(InputError, match=r"OS-64 in the poses .*'pitch_deg': \[-10.0, 0.0\]"):
            refuse_sensors_without_maps([metric], {"OS-64": sensors["OS-64"]}, turned)

    def test_other_metrics_take_any_sensor(self, sensors):
        rest = [name for name in METRICS if name not in METRICS_OF_MAPS]
        refuse_sensors_without_maps(rest, {"radar-77ghz": sensors["radar-77ghz"]}, AS_MOUNTED)


class TestStage:
    def test_metrics_are_given_all_sensors_of_the_plan(self, project, monkeypatch):
        monkeypatch.chdir(project)
        config = CONFIG | {"plans": ["any-kind"]}
        site, sample = measure_tradeoff._site(config, "tradeoffs_highway", {})
        found = measure_tradeoff._sensors(site, config)
        assert list(found) == site.plans["any-kind"].sensors
        assert sum(isinstance(sensor, Sensor) for sensor in found.values()) == 1
        assert sample.length_m == 80.0

    @pytest.mark.parametrize(
        ("changes", "told"),
        [
            ({"voxels": {"voxel_size_m": 3.0}}, "no rule behind the metrics uses what this level"),
            ({}, "variant was measured"),
        ],
    )
    def test_a_knob_that_no_rule_uses_is_refused(
        self, project, monkeypatch, tmp_path, capsys, changes, told
    ):
        def measured(_):
            raise InputError("variant was measured")

        monkeypatch.chdir(project)
        unchanged = SimpleNamespace(run=lambda *_: {}, records=measured)
        monkeypatch.setattr(
            measure_tradeoff, "Variant", SimpleNamespace(prepare=lambda *_: unchanged)
        )
        arguments = ["--site", "tradeoffs_highway", "--config", json.dumps(CONFIG | {"plans": []})]
        arguments += ["--changes", json.dumps(changes), "--metrics", "targets_lost"]
        arguments += ["--work", str(tmp_path / "work"), "--out", str(tmp_path / "out.json")]
        assert measure_tradeoff.main(arguments) == 2
        said = capsys.readouterr().err
        assert told in said
        assert bool(changes) == ("voxel_size_m" in said)

    def test_a_plan_without_maps_is_refused_before_anything_runs(
        self, project, monkeypatch, tmp_path, capsys
    ):
        monkeypatch.chdir(project)
        config = CONFIG | {"plans": ["radar"]}
        arguments = ["--site", "tradeoffs_highway", "--config", json.dumps(config)]
        arguments += ["--changes", "{}", "--metrics", "beams_wrong"]
        arguments += ["--work", str(tmp_path / "work"), "--out", str(tmp_path / "out.json")]
        assert measure_tradeoff.main(arguments) == 2
        assert "metric beams_wrong: reads depth maps" in capsys.readouterr().err
        assert not (tmp_path / "work").exists()
