import subprocess
import sys
from pathlib import Path

import pytest

from roadsight.io.records.run_records import Usage, last_usage

WORK = """
import argparse, sys, time
from roadsight.stages.command import run_stage

def work(arguments):
    until = time.process_time() + {cpu_s}
    block = bytearray({mib} * 2**20)
    block[::4096] = b"x" * len(block[::4096])
    while time.process_time() < until:
        pass

sys.exit(run_stage(argparse.ArgumentParser(), work, []))
"""


def used(tmp_path: Path, cpu_s: float, mib: int) -> Usage:
    log = tmp_path / f"{cpu_s}-{mib}.log"
    with log.open("wb") as stream:
        code = WORK.format(cpu_s=cpu_s, mib=mib)
        subprocess.run([sys.executable, "-c", code], stderr=stream, check=True)
    found = last_usage(log)
    assert found is not None
    return found


def test_a_short_stage_is_measured(tmp_path: Path) -> None:
    idle, busy = used(tmp_path, 0.0, 1), used(tmp_path, 0.3, 200)
    assert 0.25 < busy.cpu_s - idle.cpu_s < 0.8
    assert 190 < busy.peak_mib - idle.peak_mib < 210


def test_the_line_reads_back(tmp_path: Path) -> None:
    log = tmp_path / "stage.log"
    log.write_text(f"INFO {Usage(1.0, 2.0)}\nINFO {Usage(12.34, 567.0)}\n")
    assert last_usage(log) == Usage(12.34, 567.0)


@pytest.mark.parametrize("text", [None, "", "INFO tile 1 of 2\n"])
def test_no_line_no_usage(tmp_path: Path, text: str | None) -> None:
    log = tmp_path / "stage.log"
    if text is not None:
        log.write_text(text)
    assert last_usage(log) is None
