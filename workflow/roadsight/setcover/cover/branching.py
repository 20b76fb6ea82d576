"""Division of a node: do two targets share a choice or not."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Ints32
from roadsight.setcover.common.problem import Instance
from roadsight.setcover.common.relaxation import Node, Relaxation, Solution
from roadsight.setcover.common.tree import choices_of_both, divide_by_choice, divide_by_choices

_PAIRED_TARGETS = 80
"""So many targets of the highest duals are compared in pairs. The bound rises by the duals, so that
pairs of others promise less; a larger number takes time by its square."""
_FRACTION = 1e-3
"""Pairs whose common share is nearer to a whole number than this count as decided: what is left may
be the solver's tolerance, and a division by it changes next to nothing."""


def divide(relaxation: Relaxation, node: Node, solution: Solution) -> tuple[Node, Node]:
    """Two nodes that share out all covers of ``node``.

    Neighbouring candidates are nearly equal, so forbidding one changes little. Instead two targets
    are taken whose common choices have a fractional share in total: either none of these choices is
    taken, or at least one is (the rule of Ryan and Foster for partitioning, here for covering).
    Where there are no such targets, the node is divided by one choice.
    """
    choices = _shared_choices(relaxation.instance, node, solution)
    if choices is None:
        free, x = node.alive & ~node.fixed, solution.x
        nearness = np.where(free, np.minimum(x, 1 - x), -1.0)
        if nearness.max() <= 0:  # whole already: the free choice of the largest share
            nearness = np.where(free, x, -1.0)
        return divide_by_choice(node, int(np.argmax(nearness)))
    return divide_by_choices(node, choices, relaxation.add_branch(choices))


def _shared_choices(instance: Instance, node: Node, solution: Solution) -> Ints32 | None:
    """Free choices that cover both of the two targets whose division promises most."""
    tight = np.flatnonzero(solution.target_dual > 1e-9)
    dual = solution.target_dual[tight]
    order = np.argsort(-dual, kind="stable")[:_PAIRED_TARGETS]
    tight, dual = tight[order], dual[order]
    free = node.alive & ~node.fixed
    support = np.flatnonzero((solution.x > 1e-9) & free)
    # Sparse, because the order of sums in a dense product depends on the number of threads.
    covers = instance.by_choice[support][:, tight].astype(np.float64)
    share = (covers.T @ sparse.diags_array(solution.x[support]) @ covers).toarray()
    first, second = np.triu_indices(len(tight), 1)
    fraction = np.minimum(share, 1 - share)[first, second]
    if not len(fraction) or fraction.max() < _FRACTION:
        return None
    score = np.where(fraction < _FRACTION, -1.0, fraction * np.minimum(dual[first], dual[second]))
    best = int(np.argmax(score))
    return choices_of_both(instance.by_target, tight[first[best]], tight[second[best]], free)
