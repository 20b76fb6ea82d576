import shutil
from importlib import import_module
from pathlib import Path

import pandas as pd
import pytest

from roadsight.evidence import effects_audit
from roadsight.evidence.effects_audit import (
    COLUMNS,
    Answer,
    audited,
    changed_share,
    never_mattering,
    read_answer,
)
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.placement_tables import write_detections
from roadsight.io.records.sources import stage_module
from roadsight.io.records.tables import write_table
from roadsight.stages.evidence import audit_effects as stage
from roadsight.stages.evidence.write_audit import main as write_audit
from tests.conftest import PROJECT

ROOT = PROJECT

DECISION = {
    "job": "placement", "effect": "rain", "decision": "skip", "quantity": "range lost",
    "value": 0.004, "unit": "", "threshold": 0.01, "reason": "it drizzles",
    "expected_change": 0.004, "expected_seconds": 0.1,
}  # fmt: skip


def answer(*targets, sensors=1, cpu_s=1.0, candidates="a"):
    pairs = frozenset(("S", "a", target) for target in targets)
    return Answer(sensors, len(targets), frozenset(candidates), pairs, cpu_s)


def test_change_is_a_share_of_all_detections():
    assert changed_share(answer("1", "2", "3"), answer("1", "2", "3")) == 0
    assert changed_share(answer("1", "2", "3"), answer("2", "3", "4")) == pytest.approx(0.5)
    assert changed_share(answer(), answer()) == 0
    assert changed_share(answer(), answer("1")) == 1
    assert changed_share(answer("1", candidates="ab"), answer("1", candidates="abcd")) == 0.5


def test_a_skip_is_right_within_its_tolerance_only():
    many = [str(n) for n in range(100)]
    small = audited("s", DECISION, 0.02, answer(*many[1:]), answer(*many))
    large = audited("s", DECISION, 0.02, answer(*many[3:]), answer(*many))
    assert small["change"] == pytest.approx(0.01)
    assert small["right"]
    assert not large["right"]
    assert audited("s", DECISION | {"decision": "simulate"}, 0.02, answer("1"), answer())["right"]


def test_effects_that_matter_nowhere():
    rows = [
        {"effect": "rain", "change": 0.0, "tolerance": 0.02},
        {"effect": "rain", "change": 0.3, "tolerance": 0.02},
        {"effect": "curvature_refraction", "change": 0.01, "tolerance": 0.02},
    ]
    assert never_mattering(rows) == ["curvature_refraction"]


@pytest.fixture
def answered(tmp_path):
    """A folder with one plan's solution, two shards of detections, and logs."""
    placement = tmp_path / "results/s/placement"
    write_json(placement / "p/solution.json", {"sensors": [{}, {}], "covered_targets": 7})
    write_table(placement / "round-0/candidates.parquet", pd.DataFrame({"candidate": [*"abc"]}))
    for shard, candidate in enumerate("ab"):
        table = pd.DataFrame({"candidate": [candidate], "target": ["t"], "hits": [9]})
        path = placement / f"round-0/detection/S/{shard}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_detections(path, table, {"sensor": "S"})
    for name, cpu_s in (("model_rain", 2), ("solve_cover", 3)):
        log = tmp_path / f"logs/s/{name}.log"
        log.parent.mkdir(parents=True, exist_ok=True)
        log.write_text(f"INFO used {cpu_s}.00 CPU s, at most 99 MiB\n")
    return tmp_path


def test_answer_of_a_folder(answered):
    found = read_answer(answered, "s", "p")
    assert (found.sensors, found.covered) == (2, 7)
    assert found.candidates == {"a", "b", "c"}
    assert found.pairs == {("S", "a", "t"), ("S", "b", "t")}
    assert found.cpu_s == pytest.approx(5.0)


def test_the_log_of_a_rule_that_did_not_run_does_not_count(answered):
    assert read_answer(answered, "s", "p", without="rain").cpu_s == pytest.approx(3.0)


def test_each_rule_of_one_effect_is_a_stage():
    for rule in effects_audit.RULES.values():
        assert hasattr(import_module(stage_module(rule)), "main")


def test_table_and_page(tmp_path):
    many = [str(n) for n in range(100)]
    rows = [
        audited("here", DECISION, 0.02, answer(*many[1:]), answer(*many)),
        audited("there", DECISION, 0.02, answer(*many[9:], sensors=3), answer(*many)),
    ]
    write_json(tmp_path / "rows.json", rows)
    names = ("csv", "table", "page")
    options = [part for name in names for part in (f"--{name}", str(tmp_path / name))]
    assert write_audit(["--rows", str(tmp_path / "rows.json"), *options]) == 0
    table = pd.read_csv(tmp_path / "csv")
    assert tuple(table.columns) == COLUMNS
    assert table["right"].tolist() == [True, False]
    lines = (tmp_path / "table").read_text().splitlines()
    assert len(lines) == 4
    assert "**no**" in lines[3]
    page = (tmp_path / "page").read_text()
    assert "1 of 2 decisions changed the answer" in page


def test_the_stage_runs_the_other_decision_on_each_effect(answered, tmp_path, monkeypatch):
    monkeypatch.chdir(answered)
    write_json(answered / "results/s/effects.json", [DECISION, DECISION | {"job": "poles"}])
    asked = []

    class Other:
        """A run that sees one target less."""

        def __init__(self, folder):
            self.folder = folder

        @classmethod
        def prepare(cls, base, folder, config, site, changes):
            asked.append((config["seed"], site, changes))
            shutil.copytree(Path(base) / "results", Path(folder) / "results")
            (Path(folder) / "results/s/placement/round-0/detection/S/1.parquet").unlink()
            return cls(Path(folder))

        def run(self, targets):
            assert targets == ["placement/p/solution.json"]
            return {"solve_cover": 1}

    monkeypatch.setattr(stage, "Variant", Other)
    options = {
        "site": "s", "plan": "p", "effects": "results/s/effects.json",
        "catalogue": ROOT / "config/effects.yaml", "config": '{"seed": 3}',
        "work": tmp_path / "work", "out": tmp_path / "rows.json",
    }  # fmt: skip
    assert stage.main([part for k, v in options.items() for part in (f"--{k}", str(v))]) == 0
    assert asked == [(3, "s", {"effects": {"rain": "simulate"}})]
    (row,) = read_json(tmp_path / "rows.json")
    assert row["change"] == pytest.approx(0.5)
    assert not row["right"]
    assert not (tmp_path / "work").exists()
