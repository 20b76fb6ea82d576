"""Costs of the steps that all levels of a job's studies share with their base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from roadsight.evidence.tradeoffs import cheapest, stage_costs
from roadsight.evidence.variants import JobRecord

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
