"""What a run will need before anyone starts it, by the cost model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from roadsight.base.errors import InputError
from roadsight.evidence.costs import (
    STEPS,
    STORED,
    Amounts,
    Line,
    Record,
    StepCost,
    fit,
    fit_line,
    held_out,
    typical_factor,
)
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.run_records import last_usage
from roadsight.io.records.tables import read_table


@dataclass(frozen=True)
class StepEstimate:
    """One step of all runs: number of jobs, core-hours, longest job in s, its memory in MiB."""

    step: str
    jobs: int
    core_h: float
    job_s: float
    peak_mib: float


@dataclass(frozen=True)
class Estimate:
    """All runs together.

    Parameters
    ----------
    steps : in their order. wall_h : hours on ``cores`` cores. storage_gib : of all results.
    jobs_a_run : jobs in one run's DAG. dag_s, dag_mib : what Snakemake itself needs for one run.
    """

    steps: list[StepEstimate]
    runs: int
    cores: int
    wall_h: float
    storage_gib: float
    jobs_a_run: int
    dag_s: float
    dag_mib: float

    @property
    def core_h(self) -> float:
        """Core-hours of all steps."""
        return sum(step.core_h for step in self.steps)

    @property
    def jobs(self) -> int:
        """Jobs of all runs."""
        return sum(step.jobs for step in self.steps)

    @property
    def peak_mib(self) -> float:
        """Memory of the largest job."""
        return max((step.peak_mib for step in self.steps), default=0.0)


def estimate(
    table: CostTable, amounts: Amounts, jobs: tuple[str, ...], runs: int, cores: int
) -> Estimate:
    """Estimate several equal runs.

    Parameters
    ----------
    amounts : of one run. jobs : "placement", "poles" or both.
    """
    wanted = {"both", *jobs}
    steps = []
    for name, step in STEPS.items():
        per_run = amounts.jobs(step.split)
        if step.job in wanted and name in table.steps and per_run:
            units, number = amounts.units(step.driver) / per_run, per_run * runs
            cost = table.steps[name]
            job_s, job_mib = cost.cpu_s.at(units), cost.peak_mib.at(units)
            steps.append(StepEstimate(name, number, number * job_s / 3600, job_s, job_mib))
    a_run = sum(one.jobs for one in steps) // runs
    gib = sum(
        line.at(amounts.units(STORED[kind].driver))
        for kind, line in table.stored.items()
        if STORED[kind].job in wanted
    )
    dag_s, dag_mib = (line.at(a_run) for line in table.dag)
    hours = _wall_h(steps, cores, dag_s)
    return Estimate(steps, runs, cores, hours, gib * runs / 2**30, a_run, dag_s, dag_mib)


def _wall_h(steps: list[StepEstimate], cores: int, dag_s: float) -> float:
    """Hours of a schedule that never leaves a core idle while a job is ready.

    Its bound (Graham, Bell System Technical Journal 45, 1966): work / cores + (1 - 1 / cores) times
    the longest chain, here one job of every step; plus the time until the first job starts.
    """
    work_h = sum(step.core_h for step in steps)
    chain_h = sum(step.job_s for step in steps) / 3600
    return work_h / cores + (1 - 1 / cores) * chain_h + dag_s / 3600


# The fitted cost model as a JSON file.

SHIPPED = Path(__file__).resolve().parents[3] / "resources/costs/costs.json"


@dataclass(frozen=True)
class CostTable:
    """Everything that an estimate rests on.

    Parameters
    ----------
    steps : cost of each step. stored : bytes of each kind of result. dag : seconds and MiB of a
        dry run by the number of jobs. factor : within which two thirds of held-out sites lie.
    """

    steps: dict[str, StepCost]
    stored: dict[str, Line]
    dag: tuple[Line, Line]
    factor: float


def read_costs(path: Path) -> CostTable:
    """Read a cost model.

    Raises
    ------
    InputError : the file is missing or no cost model.
    """
    content = read_json(path)
    try:
        dag = Line(**content["dag"]["s"]), Line(**content["dag"]["mib"])
        stored = {kind: Line(**line) for kind, line in content["stored"].items() if kind in STORED}
        factor = float(content["held_out"]["factor"] or "nan")
        steps = {
            step: StepCost(Line(**cost["cpu_s"]), Line(**cost["peak_mib"]), int(cost["sites"]))
            for step, cost in content["steps"].items()
        }
        return CostTable(steps, stored, dag, factor)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"is no cost model ({type(error).__name__}: {error})",
            where=str(path),
            hint="write one with 'roadsight estimate --fit results/<site> ...'",
        ) from error


def fit_costs(sites: Sequence[Path], dag: tuple[Line, Line]) -> dict[str, Any]:
    """Content of a cost model fitted on finished sites, with its error on each one held out.

    Raises
    ------
    InputError : a folder holds no results, or none of them names a step.
    """
    records = [record for site in sites for record in read_records(site)]
    if not records:
        raise InputError("no benchmark files", where=", ".join(map(str, sites)))
    amounts = {site.name: read_amounts(site) for site in sites}
    stored = {site.name: read_stored(site) for site in sites}
    lines = {}  # bytes of each kind of result, from the sites that have any
    for kind, step in STORED.items():
        own = [name for name in amounts if stored[name][kind] > 0]
        if own:
            units = [amounts[name].units(step.driver) for name in own]
            lines[kind] = fit_line([1.0] * len(own), units, [stored[s][kind] for s in own])
    ratios = held_out(records)
    return {
        "sites": {name: asdict(found) for name, found in amounts.items()},
        "steps": {step: asdict(cost) for step, cost in sorted(fit(records).items())},
        "stored": {kind: asdict(line) for kind, line in lines.items()},
        "dag": {"s": asdict(dag[0]), "mib": asdict(dag[1])},
        "held_out": {"predicted_by_actual": ratios, "factor": typical_factor(ratios.values())},
    }


def write_costs(path: Path, content: dict[str, Any]) -> None:
    """Write a cost model; an error that cannot be told (no other site to hold out) is null."""
    held = content["held_out"]
    factor = held["factor"] if math.isfinite(held["factor"]) else None
    write_json(path, content | {"held_out": held | {"factor": factor}})


# What finished runs needed, read from their results, logs and benchmark files.


def read_amounts(site: Path) -> Amounts:
    """What the run of a site worked through, from its results.

    Raises
    ------
    InputError : it has none, or one cannot be read.
    """
    frame = site / "scene/frame.json"
    if not frame.is_file():
        raise InputError("holds no results of a site", where=str(site), allowed="results/<site>")
    rounds = sorted((site / "placement").glob("round-*"))
    masks = list((site / "poles/masks").glob("*.zip"))
    first = list((site / "placement/round-0/depth").glob("*/*.parquet"))
    sensors = {path.parent.name for path in first}
    candidates = [len(read_table(r / "candidates.parquet", ["candidate"])) for r in rounds]
    targets, frames = site / "placement/targets.parquet", site / "poles/frames.parquet"
    images = 0
    if frames.is_file():  # side views are images of their own
        table = read_table(frames)
        sides = [name for name in ("left_path", "right_path") if name in table]
        images = len(table) + sum(int((table[name] != "").sum()) for name in sides)
    return Amounts(
        points_m=read_json(frame)["points"] / 1e6,
        candidates=sum(candidates),
        sensors=len(sensors),
        targets=len(read_table(targets)) if targets.is_file() else 0,
        plans=len(list((site / "placement").glob("*/solution.json"))),
        images=images,
        shards=max(len(masks), len(first) // max(len(sensors), 1), 1),
        rounds=max(len(rounds), 1),
    )


def read_records(site: Path) -> list[Record]:
    """One record for each step of a site.

    Parameters
    ----------
    site : ``results/<site>``; logs are sought in ``logs/<site>`` beside ``results``.
    """
    amounts = read_amounts(site)
    found: dict[str, list[tuple[float, float]]] = {}
    for file in sorted((site / "benchmarks").rglob("*.tsv")):
        if file.stem in STEPS:
            found.setdefault(file.stem, []).append(_usage(site, file))
    records = []
    for step, usages in found.items():
        cpu_s = sum(cpu for cpu, _ in usages)
        peaks = [peak for _, peak in usages if peak > 0]
        units = amounts.units(STEPS[step].driver)
        peak = max(peaks, default=float("nan"))
        records.append(Record(site.name, step, len(usages), units, cpu_s, peak))
    return records


def _usage(site: Path, benchmark: Path) -> tuple[float, float]:
    """Processor seconds and peak MiB of a job: by its log, else by its benchmark file."""
    inside = benchmark.relative_to(site / "benchmarks").with_suffix(".log")
    usage = last_usage(site.parents[1] / "logs" / site.name / inside)
    if usage is not None:
        return usage.cpu_s, usage.peak_mib
    row = pd.read_csv(benchmark, sep="\t").apply(pd.to_numeric, errors="coerce").iloc[0]
    return float(row.get("cpu_time", 0.0) or 0.0), float(row.get("max_rss", 0.0) or 0.0)


def read_stored(site: Path) -> dict[str, int]:
    """Bytes of each kind of result of a site, by the deepest folder of `STORED` that holds it."""
    sizes = dict.fromkeys(STORED, 0)
    for path in site.rglob("*"):
        name = path.relative_to(site).as_posix()
        kinds = [kind for kind in STORED if name.startswith(f"{kind}/")]
        if kinds and path.is_file():
            sizes[max(kinds, key=len)] += path.stat().st_size
    return sizes
