from logging import ERROR, INFO, WARNING, LogRecord
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from snakemake.logging import DefaultFormatter
from snakemake_interface_logger_plugins.common import LogEvent

from snakemake_logger_plugin_roadsight import LogHandler, LogHandlerSettings
from snakemake_logger_plugin_roadsight.lines import Steps, duration

SPOKEN = dict.fromkeys(("verbose", "dryrun", "printshellcmds", "debug_dag"), False)


class Clock:
    now_s = 0.0

    def __call__(self):
        return self.now_s


def run(steps, clock, jobs):
    """Do jobs (rule, wildcards, seconds) one after the other; lines by job."""
    found = []
    for number, (rule, wildcards, seconds) in enumerate(jobs):
        steps.started([number])
        steps.named(number, rule, wildcards)
        clock.now_s += seconds
        steps.finished(number)
        found.append(steps.progressed(number + 1, len(jobs)))
    return found


def test_a_line_has_site_step_progress_and_time_left():
    clock = Clock()
    steps = Steps(clock)
    assert steps.planned({"build": 2, "all": 1, "total": 3}) == ["2 steps to do"]
    jobs = [
        ("build", {"n": "a", "site": "bend"}, 8),
        ("build", {"site": "bend"}, 8),
        ("all", {}, 0),
    ]
    first, second, last = run(steps, clock, jobs)
    assert first == ["[1/3] bend build a · 8.0 s · about 8.0 s left"]
    assert second[0].startswith("[2/3] bend build · 8.0 s")
    assert last == ["done: 3 steps in 16 s"]


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(0.1, 500)), min_size=1, max_size=30))
def test_every_step_is_said_once_and_time_left_is_never_negative(jobs):
    clock = Clock()
    steps = Steps(clock)
    rules = [rule for rule, _ in jobs]
    steps.planned({rule: rules.count(rule) for rule in set(rules)} | {"total": len(rules)})
    lines = []
    for number, (rule, seconds) in enumerate(jobs, start=1):
        lines += run(steps, clock, [])
        steps.started([number])
        steps.named(number, rule, {"site": "s"})
        clock.now_s += seconds
        steps.finished(number)
        lines += steps.progressed(number, len(jobs))
        assert steps.left_s() is None or steps.left_s() >= 0
    heads = [line.split("]")[0] for line in lines if line.startswith("[")]
    assert heads == [f"[{number}/{len(jobs)}" for number in range(1, len(jobs) + 1)]
    assert steps.left_s() == 0


def test_steps_that_overlap_shorten_the_rest():
    clock = Clock()
    steps = Steps(clock)
    steps.planned({"a": 4, "total": 4})
    steps.started([1, 2])
    for number in (1, 2):
        steps.named(number, "a", {})
    clock.now_s = 10
    for number in (1, 2):
        steps.finished(number)
    steps.progressed(2, 4)
    assert steps.left_s() == pytest.approx(10)


def test_time_left_is_not_told_by_the_long_step_that_comes_first():
    clock = Clock()
    steps = Steps(clock)
    took_s = {"render": 60, "ingest": 2, "profile": 1, "raster": 3}
    others = [f"other {number}" for number in range(50)]
    steps.planned(dict.fromkeys([*took_s, *others], 1))
    left = []
    for number, (rule, seconds) in enumerate(took_s.items()):
        steps.started([number])
        steps.named(number, rule, {})
        clock.now_s += seconds
        steps.finished(number)
        steps.progressed(number + 1, 54)
        left.append(steps.left_s())
    assert left == [None, None, None, pytest.approx(50 * 2.5)]


def test_more_steps_than_planned_are_no_trouble():
    clock = Clock()
    steps = Steps(clock)
    steps.planned({"a": 1, "total": 1})
    assert run(steps, clock, [("b", {}, 1), ("b", {}, 1)])[0][0].startswith("[1/2] b")


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.04, "0.0 s"), (9.94, "9.9 s"), (59.6, "1:00 min"), (3725, "1:02 h")]
)
def test_durations(seconds, text):
    assert duration(seconds) == text


def handler(tmp_path=None, **spoken):
    settings = LogHandlerSettings(None if tmp_path is None else str(tmp_path / "events"))
    made = LogHandler(SimpleNamespace(**SPOKEN | spoken), settings)
    made.setFormatter(DefaultFormatter(None, False))
    return made


def record(level, text, **extra):
    found = LogRecord("snakemake", level, __file__, 1, text, None, None)
    vars(found).update(extra)
    return found


def test_errors_and_warnings_are_said_and_chatter_is_not(capsys):
    lines = handler()
    lines.emit(record(INFO, "Building DAG of jobs..."))
    lines.emit(record(INFO, "Nothing to be done (all requested files are present)."))
    lines.emit(record(INFO, "Lints for rule a"))
    lines.emit(record(INFO, "stats", event=LogEvent.RUN_INFO, stats={"a": 1, "total": 1}))
    lines.emit(record(INFO, "Select jobs to execute..."))
    lines.emit(record(WARNING, "a warning"))
    lines.emit(record(ERROR, "it broke", event=LogEvent.ERROR, exception="X"))
    assert capsys.readouterr().err.splitlines() == [
        "Nothing to be done (all requested files are present).", "Lints for rule a", "1 step to do",
        "a warning", "it broke",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("log", "why"),
    [
        (
            "INFO 3 points\nroadsight: site a: too few; allowed 4.\n",
            ["roadsight: site a: too few; allowed 4."],
        ),
        (
            "INFO a\nTraceback (most recent call last):\n  x\nE: y\n",
            ["Traceback (most recent call last):", "  x", "E: y"],
        ),
        ("INFO a\nINFO b\n", ["INFO a", "INFO b"]),
        (None, []),
    ],
)
def test_a_failed_step_is_said_once_with_its_reason(log, why, tmp_path, capsys):
    path = tmp_path / "solve.log"
    if log is not None:
        path.write_text(log)
    about = {"jobid": 1, "rule_name": "solve", "log": [str(path)], "shellcmd": "python -m solve"}
    lines = handler()
    lines.emit(record(INFO, "stats", event=LogEvent.RUN_INFO, stats={"solve": 2, "total": 2}))
    named = {"jobid": 1, "rule_name": "solve", "wildcards": {"site": "a", "plan": "p"}}
    lines.emit(record(INFO, "job", event=LogEvent.JOB_INFO, **named))
    text = 'RuleException:\nCalledProcessError in file "cover.smk"\nCommand python -m solve'
    lines.emit(record(ERROR, text, event=LogEvent.ERROR, exception="RuleException"))
    lines.emit(record(ERROR, "Error in rule solve", event=LogEvent.JOB_ERROR, **about))
    lines.emit(
        record(ERROR, "Exiting because a job execution failed. Look above for error messages")
    )
    text = "WorkflowError:\nAt least one job did not complete successfully."
    lines.emit(record(ERROR, text, event=LogEvent.ERROR, exception="WorkflowError"))
    assert capsys.readouterr().err.splitlines() == [
        "2 steps to do",
        "failed: a solve p",
        *(f"  {line}" for line in why),
        f"  log: {path}",
        "stopped: a solve p failed; what is finished stays, call again to go on",
    ]


@pytest.mark.parametrize("option", SPOKEN)
def test_snakemake_speaks_for_itself_when_asked(option, capsys):
    lines = handler(**{option: True})
    assert not lines.writes_to_stream
    lines.emit(record(WARNING, "a warning"))
    assert capsys.readouterr().err == ""


def test_events_go_to_their_file_and_leave_the_output(tmp_path, capsys):
    events = handler(tmp_path)
    assert not events.writes_to_stream
    events.emit(record(WARNING, "a warning"))
    events.close()
    assert '"text": "a warning"' in (tmp_path / "events").read_text()
    assert capsys.readouterr().err == ""
