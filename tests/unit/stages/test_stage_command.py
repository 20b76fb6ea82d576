import argparse
import errno
import os
import signal
import subprocess
import sys

import pytest

from roadsight.base.errors import InputError
from roadsight.io.records.atomic import atomic_path, write_json
from roadsight.stages.command import Command, run_stage
from roadsight.stages.placement import place_targets
from roadsight.stages.poles import rate_hazard


@pytest.fixture
def run(tmp_path, capsys):
    """Run a stage with an input file and an output; gives exit code and messages."""
    parser = argparse.ArgumentParser(prog="a_stage")
    parser.add_argument("--given", nargs="*")
    parser.add_argument("--out")
    paths = [tmp_path / "a.json", tmp_path / "b.json"]
    for path in paths:
        path.write_text("{}")

    def call(stage):
        code = run_stage(
            parser, stage, ["--given", *map(str, paths), "--out", str(tmp_path / "out.json")]
        )
        lines = capsys.readouterr().err.splitlines()
        return code, [line for line in lines if line.startswith("roadsight: ")]

    return call


def test_input_that_changes_during_a_stage_is_noticed(run, tmp_path):
    def stage(arguments):
        write_json(arguments.out, {})
        (tmp_path / "b.json").write_text("{} ")

    code, messages = run(stage)
    assert code == 2
    assert len(messages) == 1
    assert f"{tmp_path / 'b.json'}: changed while it was read" in messages[0]


def test_input_that_vanishes_during_a_stage_is_noticed(run, tmp_path):
    assert run(lambda _: (tmp_path / "a.json").unlink())[0] == 2


def test_outputs_of_an_earlier_run_may_be_replaced(run, tmp_path):
    stage = lambda arguments: write_json(arguments.out, {"a": os.urandom(4).hex()})  # noqa: E731
    assert [run(stage)[0] for _ in range(2)] == [0, 0]


def test_too_little_memory_is_told(run):
    def stage(_):
        raise MemoryError("Unable to allocate 9 GiB")

    code, messages = run(stage)
    assert code == 2
    assert messages[0].startswith("roadsight: a_stage: ran out of memory")


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_full_disk_is_told(run, number):
    def stage(_):
        raise OSError(number, os.strerror(number), "some/file")

    assert run(stage) == (2, ["roadsight: some/file: the disk is full; free some."])


def test_other_failures_of_the_system_keep_their_traceback(run):
    def stage(_):
        raise PermissionError(errno.EACCES, "Permission denied", "some/file")

    with pytest.raises(PermissionError):
        run(stage)


def test_termination_leaves_no_temporary_file(run, tmp_path):
    def stage(arguments):
        with atomic_path(arguments.out) as temporary:
            temporary.write_text("half")
            os.kill(os.getpid(), signal.SIGTERM)

    before = sorted(tmp_path.iterdir())
    with pytest.raises(SystemExit) as ended:
        run(stage)
    assert ended.value.code == 143
    assert sorted(tmp_path.iterdir()) == before
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_a_stage_does_not_look_for_garbage_when_it_ends():
    code = """
import atexit, gc
atexit.register(lambda: print(gc.isenabled(), gc.get_freeze_count() > 1000))
import roadsight.stages.command
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == ["True", "True"]


def message_of(stage: Command, paths, capsys):
    """Message of a stage all of whose required options name a file that is not there."""
    needed = [action for action in stage.parser()._actions if action.required]
    given = [
        f"{one.option_strings[-1]}={1 if one.type in (int, float) else paths(one.dest)}"
        for one in needed
    ]
    assert stage([*given]) == 2
    (message,) = capsys.readouterr().err.splitlines()[-1:]
    return message


@pytest.mark.parametrize(
    ("stage", "chapter"), [(place_targets, "placement"), (rate_hazard, "poles")]
)
def test_messages_of_stages_begin_with_the_site(stage, chapter, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    # A file of the results names it already.
    own = message_of(stage.main, lambda name: f"results/here/{chapter}/{name}", capsys)
    assert own.startswith(f"roadsight: results/here/{chapter}/")
    # Files of a user, of several sites, and of evidence tell no site.
    users = message_of(stage.main, lambda name: f"/home/results/here/{chapter}/{name}", capsys)
    assert "site here" not in users
    two = message_of(stage.main, lambda name: f"results/{name}/{chapter}/x", capsys)
    assert not two.startswith("roadsight: site")
    page = message_of(stage.main, lambda name: f"results/tradeoffs/{name}", capsys)
    assert not page.startswith("roadsight: site")


@pytest.mark.parametrize(
    ("where", "before"),
    [
        ("site here, plan p", ""),
        ("results/here/scene/cloud.parquet", ""),
        ("config/sites/here.yaml", ""),
        ("config/sites/hereabouts.yaml", "site here: "),
        ("results/there/scene/cloud.parquet", "site here: "),
        ("/data/cloud.laz", "site here: "),
        ("placement.remove", "site here: "),
    ],
)
def test_a_site_is_named_once(where, before, capsys):
    def stage(_):
        raise InputError("too few", where=where)

    parser = argparse.ArgumentParser()
    parser.add_argument("--out")
    assert run_stage(parser, stage, ["--out", "results/here/scene/dem.tif"]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == f"roadsight: {before}{where}: too few."
