"""Instances whose tree is left to HiGHS: what reduced costs leave of them is small.

Our tree gains by what sensors along a road have in common: far more targets than its relaxation
holds, and neighbours that are nearly alike. Where few entries are left, HiGHS has more to branch
with: pseudo-costs, conflicts, cuts of many families.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import NEAR, Instance
from roadsight.setcover.common.program import Program, run_program
from roadsight.setcover.common.relaxation import Node
from roadsight.setcover.common.result import HIGHS
from roadsight.setcover.cover.search import Outcome

_MOST_ENTRIES = 60_000
"""Entries of the matrix that reduced costs leave, up to which HiGHS branches better."""
_TOLERANCE = 1e-6
"""HiGHS's own: coefficients are 1, and with 1e-9 the same trees took up to three times as long."""
_MOST_SPARE = 6.0
"""Choices of mean cost by which cover and bound may be apart for it: no tree closes more."""


def is_for_highs(instance: Instance, node: Node, best: Bools, bound: float) -> bool:
    """Whether HiGHS is to branch: decided by sizes and bound alone, so that runs agree."""
    width = np.diff(instance.by_choice.indptr)
    left = int(width[node.alive | best].sum())
    cost = instance.cost[best]
    spare = instance.goal(float(cost.sum())) - bound
    return left <= _MOST_ENTRIES and spare <= _MOST_SPARE * cost.mean()


def branch_by_highs(
    instance: Instance, node: Node, best: Bools, bound: float, deadline: Deadline, gap: float
) -> Outcome:
    """Outcome of an instance whose cheaper covers, if any, lie in a node.

    HiGHS is not told of the best cover: with it a tree of 60 choices and 400 targets took 28 CPU s,
    without 10.

    Parameters
    ----------
    node : choices that are not alive in it are in no cheaper cover. best : a cover.
    bound : known before, in steps.
    """
    cost = float(instance.cost[best].sum())
    alive = node.alive | best
    left = instance.select(alive, np.ones(instance.shape[1], bool))
    found = run_program(
        cover_program(left, (node.fixed & best)[alive]),
        deadline,
        gap if gap else 0.0 if instance.integral else NEAR / 2,
        1.0 if instance.integral else 0.0,
        tolerance=_TOLERANCE,
    )
    # Covers that the node leaves out cost more than the goal, by a step where there is one.
    beyond = cost if instance.integral else float(np.nextafter(instance.goal(cost), np.inf))
    bound = max(bound, min(instance.round_up(found.bound), beyond))
    if found.x is not None:
        chosen = np.zeros(len(best), bool)
        chosen[np.flatnonzero(alive)[found.x > 0.5]] = True
        if _is_cover(instance, chosen) and float(instance.cost[chosen].sum()) < cost:
            best = chosen
    return Outcome(best, min(bound, float(instance.cost[best].sum())), found.nodes, HIGHS)


def cover_program(instance: Instance, fixed: Bools) -> Program:
    """Targets and groups of an instance as an integer program, some choices taken."""
    choices, targets = instance.shape
    member = np.flatnonzero(instance.group >= 0)
    groups = int(instance.group.max(initial=-1)) + 1
    shape = (groups, choices)
    sets = sparse.csr_matrix((np.ones(len(member)), (instance.group[member], member)), shape)
    return Program(
        instance.cost,
        sparse.vstack([instance.by_choice.T.astype(np.float64), sets], format="csr"),
        np.concatenate([instance.need.astype(np.float64), np.full(groups, -np.inf)]),
        np.concatenate([np.full(targets, np.inf), np.ones(groups)]),
        fixed.astype(np.float64),
        np.ones(choices),
        np.ones(choices, bool),
    )


def _is_cover(instance: Instance, chosen: Bools) -> bool:
    group = instance.group[chosen & (instance.group >= 0)]
    seen = instance.by_choice.T @ chosen.astype(np.int32)
    return bool((seen >= instance.need).all()) and len(np.unique(group)) == len(group)
