"""Division of a node: do two targets share a sensor or not."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Ints32
from roadsight.setcover.common.problem import Instance
from roadsight.setcover.common.relaxation import Node, Relaxation, Solution

_PAIRED_TARGETS = 80
_FRACTION = 1e-3


def divide(relaxation: Relaxation, node: Node, solution: Solution) -> tuple[Node, Node]:
    """Two nodes that share out all covers of ``node``.

    Neighbouring candidates are nearly equal, so forbidding one changes little. Instead two targets
    are chosen that rows with a fractional total share cover together: either no such row is taken,
    or at least one is (the rule of Ryan and Foster for partitioning, here for covering). Where no
    two targets are divided, one row is.
    """
    rows = _shared_rows(relaxation.instance, node, solution)
    if rows is None:
        row = int(np.argmax(np.minimum(solution.x, 1 - solution.x) * (node.alive & ~node.fixed)))
        without, fixed = node.alive.copy(), node.fixed.copy()
        without[row], fixed[row] = False, True
        return Node(without, node.fixed, node.path), Node(node.alive, fixed, node.path)
    without = node.alive.copy()
    without[rows] = False
    branch = relaxation.add_branch(rows)
    return (
        Node(without, node.fixed, node.path),
        Node(node.alive, node.fixed, (*node.path, branch)),
    )


def _shared_rows(instance: Instance, node: Node, solution: Solution) -> Ints32 | None:
    """Free rows that cover both of the two targets whose division promises most."""
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
    start, index = instance.by_target.indptr, instance.by_target.indices
    one, two = (index[start[t] : start[t + 1]] for t in (tight[first[best]], tight[second[best]]))
    shared = np.intersect1d(one, two)
    return shared[free[shared]].astype(np.int32)
