"""Covers in which several choices together must give each target enough: what is asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.errors import InputError

TOLERANCE = 1e-7
"""Share of a need that may be missing."""


@dataclass(frozen=True)
class JointProblem:
    """Choices, what they give, and what targets need.

    Parameters
    ----------
    gain : (choices, targets) sparse, 0 or more; entries above the need count as the need.
    need : (targets,) positive. costs : (choices,) positive.
    groups : (choices,) at most one choice of each.

    Raises
    ------
    InputError : a gain or need is not usable.
    """

    gain: sparse.csr_matrix
    need: Floats
    costs: Floats
    groups: Ints

    def __post_init__(self) -> None:
        if not (np.isfinite(self.need) & (self.need > 0)).all():
            raise InputError("is not positive", where="need")
        if (self.gain.data < 0).any() or np.isnan(self.gain.data).any():
            raise InputError("is negative or not a number", where="gain")
        capped = sparse.csr_matrix(self.gain, dtype=np.float64, copy=True)
        capped.data = np.minimum(capped.data, self.need[capped.indices])
        capped.eliminate_zeros()
        object.__setattr__(self, "gain", capped)

    def given(self, chosen: Ints) -> Floats:
        """What chosen choices give each target (targets,)."""
        return np.asarray(self.gain[chosen].sum(axis=0)).ravel()

    def reachable(self) -> Bools:
        """Targets (targets,) to which the best choices of all groups together give enough."""
        best = best_of_groups(self.gain, self.groups)
        return np.asarray(best.sum(axis=0)).ravel() >= self.need * (1 - TOLERANCE)


def best_of_groups(gain: sparse.csr_matrix, groups: Ints) -> sparse.csr_matrix:
    """Greatest gain of each group at each target, (groups, targets)."""
    table = gain.tocoo()
    group = np.unique(groups, return_inverse=True)[1].reshape(-1)[table.row]
    order = np.lexsort((-table.data, table.col, group))
    group, target, data = group[order], table.col[order], table.data[order]
    first = np.ones(len(group), bool)
    first[1:] = (group[1:] != group[:-1]) | (target[1:] != target[:-1])
    size = (int(group.max(initial=-1)) + 1, gain.shape[1])
    return sparse.csr_matrix((data[first], (group[first], target[first])), shape=size)


def least_number(share: Floats, groups: Ints) -> int:
    """How many choices a target needs at least of those that are not enough alone; 1 for none.

    With r of them, ``sum_alone r x_i + sum_others x_i >= r`` holds for every answer, and cuts off
    more of the relaxation than the gains themselves.

    Parameters
    ----------
    share : (k,) of the need that each choice gives. groups : (k,) of which one at most is taken.
    """
    others = share < 1 - TOLERANCE
    best: dict[int, float] = {}
    for group, value in zip(groups[others].tolist(), share[others].tolist(), strict=True):
        best[group] = max(best.get(group, 0.0), value)
    total = np.cumsum(sorted(best.values(), reverse=True))
    reached = np.flatnonzero(total >= 1 - TOLERANCE)
    return int(reached[0]) + 1 if len(reached) else max(len(best), 1)
