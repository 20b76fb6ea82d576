"""What a run needs, before anyone starts it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from roadsight.base.errors import InputError
from roadsight.base.sections.run import Run
from roadsight.evidence.costs import Amounts
from roadsight.evidence.estimate import SHIPPED, Estimate, read_costs
from roadsight.evidence.estimate import estimate as estimate_runs

# A mile of the North Carolina study: 34,012,557 points on 6.3 miles, 43 million images on 54,000.
# Candidates and targets are those of the generated highway, 1,228 and 5,552 on 250 m.
A_MILE = Amounts(points_m=5.4, candidates=7_900, sensors=1, targets=35_700, plans=1, images=796)
JOBS = ("placement", "poles")  # what a run may do
_SHARDS = Run().shards  # of a run that nobody says more of


def estimate(
    miles: float,
    *,
    run_miles: float = 10.0,
    jobs: Sequence[str] = JOBS,
    cores: int = 2,
    costs: Path = SHIPPED,
    **amounts: float,
) -> Estimate:
    """Core-hours, memory and storage of a road, in equal runs.

    Each step costs what was measured, times its own amounts (``docs/running/scaling.md``).

    Parameters
    ----------
    miles : length of the road. run_miles : of one run.
    jobs : one or more of "placement" and "poles". cores : at one time.
    costs : a cost model, as `roadsight estimate --fit` writes it.
    amounts : of one run, where they are known: points_m (millions), candidates, targets, images,
        sensors (kinds), plans, shards.

    Returns
    -------
    ``core_h``, ``wall_h``, ``peak_mib``, ``storage_gib``, ``jobs``, and all by step in ``steps``

    Raises
    ------
    InputError : a number that is not positive, no such job, or an amount of no such name.

    Examples
    --------
    >>> import roadsight
    >>> needs = roadsight.estimate(6.3, jobs=["poles"])
    >>> 0 < needs.core_h < 10, needs.runs
    (True, 1)
    """
    unknown = sorted(set(amounts) - set(vars(A_MILE)))
    if unknown:
        raise InputError("is no amount", where=unknown[0], allowed=", ".join(vars(A_MILE)))
    numbers = {"miles": miles, "run_miles": run_miles, "cores": cores, **amounts}
    for name, value in numbers.items():
        if not 0 < value < math.inf:
            raise InputError("is not positive", where=name, found=value, allowed="more than 0")
    asked = (jobs,) if isinstance(jobs, str) else tuple(jobs)
    wrong = [job for job in asked if job not in JOBS]
    if wrong or not asked:
        raise InputError(
            "is no job", where="jobs", found=wrong[0] if wrong else "none", allowed=", ".join(JOBS)
        )
    runs, a_run = runs_of(miles, run_miles, amounts)
    return estimate_runs(read_costs(costs), a_run, asked, runs, cores)


def runs_of(miles: float, run_miles: float, amounts: dict[str, float]) -> tuple[int, Amounts]:
    """Number of equal runs that together are so many miles, and the amounts of one of them."""
    runs = max(round(miles / run_miles), 1)
    names = ("points_m", "candidates", "targets", "images")
    length = {name: getattr(A_MILE, name) * miles / runs for name in names}
    return runs, replace(A_MILE, **{**length, "shards": _SHARDS, **amounts})
