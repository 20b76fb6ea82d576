"""How far a run is, and when it will end."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

import roadsight
from roadsight.base.errors import InputError
from roadsight.studio.project import Project
from roadsight.studio.requests import Body

# Before this much of a run has passed, its speed says nothing, and full use of the cores is assumed
_SOON_S = 10.0
_MOST_TEXT = 2000  # Characters of an error message that are kept


@dataclass
class Job:
    """A step that has begun; end_s None while it runs; times in s since the epoch."""

    number: int
    rule: str
    wildcards: dict[str, str]
    logs: list[str]
    start_s: float
    end_s: float | None = None
    failed: bool = False

    def described(self, now_s: float) -> dict[str, Any]:
        """As the page shows it."""
        end_s = now_s if self.end_s is None else self.end_s
        return {
            "job": self.number,
            "rule": self.rule,
            "wildcards": self.wildcards,
            "seconds": max(end_s - self.start_s, 0.0),
            "log": bool(self.logs),
        }


@dataclass
class Progress:
    """What events say of a run.

    Parameters
    ----------
    jobs : those that have begun, by number. counts : steps of each rule as first planned.
    done, total : steps as Snakemake counts them. messages : errors that are not a step's.
    """

    jobs: dict[int, Job] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    done: int = 0
    total: int = 0
    messages: list[str] = field(default_factory=list)

    def add(self, event: Event) -> None:
        """Take up one event."""
        kind = event["event"]
        if kind == "run_info":
            stats = event.get("stats") or {}
            self.counts = {rule: int(count) for rule, count in stats.items() if rule != "total"}
            self.total = max(self.total, sum(self.counts.values()))
        elif kind == "job_info":
            self.jobs[event["jobid"]] = Job(
                event["jobid"],
                event["rule_name"],
                dict(event.get("wildcards") or {}),
                list(event.get("log") or []),
                event["time"],
            )
        elif kind in ("job_finished", "job_error"):
            job = self.jobs.get(event["job_id"] if kind == "job_finished" else event["jobid"])
            if job is not None:
                job.end_s, job.failed = event["time"], kind == "job_error"
        elif kind == "progress":
            self.done, self.total = int(event["done"]), int(event["total"])
        elif kind == "error":
            self.messages.append(str(event.get("text") or "")[:_MOST_TEXT])

    @property
    def failed(self) -> list[Job]:
        """Steps that failed and did not succeed in a later attempt."""
        return [job for job in self.jobs.values() if job.failed]

    @property
    def running(self) -> list[Job]:
        """Steps that have begun and not ended."""
        return [job for job in self.jobs.values() if job.end_s is None]

    @property
    def finished(self) -> list[Job]:
        """Steps that ended well, the last one first."""
        ended = [job for job in self.jobs.values() if job.end_s is not None and not job.failed]
        return sorted(ended, key=lambda job: -(job.end_s or 0.0))


def progress_of(events: Iterable[Event]) -> Progress:
    """Progress after all events."""
    progress = Progress()
    for event in events:
        progress.add(event)
    return progress


def remaining(
    progress: Progress, expected_s: Mapping[str, float], cores: int, now_s: float
) -> tuple[float | None, str]:
    """Seconds until a run ends, and on what that rests.

    Each step counts by what steps of its rule took in earlier runs; where that is unknown, by the
    mean of this run's steps. The speed is that of the run so far: work done by time passed.

    Returns
    -------
    None while nothing is known.
    """
    took = [job.described(now_s)["seconds"] for job in progress.finished if _works(job.rule)]
    usual = [expected_s[rule] for rule in progress.counts if rule in expected_s] or took
    if not usual or not progress.jobs:
        return None, ""
    # Seconds of a step of each planned rule, and of a step that was not planned.
    mean = sum(usual) / len(usual)
    work = {rule: expected_s.get(rule, mean) if _works(rule) else 0.0 for rule in progress.counts}
    left = sum(count * work[rule] for rule, count in progress.counts.items())
    left += max(progress.total - sum(progress.counts.values()), 0) * mean
    done = sum(work.get(job.rule, mean) for job in progress.finished)
    done += sum(min(now_s - job.start_s, work.get(job.rule, mean)) for job in progress.running)
    passed = now_s - min(job.start_s for job in progress.jobs.values())
    speed = done / passed if passed > _SOON_S and done > 0 else float(cores)
    known = sum(count for rule, count in progress.counts.items() if rule in expected_s)
    steps = sum(count for rule, count in progress.counts.items() if _works(rule))
    basis = f"earlier runs of {known} of {steps} steps" if known else f"{len(took)} steps so far"
    return max(left - done, 0.0) / speed, basis


def _works(rule: str) -> bool:
    return rule not in TARGETS


# What Snakemake says of a run through the project's logger plugin, and what follows from it.

# What may be asked for: the rules of the Snakefile that only name files
TARGETS = ("all", "placement", "poles", "scene", "report", "tradeoffs", "audit", "hardcases")
CHECKPOINT = "profile_scene"  # The rule after which Snakemake may find further steps

# How Snakemake begins each reason for a job; files may follow
_HEADS = (
    "Missing output files", "Incomplete output files", "Updated input files",
    "Input files updated by another job", "Set of input files has changed", "Code has changed",
    "Params have changed", "Software environment definition has changed", "Forced execution",
)  # fmt: skip

# The reason that is another job's, not a cause of its own
_FOLLOWS = "Input files updated by another job"
# Reasons are parted by semicolons, and names of files may hold some
_SPLIT = re.compile(rf"; (?={'|'.join(map(re.escape, _HEADS))})")
_LONGEST = 300  # Characters of a reason; longer ones are cut
_MOST_FILES = 4  # Files that a reason names; of more, their number is told
Event = Mapping[str, Any]


def read_events(path: Path) -> list[dict[str, Any]]:
    """Events of a file that may still be written: an unfinished last line is left out."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return []
    found = []
    for line in text.split("\n")[:-1]:
        try:
            event = json.loads(line)
        except ValueError:
            continue
        if isinstance(event, dict) and isinstance(event.get("event"), str):
            found.append(event)
    return found


def causes(reason: str) -> list[str]:
    """Parts of a reason as Snakemake words it, long lists of files cut."""
    found = []
    for part in filter(None, _SPLIT.split(reason)):
        head, colon, rest = part.partition(": ")
        files = rest.split(", ")
        if head.endswith("files") or head == _FOLLOWS:
            more = len(files) - _MOST_FILES
            rest = ", ".join(files[:_MOST_FILES]) + (f" and {more} more" if more > 0 else "")
        text = f"{head}{colon}{rest}"
        found.append(text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…")
    return found


def is_own(cause: str) -> bool:
    """Whether a cause is the step's own, not that a step before it runs."""
    return not cause.startswith(_FOLLOWS)


def plan(events: Iterable[Event], expected_s: Mapping[str, float]) -> dict[str, Any]:
    """What a dry run would do and why, one entry for each rule in the order of the run.

    Parameters
    ----------
    expected_s : seconds of a step of each rule, where known.

    Returns
    -------
    rules : rule, jobs, own (jobs that are stale by themselves), why (cause and number of jobs; own
    causes first), seconds (None if unknown); jobs; seconds of all that are known; known : jobs
    with known seconds; open : whether more steps may be found on the way.
    """
    by_rule: dict[str, list[Event]] = {}
    for event in events:
        if event["event"] == "job_info" and event["rule_name"] not in TARGETS:
            by_rule.setdefault(event["rule_name"], []).append(event)
    rules = [_planned(rule, jobs, expected_s) for rule, jobs in by_rule.items()]
    return {
        "rules": rules,
        "jobs": sum(rule["jobs"] for rule in rules),
        "seconds": sum(rule["seconds"] or 0.0 for rule in rules),
        "known": sum(rule["jobs"] for rule in rules if rule["seconds"] is not None),
        "open": CHECKPOINT in by_rule,
    }


def _planned(rule: str, jobs: Sequence[Event], expected_s: Mapping[str, float]) -> dict[str, Any]:
    found = [causes(job.get("reason") or "") for job in jobs]
    counted = Counter(cause for parts in found for cause in parts)
    why = sorted(counted.items(), key=lambda item: (not is_own(item[0]), -item[1]))
    seconds = expected_s.get(rule)
    return {
        "rule": rule,
        "jobs": len(jobs),
        "own": sum(any(map(is_own, parts)) for parts in found),
        "why": [{"text": text, "jobs": count} for text, count in why],
        "sites": sorted({(job.get("wildcards") or {}).get("site", "") for job in jobs} - {""}),
        "seconds": None if seconds is None else seconds * len(jobs),
    }


# Calls of Snakemake: only with targets and sites of fixed lists, and never through a shell.

_PACKAGES = Path(roadsight.__file__).resolve().parents[1]
_OURS = "roadsight: "
_DRY_RUN_S = 300.0  # Limit of a dry run, which takes longer with the steps of all sites
_UNLOCK_S = 120.0  # Limit of removing a lock


class Order(Body):
    """What is to be made: for one site by the name of its file, or for those of the settings."""

    site: Annotated[str, Field(max_length=200)] | None = None
    target: Literal[
        "all", "placement", "poles", "scene", "report", "tradeoffs", "audit", "hardcases"
    ] = "all"
    cores: Annotated[int, Field(ge=1, le=1024)] = 2


def command(project: Project, order: Order, events: Path) -> list[str]:
    """Command line of an order.

    Raises
    ------
    InputError : no such site.
    """
    config = []
    if order.site is not None:
        if order.site not in project.stems():
            raise InputError("no such site", where="studio", found=order.site)
        config = ["--config", f"sites={json.dumps([order.site])}"]
    return [
        sys.executable,
        "-m",
        "snakemake",
        order.target,
        "--cores",
        str(order.cores),
        "--nocolor",
        "--logger",
        "roadsight",
        "--logger-roadsight-events",
        str(events),
        *config,
    ]


def environment() -> dict[str, str]:
    """Environment in which Snakemake and its steps find this package."""
    found = [str(_PACKAGES), *filter(None, [os.environ.get("PYTHONPATH")])]
    programs = [str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)]
    return os.environ | {"PYTHONPATH": os.pathsep.join(found), "PATH": os.pathsep.join(programs)}


def dry_run(project: Project, order: Order) -> list[dict[str, Any]]:
    """Events of a dry run.

    Raises
    ------
    InputError : what Snakemake says where it cannot plan the run, or it takes too long.
    """
    scratch = project.inside(".snakemake/roadsight")
    scratch.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=scratch, prefix="dry-run-") as folder:
        events = Path(folder) / "events.jsonl"
        result = _call([*command(project, order, events), "--dry-run"], project, _DRY_RUN_S)
        found = read_events(events)
        if result.returncode != 0:
            raise InputError(
                complaint(result.stdout, progress_of(found).messages), where="the workflow"
            )
        return found


def unlock(project: Project) -> None:
    """Remove the lock that a killed run left behind.

    Raises
    ------
    InputError : what Snakemake says where it cannot.
    """
    result = _call([sys.executable, "-m", "snakemake", "--unlock"], project, _UNLOCK_S)
    if result.returncode != 0:
        raise InputError(complaint(result.stdout, []), where="snakemake --unlock")


def complaint(output: str, told: list[str]) -> str:
    """What went wrong, of the output of a call that failed and of the errors that it told."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    ours = [line.removeprefix(_OURS) for line in lines if line.startswith(_OURS)]
    return next(iter(ours + told), lines[-1] if lines else "ended without a word")


def _call(line: list[str], project: Project, timeout_s: float) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            line,
            cwd=project.root,
            env=environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise InputError(f"did not answer in {timeout_s:.0f} s", where="snakemake") from error
