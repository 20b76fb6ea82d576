from __future__ import annotations

import math
import os
import subprocess

import pytest

from roadsight.base.errors import InputError
from roadsight.io.records.atomic import atomic_path, read_json, write_json


def test_output_appears_under_its_name_only_after_success(tmp_path):
    target = tmp_path / "deep" / "er" / "out.txt"
    with atomic_path(target) as temporary:
        temporary.write_text("new")
        assert not target.exists()
        assert temporary.parent == target.parent
        assert temporary.suffix == ".txt"
    assert target.read_text() == "new"
    assert list(target.parent.iterdir()) == [target]


def test_failure_keeps_the_old_file_and_leaves_nothing_behind(tmp_path):
    target = tmp_path / "out.bin"
    target.write_bytes(b"old")
    with pytest.raises(RuntimeError, match="half way"), atomic_path(target) as temporary:
        temporary.write_bytes(b"ne")
        raise RuntimeError("half way")
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_failure_without_an_old_file_leaves_no_file(tmp_path):
    with pytest.raises(KeyboardInterrupt), atomic_path(tmp_path / "out.bin") as temporary:
        temporary.write_bytes(b"ne")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


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
