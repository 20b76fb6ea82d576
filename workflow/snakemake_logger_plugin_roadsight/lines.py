"""The lines, from what has been started and finished."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean, median
from typing import Any

_QUIET = {"all", "scene", "placement", "poles", "report"}
"""Steps that only gather others."""
_MOST_RUNNING = 3
"""Steps that are named as running; of more, their number is told."""


_FEWEST_KINDS = 4
"""Of steps that are done before the time that is left is told: after one, a run of 7 minutes was
told to last for 28; after four, one of 5 minutes for 8."""
_TOLD = ("roadsight: ", "Traceback ")
"""Beginnings of the line from which a log tells why its step failed."""
_LAST_LINES = 12
"""Of a log that tells nothing so."""


@dataclass
class _Job:
    rule: str
    words: str
    started_s: float | None = None


@dataclass
class Steps:
    """Steps of a run.

    Parameters
    ----------
    clock : seconds from any start.
    """

    clock: Callable[[], float]
    _jobs: dict[int, _Job] = field(default_factory=dict)
    _done: list[int] = field(default_factory=list)
    _seconds: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    _planned: dict[str, int] = field(default_factory=dict)
    _begun_s: float | None = None
    _failed: list[str] = field(default_factory=list)

    def planned(self, stats: Mapping[str, Any]) -> list[str]:
        """Steps by rule; the first line of a run."""
        self._planned = {
            str(rule): int(count) for rule, count in stats.items() if rule not in ("total", *_QUIET)
        }
        self._begun_s = self.clock()
        steps = sum(self._planned.values())
        return [f"{steps} {'step' if steps == 1 else 'steps'} to do"]

    def named(self, job: int, rule: str, wildcards: Mapping[str, Any]) -> None:
        """A job's rule and wildcards; its site comes first."""
        others = [f"{value}" for name, value in wildcards.items() if name != "site"]
        site = str(wildcards.get("site", ""))
        words = " ".join(word for word in (site, rule, *others) if word)
        before = self._jobs.get(job)
        self._jobs[job] = _Job(rule, words, None if before is None else before.started_s)

    def started(self, jobs: Iterable[int]) -> None:
        """Jobs begin now."""
        for number in jobs:
            self._jobs.setdefault(number, _Job("", "")).started_s = self.clock()

    def finished(self, number: int) -> None:
        """A job is done; its line is said with the progress that follows."""
        self._done.append(number)

    def failed(self, number: int, rule: str, logs: Iterable[str]) -> list[str]:
        """A step that failed: its name, why, and where to read more."""
        job = self._jobs.pop(number, None)
        words = rule if job is None or not job.words else job.words
        self._failed.append(words)
        found = [f"failed: {words}"]
        for path in logs:
            found += [f"  {line}" for line in _reason(Path(path))]
            found.append(f"  log: {path}")
        return found

    def stopped(self) -> list[str]:
        """The end of a run in which steps failed; each is named, for others went on."""
        names = ", ".join(dict.fromkeys(self._failed))
        return [f"stopped: {names} failed; what is finished stays, call again to go on"]

    def progressed(self, done: int, total: int) -> list[str]:
        """One line for each job that was finished since the last call."""
        found = []
        first = done - len(self._done)
        for place, number in enumerate(self._done, start=first + 1):
            job = self._jobs.pop(number, None)
            if job is None or not job.rule:
                continue
            now_s = self.clock()
            took_s = 0.0 if job.started_s is None else now_s - job.started_s
            self._seconds[job.rule].append(took_s)
            self._planned[job.rule] = max(self._planned.get(job.rule, 1) - 1, 0)
            if job.rule not in _QUIET:
                found.append((place, job, took_s))
        self._done.clear()
        tail = self._left(done, total)
        return [
            f"[{place}/{total}] {job.words} · {duration(took_s)}{tail if place == done else ''}"
            for place, job, took_s in found
        ] + ([self._end(total)] if done == total else [])

    def _left(self, done: int, total: int) -> str:
        """Time that is left, and what runs now."""
        running = [job.words for job in self._jobs.values() if job.started_s is not None]
        said = ""
        seconds = self.left_s()
        if seconds is not None and done < total:
            said = f" · about {duration(seconds)} left"
        if running:
            shown = ", ".join(running[:_MOST_RUNNING])
            more = len(running) - _MOST_RUNNING
            said += f" · running: {shown}{f' and {more} more' if more > 0 else ''}"
        return said

    def left_s(self) -> float | None:
        """Seconds that are left by what steps of the same kind took.

        Steps of kinds that are still to come take as long as the median kind: a run begins with its
        longest. None while too few kinds are known to tell it. The rate at which steps overlap so
        far is that of the rest.
        """
        kinds_s = {rule: fmean(found) for rule, found in self._seconds.items()}
        to_come = [rule for rule, count in self._planned.items() if count and rule not in kinds_s]
        if self._begun_s is None or not kinds_s or (to_come and len(kinds_s) < _FEWEST_KINDS):
            return None
        typical_s = median(kinds_s.values())
        work_s = sum(count * kinds_s.get(rule, typical_s) for rule, count in self._planned.items())
        took_s = sum(map(sum, self._seconds.values()))
        elapsed_s = max(self.clock() - self._begun_s, 1e-9)
        return work_s / max(took_s / elapsed_s, 1e-9)

    def _end(self, total: int) -> str:
        elapsed = 0.0 if self._begun_s is None else self.clock() - self._begun_s
        return f"done: {total} steps in {duration(elapsed)}"


def _reason(log: Path) -> list[str]:
    """Last lines of a log, from where it tells why the step failed."""
    try:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    told = [number for number, line in enumerate(lines) if line.startswith(_TOLD)]
    return lines[told[-1] :] if told else lines[-_LAST_LINES:]


def duration(seconds: float) -> str:
    """Time as people say it: ``4 s``, ``2:05 min``, ``1:02 h``."""
    whole = round(seconds)
    if whole < 60:
        return f"{seconds:.1f} s" if seconds < 10 else f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d} min"
    return f"{whole // 3600}:{whole % 3600 // 60:02d} h"
