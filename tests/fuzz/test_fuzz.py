"""Damaged files never end in a traceback, a crash, a hang or without memory.

What a number of a reader's damaged files shows is repeated by
``python -m tests.fuzz.worker READER NUMBER 1 /tmp``.
"""

import os
import selectors
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.conftest import PROJECT
from tests.fuzz.readers import READERS

LONGEST_S = 30.0
"""What reading one small file may take on a busy machine."""

FEW, MANY = 200, int(os.environ.get("ROADSIGHT_FUZZ", "500"))
"""Files of each reader, the same in every run; more with ROADSIGHT_FUZZ=10000."""


def read_damaged(name: str, count: int, folder: Path) -> list[str]:
    """What went wrong, file by file; a worker that dies is replaced behind the file it died of."""
    problems: list[str] = []
    first = 0
    while first < count:
        lines, ended = _run(name, first, count - first, folder)
        problems += [line for line in lines if line.startswith("bad")]
        reached = [int(line.split()[1]) for line in lines if line.startswith("at")]
        if ended == "":
            break
        assert reached, f"{name}: the worker did not start: {ended}"
        problems.append(f"bad {reached[-1]} {ended}")
        first = reached[-1] + 1
    return problems


def _run(name: str, first: int, count: int, folder: Path) -> tuple[list[str], str]:
    """Lines of one worker, and how it ended if not well."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.fuzz.worker", name, str(first), str(count), str(folder)],
        cwd=PROJECT,
        env=os.environ | {"PYTHONPATH": f"{PROJECT / 'workflow'}{os.pathsep}{PROJECT}"},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    lines, rest = [], b""
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        until = time.monotonic() + 4 * LONGEST_S
        while time.monotonic() < until and selector.select(until - time.monotonic()):
            content = os.read(process.stdout.fileno(), 1 << 16)
            if not content:
                break
            *whole, rest = (rest + content).split(b"\n")
            lines += [line.decode(errors="replace") for line in whole]
            until = time.monotonic() + LONGEST_S
        else:
            process.kill()
            process.wait()
            return lines, "hangs"
    code = process.wait()
    return lines, "" if code == 0 else f"ends the process ({code})"


@pytest.mark.parametrize("name", READERS)
def test_whole_files_are_read(name, tmp_path):
    reader = READERS[name]
    for number, content in enumerate(reader.seeds(tmp_path)):
        folder = tmp_path / f"in{number}"
        folder.mkdir()
        path = folder / f"whole{reader.suffixes[0]}"
        path.write_bytes(content)
        if name not in ("geojson", "geopackage", "site", "network", "image"):
            reader.read(path)


@pytest.mark.parametrize("name", READERS)
def test_a_few_damaged_files(name, tmp_path):
    assert read_damaged(name, FEW, tmp_path) == []


@pytest.mark.full
@pytest.mark.parametrize("name", READERS)
def test_many_damaged_files(name, tmp_path):
    assert read_damaged(name, MANY, tmp_path) == []
