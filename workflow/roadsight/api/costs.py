"""What a run needs, before anyone starts it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from roadsight.base.errors import InputError
from roadsight.evidence.cost_tables import SHIPPED, read_costs
from roadsight.evidence.costs import Amounts
from roadsight.evidence.estimate import Estimate
from roadsight.evidence.estimate import estimate as estimate_runs

A_MILE = Amounts(points_m=5.4, candidates=7_900, sensors=1, targets=35_700, plans=1, images=796)
"""A mile of the North Carolina study: 34,012,557 points on 6.3 miles, 43 million images on 54,000.
Candidates and targets are those of the generated highway, 1,228 and 5,552 on 250 m."""
_SHARDS = 4
"""Of a run that nobody says more of."""


def estimate(
    miles: float,
    *,
    run_miles: float = 10.0,
    jobs: Sequence[str] = ("placement", "poles"),
    cores: int = 2,
    costs: Path = SHIPPED,
    **amounts: float,
) -> Estimate:
    """Core-hours, memory and storage of a road, in equal runs.

    Parameters
    ----------
    miles : length of the road. run_miles : of one run.
    jobs : "placement", "poles" or both. cores : at one time.
    amounts : of one run, where they are known: points_m (millions), candidates, targets, images,
        sensors (kinds), plans, shards.

    Returns
    -------
    ``core_h``, ``wall_h``, ``peak_mib``, ``storage_gib``, ``jobs``, and all by step in ``steps``

    Raises
    ------
    InputError : a number that is not positive, or an amount of no such name.

    Examples
    --------
    >>> import roadsight
    >>> needs = roadsight.estimate(6.3, jobs=["poles"])
    >>> 0 < needs.core_h < 10, needs.runs
    (True, 1)
    """
    for name, value in (("miles", miles), ("run_miles", run_miles), ("cores", cores)):
        if not value > 0:
            raise InputError("is not positive", where=name, found=value, allowed="more than 0")
    unknown = sorted(set(amounts) - set(vars(A_MILE)))
    if unknown:
        raise InputError("is no amount", where=unknown[0], allowed=", ".join(vars(A_MILE)))
    table = read_costs(costs)
    runs, a_run = runs_of(miles, run_miles, amounts)
    return estimate_runs(table.steps, table.stored, table.dag, a_run, tuple(jobs), runs, cores)


def runs_of(miles: float, run_miles: float, amounts: dict[str, float]) -> tuple[int, Amounts]:
    """Number of equal runs that together are so many miles, and the amounts of one of them."""
    runs = max(round(miles / run_miles), 1)
    names = ("points_m", "candidates", "targets", "images")
    length = {name: getattr(A_MILE, name) * miles / runs for name in names}
    return runs, replace(A_MILE, **{**length, "shards": _SHARDS, **amounts})
