"""Proof on a core: the few targets that keep covers from being cheaper.

A cover of all targets covers those of the core, so that what the core cannot be covered for is
refuted for all. Its instance is far smaller, and many of its choices are alike. A cheap cover of
the core either covers everything, or leaves targets open that join the core.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import Instance
from roadsight.setcover.common.reductions import shrink, split_components
from roadsight.setcover.common.result import is_within
from roadsight.setcover.cover.local_search import LocalSearch
from roadsight.setcover.cover.search import Outcome

_LARGEST_SHARE = 0.5
"""Share of all targets that is still a core: with more of them the proof is hardly easier, and may
have to begin again once other targets join."""
_STEPS = 2_000
"""Steps of local search after a cover of the core that leaves targets open, which join it."""

SolvePart = Callable[[Instance, Deadline, float], Outcome]
"""Outcome of an instance: its best cover, or any that costs less than a ceiling."""


def is_small(local: LocalSearch) -> bool:
    """Whether the targets that a local search looks at are few enough to be a core."""
    return float(local.active.mean()) <= _LARGEST_SHARE


def prove_on_core(
    local: LocalSearch, bound: float, solve: SolvePart, deadline: Deadline, gap: float
) -> Outcome:
    """Prove the best cover of a local search, or find cheaper ones, on the targets it looks at.

    Parameters
    ----------
    bound : known before, in steps. solve : how a core is solved.
    gap : share of the cost that is close enough to the bound.
    """
    instance, nodes = local.instance, 0
    while True:
        outcome = _on_core(local, solve, deadline)
        nodes += outcome.nodes
        bound = max(bound, outcome.bound)
        if bound > instance.goal(local.cost):
            return Outcome(local.best, local.cost, nodes)
        if outcome.best is None or deadline.passed() or is_within(gap, local.cost, bound):
            return Outcome(local.best, bound, nodes)
        if not local.accept(outcome.best):
            local.run(_STEPS, bound, deadline)


def _on_core(local: LocalSearch, solve: SolvePart, deadline: Deadline) -> Outcome:
    """Proven bound of the core, and a cover of it (of the whole instance's choices) if cheap."""
    instance = local.instance
    everything = np.ones(instance.shape[0], bool)
    core, taken, feasible = shrink(instance.select(everything, local.active), ~everything)
    if not feasible:
        return Outcome(None, np.inf, 0)
    parts = sorted(split_components(core), key=lambda part: part.by_choice.nnz)
    chosen = np.isin(instance.choice, taken)
    bound, nodes = float(instance.cost[chosen].sum()), 0
    for number, part in enumerate(parts):
        ceiling = local.cost - bound if len(parts) == 1 else np.inf
        outcome = solve(part, deadline.part(len(parts) - number), ceiling)
        bound, nodes = bound + outcome.bound, nodes + outcome.nodes
        if outcome.best is None:
            return Outcome(None, bound, nodes)
        chosen |= np.isin(instance.choice, part.choice[outcome.best])
    cheap = float(instance.cost[chosen].sum()) < local.cost
    return Outcome(chosen if cheap else None, bound, nodes)
