"""Cost model: what each step needs, as a line in what it works through, fitted on finished runs.

    processor seconds of a job = base + rate * units
    peak memory of a job       = base + rate * units
    bytes of a kind of result  = base + rate * units

A line with both parts at least 0 is the simplest model that holds for a tiny site (start-up and
imports) and for a large one. Both parts come from non-negative least squares (Lawson and Hanson,
Solving Least Squares Problems, 1974, chapter 23) on relative residuals, so that small and large
sites count alike.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import nnls

from roadsight.evidence.tradeoffs import cheapest, stage_costs
from roadsight.evidence.variants import JobRecord


@dataclass(frozen=True)
class Amounts:
    """What a run works through.

    Parameters
    ----------
    points_m : points of the cloud, millions. candidates : sensor positions of all rounds.
    sensors : kinds of sensor. targets : of the placement. plans : deployment plans.
    images : of the videolog, side views included. shards : of candidates and images each.
    rounds : rounds of candidates.
    """

    points_m: float = 0.0
    candidates: float = 0.0
    sensors: int = 0
    targets: float = 0.0
    plans: int = 0
    images: float = 0.0
    shards: int = 1
    rounds: int = 1

    def units(self, driver: str) -> float:
        """Units of a driver in the whole run."""
        return {
            "points_m": self.points_m,
            "candidates": self.candidates,
            "candidate_sensors": self.candidates * self.sensors,
            "plan_targets": self.targets * self.plans,
            "images": self.images,
            "runs": 1.0,
        }[driver]

    def jobs(self, split: str) -> int:
        """Jobs of a step that is split so."""
        return {
            "run": 1,
            "shard": self.shards,
            "sensor_shard": self.shards * self.sensors * self.rounds,
            "plan": self.plans,
            "round": self.rounds,
        }[split]


@dataclass(frozen=True)
class Step:
    """How a step grows: job that it belongs to, driver of its cost, what it is split into."""

    job: str
    driver: str
    split: str = "run"


# Driver and split of steps that are one job a run.
_CLOUD = ("points_m", "run")
_RUN = ("runs", "run")
# Steps of a site, in their order. Left out are those that generate samples, that score against
# truth, and that only some sites ask for (effects, tilted mounts, poses, bent lenses).
STEPS: dict[str, Step] = {
    **{name: Step("both", *_CLOUD) for name in ("ingest_cloud", "profile_scene", "build_dem")},
    **{
        name: Step("placement", *_CLOUD)
        for name in (
            "cluster_fpfh",
            "extract_pavement",
            "build_edges",
            "mark_traffic",
            "build_surfels",
            "place_targets",
            "gather_objects",
            "write_site_page",
        )
    },
    "place_candidates": Step("placement", "candidates"),
    "densify_candidates": Step("placement", "points_m"),
    "render_depth_maps": Step("placement", "candidate_sensors", "sensor_shard"),
    "build_detection_shard": Step("placement", "candidate_sensors", "sensor_shard"),
    "check_coverage": Step("placement", "candidate_sensors", "round"),
    **{
        name: Step("placement", "plan_targets", "plan")
        for name in (
            "solve_cover",
            "find_obstacles",
            "render_scans",
            "measure_data",
            "measure_tolerance",
            "try_removals",
        )
    },
    "write_stakeout": Step("placement", *_RUN),
    **{
        name: Step("poles", *_CLOUD)
        for name in ("rasterise_lidar", "extract_road_edges", "find_pole_columns", "build_terrain")
    },
    **{
        name: Step("poles", "images", "shard")
        for name in (
            "segment_images",
            "estimate_depth",
            "trace_image_edges",
            "trace_pole_axes",
            "match_images",
            "align_cameras",
            "measure_poles",
        )
    },
    **{
        name: Step("poles", "images")
        for name in (
            "read_videolog",
            "profile_drive",
            "calibrate_drive",
            "turn_side_views",
            "triangulate_poles",
            "rate_hazard",
            "write_poles_page",
        )
    },
    **{
        name: Step("both", *_RUN)
        for name in ("plan_effects", "summarise_site", "write_handover", "write_pdf")
    },
}
# Folders of results and what they grow with.
STORED: dict[str, Step] = {
    "scene": Step("both", "points_m"),
    "placement": Step("placement", "candidate_sensors"),
    "poles/masks": Step("poles", "images"),
    "poles/depth": Step("poles", "images"),
    "poles": Step("poles", "points_m"),
}


@dataclass(frozen=True)
class Record:
    """What one step needed at one site.

    Parameters
    ----------
    site, step : names. jobs : how many jobs it was. units : of its driver, over all jobs.
    cpu_s : processor seconds of all jobs. peak_mib : of the largest job, NaN if not known.
    """

    site: str
    step: str
    jobs: int
    units: float
    cpu_s: float
    peak_mib: float


@dataclass(frozen=True)
class Line:
    """Cost of a job: ``base + rate * units``."""

    base: float
    rate: float

    def at(self, units: float) -> float:
        """Cost of a job of so many units."""
        return self.base + self.rate * units


@dataclass(frozen=True)
class StepCost:
    """Fitted lines of a step, and how many sites they rest on."""

    cpu_s: Line
    peak_mib: Line
    sites: int


def fit_line(counts: Sequence[float], units: Sequence[float], costs: Sequence[float]) -> Line:
    """Line whose relative residuals have the least sum of squares, both parts at least 0.

    Parameters
    ----------
    counts : how many jobs each cost is the sum of. units : over these jobs. costs : above 0;
        without any the line is 0.
    """
    if len(costs) == 0:
        return Line(0.0, 0.0)
    cost = np.maximum(np.asarray(costs, np.float64), 1e-9)
    matrix = np.column_stack([counts, units]) / cost[:, None]
    scale = np.maximum(np.abs(matrix).max(axis=0), 1e-300)
    base, rate = nnls(matrix / scale, np.ones(len(cost)))[0] / scale
    return Line(float(base), float(rate))


def fit(records: Iterable[Record]) -> dict[str, StepCost]:
    """Lines of every step that has a record."""
    by_step: dict[str, list[Record]] = {}
    for record in records:
        by_step.setdefault(record.step, []).append(record)
    costs = {}
    for step, found in by_step.items():
        jobs, units = [r.jobs for r in found], [r.units for r in found]
        cpu = fit_line(jobs, units, [r.cpu_s for r in found])
        known = [r for r in found if np.isfinite(r.peak_mib)]
        units = [r.units / r.jobs for r in known]
        peak = fit_line([1.0] * len(known), units, [r.peak_mib for r in known])
        costs[step] = StepCost(cpu, peak, len({r.site for r in found}))
    return costs


def predict(costs: dict[str, StepCost], record: Record) -> float:
    """Processor seconds that the model expects of a record's jobs."""
    cost = costs[record.step]
    return record.jobs * cost.cpu_s.base + cost.cpu_s.rate * record.units


def held_out(records: Sequence[Record]) -> dict[str, float]:
    """Predicted by actual processor time of each site, from a model that never saw it.

    Only steps that another site has too are compared.
    """
    ratios = {}
    for site in sorted({record.site for record in records}):
        model = fit(r for r in records if r.site != site)
        own = [r for r in records if r.site == site and r.step in model]
        actual = sum(r.cpu_s for r in own)
        if actual > 0:
            ratios[site] = sum(predict(model, r) for r in own) / actual
    return ratios


def typical_factor(ratios: Iterable[float]) -> float:
    """Factor within which two thirds of held-out predictions lie, in either direction."""
    logs = np.abs(np.log(list(ratios)))
    return float(np.exp(np.quantile(logs, 2 / 3))) if len(logs) else float("nan")


# Costs of the steps that all levels of a job's studies share with their base.

_Costs = Mapping[str, Mapping[str, Any]]


def base_costs(runs: Sequence[Sequence[JobRecord]]) -> dict[str, dict[str, Any]]:
    """First and cheapest cost of each rule over several runs of the same jobs.

    The first run of all compiles kernels for the machine, which no later run has to do.
    """
    timings = [stage_costs(run) for run in runs]
    return {
        rule: {
            "first": vars(timings[0][rule]),
            "cheapest": vars(cheapest([timing[rule] for timing in timings])),
        }
        for rule in timings[0]
    }


def with_base_costs(costs: _Costs, base: _Costs) -> dict[str, Mapping[str, Any]]:
    """Costs of a level, where it carries its base's first record the cheapest one in its place.

    Parameters
    ----------
    costs : of a level by rule. base : as `base_costs`.
    """
    return {
        rule: base[rule]["cheapest"] if rule in base and cost == base[rule]["first"] else cost
        for rule, cost in costs.items()
    }
