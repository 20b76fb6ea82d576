"""Answer of the cover problems, with its proof."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from roadsight.base.arrays import Ints

OPTIMAL = "optimal"
TIME_LIMIT = "time_limit"
WITHIN_GAP = "within_gap"
INFEASIBLE = "infeasible"
OWN: Final = "own"
HIGHS: Final = "highs"
"""Solvers: ours, and HiGHS on a whole integer program."""


@dataclass(frozen=True)
class Cover:
    """What is chosen, and how far it is proven.

    Parameters
    ----------
    status : "optimal" (proven), "within_gap" (proven as far as was asked for), "time_limit" (not
        proven) or "infeasible".
    chosen : sorted numbers of choices; empty where nothing feasible was found.
    objective : cost of what is chosen, or covered weight for a budget; infinite (cover) where
        nothing feasible was found.
    bound : proven lower bound of the cost, or upper bound of the covered weight.
    gap : distance of objective and bound over the larger of the two; 0 where both are 0.
    seconds_cpu : CPU seconds of this process.
    uncoverable : targets that too few choices can cover, sorted.
    reductions : numbers of choices ("rows") and targets ("columns") before and after each step.
    lp_bound : bound of the linear relaxation, in cost; None where it was not needed.
    nodes : nodes of the search tree.
    solver, proved_by : "own" or "highs": who searched, and whose proof the bound is.
    """

    status: str
    chosen: Ints
    objective: float
    bound: float
    gap: float
    seconds_cpu: float
    uncoverable: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    reductions: dict[str, int] = field(default_factory=dict)
    lp_bound: float | None = None
    nodes: int = 0
    solver: str = OWN
    proved_by: str = OWN


def is_within(gap: float, objective: float, bound: float) -> bool:
    """Whether a cover is proven as far as an allowed gap (0: to the end) asks for."""
    return gap > 0.0 and relative_gap(objective, bound) <= gap


def relative_gap(objective: float, bound: float) -> float:
    """Distance of objective and bound over the larger of the two, in [0, 1]."""
    if objective == bound:
        return 0.0
    if not (np.isfinite(objective) and np.isfinite(bound)):
        return 1.0
    return abs(objective - bound) / max(abs(objective), abs(bound))
