"""How far a run is, and when it will end."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from roadsight.studio.run.run_events import TARGETS, Event

_SOON_S = 10.0
"""Before this much of a run has passed, its speed says nothing, and full use of the cores is
assumed."""
_MOST_TEXT = 2000
"""Characters of an error message that are kept."""


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
    work = _work(progress, expected_s, took)
    if work is None or not progress.jobs:
        return None, ""
    left = sum(count * work[rule] for rule, count in progress.counts.items())
    left += max(progress.total - sum(progress.counts.values()), 0) * work[""]
    done = sum(work.get(job.rule, work[""]) for job in progress.finished)
    done += sum(min(now_s - job.start_s, work.get(job.rule, work[""])) for job in progress.running)
    passed = now_s - min(job.start_s for job in progress.jobs.values())
    speed = done / passed if passed > _SOON_S and done > 0 else float(cores)
    known = sum(count for rule, count in progress.counts.items() if rule in expected_s)
    steps = sum(count for rule, count in progress.counts.items() if _works(rule))
    basis = f"earlier runs of {known} of {steps} steps" if known else f"{len(took)} steps so far"
    return max(left - done, 0.0) / speed, basis


def _works(rule: str) -> bool:
    return rule not in TARGETS


def _work(
    progress: Progress, expected_s: Mapping[str, float], took: list[float]
) -> dict[str, float] | None:
    """Seconds of a step of each planned rule; under "" of a step that was not planned."""
    known = [expected_s[rule] for rule in progress.counts if rule in expected_s]
    usual = known or took
    if not usual:
        return None
    mean = sum(usual) / len(usual)
    work = {rule: expected_s.get(rule, mean) if _works(rule) else 0.0 for rule in progress.counts}
    return work | {"": mean}
