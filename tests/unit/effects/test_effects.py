import json
import shutil

import numpy as np
import pytest
import yaml

from roadsight.base.errors import InputError
from roadsight.config.load import load_config, load_site
from roadsight.config.schema import Settings
from roadsight.effects.catalogue import QUANTITIES, load_catalogue, plan
from roadsight.effects.quantities import SETTINGS, Circumstances
from roadsight.io.records.atomic import read_json, write_json
from roadsight.placement.sensors.sensors import Sensor
from roadsight.stages.scene.plan_effects import main
from tests.conftest import PROJECT

ROOT = PROJECT
CATALOGUE = ROOT / "config/effects.yaml"
FIELDS = {
    *("effect", "job", "decision", "quantity", "value", "unit", "threshold", "reason"),
    *("expected_change", "expected_seconds"),
}
PROFILE = {
    "extent_m": [200.0, 80.0, 20.0],
    "density_per_m2": {"median": 400.0},
    "slope_deg": {"median": 1.0, "p95": 4.0},
    "cover_core_m2": 0.0,
}
FRAME = {"location": {"convergence_deg": -1.2, "scale_east": 0.9996, "scale_north": 0.9997}}
GIVEN = {"posed_share": 0.0, "lenses": [], "baseline": {}}
LENS = {
    **{"route": "a", "width_px": 1000, "height_px": 600, "k1": -0.01, "k2": 0.0},
    **{"scale_px": 583.0, "corner_px": -6.0, "sigma_px": 1.5, "source": "plumb lines"},
}
DRIVE = {
    "images": 100, "hidden_road_share": 0.2, "side_share": 1.0,
    "front_view_gaps": [[20.0, 0.9], [60.0, 0.3], [110.0, 0.0]], "lenses": [LENS],
}  # fmt: skip
SENSOR = Sensor(
    elevation_min_deg=-20, elevation_max_deg=20, channels=129, range_m=100, range_10_m=40,
    divergence_mrad=(3.0, 1.5),
)  # fmt: skip


def circumstances(profile=None, sensors=None, drive=None, given=None, **sections):
    settings = Settings.model_validate(sections).model_dump(mode="json", include=SETTINGS)
    known = {"S": SENSOR} if sensors is None else sensors
    own = GIVEN | (given or {}), DRIVE | (drive or {})
    return Circumstances(PROFILE | (profile or {}), FRAME, settings, known, *own)


def decided(jobs=("placement",), modes=None, **about):
    made = plan(load_catalogue(CATALOGUE), modes or {}, jobs, circumstances(**about))
    return {decision.effect: decision for decision in made}


def simulated(**about):
    return {name for name, made in decided(**about).items() if made.decision == "simulate"}


class TestDecisions:
    def test_every_effect_of_the_asked_jobs_is_decided(self):
        assert set(decided()) == set(QUANTITIES["placement"])
        assert set(decided(jobs=("placement", "poles"))) == {
            *QUANTITIES["placement"],
            *QUANTITIES["poles"],
        }
        assert decided(jobs=("scene",)) == {}

    def test_conditions_call_for_effects(self):
        fair = simulated()
        for condition, effect in [
            ({"rain_mm_h": 150.0}, "rain"),
            ({"visibility_m": 200.0}, "fog"),
            ({"target_reflectivity": 0.1}, "reflectivity"),
            ({"aadt": 60_000.0}, "moving_vehicles"),
        ]:
            assert effect not in fair
            assert simulated(conditions=condition) == fair | {effect}

    def test_the_scene_calls_for_effects(self):
        assert "overhead_cover" not in simulated()
        assert "overhead_cover" in simulated(profile={"cover_core_m2": 200.0})
        assert "mount_tilt" not in simulated()
        assert "mount_tilt" in simulated(lidar={"mounting": "normal"})
        level = {"slope_deg": {"median": 0.0, "p95": 0.05}}
        assert "mount_tilt" not in simulated(profile=level, lidar={"mounting": "normal"})

    def test_holes_are_filled_in_sparse_clouds_only(self):
        assert "hole_filling" not in simulated()
        sparse = {"density_per_m2": {"median": 20.0}}
        dense = {"density_per_m2": {"median": 1e6}}
        assert "hole_filling" in simulated(profile=sparse, lidar={"model": "hybrid"})
        assert "hole_filling" not in simulated(profile=dense, lidar={"model": "hybrid"})

    def test_light_matters_only_within_the_range_at_which_beams_are_dense_enough(self):
        # 0.5 m by 0.6 m seen by 8 beams of 0.1 by 0.3125 deg: 62.8 m.
        useful_m = (0.3 / (8 * np.radians(0.1) * np.radians(0.3125))) ** 0.5
        dark = decided(conditions={"target_reflectivity": 0.1})["reflectivity"]
        assert dark.value == pytest.approx(1 - 40 / useful_m, rel=1e-3)
        # Rain that leaves 70 of 100 m costs this sensor nothing.
        assert decided(conditions={"rain_mm_h": 50.0})["rain"].value == 0
        both = decided(conditions={"rain_mm_h": 50.0, "target_reflectivity": 0.1})["rain"]
        assert both.value == pytest.approx(1 - 34.5 / 40, abs=0.01)

    def test_curvature_never_matters_to_a_roadside_sensor(self):
        made = decided()["curvature_refraction"]
        assert made.decision == "skip"
        # (1 - 0.13) 100^2 / (2 * 6371000)
        assert made.value == pytest.approx(0.000683, rel=1e-3)

    def test_a_value_at_the_threshold_is_skipped(self):
        threshold = load_catalogue(CATALOGUE)["overhead_cover"].threshold
        assert "overhead_cover" not in simulated(profile={"cover_core_m2": threshold})
        assert "overhead_cover" in simulated(profile={"cover_core_m2": threshold * 1.001})

    def test_a_site_may_decide_itself(self):
        made = decided(modes={"rain": "simulate", "partial_hits": "skip"})
        assert made["rain"].decision == "simulate"
        assert made["partial_hits"].decision == "skip"
        assert made["partial_hits"].value > made["partial_hits"].threshold
        assert "settings say skip" in made["partial_hits"].reason

    def test_without_sensors_nothing_of_theirs_is_called_for(self):
        assert simulated(sensors={}, conditions={"rain_mm_h": 50.0}) == set()

    def test_poles(self):
        made = decided(jobs=("poles",))
        assert made["grid_convergence"].value == pytest.approx(1.2)
        assert made["scale_factor"].value == pytest.approx(400)
        assert made["road_alignment"].decision == "simulate"


class TestDrive:
    def one(self, effect, **about):
        return decided(jobs=("poles",), **about)[effect]

    def test_hidden_road(self):
        assert self.one("terrain_occlusion").decision == "simulate"
        for share in (0.0, None):
            made = self.one("terrain_occlusion", drive={"hidden_road_share": share})
            assert (made.decision, made.value) == ("skip", 0.0)

    def test_side_views_are_needed_unless_the_front_view_is_known_to_be_wide(self):
        assert self.one("side_views").value == 1.0
        assert "not known" in self.one("side_views").reason
        narrow = self.one("side_views", calibration={"hfov_deg": 20.0})
        assert narrow.decision == "simulate"
        # Known to 10 %: 66.7 degrees may be 60.
        made = self.one("side_views", calibration={"hfov_deg": 60.0 / 0.9})
        assert made.value == pytest.approx(0.3)
        wide = self.one("side_views", calibration={"hfov_deg": 125.0})
        assert (wide.decision, wide.value) == ("skip", 0.0)
        assert self.one("side_views", drive={"side_share": 0.0}).decision == "skip"

    def test_baselines_tell_the_field_of_view(self):
        by_angle = self.one("side_views", given={"baseline": {"all": {"hfov_deg": 60.0 / 0.9}}})
        assert by_angle.value == pytest.approx(0.3)
        focal = 500.0 / np.tan(np.radians(60.0 / 0.9 / 2))
        by_focal = {"baseline": {"1000x600": {"focal_px": focal}}}
        assert self.one("side_views", given=by_focal).value == pytest.approx(0.3)
        other_size = {"baseline": {"640x400": {"focal_px": focal}}}
        assert self.one("side_views", given=other_size).value == 1.0

    def test_a_lens_is_straightened_where_it_is_certain_that_it_bends(self):
        assert self.one("lens_distortion").value == 6.0
        assert self.one("lens_distortion").decision == "simulate"
        uncertain = {"lenses": [LENS | {"sigma_px": 2.5}]}
        assert self.one("lens_distortion", drive=uncertain).decision == "skip"
        unknown = {"lenses": [LENS | {"source": "unknown", "corner_px": 0.0, "sigma_px": None}]}
        assert self.one("lens_distortion", drive=unknown).decision == "skip"
        half_as_wide = {"lenses": [LENS | {"width_px": 500}]}
        assert self.one("lens_distortion", drive=half_as_wide).value == 12.0

    def test_an_unknown_sigma_is_not_told_as_none(self):
        known = self.one("lens_distortion", drive={"lenses": [LENS | {"sigma_px": 2.5}]})
        assert "6.0 +- 2.5 px on a" in known.reason
        unknown = self.one("lens_distortion", drive={"lenses": [LENS | {"sigma_px": None}]})
        assert "plumb lines, 6.0 px on a: may be none" in unknown.reason
        assert "+-" not in unknown.reason and unknown.decision == "skip"

    def test_a_given_lens_counts_whatever_was_measured(self):
        straight = {"route": None, "k1": 0.0, "k2": 0.0, "focal_px": 800.0}
        assert self.one("lens_distortion", given={"lenses": [straight]}).value == 0.0
        bent = straight | {"k1": -0.2}
        assert self.one("lens_distortion", given={"lenses": [bent]}).value > 20

    def test_given_poses_spare_the_alignment(self):
        assert self.one("road_alignment").decision == "simulate"
        assert self.one("road_alignment", given={"posed_share": 1.0}).decision == "skip"
        assert self.one("road_alignment", given={"posed_share": 0.5}).decision == "simulate"

    def test_curvature_never_matters_within_the_reach_of_images(self):
        made = self.one("sight_curvature")
        # (1 - 0.13) 240^2 / (2 * 6371000)
        assert made.value == pytest.approx(0.00393, rel=1e-2)
        assert made.decision == "skip"
        assert self.one("sight_curvature", alignment={"farthest_m": 1000.0}).decision == "simulate"


class TestStage:
    def run(self, folder, circumstances_json):
        write_json(folder / "profile.json", PROFILE)
        write_json(folder / "frame.json", FRAME)
        options = ["--profile", folder / "profile.json", "--frame", folder / "frame.json"]
        write_json(folder / "drive.json", DRIVE)
        options += ["--catalogue", CATALOGUE, "--circumstances", circumstances_json]
        options += ["--drive", folder / "drive.json"]
        return main([str(option) for option in [*options, "--out", folder / "effects.json"]])

    def test_fields_are_those_that_checks_rely_on(self, tmp_path):
        content = {
            "jobs": ["placement", "poles"],
            "modes": {"fog": "simulate"},
            "settings": dict(circumstances().settings),
            "sensors": {"S": SENSOR.to_dict()},
            "given": GIVEN,
        }
        assert self.run(tmp_path, json.dumps(content)) == 0
        effects = read_json(tmp_path / "effects.json")
        assert [set(effect) for effect in effects] == [FIELDS] * len(effects)
        assert {e["effect"] for e in effects} == set(load_catalogue(CATALOGUE))
        assert {e["decision"] for e in effects} == {"simulate", "skip"}


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda e: e["rain"].update(treshold=1), "did you mean 'threshold'"),
        (lambda e: e.update(rainn=e["rain"]), "did you mean 'rain'"),
        (lambda e: e.pop("fog"), "lacks the effect 'fog'"),
    ],
)
def test_what_is_wrong_in_the_catalogue_is_told(tmp_path, change, told):
    content = yaml.safe_load(CATALOGUE.read_text())
    change(content["effects"])
    (tmp_path / "effects.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(InputError, match=told):
        load_catalogue(tmp_path / "effects.yaml")


class TestSiteModes:
    @pytest.fixture
    def site(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        shutil.copytree(ROOT / "config", tmp_path / "config")

        def load(effects):
            settings = f"settings: {{effects: {effects}}}\n"
            (tmp_path / "a.yaml").write_text("site: a\nclouds: [a.laz]\n" + settings)
            return load_site(str(tmp_path / "a.yaml"), load_config({}))

        return load

    def test_modes_and_audit(self, site):
        assert site("{rain: skip}").settings.effect_modes == {"rain": "skip"}
        assert site("audit").settings.effect_modes == {}
        assert site("audit").settings.effects == "audit"

    @pytest.mark.parametrize(
        ("effects", "message"),
        [
            ("{rein: skip}", "did you mean 'rain'"),
            ("{rain: maybe}", "none of auto, simulate, skip"),
            ("audits", "must be audit"),
        ],
    )
    def test_bad_modes(self, site, effects, message):
        with pytest.raises(InputError, match=message):
            site(effects)
