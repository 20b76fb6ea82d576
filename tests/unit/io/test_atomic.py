import math
import os
import subprocess

import pytest

from roadsight.base.errors import InputError
from roadsight.io.records.atomic import Incomplete, WholeFile, atomic_path, read_json, write_json


def test_output_appears_under_its_name_only_after_success(tmp_path):
    target = tmp_path / "deep" / "er" / "out.txt"
    with atomic_path(target) as temporary:
        temporary.write_text("new")
        assert not target.exists()
        assert temporary.parent == target.parent
        assert temporary.suffix == ".txt"
    assert target.read_text() == "new"
    assert list(target.parent.iterdir()) == [target]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
@pytest.mark.parametrize("old", [[b"old"], []])
def test_failure_keeps_the_old_file_and_leaves_nothing_behind(tmp_path, error, old):
    target = tmp_path / "out.bin"
    for content in old:
        target.write_bytes(content)
    with pytest.raises(error, match="half way"), atomic_path(target) as temporary:
        temporary.write_bytes(b"ne")
        raise error("half way")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == old


def test_a_block_that_writes_nothing_fails_and_keeps_the_old_file(tmp_path):
    target = tmp_path / "out.txt"
    target.write_text("old")
    with pytest.raises(FileNotFoundError), atomic_path(target):
        pass
    assert target.read_text() == "old"


def test_json_is_sorted_readable_and_read_back(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"b": [1, 2.5], "a": "grüße"})
    assert path.read_text(encoding="utf-8").index('"a"') < path.read_text().index('"b"')
    assert "grüße" in path.read_text(encoding="utf-8")
    assert read_json(path) == {"a": "grüße", "b": [1, 2.5]}


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_json_refuses_what_other_readers_cannot_read(tmp_path, value):
    path = tmp_path / "a.json"
    write_json(path, {"kept": True})
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, {"lost": value})
    assert read_json(path) == {"kept": True}


def test_what_a_killed_process_left_is_removed(tmp_path):
    target = tmp_path / "cloud [1].parquet"
    ended = subprocess.Popen(["true"])
    ended.wait()
    with atomic_path(target) as temporary:
        temporary.write_text("whole")
        own = str(os.getpid())
        names = [temporary.name.replace(own, str(pid)) for pid in (ended.pid, 1)]
    for name in (*names, f"{names[0]}-journal", f".other{names[0]}"):
        (tmp_path / name).write_text("half")
    with atomic_path(target) as temporary:
        temporary.write_text("new")
    # The temporary of a process that still runs, and of another file, are left alone.
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {target.name, names[1], f".other{names[0]}"}


def test_a_file_that_is_no_json_is_told(tmp_path):
    path = tmp_path / "a.json"
    for content in (b'{"a": [1, 2', b"", b"\xff\xfe", b"[" * 100_000):
        path.write_bytes(content)
        with pytest.raises(InputError, match="JSON"):
            read_json(path)
    with pytest.raises(InputError, match="JSON"):
        read_json(tmp_path / "none.json")


class Lines(WholeFile):
    """Lines of text; the last is held back until the block ends well."""

    def __init__(self, path, fails_at=""):
        super().__init__(path)
        self.fails_at, self.closed, self.wanted = fails_at, 0, True

    def _fail(self, step):
        if step == self.fails_at:
            raise RuntimeError(step)

    def _open(self, temporary):
        self.file = temporary.open("w")
        self._fail("open")

    def write(self, line):
        self.file.write(f"{line}\n")
        self._fail("write")

    def _complete(self):
        if not self.wanted:
            raise Incomplete
        self.file.write("end\n")
        self._fail("complete")

    def _close(self):
        self.closed += 1
        self.file.close()
        self._fail("close")

    def _check(self):
        self._fail("check")


def test_a_file_written_piece_by_piece_appears_after_its_block(tmp_path):
    target = tmp_path / "a.txt"
    with Lines(target) as lines:
        lines.write("one")
        assert not target.exists()
    assert target.read_text() == "one\nend\n"
    assert lines.closed == 1
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("step", ["open", "write", "complete", "close", "check"])
def test_a_step_that_fails_leaves_the_old_file(tmp_path, step):
    target = tmp_path / "a.txt"
    target.write_text("old")
    lines = Lines(target, step)
    with pytest.raises(RuntimeError, match=step), lines:
        lines.write("one")
    assert lines.closed == (step != "open")
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_the_first_error_is_told_and_not_that_of_closing(tmp_path):
    with pytest.raises(KeyError, match="first"), Lines(tmp_path / "a.txt", "close"):
        raise KeyError("first")
    assert list(tmp_path.iterdir()) == []


def test_a_file_can_be_dropped_without_an_error_and_kept_early(tmp_path):
    with Lines(tmp_path / "a.txt") as lines:
        lines.wanted = False
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(KeyError), Lines(tmp_path / "b.txt") as lines:
        lines.keep()
        assert (tmp_path / "b.txt").read_text() == "end\n"
        raise KeyError
    assert lines.closed == 1
    assert (tmp_path / "b.txt").exists()
