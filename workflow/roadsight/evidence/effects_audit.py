"""How far decisions on effects were right: a site's answer with and without each effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from roadsight.base.arrays import Floats, Ints
from roadsight.geometry.cameras import wrap_deg
from roadsight.io.records.atomic import read_json
from roadsight.io.records.placement_tables import read_detections
from roadsight.io.records.run_records import last_usage
from roadsight.io.records.tables import read_table

# Rules that run for one effect alone.
RULES = {
    "mount_tilt": "tilt_mounts",
    "rain": "model_rain",
    "fog": "model_fog",
    "reflectivity": "measure_reflectivity",
    "moving_vehicles": "trace_lanes",
}
# Columns of the audit's table; found and seen are sensors and covered targets, or poles and their
# sightings.
COLUMNS = (
    *("site", "job", "effect", "decision", "quantity", "value", "unit", "threshold"),
    *("found_with", "found_without", "seen_with", "seen_without", "change"),
    *("tolerance", "right", "cpu_seconds", "expected_change", "expected_seconds"),
)


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
    return max(_apart(one.pairs, other.pairs), _apart(one.candidates, other.candidates))


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


# How far simulating an effect changes the answer of the pole job.

MOVED_M = 0.5  # Poles of two answers that lie further apart are not the same pole.


@dataclass(frozen=True)
class PoleAnswer:
    """What the pole job says about a site.

    Parameters
    ----------
    poles : x, y and kept of each pole. sightings : image, view, u_foot, v_foot, bearing_deg,
    sigma_bearing_deg and kept. hazard : x, y and rating of the kept poles.
    cpu_s : processor time of the jobs behind it, s.
    """

    poles: pd.DataFrame
    sightings: pd.DataFrame
    hazard: pd.DataFrame
    cpu_s: float = 0.0

    @property
    def found(self) -> int:
        """Number of kept poles."""
        return int(self.poles["kept"].sum())

    @property
    def seen(self) -> int:
        """Number of kept sightings."""
        return int(self.sightings["kept"].sum())


def answer_change(one: PoleAnswer, other: PoleAnswer) -> float:
    """Largest share of the answer that differs: of poles, of true bearings or of ratings."""
    return max(
        pole_change(kept_places(one.poles), kept_places(other.poles)),
        bearing_change(one.sightings, other.sightings),
        rating_change(one.hazard, other.hazard),
    )


def kept_places(poles: pd.DataFrame) -> Floats:
    """Places (n, 2) of the kept poles."""
    return poles.loc[poles["kept"].astype(bool), ["x", "y"]].to_numpy(np.float64)


def matches(one_m: Floats, other_m: Floats, within_m: float = MOVED_M) -> Ints:
    """Pairs (k, 2) of places that are one pole: as many as there can be, then the nearest."""
    away_m = np.hypot(*np.moveaxis(one_m[:, None] - other_m[None], -1, 0))
    near = away_m <= within_m
    pairs = np.column_stack(linear_sum_assignment(np.where(near, away_m / within_m - 2.0, 0.0)))
    return pairs[near[pairs[:, 0], pairs[:, 1]]]


def pole_change(one_m: Floats, other_m: Floats) -> float:
    """Share of poles that appear, vanish or move by more than half a metre; 0 without any."""
    most = max(len(one_m), len(other_m))
    return 1.0 - len(matches(one_m, other_m)) / most if most else 0.0


def bearing_change(one: pd.DataFrame, other: pd.DataFrame) -> float:
    """Share of sightings in both whose bearing from true north moves by more than its sigma."""
    keys = ["image", "view", "u_foot", "v_foot"]
    kept = [table[table["kept"].astype(bool)] for table in (one, other)]
    both = kept[0].merge(kept[1], on=keys, suffixes=("", "_other"))
    if both.empty:
        return 0.0
    moved = np.abs(wrap_deg(both["bearing_deg"] - both["bearing_deg_other"]))
    return float((moved > both["sigma_bearing_deg"].to_numpy(np.float64)).mean())


def rating_change(one: pd.DataFrame, other: pd.DataFrame) -> float:
    """Share of poles in both whose hazard is rated otherwise."""
    plan = ["x", "y"]
    pairs = matches(one[plan].to_numpy(np.float64), other[plan].to_numpy(np.float64))
    if not len(pairs):
        return 0.0
    ratings = [table["rating"].to_numpy()[pairs[:, k]] for k, table in enumerate((one, other))]
    return float((ratings[0] != ratings[1]).mean())
