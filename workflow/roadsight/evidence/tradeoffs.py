"""What each step of accuracy costs: costs and errors of a study's levels, and the frontier."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from roadsight.evidence.metrics import METRICS
from roadsight.evidence.studies import WHOLE_JOB, Measure, Study
from roadsight.evidence.variants import JobRecord

# Rules that make the generated sites or score results: no user's job has them.
NOT_OF_THE_JOB = frozenset(
    (
        "generate_sample",
        "generate_rural",
        "render_videolog",
        "score_pavement",
        "score_cameras",
        "validate_poles",
    )
)
# A level is clearly cheaper than another when it needs this share less processor time, ...
TIMING_NOISE = 0.1
# ... and more than so many seconds less: that is what starting a process varies by.
TIMING_NOISE_S = 0.3
COLUMNS = (
    "job", "stage", "knob", "level", "cpu_seconds", "wall_seconds", "peak_mib", "metric", "value",
    "unit", "reference", "error_vs_reference", "repeats", "is_default", "on_frontier",
)  # fmt: skip


@dataclass(frozen=True)
class Cost:
    """Cost of a stage's jobs together.

    Parameters
    ----------
    cpu_s, wall_s : sums over the jobs, s. peak_mib : of the largest job. repeats : timings, of
    which this is the cheapest.
    """

    cpu_s: float
    wall_s: float
    peak_mib: float
    repeats: int = 1


def stage_costs(records: Sequence[JobRecord]) -> dict[str, Cost]:
    """Cost of each rule that a user's own job has too."""
    found: dict[str, Cost] = {}
    for rule in sorted({record.rule for record in records} - NOT_OF_THE_JOB):
        jobs = [record for record in records if record.rule == rule]
        found[rule] = Cost(
            math.fsum(job.cpu_s for job in jobs),
            math.fsum(job.wall_s for job in jobs),
            max(job.peak_mib for job in jobs),
        )
    return found


def cheapest(timings: Sequence[Cost]) -> Cost:
    """The cheapest of several timings: what disturbs a run only ever makes it dearer."""
    best = min(timings, key=lambda cost: cost.cpu_s)
    return Cost(best.cpu_s, best.wall_s, best.peak_mib, len(timings))


def cost_of(stage: str, costs: Mapping[str, Cost]) -> Cost:
    """Cost of one stage, or of all of them together."""
    if stage != WHOLE_JOB:
        return costs[stage]
    return Cost(
        math.fsum(cost.cpu_s for cost in costs.values()),
        math.fsum(cost.wall_s for cost in costs.values()),
        max(cost.peak_mib for cost in costs.values()),
    )


def on_frontier(cpu_s: Sequence[float], errors: Sequence[float]) -> list[bool]:
    """Whether no other level is as good and clearly cheaper, or better and no dearer.

    A level without an error (NaN) is never on the frontier.
    """
    found = []
    for own_cost, own_error in zip(cpu_s, errors, strict=True):
        beaten = any(
            (
                error <= own_error
                and cost < own_cost * (1 - TIMING_NOISE)
                and cost < own_cost - TIMING_NOISE_S
            )
            or (error < own_error and cost <= own_cost)
            for cost, error in zip(cpu_s, errors, strict=True)
        )
        found.append(not beaten and math.isfinite(own_error))
    return found


def study_rows(study: Study, levels: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows of ``tradeoffs.csv``: each measure at each level, in the study's order.

    Parameters
    ----------
    levels : by name, what `roadsight.stages.evidence.measure_tradeoff` wrote.
    """
    return [row for measure in study.measures for row in measure_rows(study, measure, levels)]


def measure_rows(
    study: Study, measure: Measure, levels: Mapping[str, Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Rows of one measure."""
    metric = METRICS[measure.metric]
    read = {level: content["metrics"][measure.metric] for level, content in levels.items()}
    if metric.against is not None:
        other = read[str(study.reference)]
        values = {level: metric.against(one, other) for level, one in read.items()}
    else:
        values = {level: math.nan if v is None else float(v) for level, v in read.items()}
    ideal = values[str(study.reference)] if metric.ideal is None else metric.ideal
    costs = {
        name: cost_of(measure.stage, {rule: Cost(**c) for rule, c in level["stages"].items()})
        for name, level in levels.items()
    }
    errors = [abs(value - ideal) for value in values.values()]
    frontier = on_frontier([cost.cpu_s for cost in costs.values()], errors)
    reference = f"level {study.reference}" if metric.needs_reference else metric.reference
    return [
        {
            "job": study.job,
            "stage": measure.stage,
            "knob": study.knob,
            "level": name,
            "cpu_seconds": round(costs[name].cpu_s, 2),
            "wall_seconds": round(costs[name].wall_s, 2),
            "peak_mib": round(costs[name].peak_mib),
            "metric": measure.metric,
            "value": value,
            "unit": metric.unit,
            "reference": reference,
            "error_vs_reference": error,
            "repeats": costs[name].repeats,
            "is_default": name == study.default,
            "on_frontier": best,
        }
        for (name, value), error, best in zip(values.items(), errors, frontier, strict=True)
    ]


def next_step(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """What the next gain in accuracy beyond the default costs; None where there is none.

    Parameters
    ----------
    rows : of one measure, as `measure_rows`.
    """
    default = next(row for row in rows if row["is_default"])
    better = [
        row
        for row in rows
        if row["on_frontier"] and row["error_vs_reference"] < default["error_vs_reference"]
    ]
    if not better:
        return None
    step = min(better, key=lambda row: row["cpu_seconds"])
    return {
        "level": step["level"],
        "cpu_s": step["cpu_seconds"] - default["cpu_seconds"],
        "mib": step["peak_mib"] - default["peak_mib"],
        "error": step["error_vs_reference"] - default["error_vs_reference"],
    }


def precision_rows(measured: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of what `roadsight.stages.evidence.measure_precision` wrote."""
    rows = []
    for metric, unit in (("coordinate_error_m", "m"), ("normal_error_deg", "deg")):
        levels = measured["levels"]
        frontier = on_frontier(
            [level["cpu_s"] for level in levels.values()],
            [level[metric] for level in levels.values()],
        )
        rows += [
            {
                "job": "placement",
                "stage": "ingest_cloud",
                "knob": "coordinates",
                "level": name,
                "cpu_seconds": round(level["cpu_s"], 2),
                "wall_seconds": round(level["wall_s"], 2),
                "peak_mib": round(level["peak_mib"]),
                "metric": metric,
                "value": level[metric],
                "unit": unit,
                "reference": "float64",
                "error_vs_reference": level[metric],
                "repeats": measured["repeats"],
                "is_default": name == measured["default"],
                "on_frontier": best,
            }
            for (name, level), best in zip(levels.items(), frontier, strict=True)
        ]
    return rows
