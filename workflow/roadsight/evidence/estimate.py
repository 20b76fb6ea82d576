"""What a run will need before anyone starts it, by the cost model."""

from __future__ import annotations

from dataclasses import dataclass

from roadsight.evidence.costs import STEPS, STORED, Amounts, Line, StepCost


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
    costs: dict[str, StepCost],
    stored: dict[str, Line],
    dag: tuple[Line, Line],
    amounts: Amounts,
    jobs: tuple[str, ...],
    runs: int,
    cores: int,
) -> Estimate:
    """Estimate several equal runs.

    Parameters
    ----------
    costs : of each step. stored : bytes of each kind of result. dag : seconds and MiB of Snakemake
        by the number of jobs. amounts : of one run. jobs : "placement", "poles" or both.
    """
    wanted = {"both", *jobs}
    steps = [
        _step(name, costs[name], amounts, runs)
        for name, step in STEPS.items()
        if step.job in wanted and name in costs and amounts.jobs(step.split)
    ]
    a_run = sum(step.jobs for step in steps) // runs
    gib = sum(
        line.at(amounts.units(STORED[kind].driver))
        for kind, line in stored.items()
        if STORED[kind].job in wanted
    )
    dag_s, dag_mib = (line.at(a_run) for line in dag)
    hours = _wall_h(steps, cores, dag_s)
    return Estimate(steps, runs, cores, hours, gib * runs / 2**30, a_run, dag_s, dag_mib)


def _step(name: str, cost: StepCost, amounts: Amounts, runs: int) -> StepEstimate:
    jobs = amounts.jobs(STEPS[name].split)
    units = amounts.units(STEPS[name].driver) / jobs
    job_s = cost.cpu_s.at(units)
    return StepEstimate(
        name, jobs * runs, jobs * runs * job_s / 3600, job_s, cost.peak_mib.at(units)
    )


def _wall_h(steps: list[StepEstimate], cores: int, dag_s: float) -> float:
    """Hours of a schedule that never leaves a core idle while a job is ready.

    Its bound (Graham, Bell System Technical Journal 45, 1966): work / cores + (1 - 1 / cores) times
    the longest chain, here one job of every step; plus the time until the first job starts.
    """
    work_h = sum(step.core_h for step in steps)
    chain_h = sum(step.job_s for step in steps) / 3600
    return work_h / cores + (1 - 1 / cores) * chain_h + dag_s / 3600
