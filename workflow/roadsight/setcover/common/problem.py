"""The set-cover problem and its working form."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints, Ints32
from roadsight.base.errors import InputError

# Parts of the smallest cost that a step may be: two costs of six digits have a step.
_MOST_PARTS = 2**20
# Costs of more steps than this have no step: 64-bit floats hold whole numbers up to 2**53, and sums
# of thousands of costs must be among them.
_LARGEST = 2.0**40
_WHOLE = 2.0**-48  # share of a cost within which it is a multiple of a step: some roundings
NEAR = 1e-7  # share of its cost to which a cover is proven where costs have no common step


class CoverProblem:
    """Minimise the cost of choices that cover each target often enough.

    Rows of the matrix are the choices, columns the targets.

    minimise ``sum c_i x_i`` subject to ``sum_i a_ij x_i >= at_least_j`` for each target j and
    ``sum_{i in g} x_i <= 1`` for each group g, x binary (Eqs. 5 to 7 of the placement paper).

    Parameters
    ----------
    matrix : (choices, targets) sparse or dense, any numeric or bool type; positive = covers. Of
        repeated entries one positive is enough, stored zeros are dropped.
    costs : (choices,) positive and finite, in any unit; None = 1 each.
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
    step : cost of one step in the problem; where not ``integral``, a unit of the size of the least
        that any cover costs, so that absolute tolerances do not depend on the problem's unit.
    """

    by_choice: sparse.csr_matrix
    cost: Floats
    need: Ints32
    group: Ints
    choice: Ints
    integral: bool
    step: float = 1.0

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

    def is_cover(self, chosen: Bools) -> bool:
        """Whether choices (m,) cover each target often enough, one of a group at most."""
        group = self.group[chosen & (self.group >= 0)]
        seen = self.by_choice.T @ chosen.astype(np.int32)
        return bool((seen >= self.need).all()) and len(np.unique(group)) == len(group)

    def least(self) -> float:
        """Cost of the target that is dearest to cover, in steps: no cover costs less."""
        by_target = self.by_target
        if not by_target.nnz:
            return 0.0
        cheapest = np.minimum.reduceat(self.cost[by_target.indices], by_target.indptr[:-1])
        return float((cheapest * self.need).max())

    def rescaled(self) -> Instance:
        """The same with costs in steps of their own, if they have any, else in a fitting unit."""
        step = 1.0 if self.integral else objective_step(self.cost)
        if step:
            cost = np.round(self.cost / step)
            return replace(self, cost=cost, integral=True, step=self.step * step)
        unit = power_of_two(self.least())
        return replace(self, cost=self.cost / unit, step=self.step * unit)

    def goal(self, best: float) -> float:
        """Largest bound that still allows a cover cheaper than ``best``, in steps."""
        if not np.isfinite(best):
            return np.inf
        # One step less where costs are whole; bounds may be rounded by a millionth of a step.
        return best - 1 + 1e-6 if self.integral else best * (1 - NEAR)

    def round_up(self, bound: float) -> float:
        """Bound lifted to the next possible objective."""
        return math.ceil(bound - 1e-6) if self.integral and np.isfinite(bound) else bound


def clean_matrix(matrix: Any) -> sparse.csr_matrix:
    """CSR of ones from any sparse or dense 2-D matrix: where an entry is positive.

    Entries of one place are looked at one by one and never added up: sums of small integers wrap.

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
    entries = matrix.tocoo() if sparse.issparse(matrix) else None
    data = matrix if entries is None else entries.data
    if not np.isfinite(data).all() or (data < 0).any():
        raise InputError(
            "has entries that are negative or not finite", where="matrix", allowed="0 or more"
        )
    covers = data > 0
    place = np.nonzero(covers) if entries is None else (entries.row[covers], entries.col[covers])
    clean = sparse.csr_matrix((np.ones(len(place[0]), bool), place), shape=matrix.shape)
    clean.sum_duplicates()
    index, start = clean.indices.astype(np.int32), clean.indptr.astype(np.int32)
    return sparse.csr_matrix((np.ones(clean.nnz, np.int8), index, start), shape=clean.shape)


def objective_step(costs: Floats) -> float:
    """Largest number of which all positive costs are whole multiples, or 0 where there is none.

    A step is a whole part of the smallest cost, one millionth at least, whatever the unit.
    """
    values = np.unique(costs[costs > 0])
    parts = 1
    while len(values):
        scaled = values / values[0] * parts
        if scaled[-1] > _LARGEST:
            break
        off = np.flatnonzero(np.abs(scaled - np.round(scaled)) > _WHOLE * scaled)
        if not len(off):
            return float(values[0] / parts)
        part = Fraction(scaled[off[0]]).limit_denominator(max(_MOST_PARTS // parts, 1))
        if part.denominator == 1:
            break
        parts *= part.denominator
    return 0.0


def power_of_two(size: float) -> float:
    """Unit of a size: the power of two at or below it, by which nothing is rounded; 1 for 0."""
    return 2.0 ** math.floor(math.log2(size)) if size > 0 else 1.0


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
    if not np.isfinite(values.sum()):
        raise InputError("add up to more than a 64-bit float holds", where="costs")
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


OPTIMAL = "optimal"
TIME_LIMIT = "time_limit"
WITHIN_GAP = "within_gap"
INFEASIBLE = "infeasible"
OWN: Final = "own"
HIGHS: Final = "highs"  # solvers: ours, and HiGHS on a whole integer program


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


def infeasible(start: float, **known: Any) -> Cover:
    """Answer where nothing is allowed; ``start`` : CPU seconds of this process at its beginning."""
    seconds = time.process_time() - start
    return Cover(INFEASIBLE, np.empty(0, np.int64), math.inf, math.inf, 0.0, seconds, **known)


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
