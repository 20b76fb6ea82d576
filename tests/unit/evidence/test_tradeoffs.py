import itertools
import math
from functools import partial

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from roadsight.base.errors import InputError
from roadsight.config.load import load_config, load_site
from roadsight.config.schema import Config
from roadsight.evidence import placement_metrics
from roadsight.evidence.costs import base_costs, with_base_costs
from roadsight.evidence.metrics import METRICS
from roadsight.evidence.studies import (
    NAMED,
    PLAN,
    load_evidence_sites,
    load_overrides,
    load_tradeoffs,
)
from roadsight.evidence.tradeoffs import (
    COLUMNS,
    TIMING_NOISE,
    TIMING_NOISE_S,
    Cost,
    cheapest,
    cost_of,
    next_step,
    on_frontier,
    precision_rows,
    stage_costs,
    study_rows,
)
from roadsight.evidence.variants import JobRecord
from roadsight.report.files import read_assets
from roadsight.report.tradeoffs_page import (
    STYLES,
    TEMPLATE,
    measure_views,
    plain_table,
    render_page,
    stage_rows,
)

STUDY = {
    "job": "placement",
    "title": "Cell",
    "knob": "ground.dem_cell_m",
    "levels": [2.0, 1.0, 0.5],
    "measures": [{"stage": "build_dem", "metric": "dem_rmse_m"}],
    "why": "it is",
}
FILE = {"sites": {"placement": "a", "poles": "b"}, "published_stages": [], "studies": {"s": STUDY}}


def load(tmp_path, **changes):
    study = {key: value for key, value in (STUDY | changes).items() if value is not None}
    (tmp_path / "t.yaml").write_text(yaml.safe_dump(FILE | {"studies": {"s": study}}))
    return load_tradeoffs(tmp_path / "t.yaml")


def message(call, *arguments, **keywords):
    with pytest.raises(InputError) as caught:
        call(*arguments, **keywords)
    return str(caught.value)


class TestFile:
    def test_shipped_studies_load_and_each_default_is_a_level(self, project, monkeypatch):
        monkeypatch.chdir(project)
        found = load_tradeoffs("config/tradeoffs.yaml")
        assert {study.job for study in found.studies.values()} == {"placement", "poles"}
        for study in found.studies.values():
            assert study.default in study.levels
            assert len(study.measures) >= 1
        for site in map(found.site_of, found.studies.values()):
            resolved = load_site(site, Config())
            for study in found.studies.values():
                named = study.knob in (NAMED, PLAN)
                if found.site_of(study) == site and not named:
                    usual = study.levels[study.default]
                    assert resolved.setting(study.knob) == usual, "a site must not set a knob"

    def test_levels_of_a_list_are_named_by_their_values(self, tmp_path):
        study = load(tmp_path).studies["s"]
        assert study.levels == {"2": 2.0, "1": 1.0, "0.5": 0.5}
        assert study.default == "0.5"
        assert study.changes("2") == {"ground": {"dem_cell_m": 2.0}}

    def test_settings_of_all_levels_stay_beside_the_knob(self, tmp_path):
        study = load(tmp_path, settings={"ground": {"slope": 0.3}, "shards": 1}).studies["s"]
        assert study.changes("1") == {"ground": {"slope": 0.3, "dem_cell_m": 1.0}, "shards": 1}

    def test_levels_that_are_plans_change_no_setting(self, tmp_path):
        study = load(tmp_path, knob="plan", levels={"usual": "", "six": "six"}).studies["s"]
        assert study.default == "usual"
        assert {level: study.plan(level) for level in study.levels} == {"usual": "", "six": "six"}
        assert study.changes("six") == {}
        assert load(tmp_path).studies["s"].plan("2") == ""

    def test_a_study_may_have_a_site_of_its_own(self, project, monkeypatch, tmp_path):
        monkeypatch.chdir(project)
        usual, own = load(tmp_path), load(tmp_path, site="sample")
        assert usual.site_of(usual.studies["s"]) == "a"
        assert own.site_of(own.studies["s"]) == "sample"
        own = own.model_copy(update={"sites": {"placement": "tradeoffs_highway"}})
        assert list(load_evidence_sites(Config(), own)) == ["tradeoffs_highway", "sample"]

    def test_a_study_of_an_unknown_plan_is_refused(self, project, monkeypatch, tmp_path):
        monkeypatch.chdir(project)
        found = load(tmp_path, knob="plan", levels={"usual": "", "six": "os-46"})
        found = found.model_copy(update={"sites": {"placement": "tradeoffs_highway"}})
        told = message(load_evidence_sites, Config(), found)
        assert "plans: unknown plan 'os-46'" in told
        assert "allowed" in told

    def test_plans_that_a_run_asks_for_are_none_of_the_studies(self, project, monkeypatch):
        monkeypatch.chdir(project)
        config = Config(plans=["own_plan_of_another_site"])
        found = load_evidence_sites(config, load_tradeoffs("config/tradeoffs.yaml"))
        assert list(found["tradeoffs_highway"].plans) == ["os-64"]

    @pytest.mark.parametrize(
        ("changes", "told"),
        [
            ({"knob": "ground.dem_sell_m"}, "no setting 'ground.dem_sell_m'"),
            ({"levels": [2.0, 1.0]}, "no level has the default 0.5"),
            ({"levels": [0.5, -1.0]}, r"levels.-1: ground.dem_cell_m"),
            ({"levels": [0.5]}, "levels"),
            (
                {"knob": "lidar.model", "levels": ["surfel", "magic"]},
                "studies.s.levels.magic: lidar.model",
            ),
            ({"measures": [{"stage": "bild_dem", "metric": "dem_rmse_m"}]}, "unknown stage 'bild_"),
            ({"measures": [{"stage": "all", "metric": "speed"}]}, "unknown metric 'speed'"),
            ({"measures": [{"stage": "all", "metric": "missed_poles"}]}, "of the job poles"),
            ({"measures": [{"stage": "all", "metric": "sensors"}]}, "needs a reference level"),
            ({"reference": "9"}, "reference '9' is no level"),
            (
                {"knob": "plan", "job": "poles", "levels": {"a": "", "b": "os-64"}},
                "plans are of the job placement, not of poles",
            ),
            ({"whi": "x"}, "unknown key 'studies.s.whi'; did you mean 'why'?"),
            ({"why": None}, "key 'studies.s.why' is missing"),
            ({"published": {"source": "a", "columns": ["x"], "rows": [[1, 2]]}}, "1 entries"),
        ],
    )
    def test_bad_studies_end_in_one_message(self, tmp_path, changes, told):
        assert told in message(load, tmp_path, **changes)


class TestNamedSettings:
    @pytest.mark.parametrize("name", ["quick", "reference"])
    def test_they_load_and_beat_the_site_file(self, project, monkeypatch, name):
        monkeypatch.chdir(project)
        overrides = load_overrides(f"config/{name}.yaml")
        content = yaml.safe_load((project / "config/config.yaml").read_text())
        config = load_config(content | {"overrides": overrides})
        for site in ("sample", "sample_rural"):
            resolved, usual = load_site(site, config), load_site(site, load_config(content))
            for section, values in overrides.items():
                for key, value in values.items():
                    assert resolved.setting(f"{section}.{key}") == value
            assert resolved.settings != usual.settings

    def test_quick_is_coarser_and_reference_finer_than_standard(self, project, monkeypatch):
        monkeypatch.chdir(project)
        usual = load_site("sample_rural", Config())
        quick, fine = (load_overrides(f"config/{name}.yaml") for name in ("quick", "reference"))
        coarser = {"spacing_m", "height_step_m", "cell_size_m", "surfel_size_m", "voxel_size_m"}
        for sign, overrides in ((1, quick), (-1, fine)):
            for section, values in overrides.items():
                for key, value in values.items():
                    if key in coarser:
                        change = value - usual.setting(f"{section}.{key}")
                        assert sign * change > 0, (section, key)

    def test_a_misspelt_override_is_told_with_its_file(self, tmp_path):
        path = tmp_path / "my.yaml"
        path.write_text("overrides: {lidar: {modle: hybrid}}\n")
        assert "my.yaml: overrides: unknown key 'lidar.modle'" in message(load_overrides, str(path))


LEVELS = st.lists(
    st.tuples(st.floats(0.01, 100), st.sampled_from([0.0, 0.5, 1.0, 2.0, math.nan])),
    min_size=1,
    max_size=8,
)


class TestFrontier:
    @given(LEVELS)
    def test_against_the_definition(self, levels):
        cost, error = zip(*levels, strict=True)
        found = on_frontier(cost, error)
        for i, kept in enumerate(found):
            beaten = math.isnan(error[i]) or any(
                (
                    error[j] <= error[i]
                    and cost[j] < min(cost[i] * (1 - TIMING_NOISE), cost[i] - TIMING_NOISE_S)
                )
                or (error[j] < error[i] and cost[j] <= cost[i])
                for j in range(len(levels))
            )
            assert kept is not beaten

    @given(LEVELS)
    def test_the_best_are_on_it_whatever_the_order(self, levels):
        cost, error = zip(*levels, strict=True)
        found = on_frontier(cost, error)
        known = [level for level in levels if not math.isnan(level[1])]
        assert any(found) == bool(known)
        if known:
            best = min(known, key=lambda level: (level[1], level[0]))
            assert found[levels.index(best)]
        again = on_frontier(cost[::-1], error[::-1])
        assert again[::-1] == found

    def test_noise_of_timings_decides_nothing(self):
        assert on_frontier([1.0, 1.05], [0.2, 0.2]) == [True, True]
        assert on_frontier([10.0, 10.5], [0.2, 0.2]) == [True, True]
        assert on_frontier([10.0, 12.0], [0.2, 0.2]) == [True, False]
        assert on_frontier([1.0, 1.2], [0.2, 0.2]) == [True, True]
        assert on_frontier([1.0, 1.4], [0.2, 0.2]) == [True, False]
        assert on_frontier([1.0, 1.05], [0.1, 0.2]) == [True, False]


def level(cpu_s, error, stage="build_dem", others=()):
    costs = {stage: Cost(cpu_s, 2 * cpu_s, 100.0, 2)} | dict(others)
    return {
        "metrics": {"dem_rmse_m": error},
        "stages": {rule: vars(cost) for rule, cost in costs.items()},
    }


class TestRows:
    def test_columns_order_default_and_frontier(self, tmp_path):
        study = load(tmp_path).studies["s"]
        measured = {"2": level(1.0, 0.3), "1": level(2.0, 0.4), "0.5": level(4.0, 0.1)}
        rows = study_rows(study, measured)
        assert [tuple(row) for row in rows] == [COLUMNS] * 3
        assert [row["level"] for row in rows] == ["2", "1", "0.5"]
        assert [row["on_frontier"] for row in rows] == [True, False, True]
        assert [row["is_default"] for row in rows] == [False, False, True]
        assert [row["repeats"] for row in rows] == [2] * 3
        assert next_step(rows) is None

    def test_the_whole_job_is_the_sum_of_its_steps(self):
        costs = {"a": Cost(1.0, 2.0, 100.0), "b": Cost(3.0, 4.0, 50.0)}
        assert cost_of("all", costs) == Cost(4.0, 6.0, 100.0)
        assert cost_of("b", costs) == costs["b"]

    def test_a_reference_level_stands_for_the_truth(self, tmp_path):
        study = load(
            tmp_path, reference="0.5", measures=[{"stage": "all", "metric": "sensors"}]
        ).studies["s"]
        counts = {"2": 7.0, "1": 4.0, "0.5": 5.0}
        measured = {
            name: level(1.0, 0.0) | {"metrics": {"sensors": count}}
            for name, count in counts.items()
        }
        rows = study_rows(study, measured)
        assert [row["error_vs_reference"] for row in rows] == [2.0, 1.0, 0.0]
        assert {row["reference"] for row in rows} == {"level 0.5"}

    def test_positions_are_compared_with_those_of_the_reference_level(self, tmp_path):
        measures = [{"stage": "all", "metric": "baseline_distance_m"}]
        told = message(load, tmp_path, measures=measures)
        assert "needs a reference level" in told
        study = load(tmp_path, reference="0.5", measures=measures).studies["s"]
        places = {
            "2": [[3.0, 4.0, 0.0], [10.0, 0.0, 1.0]],
            "1": [],
            "0.5": [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]],
        }
        measured = {
            name: level(1.0, 0.0) | {"metrics": {"baseline_distance_m": place}}
            for name, place in places.items()
        }
        rows = study_rows(study, measured)
        assert rows[0]["value"] == rows[0]["error_vs_reference"] == pytest.approx(3.0)
        assert math.isnan(rows[1]["value"])
        assert not rows[1]["on_frontier"]
        assert rows[2]["value"] == 0.0
        assert {row["reference"] for row in rows} == {"level 0.5"}

    def test_a_result_that_is_missing_is_no_error_of_zero(self, tmp_path):
        measured = {"2": level(1.0, None), "1": level(2.0, 0.4), "0.5": level(4.0, 0.1)}
        rows = study_rows(load(tmp_path).studies["s"], measured)
        assert math.isnan(rows[0]["error_vs_reference"])
        assert not rows[0]["on_frontier"]

    def test_the_next_step_is_the_cheapest_better_level_of_the_frontier(self, tmp_path):
        study = load(tmp_path, levels={"a": 0.5, "b": 0.4, "c": 0.3, "d": 0.2}).studies["s"]
        measured = {
            "a": level(1.0, 0.5),
            "b": level(9.0, 0.2),
            "c": level(5.0, 0.3),
            "d": level(6.0, 0.3),
        }
        step = next_step(study_rows(study, measured))
        assert step["level"] == "c"
        assert step["cpu_s"] == pytest.approx(4.0)
        assert step["error"] == pytest.approx(-0.2)


def test_costs_leave_out_what_no_user_has_to_run():
    jobs = [
        JobRecord("build_dem", "a", True, 1.0, 2.0, 100.0),
        JobRecord("build_dem", "b", True, 0.5, 1.0, 300.0),
        JobRecord("generate_sample", "c", False, 99.0, 99.0, 999.0),
        JobRecord("score_pavement", "d", False, 99.0, 99.0, 999.0),
    ]
    assert stage_costs(jobs) == {"build_dem": Cost(1.5, 3.0, 300.0)}


def test_the_least_of_several_timings_counts():
    runs = [Cost(2.0, 9.0, 100.0), Cost(1.0, 5.0, 90.0), Cost(3.0, 4.0, 80.0)]
    for order in itertools.permutations(runs):
        assert cheapest(order) == Cost(1.0, 5.0, 90.0, 3)


def test_stages_are_compared_in_core_minutes_a_mile(project, monkeypatch):
    monkeypatch.chdir(project)
    published = load_tradeoffs("config/tradeoffs.yaml").published_stages
    costs = {"calibrate_drive": Cost(30.0, 0, 0), "align_cameras": Cost(90.0, 0, 0)}
    row = next(r for r in stage_rows(published, costs, 1.609344 / 2) if "align" in r["rules"])
    assert row["published"] == "429.1"  # 4.47 min on 96 cores
    assert row["own"] == "4"
    missing = next(r for r in stage_rows(published, costs, 1.0) if "segment" in r["rules"])
    assert missing["own"] == "\u2013"


class TestPage:
    def page(self, project, tmp_path, has_default=True, **changes):
        study = load(tmp_path, title="Cell <of> the DEM", **changes)
        measured = {"2": level(1.0, 0.3), "1": level(2.0, None), "0.5": level(4.0, 0.1)}
        rows = [{"study": "s", **row} for row in study_rows(study.studies["s"], measured)]
        rows = [row | {"is_default": row["is_default"] and has_default} for row in rows]
        ways = {
            name: {
                "coordinate_error_m": e, "normal_error_deg": e, "cpu_s": 1.0, "wall_s": 1.0,
                "peak_mib": 1.0,
            }
            for name, e in (("world", 0.25), ("local", 1e-5))
        }  # fmt: skip
        coordinates = precision_rows({"default": "local", "repeats": 3, "levels": ways})
        rows += [{"study": "coordinates", **row} for row in coordinates]
        assets = read_assets((TEMPLATE, *STYLES))
        return rows, render_page(study.studies, rows, [], assets, "1.0")

    def test_it_needs_nothing_else_and_hides_nothing(self, project, tmp_path):
        rows, html = self.page(project, tmp_path)
        assert "Cell &lt;of&gt; the DEM" in html
        assert "http" not in html.replace("http-equiv", "")
        assert html.count("<svg") == 3
        assert "default on the frontier" in html
        assert plain_table(rows).count("\n") == 2 + len(rows)

    def test_rows_without_a_default_are_drawn_and_told(self, project, tmp_path):
        _, html = self.page(project, tmp_path, has_default=False)
        assert html.count("<svg") == 3
        assert html.count(">no default row</span> There is no default row, so") == 1
        assert html.count(">default on the frontier</span>") == 2

    def test_a_default_off_its_frontier_is_called_that(self, project, tmp_path):
        levels = {"a": 0.5, "b": 0.4}
        study = load(tmp_path, levels=levels).studies["s"]
        rows = study_rows(study, {"a": level(5.0, 0.3), "b": level(1.0, 0.1)})
        view = measure_views(rows)[0]
        assert not view["on_frontier"]
        assert view["verdict"].startswith("The default a is off the frontier; b is better by 0.2 m")
        assert "-4 CPU s" in view["verdict"].replace("\u2212", "-")


def test_every_metric_says_what_it_reads():
    for name, metric in METRICS.items():
        assert metric.targets, name
        assert metric.job in ("placement", "poles")
        assert metric.unit in ("m", "deg", "share", "count", "cost", "1")
        for function in (metric.value, metric.against):
            if isinstance(function, partial):
                assert callable(getattr(placement_metrics, *function.args)), name


def test_a_shared_step_costs_what_it_costs_once_its_kernels_are_compiled():
    cold = [JobRecord("build_dem", "a", False, 5.0, 6.0, 100.0)]
    warm = [JobRecord("build_dem", "a", True, 1.0, 2.0, 90.0)]
    base = base_costs([cold, warm])
    own = {"cpu_s": 5.0, "wall_s": 7.0, "peak_mib": 100.0, "repeats": 1}
    shared = vars(Cost(5.0, 6.0, 100.0))
    assert with_base_costs({"build_dem": shared}, base)["build_dem"] == vars(Cost(1, 2, 90, 2))
    assert with_base_costs({"build_dem": own}, base)["build_dem"] == own
    assert with_base_costs({"solve_cover": own}, base) == {"solve_cover": own}


def test_studies_of_open3d_are_left_out_where_it_cannot_be_loaded(tmp_path, monkeypatch):
    engines = {**STUDY, "knob": "pavement.fpfh_engine", "levels": ["open3d", "own"]}
    file = tmp_path / "t.yaml"
    file.write_text(yaml.safe_dump(FILE | {"studies": {"s": STUDY, "engines": engines}}))
    for usable, expected in ((True, {"s", "engines"}), (False, {"s"})):
        monkeypatch.setattr("roadsight.evidence.studies.is_usable", lambda found=usable: found)
        assert set(load_tradeoffs(file).studies) == expected
        assert set(load_tradeoffs(file, True).studies) == {"s", "engines"}
