"""What Snakemake says of a run through the project's logger plugin, and what follows from it."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

TARGETS = ("all", "placement", "poles", "scene", "report", "tradeoffs", "audit", "hardcases")
"""What may be asked for: the rules of the Snakefile that only name files."""
CHECKPOINT = "profile_scene"
"""The rule after which Snakemake may find further steps."""
_HEADS = (
    "Missing output files",
    "Incomplete output files",
    "Updated input files",
    "Input files updated by another job",
    "Set of input files has changed",
    "Code has changed",
    "Params have changed",
    "Software environment definition has changed",
    "Forced execution",
)
"""How Snakemake begins each reason for a job; files may follow."""
_FOLLOWS = "Input files updated by another job"
"""The reason that is another job's, not a cause of its own."""
_SPLIT = re.compile(rf"; (?={'|'.join(map(re.escape, _HEADS))})")
"""Reasons are parted by semicolons, and names of files may hold some."""
_LONGEST = 300
"""Characters of a reason; longer ones are cut."""
_MOST_FILES = 4
"""Files that a reason names; of more, their number is told."""

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
    return [_shortened(part) for part in _SPLIT.split(reason) if part]


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


def _shortened(cause: str) -> str:
    head, colon, rest = cause.partition(": ")
    files = rest.split(", ")
    if head.endswith("files") or head == _FOLLOWS:
        more = len(files) - _MOST_FILES
        rest = ", ".join(files[:_MOST_FILES]) + (f" and {more} more" if more > 0 else "")
    text = f"{head}{colon}{rest}"
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"
