"""When, from what code, and at what cost a site's results were made."""

from __future__ import annotations

import csv
import os
import re
import resource
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from roadsight.base.arrays import AnyPath

PACKAGE = "roadsight"
_UNKNOWN = "unknown"
_HOUR_S = 3600


@dataclass(frozen=True)
class RunRecord:
    """Provenance of a site's results.

    Parameters
    ----------
    started, ended : of the first and of the last step whose results there are, ISO 8601, UTC.
    version : of the package. commit : of its code, with a
        plus where files differ from it.
    packages : versions by name of what the package stands on.
    cpu_s, wall_s : sums over the site's steps, as Snakemake measured them. peak_mib : of any step.
    steps : number of those steps.
    """

    started: str
    ended: str
    version: str
    commit: str
    packages: dict[str, str]
    cpu_s: float
    wall_s: float
    peak_mib: float
    steps: int

    def to_dict(self) -> dict[str, Any]:
        """JSON content; `from_dict` reads it back."""
        return asdict(self)

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> RunRecord:
        """Record from the content of ``run.json`` (other keys are ignored)."""
        return cls(**{name: content[name] for name in cls.__dataclass_fields__})

    @property
    def date(self) -> str:
        """Day on which the last step ended."""
        return self.ended[:10]

    @property
    def elapsed_s(self) -> float:
        """From the start of the first step to the end of the last."""
        first, last = map(datetime.fromisoformat, (self.started, self.ended))
        return (last - first).total_seconds()

    def line(self) -> str:
        """What the head of each page says."""
        return f"{self.date} · {PACKAGE} {self.version} · commit {self.commit}"

    def rows(self) -> list[list[str]]:
        """Name and value, for a table."""
        first, last = (text[:16].replace("T", " ") for text in (self.started, self.ended))
        hours, rest_s = divmod(self.elapsed_s, _HOUR_S)
        minutes, seconds = divmod(rest_s, 60)
        took = f"{hours:.0f} h {minutes:.0f} min" if hours else f"{minutes:.0f} min {seconds:.0f} s"
        return [
            ["Date", self.date],
            ["Version", f"{PACKAGE} {self.version}"],
            ["Commit", self.commit],
            ["Steps, up to the summary", str(self.steps)],
            ["First step to last", f"{first} to {last} UTC, {took}"],
            ["CPU time", f"{self.cpu_s:.0f} s"],
            ["Sum of the steps' wall time", f"{self.wall_s:.0f} s"],
            ["Most memory of a step", f"{self.peak_mib:.0f} MiB"],
            ["Packages", ", ".join(f"{name} {found}" for name, found in self.packages.items())],
        ]


# CPU and wall seconds, MiB, start (epoch) of a step, and whether a site has it once.
_Step = tuple[float, float, float, float, bool]


def run_record(benchmarks: Iterable[AnyPath], version: str) -> RunRecord:
    """The record of a run whose last step is this one.

    Parameters
    ----------
    benchmarks : folders of Snakemake's benchmark files of a site; one that is missing counts
        nothing.

    Notes
    -----
    A step's benchmark file is written at its end. ``SOURCE_DATE_EPOCH``, the convention of
    reproducible builds, stands for the clock.
    """
    used = [row for folder in benchmarks for row in _steps(Path(folder))]
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    now = float(epoch) if epoch.isdigit() else datetime.now(UTC).timestamp()
    return RunRecord(
        _text(min([now, *(row[3] for row in used)])),
        _text(now),
        version,
        _commit(),
        _packages(),
        sum(row[0] for row in used),
        sum(row[1] for row in used),
        max((row[2] for row in used), default=0.0),
        len(used),
    )


def _text(epoch_s: float) -> str:
    return datetime.fromtimestamp(epoch_s, UTC).replace(tzinfo=None).isoformat(timespec="seconds")


def _commit() -> str:
    """Short name of the code's commit, where it stands in a git checkout."""
    here = Path(__file__).parent
    asked = ["git", "describe", "--always", "--abbrev=10", "--dirty=+", "--exclude=*"]
    try:
        found = subprocess.run(asked, cwd=here, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return _UNKNOWN
    return found.stdout.strip() or _UNKNOWN


def _packages() -> dict[str, str]:
    """Versions of the direct dependencies."""
    found: dict[str, str] = {}
    for requirement in metadata.requires(PACKAGE) or []:
        text, _, marker = requirement.partition(";")
        if "extra" in marker:
            continue
        name = text.split("[")[0].split(">")[0].split("=")[0].split("<")[0].strip()
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = _UNKNOWN
    return found


def _steps(folder: Path) -> list[_Step]:
    """Steps of a folder of benchmark files.

    Those of shards, plans and rounds that ended before the cloud was read again are left out. Steps
    that are one for a site write over their files, so that the first of these bounds all.
    """
    steps: list[_Step] = []
    for path in sorted(folder.rglob("*.tsv")):
        with path.open(encoding="utf-8", newline="") as lines:
            for row in csv.DictReader(lines, delimiter="\t"):
                cpu_s, wall_s, mib = (_number(row.get(key)) for key in ("cpu_time", "s", "max_rss"))
                start = path.stat().st_mtime - wall_s
                steps.append((cpu_s, wall_s, mib, start, path.parent == folder))
    first = min((step[3] for step in steps if step[4]), default=0.0)
    return [step for step in steps if step[3] + step[1] >= first]


def _number(text: str | None) -> float:
    """A figure; steps too short to be measured have none."""
    try:
        return float(text or 0.0)
    except ValueError:
        return 0.0


# What a process has used of the machine: processor time and memory.

_STATUS = Path("/proc/self/status")  # where Linux tells the peak of memory
_LINE = "used {cpu_s:.2f} CPU s, at most {peak_mib:.0f} MiB"  # last line of a step's log
_PATTERN = re.compile(r"used (\d+\.\d+) CPU s, at most (\d+) MiB")  # the same, to be found again


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
    own_mib = own.ru_maxrss / unit
    if _STATUS.exists():  # the peak of this program; that of `getrusage` may be its caller's
        found = re.search(r"VmHWM:\s*(\d+) kB", _STATUS.read_text(encoding="ascii"))
        own_mib = int(found[1]) / 2**10 if found else own_mib
    return Usage(cpu_s, max(own_mib, children.ru_maxrss / unit))


def last_usage(log: Path) -> Usage | None:
    """What a stage's log says at its end, or None if it does not say."""
    if not log.is_file():
        return None
    found = _PATTERN.findall(log.read_text(encoding="utf-8", errors="replace"))
    return Usage(float(found[-1][0]), float(found[-1][1])) if found else None
