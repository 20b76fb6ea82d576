import hashlib
import json

import pandas as pd
import pytest

from roadsight import __version__
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import write_table
from roadsight.stages.evidence.summarise_site import main

SETTINGS = {"seed": 7, "shards": 2, "cover": {"time_limit_s": 300.0}}


def solution(plan, **changes):
    return {
        "site": "here", "plan": plan, "sensor_types": ["S"], "status": "optimal", "objective": 2.5,
        "bound": 2.5, "gap": 0.0, "at_least": 1,
        "sensors": [{"candidate": "a"}, {"candidate": "b"}], "targets": 10, "covered_targets": 9,
        "uncoverable_targets": 1, "excluded": ["t3"], "proven_area_m2": 7.5,
        "reductions": {"rows": 4},
    } | changes  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    write_json(tmp_path / "frame.json", {"inputs": {"a.laz": "ab12", "b.laz": "cd34"}, "unit_m": 1})
    write_json(tmp_path / "effects.json", [{"effect": "rain", "decision": "skip"}])
    write_json(tmp_path / "profile.json", {"points": 12, "density_per_m2": {"median": 3.0}})
    write_json(tmp_path / "scores.json", {"f1": 0.95})
    write_json(tmp_path / "coverage.json", {"targets": 10, "candidates": 30, "plans": {}})
    late = solution("late", status="time_limit", bound=2.0, gap=0.2)
    for plan, content in (("early", solution("early")), ("late", late)):
        write_json(tmp_path / f"{plan}.json", content)
        write_json(tmp_path / f"{plan}-timing.json", {"seconds_cpu": float(len(plan))})
    return tmp_path


def summarise(folder, *options, out="summary.json"):
    named = {
        "frame": "frame.json", "profile": "profile.json", "effects": "effects.json", "out": out,
        "run": f"run-of-{out}",
    }  # fmt: skip
    paths = [part for n, file in named.items() for part in (f"--{n}", str(folder / file))]
    fixed = ["--site", "here", "--seed", "7", "--settings", json.dumps(SETTINGS)]
    code = main([*fixed, *paths, *options])
    return code, folder / out


def placement(folder, plans=("early", "late")):
    return [
        *("--coverage", str(folder / "coverage.json")),
        *("--solutions", *(str(folder / f"{plan}.json") for plan in plans)),
        *("--timings", *(str(folder / f"{plan}-timing.json") for plan in plans)),
    ]


def test_summary_holds_the_keys_that_checks_rely_on(folder):
    scores = ["--scores", str(folder / "scores.json")]
    (folder / "edges.csv").write_text("x,y\n")
    options = ["--given", str(folder / "edges.csv"), "--sensors", '{"S": {"cost": 1.0}}']
    code, path = summarise(folder, *scores, *options, *placement(folder))
    assert code == 0
    assert json.loads(path.read_text()) == {
        "site": "here",
        "warnings": [],
        "version": __version__,
        "seed": 7,
        "inputs": {
            "a.laz": "ab12",
            "b.laz": "cd34",
            str(folder / "edges.csv"): hashlib.sha256(b"x,y\n").hexdigest(),
        },
        "settings": SETTINGS,
        "scene": {
            "points": 12,
            "density_per_m2": {"median": 3.0},
            "pavement_scores": {"f1": 0.95},
            "traffic": None,
        },
        "effects": {"rain": {"decision": "skip"}},
        "sensors": {"S": {"cost": 1.0}},
        "placement": {
            "early": {
                "status": "optimal", "sensors": 2, "cost": 2.5, "lower_bound": 2.5, "gap": 0.0,
                "covered_targets": 9, "targets": 10, "candidates": 30, "uncoverable_targets": 1,
                "seconds_cpu": 5.0, "proven_area_m2": 7.5,
            },
            "late": {
                "status": "time_limit", "sensors": 2, "cost": 2.5, "lower_bound": 2.0, "gap": 0.2,
                "covered_targets": 9, "targets": 10, "candidates": 30, "uncoverable_targets": 1,
                "seconds_cpu": 4.0, "proven_area_m2": 7.5,
            },
        },
    }  # fmt: skip


def test_a_job_that_was_not_asked_for_is_absent(folder):
    # Snakemake gives the options of an absent job without any value.
    code, path = summarise(
        folder, "--given", "--scores", "--traffic", "--coverage", "--solutions", "--timings"
    )
    assert code == 0
    summary = json.loads(path.read_text())
    assert "placement" not in summary
    assert summary["scene"]["pavement_scores"] is None


def test_order_of_plans_does_not_change_the_bytes(folder):
    _, first = summarise(folder, *placement(folder))
    _, second = summarise(folder, *placement(folder, ("late", "early")), out="second.json")
    assert first.read_bytes() == second.read_bytes()


def test_what_was_withheld_is_counted_by_its_reason(folder):
    frames = pd.DataFrame({"image": list("abcde"), "status": ["ok", "ok", "ok", "ok", "GPS jump"]})
    cameras = [
        pd.DataFrame({"accepted": [True, False], "reason": ["", "the edges fit badly"]}),
        pd.DataFrame({"accepted": [False, True], "reason": ["the edges fit badly", ""]}),
    ]
    sightings = pd.DataFrame({"kept": [True, False, True], "reason": ["", "too far", ""]})
    weak = "error ellipse longer than 5 m"
    poles = pd.DataFrame({"kept": [True, True, False, False], "reason": ["", "", weak, weak]})
    poles["kind"] = ["pole", "tree", "pole", "pole"]
    named = {"frames": frames, "c0": cameras[0], "c1": cameras[1], "s0": sightings, "poles": poles}
    path = {name: str(folder / f"{name}.parquet") for name in named}
    for name, table in named.items():
        write_table(path[name], table)
    shards = ["--cameras", path["c0"], path["c1"], "--sightings", path["s0"]]
    code, out = summarise(folder, "--frames", path["frames"], "--poles", path["poles"], *shards)
    assert code == 0
    found = json.loads(out.read_text())["poles"]
    assert (found["images"], found["aligned_images"]) == (5, 2)
    assert (found["sightings"], found["poles"]) == (2, 1)
    assert found["objects"] == {"pole": 1, "tree": 1}
    assert found["withheld"] == {
        "images": {"GPS jump": 1, "the edges fit badly": 2},
        "sightings": {"too far": 1},
        "poles": {weak: 2},
    }


def test_what_stages_told_is_gathered_gravest_first(folder):
    told = {"message": "m", "measured": 0.1, "limit": None}
    note, doubt = ({"code": c, "severity": c} | told for c in ("note", "doubt"))
    write_json(folder / "one.json", [note])
    write_json(folder / "two.json", [note, doubt])
    paths = [str(folder / f"{name}.json") for name in ("one", "two")]
    code, path = summarise(folder, "--doubts", *paths)
    assert code == 0
    assert json.loads(path.read_text())["warnings"] == [doubt, note]
