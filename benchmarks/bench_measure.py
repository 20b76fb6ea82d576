"""What all benchmark programs share: CPU seconds, added peak memory, one row per comparison."""

from __future__ import annotations

import ctypes
import gc
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple

Cost = tuple[str, float, float | None]
"""Name, CPU seconds, added peak MiB."""

Size = Literal["quick", "usual", "full"]
"""Workloads: small ones for tests, those of every day, and the published ones with their tens."""

_LAUNCHER = """
import json, os, subprocess, sys, time
start = time.monotonic()
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
_, status, used = os.wait4(child.pid, 0)
wall_s, cpu_s = time.monotonic() - start, used.ru_utime + used.ru_stime
print(json.dumps([os.waitstatus_to_exitcode(status), cpu_s, wall_s, used.ru_maxrss]))
"""


class Used(NamedTuple):
    """What a program took: CPU seconds, seconds by the clock, peak MiB."""

    cpu_s: float
    wall_s: float
    peak_mib: float


def measured(function: Callable[[], Any]) -> tuple[Any, float, float | None]:
    """Result, CPU seconds and added peak memory in MiB (None where the system does not tell).

    Freed memory goes back to the system first: what a kernel reuses would not be seen to be added.
    """
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
    before = _memory_mib(reset=True)
    start = time.process_time()
    result = function()
    cpu_s = time.process_time() - start
    after = _memory_mib(reset=False)
    known = before is not None and after is not None
    return result, cpu_s, round(max(after - before, 0.0), 1) if known else None


def measured_apart(command: list[str], threads: int = 1) -> Used:
    """What a program takes, its start included, with as many threads where it can use them.

    A small process starts it: the system counts a parent's memory as its child's.

    Raises
    ------
    RuntimeError : it failed.
    """
    told = subprocess.run(
        [sys.executable, "-c", _LAUNCHER, *command],
        env=os.environ | {"RAYON_NUM_THREADS": str(threads)},
        stdout=subprocess.PIPE,
        check=True,
    ).stdout
    failed, cpu_s, wall_s, peak_kib = json.loads(told)
    if failed:
        raise RuntimeError(f"{' '.join(command)} failed")
    return Used(cpu_s, wall_s, round(peak_kib / 1024, 1))


def _memory_mib(reset: bool) -> float | None:
    try:
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
        status = Path("/proc/self/status").read_text()
    except OSError:
        return None
    field = "VmRSS:" if reset else "VmHWM:"
    return int(status.split(field)[1].split()[0]) / 1024


def row(
    kernel: str,
    ours: Cost,
    against: Cost,
    agreement: tuple[float, str],
    workload: str,
    wall_s: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """One comparison; ``wall_s`` by the clock, of both, where threads make it another story."""
    clock = {} if wall_s is None else {"wall_s_ours": wall_s[0], "wall_s_against": wall_s[1]}
    return clock | {
        "kernel": kernel,
        "ours": ours[0],
        "against": against[0],
        "cpu_s_ours": ours[1],
        "cpu_s_against": against[1],
        "ratio": against[1] / max(ours[1], 1e-9),
        "peak_mib_ours": ours[2],
        "peak_mib_against": against[2],
        "agreement": None if math.isnan(agreement[0]) else round(agreement[0], 4),
        "agreement_metric": agreement[1],
        "workload": workload,
    }
