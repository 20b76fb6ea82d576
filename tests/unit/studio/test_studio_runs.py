import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress

import pytest

from roadsight.base.errors import InputError
from roadsight.io.records.atomic import read_json, write_json
from roadsight.studio.project import Project
from roadsight.studio.run_progress import Order
from roadsight.studio.runner import BEGUN, BUSY, ENDED, EVENTS, ORDER, OUTPUT, hold, is_held, main
from roadsight.studio.runs import FOLDER, Runs, processes_outside
from tests.helpers.small_workflow import small_project


@pytest.fixture
def runs(tmp_path, monkeypatch):
    monkeypatch.chdir(small_project(tmp_path))
    found = Runs(Project(tmp_path))
    yield found
    if found.state()["running"]:
        os.killpg(read_json(tmp_path / FOLDER / BEGUN)["pid"], signal.SIGKILL)


def until(runs, test, seconds=60):
    """The first state that passes a test."""
    end = time.monotonic() + seconds
    while not test(state := runs.state()):
        assert time.monotonic() < end, state
        time.sleep(0.05)
    return state


def ended(runs):
    return until(runs, lambda state: not state["running"])


def test_a_run_to_its_end_and_what_is_stale_before_and_after(runs, tmp_path):
    assert runs.state()["order"] is None
    before = runs.plan(Order(cores=1))
    assert [(rule["rule"], rule["jobs"]) for rule in before["rules"]] == [
        ("count_steps", 4),
        ("join_steps", 1),
    ]
    assert before["rules"][0]["why"][0]["text"].startswith("Missing output files: results/small/")
    assert before["known"] == 0 and runs.state()["order"] is None
    runs.start(Order(cores=2))
    state = ended(runs)
    assert state["status"] == "done" and state["done"] == state["total"] == 6
    assert {step["rule"] for step in state["last"]} == {"count_steps", "join_steps", "all"}
    assert runs.plan(Order())["jobs"] == 0
    assert Runs(Project(tmp_path)).state()["status"] == "done"
    (tmp_path / "given.txt").write_text("another\n")
    after = runs.plan(Order(target="poles", cores=1))
    assert after["jobs"] == after["known"] == after["rules"][0]["own"] == 4
    assert after["rules"][0]["why"] == [{"text": "Updated input files: given.txt", "jobs": 4}]
    with pytest.raises(InputError, match="no log of such a step"):
        runs.log(999)


@pytest.mark.full
def test_a_failed_step_shows_its_log(runs, tmp_path):
    (tmp_path / "fail").touch()
    runs.start(Order(cores=2))
    state = ended(runs)
    assert state["status"] == "failed"
    (step,) = state["failed"]
    assert step["rule"] == "count_steps" and step["wildcards"] == {"n": "2"}
    log = runs.log(step["job"])
    assert log == {"path": "logs/small/count_steps_2.log", "text": "begins 2\nthe <b>reason</b>\n"}
    (tmp_path / "fail").unlink()
    runs.start(Order(cores=2))
    assert ended(runs)["status"] == "done"


def test_a_run_is_stopped_found_again_and_leaves_no_lock(runs, tmp_path):
    (tmp_path / "slow").touch()
    runs.start(Order(cores=2))
    until(runs, lambda state: len(state["steps"]) == 2)
    again = Runs(Project(tmp_path))
    assert again.state()["status"] == "running" and again.state()["outside"] == []
    with pytest.raises(InputError, match="runs already"):
        again.start(Order())
    with pytest.raises(InputError, match="its lock stays"):
        again.unlock()
    again.stop(firmly=False)
    first_s = read_json(tmp_path / FOLDER / ORDER)["stop_s"]
    assert again.state()["status"] in ("stopping", "stopped")
    with suppress(InputError):  # where it has stopped already
        again.stop(firmly=True)
    assert read_json(tmp_path / FOLDER / ORDER)["stop_s"] == first_s
    state = ended(runs)
    assert state["status"] == "stopped" and not state["locked"] and state["failed"] == []
    (tmp_path / "slow").unlink()
    runs.start(Order(cores=2))
    assert ended(runs)["status"] == "done"


def test_what_a_killed_run_leaves_is_told_and_removed_on_demand(runs, tmp_path):
    (tmp_path / "slow").touch()
    runs.start(Order(cores=2))
    until(runs, lambda state: state["steps"])
    os.killpg(read_json(tmp_path / FOLDER / BEGUN)["pid"], signal.SIGKILL)
    state = until(runs, lambda state: not state["running"] and state["locked"])
    assert state["status"] == "lost"
    with pytest.raises(InputError, match="left its lock"):
        runs.start(Order())
    runs.unlock()
    assert not runs.state()["locked"]
    with pytest.raises(InputError, match="there is no lock"):
        runs.unlock()


def test_no_run_starts_while_a_lock_is_removed(runs, monkeypatch):
    done = []
    starting = threading.Thread(target=runs.start, args=(Order(),))

    def remove(_):
        starting.start()
        starting.join(timeout=1)
        done.append("removed")

    monkeypatch.setattr("roadsight.studio.runs.lock_is_there", lambda _: True)
    monkeypatch.setattr("roadsight.studio.runs.unlock", remove)
    monkeypatch.setattr(Runs, "_check_free", lambda _: None)
    monkeypatch.setattr(Runs, "_launch", lambda *_: done.append("started"))
    runs.unlock()
    starting.join()
    assert done == ["removed", "started"]


def within_s(limit_s, condition):
    end = time.monotonic() + limit_s
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)


def test_a_run_outside_is_seen_and_left_alone(runs, tmp_path):
    (tmp_path / "slow").touch()
    process = subprocess.Popen(
        [sys.executable, "-m", "snakemake", "--cores", "1"], cwd=tmp_path,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    try:
        within_s(10, lambda: processes_outside(tmp_path))  # its arguments are not there at once
        assert [found["pid"] for found in processes_outside(tmp_path)] == [process.pid]
        with pytest.raises(InputError, match=f"process {process.pid} outside"):
            runs.start(Order())
        with pytest.raises(InputError, match="no run that the studio started"):
            runs.stop(firmly=False)
        assert processes_outside(tmp_path.parent) == []
    finally:
        os.killpg(process.pid, signal.SIGKILL)  # at its very start it may miss a milder one
        process.wait(timeout=60)
    assert runs.state()["outside"] == []


@pytest.mark.full
def test_a_broken_workflow_is_told(runs, tmp_path):
    (tmp_path / "Snakefile").write_text("rule all:\n    input: 'nowhere.txt'\n")
    with pytest.raises(InputError, match=r"the workflow: .*Missing input files.*nowhere\.txt"):
        runs.plan(Order())
    runs.start(Order())
    state = ended(runs)
    assert state["status"] == "failed" and "nowhere.txt" in state["complaint"]
    assert state["failed"] == []


def test_only_known_sites_are_run(runs):
    with pytest.raises(InputError, match="no such site"):
        runs.plan(Order(site="../small"))
    assert runs.plan(Order(site="small"))["jobs"] == 5


def test_one_lock_one_holder(tmp_path):
    lock = hold(tmp_path)
    assert lock is not None and hold(tmp_path, 2) is None
    lock.close()
    hold(tmp_path).close()


def test_those_who_ask_for_the_lock_do_not_see_each_other(tmp_path):
    hold(tmp_path).close()
    found = []
    ask = lambda: found.extend(is_held(tmp_path) for _ in range(2000))  # noqa: E731
    threads = [threading.Thread(target=ask) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [False] * 4000
    lock = hold(tmp_path)
    assert is_held(tmp_path)
    lock.close()


def test_a_run_that_ended_just_before_it_was_stopped_is_no_run(runs, tmp_path):
    folder = tmp_path / FOLDER
    lock = hold(folder)
    gone = subprocess.Popen(["true"], start_new_session=True)
    gone.wait()
    write_json(folder / BEGUN, {"pid": gone.pid, "time": 0.0})
    write_json(folder / ORDER, {"time": 0.0, "stop_s": 5.0})
    try:
        with pytest.raises(InputError, match="no run that the studio started"):
            runs.stop(firmly=False)
        assert read_json(folder / ORDER)["stop_s"] == 5.0
    finally:
        lock.close()
        (folder / ORDER).unlink()


def test_a_run_that_does_not_get_the_lock_leaves_the_files_of_the_other(
    runs, tmp_path, monkeypatch
):
    folder = tmp_path / FOLDER
    lock = hold(folder)
    files = [folder / name for name in (ORDER, BEGUN, ENDED, EVENTS, OUTPUT)]
    for file in files:
        file.write_text('{"pid": 999999999}')
    try:
        assert main([str(folder), "{}", "true"]) == BUSY
        monkeypatch.setattr(Runs, "_is_alive", lambda _: False)  # as it was a moment ago
        with pytest.raises(InputError, match="the workflow runs already"):
            runs.start(Order())
        assert {file.read_text() for file in files} == {'{"pid": 999999999}'}
    finally:
        lock.close()
        for file in files:
            file.unlink(missing_ok=True)


def test_the_state_is_told_while_the_next_run_begins(runs, tmp_path):
    folder = tmp_path / FOLDER
    hold(folder).close()
    order = {"time": 0.0, "site": None, "target": "all", "cores": 1, "expected_s": {}}
    write_json(folder / ORDER, order)
    done = threading.Event()

    def begin_and_end():
        while not done.is_set():
            write_json(folder / ENDED, {"code": 0, "stopped": False, "time": 1.0})
            for name in (EVENTS, OUTPUT):
                (folder / name).write_text("{}\n")
            for name in (ENDED, EVENTS, OUTPUT):
                (folder / name).unlink()

    other = threading.Thread(target=begin_and_end)
    other.start()
    try:
        statuses = {runs.state()["status"] for _ in range(300)}
    finally:
        done.set()
        other.join()
        (folder / ORDER).unlink()
    assert statuses <= {"done", "lost"}
