"""What a process has used of the machine: processor time and memory."""

from __future__ import annotations

import re
import resource
import sys
from dataclasses import dataclass
from pathlib import Path

_STATUS = Path("/proc/self/status")
"""Where Linux tells the peak of memory."""
_LINE = "used {cpu_s:.2f} CPU s, at most {peak_mib:.0f} MiB"
"""Last line of a step's log."""
_PATTERN = re.compile(r"used (\d+\.\d+) CPU s, at most (\d+) MiB")
"""The same, to be found again."""


@dataclass(frozen=True)
class Usage:
    """Use of a process and its children since it started.

    Parameters
    ----------
    cpu_s : processor time, user and system, s. peak_mib : most resident memory at one time, MiB.
    """

    cpu_s: float
    peak_mib: float

    def __str__(self) -> str:
        """The line that stages log and `last_usage` reads."""
        return _LINE.format(cpu_s=self.cpu_s, peak_mib=self.peak_mib)


def own_usage() -> Usage:
    """Use of this process and the children that it has waited for."""
    own, children = (
        resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    cpu_s = own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime
    unit = 2**20 if sys.platform == "darwin" else 2**10
    peak_mib = max(_own_peak_mib(own.ru_maxrss / unit), children.ru_maxrss / unit)
    return Usage(cpu_s, peak_mib)


def _own_peak_mib(otherwise: float) -> float:
    """High-water mark of this program; the one of ``getrusage`` may be that of its caller."""
    if not _STATUS.exists():
        return otherwise
    found = re.search(r"VmHWM:\s*(\d+) kB", _STATUS.read_text(encoding="ascii"))
    return int(found[1]) / 2**10 if found else otherwise


def last_usage(log: Path) -> Usage | None:
    """What a stage's log says at its end, or None if it does not say."""
    if not log.is_file():
        return None
    found = _PATTERN.findall(log.read_text(encoding="utf-8", errors="replace"))
    return Usage(float(found[-1][0]), float(found[-1][1])) if found else None
