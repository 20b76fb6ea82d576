"""How far decisions on effects were right: a site's answer with and without each effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from roadsight.io.records.atomic import read_json
from roadsight.io.records.detections import read_detections
from roadsight.io.records.tables import read_table
from roadsight.io.records.usage import last_usage

RULES = {
    "mount_tilt": "tilt_mounts",
    "rain": "model_rain",
    "fog": "model_fog",
    "reflectivity": "measure_reflectivity",
    "moving_vehicles": "trace_lanes",
}
"""Rules that run for one effect alone."""

COLUMNS = (
    *("site", "job", "effect", "decision", "quantity", "value", "unit", "threshold"),
    *("found_with", "found_without", "seen_with", "seen_without", "change"),
    *("tolerance", "right", "cpu_seconds", "expected_change", "expected_seconds"),
)
"""Columns of the audit's table; found and seen are sensors and covered targets, or poles and their
sightings."""


@dataclass(frozen=True)
class Answer:
    """What a site's placement comes to.

    Parameters
    ----------
    sensors, covered : sensors of the plan, and targets that it covers.
    candidates : names of all places where a sensor may stand.
    pairs : sensor, candidate and target of every detection.
    cpu_s : processor time of the jobs behind it, s, those of left-out rules not counted.
    """

    sensors: int
    covered: int
    candidates: frozenset[str]
    pairs: frozenset[tuple[str, str, str]]
    cpu_s: float


def read_answer(folder: Path, site: str, plan: str, without: str = "") -> Answer:
    """The answer in a work folder.

    Parameters
    ----------
    without : effect that is skipped there: the log of its own rule is of another run.
    """
    solution = read_json(folder / "results" / site / "placement" / plan / "solution.json")
    placement = folder / "results" / site / "placement"
    places = sorted(placement.glob("round-*/candidates.parquet"))
    found = read_detections(sorted(placement.glob("round-*/detection/*/*.parquet")))
    pairs = zip(
        *(found[name].astype(str) for name in ("sensor", "candidate", "target")), strict=True
    )
    logs = sorted((folder / "logs" / site).rglob("*.log"))
    used = [last_usage(log) for log in logs if log.stem != RULES.get(without)]
    return Answer(
        len(solution["sensors"]),
        solution["covered_targets"],
        frozenset(name for path in places for name in read_table(path, ["candidate"])["candidate"]),
        frozenset(pairs),
        sum(usage.cpu_s for usage in used if usage is not None),
    )


def changed_share(one: Answer, other: Answer) -> float:
    """Share of the detections, or of the candidates if that is more, that only one answer has."""
    return max(
        _apart(one.pairs, other.pairs),
        _apart(one.candidates, other.candidates),
    )


def _apart(one: frozenset[Any], other: frozenset[Any]) -> float:
    """Share of the members of either set that the other lacks."""
    return len(one ^ other) / len(one | other) if one or other else 0.0


def audited(
    site: str, decision: Mapping[str, Any], tolerance: float, simulated: Answer, skipped: Answer
) -> dict[str, Any]:
    """One row of the table, with the verdict on the decision.

    A skip is right where simulating the effect would have changed the answer by no more than the
    tolerance. To simulate what changes little costs time but spoils nothing.
    """
    numbers = {
        "found_with": simulated.sensors,
        "found_without": skipped.sensors,
        "seen_with": simulated.covered,
        "seen_without": skipped.covered,
        "change": changed_share(simulated, skipped),
        "cpu_seconds": max(simulated.cpu_s - skipped.cpu_s, 0.0),
    }
    return row_of(site, decision, tolerance, numbers)


def row_of(
    site: str, decision: Mapping[str, Any], tolerance: float, numbers: Mapping[str, Any]
) -> dict[str, Any]:
    """Row of the table from the decision and what the two ways came to, with the verdict.

    Parameters
    ----------
    numbers : found and seen, each with and without, change, cpu_seconds.
    """
    row = {
        "site": site,
        **{name: decision[name] for name in decision if name in COLUMNS},
        **numbers,
        "tolerance": tolerance,
        "right": decision["decision"] == "simulate" or numbers["change"] <= tolerance,
    }
    return {name: row[name] for name in COLUMNS}


def never_mattering(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Effects that change the answer by more than their tolerance at no site."""
    table = pd.DataFrame(rows)
    matters = (table["change"] > table["tolerance"]).groupby(table["effect"]).any()
    return [str(name) for name in matters.index[~matters]]
