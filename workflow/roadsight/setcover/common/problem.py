"""The set-cover problem and its working form."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints, Ints32
from roadsight.base.errors import InputError

_DECIMALS = 6
"""Costs with more decimals have no common step: their cover is proven to 1e-7 of its cost."""
_LARGEST_UNIT = 2.0**50
"""Costs of more units than this have no step: 64-bit floats hold whole numbers up to 2**53, and
sums of several costs must be among them."""


class CoverProblem:
    """Minimise the cost of choices that cover each target often enough.

    Rows of the matrix are the choices, columns the targets.

    minimise ``sum c_i x_i`` subject to ``sum_i a_ij x_i >= at_least_j`` for each target j and
    ``sum_{i in g} x_i <= 1`` for each group g, x binary (Eqs. 5 to 7 of the placement paper).

    Parameters
    ----------
    matrix : (choices, targets) sparse, any numeric or bool type; positive = covers. Repeated
        entries are summed, stored zeros dropped.
    costs : (choices,) positive and finite; None = 1 each.
    groups : (choices,) whole numbers, at most one choice of a group is taken; negative = no group;
        None = no groups.
    at_least : how often each target is covered: one number or (targets,); 0 = not at all.
    mandatory, forbidden : numbers of choices that must, must not be taken.

    Raises
    ------
    InputError : a shape, type or value is not as above.
    """

    def __init__(
        self,
        matrix: Any,
        costs: ArrayLike | None = None,
        groups: ArrayLike | None = None,
        at_least: ArrayLike = 1,
        mandatory: ArrayLike = (),
        forbidden: ArrayLike = (),
    ) -> None:
        self.matrix = clean_matrix(matrix)
        choices, targets = self.matrix.shape
        self.costs = _costs(costs, choices)
        self.groups = _whole("groups", -1 if groups is None else groups, choices)
        self.at_least = _whole("at_least", at_least, targets)
        if (self.at_least < 0).any():
            raise InputError("is negative", where="at_least", found=self.at_least.min(), allowed=0)
        self.mandatory = _choice_mask("mandatory", mandatory, choices)
        self.forbidden = _choice_mask("forbidden", forbidden, choices)
        both = np.flatnonzero(self.mandatory & self.forbidden)
        if len(both):
            raise InputError("is both mandatory and forbidden", where="row", found=both[0])

    def changed(self, **parts: ArrayLike | None) -> CoverProblem:
        """The same with another matrix, other ``costs``, ``at_least`` or choices.

        ``parts`` are arguments as those of the constructor.
        """
        mine = {
            "matrix": self.matrix,
            "costs": self.costs,
            "groups": self.groups,
            "at_least": self.at_least,
            "mandatory": np.flatnonzero(self.mandatory),
            "forbidden": np.flatnonzero(self.forbidden),
        }
        return CoverProblem(**(mine | parts))


@dataclass(frozen=True)
class Instance:
    """Working form of a problem: costs in objective steps, choices that keep their first number.

    Parameters
    ----------
    by_choice : (m, n) CSR, sorted indices.
    cost : (m,) in units of the objective step.
    need : (n,) at least 1.
    group : (m,) -1 where the choice is alone in its group.
    choice : (m,) its number in the problem.
    integral : costs are whole numbers of steps.
    """

    by_choice: sparse.csr_matrix
    cost: Floats
    need: Ints32
    group: Ints
    choice: Ints
    integral: bool

    @cached_property
    def by_target(self) -> sparse.csc_matrix:
        """The matrix as CSC."""
        return self.by_choice.tocsc()

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of choices and targets."""
        return self.by_choice.shape

    def select(self, choices: Bools, targets: Bools) -> Instance:
        """Instance of the choices and targets of two masks."""
        number = np.flatnonzero(targets)
        if choices.all():
            matrix = self.by_target[:, number].tocsr()  # takes time by what stays alone
        else:
            matrix = self.by_choice[np.flatnonzero(choices)][:, number].tocsr()
        matrix.sort_indices()
        return replace(
            self,
            by_choice=matrix,
            cost=self.cost[choices],
            need=self.need[targets],
            group=alone_to_none(self.group[choices]),
            choice=self.choice[choices],
        )

    def goal(self, best: float) -> float:
        """Largest bound that still allows a cover cheaper than ``best``, in steps."""
        if not np.isfinite(best):
            return np.inf
        # One step less where costs are whole; bounds may be rounded by a millionth of a step.
        return best - 1 + 1e-6 if self.integral else best - 1e-7 * max(1.0, best)

    def round_up(self, bound: float) -> float:
        """Bound lifted to the next possible objective."""
        return math.ceil(bound - 1e-6) if self.integral and np.isfinite(bound) else bound


def clean_matrix(matrix: Any) -> sparse.csr_matrix:
    """CSR of bool from any sparse or dense 2-D matrix.

    Raises
    ------
    InputError : not 2-D, not numeric, or an entry is negative, infinite or NaN.
    """
    if not sparse.issparse(matrix):
        matrix = np.asarray(matrix)
    if matrix.ndim != 2:
        raise InputError("is not 2-D", where="matrix", found=f"shape {matrix.shape}")
    if matrix.dtype.kind not in "biuf":
        raise InputError("is not numeric", where="matrix", found=f"type {matrix.dtype}")
    clean = sparse.csr_matrix(matrix, copy=True)
    if not np.isfinite(clean.data).all() or (clean.data < 0).any():
        raise InputError(
            "has entries that are negative or not finite", where="matrix", allowed="0 or more"
        )
    clean.sum_duplicates()
    clean.eliminate_zeros()
    clean.sort_indices()
    index, start = clean.indices.astype(np.int32), clean.indptr.astype(np.int32)
    return sparse.csr_matrix((np.ones(clean.nnz, np.int8), index, start), shape=clean.shape)


def objective_step(costs: Floats) -> float:
    """Largest number of which all costs are whole multiples, or 0 where there is none.

    Costs with up to six decimals have one. Costs count as whole within 1e-9 of their size.
    """
    for decimals in range(_DECIMALS + 1):
        scaled = costs * 10.0**decimals
        whole = np.round(scaled)
        if len(scaled) and scaled.max() > _LARGEST_UNIT:
            return 0.0
        if (np.abs(scaled - whole) <= 1e-9 * np.maximum(scaled, 1.0)).all() and (whole > 0).all():
            return float(np.gcd.reduce(whole.astype(np.int64))) / 10.0**decimals
    return 0.0


def alone_to_none(group: Ints) -> Ints:
    """Groups with one member become -1; the others are numbered from 0."""
    _, number, size = np.unique(group, return_inverse=True, return_counts=True)
    shared = (group >= 0) & (size[number] > 1)
    result = np.full(len(group), -1, np.int64)
    result[shared] = np.unique(group[shared], return_inverse=True)[1]
    return result


def _costs(costs: ArrayLike | None, choices: int) -> Floats:
    values = np.ones(choices) if costs is None else np.asarray(costs)
    if values.shape != (choices,):
        raise InputError(
            "has another length than the matrix has rows",
            where="costs",
            found=f"shape {values.shape}",
            allowed=f"({choices},)",
        )
    if values.dtype.kind not in "biuf":
        raise InputError("is not numeric", where="costs", found=f"type {values.dtype}")
    values = values.astype(np.float64)
    bad = np.flatnonzero(~(np.isfinite(values) & (values > 0)))
    if len(bad):
        raise InputError(
            "is not positive and finite", where=f"costs[{bad[0]}]", found=values[bad[0]]
        )
    return values


def _whole(name: str, values: ArrayLike, length: int) -> Ints:
    array = np.asarray(values)
    if array.dtype.kind not in "iu" or array.shape not in ((), (length,)):
        raise InputError(
            "is not a whole number or an array of them",
            where=name,
            found=f"type {array.dtype}, shape {array.shape}",
            allowed=f"whole numbers, shape ({length},)",
        )
    return np.broadcast_to(array, (length,)).astype(np.int64)


def _choice_mask(name: str, values: ArrayLike, choices: int) -> Bools:
    numbers = np.asarray(values).reshape(-1)
    mask = np.zeros(choices, bool)
    if not len(numbers):
        return mask
    if numbers.dtype.kind not in "iu" or numbers.min() < 0 or numbers.max() >= choices:
        raise InputError(
            "has values that are no row numbers", where=name, allowed=f"0 to {choices - 1}"
        )
    mask[numbers] = True
    return mask
