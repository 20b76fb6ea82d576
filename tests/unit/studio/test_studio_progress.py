import json
from logging import ERROR, INFO, WARNING, LogRecord
from typing import get_args

import pytest

from roadsight.studio.api_routes import effects_of, frontiers
from roadsight.studio.project import SiteFolder
from roadsight.studio.run_progress import (
    TARGETS,
    Order,
    causes,
    complaint,
    is_own,
    plan,
    progress_of,
    read_events,
    remaining,
)
from roadsight.studio.runs import earlier_seconds
from snakemake_logger_plugin_roadsight.events import entry


def begun(number, rule, time, **more):
    return {
        "event": "job_info", "time": time, "jobid": number, "rule_name": rule,
        "wildcards": {"site": "a"}, "log": [f"{number}.log"], **more,
    }  # fmt: skip


def finished(number, time):
    return {"event": "job_finished", "time": time, "job_id": number}


def counted(**stats):
    return {"event": "run_info", "time": 0, "stats": stats | {"total": sum(stats.values())}}


def test_the_time_left_is_that_of_earlier_runs_at_this_runs_speed():
    # Two cores do in 30 s what took 60 s before, so the other 40 s take 20 s.
    events = [counted(ground=2, cover=2, all=1), begun(1, "ground", 0), begun(2, "ground", 0)]
    expected = {"ground": 30.0, "cover": 20.0}
    left, basis = remaining(progress_of(events), expected, 2, 5.0)
    assert left == pytest.approx((100 - 10) / 2) and basis == "earlier runs of 4 of 4 steps"
    events += [finished(1, 30), finished(2, 30)]
    assert remaining(progress_of(events), expected, 2, 30.0)[0] == pytest.approx(20.0)


def test_without_earlier_runs_the_steps_so_far_count():
    events = [counted(ground=5), begun(1, "ground", 0)]
    assert remaining(progress_of(events), {}, 1, 3.0) == (None, "")
    events += [finished(1, 12), begun(2, "ground", 12)]
    left, basis = remaining(progress_of(events), {}, 1, 18.0)
    assert left == pytest.approx(12 * 5 - 18) and basis == "1 steps so far"


def test_steps_that_were_not_planned_count_like_the_mean():
    events = [counted(ground=1), begun(1, "ground", 0), finished(1, 20)]
    events.append({"event": "progress", "time": 20, "done": 1, "total": 4})
    assert remaining(progress_of(events), {"ground": 10.0}, 1, 20.0)[0] == pytest.approx(60.0)


def test_a_step_that_succeeds_at_its_second_attempt_has_not_failed():
    failure = {"event": "job_error", "time": 1, "jobid": 1, "rule_name": "r", "log": []}
    progress = progress_of([begun(1, "r", 0), failure])
    assert [job.number for job in progress.failed] == [1] and progress.running == []
    progress.add(begun(1, "r", 2))
    assert progress.failed == [] and len(progress.running) == 1
    progress.add(finished(1, 3))
    assert progress.finished[0].described(9.0)["seconds"] == 1.0


def test_reasons_are_split_and_shortened():
    files = ", ".join(f"f{n}" for n in range(9))
    reason = f"Missing output files: a; b.txt; Updated input files: {files}; Code has changed since"
    assert causes(reason) == [
        "Missing output files: a; b.txt",
        "Updated input files: f0, f1, f2, f3 and 5 more",
        "Code has changed since",
    ]
    assert is_own("Updated input files: a")
    assert not is_own("Input files updated by another job: a")
    assert len(causes("Params have changed since last execution: " + "x" * 900)[0]) < 310


def test_a_plan_tells_own_causes_apart():
    follows = "Input files updated by another job: x"
    events = [
        begun(1, "ground", 0, reason="Updated input files: cloud"),
        begun(2, "cover", 0, reason=follows),
        begun(3, "cover", 0, reason=f"{follows}; Code has changed"),
        begun(4, "all", 0, reason=follows),
        begun(5, "profile_scene", 0, reason=follows),
    ]
    found = plan(events, {"cover": 3.0})
    assert [(rule["rule"], rule["jobs"], rule["own"]) for rule in found["rules"]] == [
        ("ground", 1, 1),
        ("cover", 2, 1),
        ("profile_scene", 1, 0),
    ]
    assert (found["jobs"], found["seconds"], found["known"], found["open"]) == (4, 6.0, 2, True)
    assert [cause["text"] for cause in found["rules"][1]["why"]] == ["Code has changed", follows]


def test_events_that_are_still_written_or_damaged_are_left_out(tmp_path):
    path = tmp_path / "events.jsonl"
    assert read_events(path) == []
    whole = json.dumps({"event": "opened", "time": 1.0})
    path.write_text(f'{whole}\nnot json\n[1]\n{{"event": 3}}\n{whole}\n{{"event": "pro')
    assert len(read_events(path)) == 2


def test_the_plugin_keeps_what_is_read():
    def record(level, text, **extra):
        made = LogRecord("snakemake", level, "file", 1, text, None, None)
        made.__dict__.update(extra)
        return entry(made)

    assert record(INFO, "chat") is None
    assert record(INFO, "", event="resources_info") is None
    assert record(WARNING, "careful")["text"] == "careful"
    assert record(ERROR, "wrong", event="error", exception="X")["exception"] == "X"
    kept = record(INFO, "", event="progress", done=1, total=2)
    assert (kept["event"], kept["done"], kept["total"]) == ("progress", 1, 2)


def test_earlier_seconds_are_those_of_the_site_if_it_has_any(tmp_path):
    for site, rule, text in (
        ("a", "ground", "s\th:m:s\n4.0\tx\n"),
        ("a", "2/ground", "s\n6.0\n"),
        ("b", "ground", "s\n90\n"),
        ("b", "cover", "s\n7\n"),
        ("a", "broken", "nothing"),
        ("a", "other", "s\n-\n"),
    ):
        path = tmp_path / site / "benchmarks" / f"{rule}.tsv"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    assert earlier_seconds(tmp_path, {"a"}) == {"ground": 5.0, "cover": 7.0}
    assert earlier_seconds(tmp_path, ()) == {"ground": pytest.approx(100 / 3), "cover": 7.0}


def test_work_is_time_of_the_processor_where_it_was_measured(tmp_path):
    folder = tmp_path / "a/benchmarks"
    folder.mkdir(parents=True)
    for rule, row in (("busy", "45.1\t4.3"), ("short", "0.4\t0.00"), ("odd", "7.0\t-")):
        (folder / f"{rule}.tsv").write_text(f"s\tcpu_time\n{row}\n")
    assert earlier_seconds(tmp_path, ()) == {"busy": 4.3, "short": 0.4, "odd": 7.0}


def test_the_workflows_own_message_comes_first():
    assert complaint("noise\nroadsight: the site is bad.\nmore\n", ["x"]) == "the site is bad."
    assert complaint("noise\nlast\n", ["told"]) == "told"
    assert complaint("noise\nlast\n", []) == "last"


def test_targets_are_those_that_may_be_ordered():
    assert get_args(Order.model_fields["target"].annotation) == TARGETS


def test_damaged_evidence_is_told(tmp_path):
    site = SiteFolder("a", None, tmp_path)
    assert effects_of(site) == {"effects": []} and frontiers(tmp_path) == {"studies": []}
    (tmp_path / "effects.json").write_text('[{"effect": "rain"}]')
    with pytest.raises(Exception, match="is damaged"):
        effects_of(site)
    (tmp_path / "tradeoffs").mkdir()
    (tmp_path / "tradeoffs/tradeoffs.csv").write_text("job,knob\na,b\n")
    with pytest.raises(Exception, match="is damaged"):
        frontiers(tmp_path)


def test_a_frontier_has_a_chart_and_a_verdict(tmp_path):
    (tmp_path / "tradeoffs").mkdir()
    head = "job,stage,knob,level,cpu_seconds,wall_seconds,peak_mib,metric,value,unit,reference,"
    rows = "".join(
        f"placement,whole,k,<{level}>,{cpu},1,9,coordinate_error_m,{error},m,exact,{error},1,"
        f"{level == 1},True\n"
        for level, cpu, error in ((1, 5.0, 0.2), (2, 9.0, 0.1))
    )
    text = f"{head}error_vs_reference,repeats,is_default,on_frontier\n{rows}"
    (tmp_path / "tradeoffs/tradeoffs.csv").write_text(text)
    (study,) = frontiers(tmp_path)["studies"]
    (view,) = study["views"]
    assert (study["job"], study["knob"]) == ("placement", "k")
    assert "&lt;1&gt;" in view["svg"] and "<1>" not in view["svg"]
    assert "better by 0.1 m" in view["verdict"]
