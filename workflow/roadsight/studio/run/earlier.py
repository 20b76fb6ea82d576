"""What work steps were in earlier runs, by the benchmark files that they left.

Work is time of the processor: the time that passed depends on what else the machine did then.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from statistics import mean

_CPU, _WALL = "cpu_time", "s"


def earlier_seconds(results: Path, sites: Collection[str]) -> dict[str, float]:
    """Mean seconds of work of a step of each rule: at the given sites, else at all others.

    Parameters
    ----------
    results : folder of the results, with ``<site>/benchmarks/**/<rule>.tsv``.
    sites : names of sites; none: all.
    """
    near: dict[str, list[float]] = {}
    far: dict[str, list[float]] = {}
    for folder in [*sorted(results.glob("*/benchmarks")), results / "benchmarks"]:
        own = not sites or folder.parent.name in sites or folder.parent == results
        for rule, seconds in _benchmarks(folder):
            (near if own else far).setdefault(rule, []).append(seconds)
    return {rule: mean(values) for rule, values in (far | near).items()}


def _benchmarks(folder: Path) -> Iterator[tuple[str, float]]:
    """Rule and seconds of each readable file."""
    for path in sorted(folder.rglob("*.tsv")):
        try:
            head, first, *_ = path.read_text(encoding="utf-8").split("\n")
            named = dict(zip(head.split("\t"), first.split("\t"), strict=True))
            yield path.stem, _work_s(named)
        except (OSError, ValueError, KeyError):
            continue


def _work_s(named: dict[str, str]) -> float:
    """Seconds of the processor; those that passed where the step was too short to be watched."""
    passed = float(named[_WALL])
    try:
        return float(named[_CPU]) or passed
    except (KeyError, ValueError):
        return passed
