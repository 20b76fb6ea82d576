import math
import re
from types import SimpleNamespace

import pytest
import yaml

from roadsight.base.errors import InputError
from roadsight.base.section import validated
from roadsight.base.texts import read_yaml
from roadsight.config.load import load_config, load_site
from roadsight.config.plans import load_plans
from roadsight.config.render import render_config
from roadsight.config.schema import Config, Settings
from roadsight.config.sites import Site

SENSORS = "sensors: {VLP-16: {range_m: 100}, OS-128: {range_m: 120}}\n"
PLANS = (
    "plans:\n"
    "  small: {title: Small, sensors: [VLP-16]}\n"
    "  both: {title: Both, sensors: [VLP-16, OS-128]}\n"
)
SITE = "site: junction\nclouds: [cloud.laz]\n"


@pytest.fixture
def files(tmp_path):
    """Writes texts to files and loads them: ``files(site=..., plans=..., sensors=...)``."""

    def load(site=SITE, plans=PLANS, sensors=SENSORS, config=None):
        for name, text in (("site", site), ("plans", plans), ("sensors", sensors)):
            (tmp_path / f"{name}.yaml").write_text(text)
        content = {
            "plans_file": str(tmp_path / "plans.yaml"),
            "sensors_file": str(tmp_path / "sensors.yaml"),
        }
        return load_site(str(tmp_path / "site.yaml"), load_config(content | (config or {})))

    return SimpleNamespace(load=load, folder=tmp_path)


def message(call, *arguments, **keywords):
    with pytest.raises(InputError) as caught:
        call(*arguments, **keywords)
    return str(caught.value)


class TestDefaultFile:
    def test_config_file_is_generated_from_the_schema(self, project):
        written = (project / "config" / "config.yaml").read_text(encoding="utf-8")
        assert written == render_config(), "config/config.yaml is out of date: run `make config`"

    def test_generated_file_holds_exactly_the_defaults(self):
        assert Config.model_validate(yaml.safe_load(render_config())) == Config()

    def test_every_key_is_commented(self):
        lines = render_config().splitlines()
        keys = [n for n, line in enumerate(lines) if line and not line.lstrip().startswith("#")]
        assert len(keys) > 40
        assert all(lines[n - 1].lstrip().startswith("# ") for n in keys)

    def test_no_line_is_too_long_to_read(self):
        assert max(map(len, render_config().splitlines())) <= 100

    def test_ranges_choices_and_units_are_told(self):
        text = render_config()
        assert "doubled where points are sparse [> 0, <= 1000]\n  pillar_width_m: 0.2\n" in text
        assert "[surfel | hybrid | preliminary | unet | unet_mask]\n  model: surfel" in text


class TestConfig:
    def test_empty_content_gives_the_defaults(self):
        assert load_config({}) == Config()

    @pytest.mark.parametrize(
        ("content", "told"),
        [
            ({"grond": {}}, "unknown key 'grond'; did you mean 'ground'?"),
            (
                {"ground": {"pilar_width_m": 0.3}},
                "unknown key 'ground.pilar_width_m'; did you mean 'pillar_width_m'?",
            ),
            ({"cover": {"zzzzzz": 1}}, "valid names: at_least, gap, patience, second_objective"),
        ],
    )
    def test_a_misspelt_key_gets_its_section_and_the_nearest_valid_name(self, content, told):
        found = message(load_config, content, "my.yaml")
        assert found.startswith("my.yaml: unknown key ") and told in found

    @pytest.mark.parametrize("low", [10.0, 12])
    def test_lowest_height_must_be_below_the_highest(self, low):
        found = message(load_config, {"candidates": {"height_min_m": low}})
        assert f"candidates: height_min_m ({low:g}) must be below height_max_m (10)" in found

    def test_plants_are_left_out_of_surfels_alone(self):
        winter = {"vegetation": "leave_out"}
        assert load_config({"lidar": winter}).lidar.vegetation == "leave_out"
        found = message(load_config, {"lidar": winter | {"model": "hybrid"}})
        assert "model: hybrid looks at the points themselves; use model: surfel" in found

    @pytest.mark.parametrize(
        ("section", "key", "value"),
        [
            ("ground", "slope", 0), ("ground", "slope", 3.0), ("ground", "slope", "steep"),
            ("ground", "pillar_width_m", -0.2), ("ground", "pillar_width_m", math.nan),
            ("scene", "tile_size_m", math.inf), ("pavement", "smallest_hole_m2", math.inf),
            ("pavement", "neighbours", 2), ("pavement", "neighbours", 10.5),
            ("pavement", "intensity", "maybe"), ("candidates", "gap_factor", 1.9),
            ("coverage", "uncoverable", None),
        ],
    )  # fmt: skip
    def test_a_bad_value_is_shown_with_its_key(self, files, section, key, value):
        found = message(load_config, {section: {key: value}})
        assert f"config/config.yaml: {section}.{key}: " in found
        assert f"found {value!r}" in found
        site = SITE + yaml.safe_dump({"settings": {section: {key: value}}})
        assert f"site.yaml: settings: {section}.{key}: " in message(files.load, site)

    @pytest.mark.parametrize("content", [None, [], "sample", 5])
    def test_content_that_is_no_mapping_is_refused(self, content):
        assert "must be a mapping" in message(load_config, content)

    @pytest.mark.parametrize("sites", [[], "sample", None])
    def test_sites_must_be_a_list_of_at_least_one(self, sites):
        assert "sites: " in message(load_config, {"sites": sites})

    def test_settings_cannot_be_changed_once_resolved(self):
        with pytest.raises(ValueError, match="frozen"):
            Config().ground.slope = 1.0


class TestYaml:
    @pytest.mark.parametrize(
        ("text", "line", "first"), [("a: 1\nb: 2\na: 3\n", 3, 1), ("x:\n  k: 1\n  k: {}\n", 3, 2)]
    )
    def test_a_key_that_is_there_twice_is_refused(self, tmp_path, text, line, first):
        path = tmp_path / "twice.yaml"
        path.write_text(text)
        told = message(read_yaml, path)
        assert f"twice.yaml, line {line}: " in told
        assert f"is there twice, first in line {first}" in told

    def test_keys_of_other_mappings_and_merged_ones_may_return(self, tmp_path):
        path = tmp_path / "fine.yaml"
        path.write_text("a: &a {k: 1}\nr: {b: &b {<<: *a, k: 2}}\nc: {<<: *b, k: 3}\n")
        assert read_yaml(path) == {"a": {"k": 1}, "r": {"b": {"k": 2}}, "c": {"k": 3}}

    @pytest.mark.parametrize(
        ("text", "line"),
        [("a: 1\nb: [1, 2\nc: 3\n", 3), ("a: 1\n\tb: 2\n", 2), ("a: {b: 1}}\n", 1)],
    )
    def test_a_syntax_error_is_told_with_its_line(self, tmp_path, text, line):
        path = tmp_path / "bad.yaml"
        path.write_text(text)
        assert f"bad.yaml, line {line}: is not valid YAML; found " in message(read_yaml, path)

    @pytest.mark.parametrize(
        ("content", "problem"),
        [
            (b"\xff\xfe\x00", "is not UTF-8 text"),
            (b"a: \x07", "special characters are not allowed"),
            (b"day: 2024-13-45", "month must be in"),
            (b"[" * 5000, "nested too deeply"),
        ],
    )
    def test_what_cannot_be_parsed_says_why(self, tmp_path, content, problem):
        path = tmp_path / "bad.yaml"
        path.write_bytes(content)
        assert problem in message(read_yaml, path)

    def test_missing_file_and_folder_are_told(self, tmp_path):
        assert "No such file" in message(read_yaml, tmp_path / "nope.yaml")
        assert "directory" in message(read_yaml, tmp_path)


class TestPlans:
    def test_plans_keep_their_order_and_content(self, files):
        plans = files.load().plans
        assert list(plans) == ["small", "both"]
        assert plans["both"].sensors == ["VLP-16", "OS-128"]

    def test_unknown_sensor_is_told_the_nearest_one(self, files):
        plans = PLANS.replace("OS-128]", "OS-129]")
        found = message(files.load, plans=plans)
        assert "plan 'both' names the unknown sensor 'OS-129'; did you mean 'OS-128'?" in found
        assert "sensors.yaml" in found

    @pytest.mark.parametrize(
        ("plan", "told"),
        [
            ("none: {title: None, sensors: []}", r"plans\.none\.sensors: .*at least 1"),
            ("one: {title: One, sensor: [VLP-16]}", "'plans.one.sensor'; did you mean 'sensors'"),
            # A plan may be named like a key.
            ("title: {title: 1, sensor: [VLP-16]}", "'plans.title.sensor'; did you mean 'sensors'"),
            ("one: {title: One}", "key 'plans.one.sensors' is missing"),
            # Names of plans are names of folders.
            ("VLP 16: {title: One, sensors: [VLP-16]}", "plans.VLP 16"),
        ],
    )
    def test_what_is_wrong_in_a_plan_is_told_with_its_place(self, files, plan, told):
        assert re.search(told, message(files.load, plans=f"plans: {{{plan}}}"))

    @pytest.mark.parametrize("sensors", ["", "sensors:\n", "sensors: [VLP-16]\n", "- VLP-16\n"])
    def test_a_malformed_sensors_file_is_an_input_error(self, files, sensors):
        assert "sensors.yaml" in message(files.load, sensors=sensors)

    def test_shipped_plans_name_shipped_sensors(self, project, monkeypatch):
        monkeypatch.chdir(project)
        plans = load_plans(Config().plans_file, Config().sensors_file)
        assert {"vlp-16", "puck-32c", "puck-32c-or-os-32", "os-32", "os-64", "os-128"} <= set(plans)


class TestSite:
    def test_defaults_come_from_the_config_and_the_site_overrides_single_keys(self, files):
        site = SITE + "settings: {ground: {slope: 0.5}, seed: 9}\n"
        resolved = files.load(site, config={"ground": {"dem_cell_m": 0.25, "slope": 0.3}})
        assert resolved.setting("ground.slope") == 0.5
        assert resolved.setting("ground.dem_cell_m") == 0.25
        assert resolved.setting("seed") == 9
        assert resolved.settings.pavement == Settings().pavement

    def test_one_site_does_not_change_another(self, files):
        changed = files.load(SITE + "settings: {ground: {slope: 0.5}}\n")
        assert changed.setting("ground.slope") == 0.5
        assert files.load().setting("ground.slope") == Settings().ground.slope

    def test_misspelt_override_is_told_where_it_is(self, files):
        found = message(files.load, SITE + "settings: {ground: {slop: 0.5}}\n")
        assert "site.yaml: settings: unknown key 'ground.slop'; did you mean 'slope'?" in found

    def test_overrides_are_checked_together_with_the_config(self, files):
        site = SITE + "settings: {candidates: {height_max_m: 3}}\n"
        assert "height_min_m (4) must be below height_max_m (3)" in message(files.load, site)

    @pytest.mark.parametrize("override", ["sites: [a]", "plans_file: a.yaml", "ground: 5"])
    def test_what_a_site_may_not_override_is_refused(self, files, override):
        found = message(files.load, SITE + f"settings: {{{override}}}\n")
        assert override.partition(":")[0] in found

    @pytest.mark.parametrize(
        "site", ["site: a\n", "site: a\nclouds: []\n", "site: a\nclouds: [b.laz]\nsample: {}\n"]
    )
    def test_a_site_has_either_clouds_or_a_sample(self, files, site):
        assert "give either clouds (a list of files) or sample" in message(files.load, site)

    @pytest.mark.parametrize("text", ["", "- a\n- b\n", "site: [\n", "site: Ä b\nsample: {}\n"])
    def test_a_file_that_is_no_site_is_named(self, files, text):
        assert "site.yaml" in message(files.load, text)

    @pytest.mark.parametrize("name", ["A", "a b", "../a", "-a", ""])
    def test_site_names_must_be_usable_as_folders(self, files, name):
        assert "site: " in message(files.load, f"site: '{name}'\nclouds: [b.laz]\n")

    def test_unknown_key_at_the_top_and_inside_a_section(self, files):
        assert "'cloud'; did you mean 'clouds'?" in message(files.load, "site: a\ncloud: b\n")
        nested = SITE + "placement: {plan: [small]}\n"
        assert "'placement.plan'; did you mean 'plans'?" in message(files.load, nested)
        sample = "site: a\nsample: {point: 5}\n"
        assert "'sample.point'; did you mean 'points'?" in message(files.load, sample)

    @pytest.mark.parametrize(
        ("given", "told"),
        [
            ("scene: highway, lanes: 2, k1: 0.1", "a highway scene has no k1, lanes"),
            ("scene: rural, tunnel: true", "a rural scene has no tunnel"),
        ],
    )
    def test_settings_of_the_other_generated_scene_are_refused(self, files, given, told):
        assert told in message(files.load, f"site: a\nsample: {{{given}}}\n")

    def test_unknown_and_empty_plans_are_refused(self, files):
        found = message(files.load, SITE + "placement: {plans: [smal]}\n")
        assert "unknown plan 'smal'" in found
        assert "small, both" in found
        assert "placement.plans: names no plan" in message(
            files.load, SITE + "placement: {plans: []}\n"
        )

    def test_plans_of_the_configuration_beat_those_of_the_site(self, files):
        site = SITE + "placement: {plans: [small]}\n"
        assert list(files.load(site, config={"plans": ["both"]}).plans) == ["both"]
        assert "unknown plan 'big'" in message(files.load, site, config={"plans": ["big"]})

    def test_overrides_beat_the_site_file_value_by_value(self, files):
        site = SITE + "settings: {cover: {time_limit_s: 60, at_least: 2}}\n"
        found = files.load(site, config={"overrides": {"cover": {"time_limit_s": 5}}})
        assert found.setting("cover.time_limit_s") == 5
        assert found.setting("cover.at_least") == 2
        wrong = {"overrides": {"cover": {"at_last": 2}}}
        told = message(files.load, site, config=wrong)
        assert "overrides: unknown key 'cover.at_last'; did you mean 'at_least'?" in told

    def test_only_the_asked_plans_are_kept_in_the_asked_order(self, files):
        assert list(files.load(SITE + "placement: {plans: [both, small]}\n").plans) == [
            "both",
            "small",
        ]

    def test_no_such_site_tells_what_there_is(self, project, monkeypatch):
        monkeypatch.chdir(project)
        found = message(load_site, "smaple", Config())
        assert "no site file config/sites/smaple.yaml" in found
        assert "sample" in found

    def test_paths_are_relative_to_the_site_file_or_absolute(self, files):
        site = "site: a\nclouds: [../c.laz, /data/d.laz]\ntruth: {pavement: t.gpkg}\n"
        resolved = files.load(site)
        assert resolved.clouds == [str(files.folder.parent / "c.laz"), "/data/d.laz"]
        assert resolved.beside(resolved.site.truth.pavement) == str(files.folder / "t.gpkg")
        assert resolved.beside(None) is None

    def test_environment_variables_are_replaced(self, files, monkeypatch):
        monkeypatch.setenv("CLOUDS_AT", "/somewhere")
        site = "site: a\nclouds: ['${CLOUDS_AT}/${CLOUDS_AT}/a.laz']\n"
        assert files.load(site).clouds == ["/somewhere/somewhere/a.laz"]

    @pytest.mark.parametrize("value", [None, ""])
    def test_an_unset_variable_is_named_with_what_to_do(self, files, monkeypatch, value):
        monkeypatch.delenv("CLOUDS_AT", raising=False)
        if value is not None:
            monkeypatch.setenv("CLOUDS_AT", value)
        found = message(files.load, "site: a\nclouds: ['${CLOUDS_AT}/a.laz']\n")
        assert "environment variable CLOUDS_AT is not set; export CLOUDS_AT=<folder>" in found

    def test_shipped_sites_are_valid(self, project):
        paths = sorted((project / "config" / "sites").glob("*.yaml"))
        assert "sample" in [path.stem for path in paths]
        for path in paths:
            site = validated(Site, read_yaml(path), str(path))
            assert site.site == path.stem
            validated(Settings, site.settings, str(path))
