"""Covers with more to them: budgets, prices, weights, distances, failures of a sensor."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints
from roadsight.base.errors import InputError
from roadsight.setcover.common.kernels import count_of_rows, sums_of_rows
from roadsight.setcover.common.problem import (
    NEAR,
    CoverProblem,
    alone_to_none,
    objective_step,
    power_of_two,
)

_ROUNDING = 1e-12  # share of a budget that sums of charges may exceed it by: they are rounded
ROUNDED = 2.0**-43  # share of its terms by which an objective may be rounded
# Common steps of the objective that are smaller, as a share of its largest term, do not count:
# rounding bounds up to them would hardly help.
_LEAST_STEP = 1e-3


@dataclass(frozen=True)
class Deployment:
    """Take choices X with ``minimise cost(X) - worth * V(X)``.

    V(X) is the coverage that is guaranteed. Let f(X) be the weight of the targets that at least
    ``at_least_j`` choices of X see. V is f(X) and, with ``keep`` = r, at most 1/r of what is left
    when any one choice of X fails: ``V = min(f(X), min_i f(X - i) / r)``.

    X keeps to the groups, mandatory and forbidden choices of the problem, to
    ``sum charge_i x_i <= budget``, to at most one choice of each clique and to V >= ``floor``.
    Where ``complete``, V is the weight of all targets, and each target is seen often enough.

    Parameters
    ----------
    problem : matrix, costs, groups, at_least, mandatory and forbidden choices.
    weights : (targets,) 0 or more; None = 1 each.
    complete : every target must be seen, as in a cover.
    worth : what a unit of weight is worth, in cost.
    cost : (choices,) 0 or more, what is minimised; None = the problem's costs.
    charge, budget : (choices,) 0 or more, and what they may add up to.
    cliques : sets of choices of which at most one is taken.
    keep : share of V that is left when any one choice fails, in [0, 1].
    floor : least V.

    Raises
    ------
    InputError : a weight, charge, budget or share is not usable.
    """

    problem: CoverProblem
    weights: Floats = None  # type: ignore[assignment]
    complete: bool = True
    worth: float = 0.0
    cost: Floats = None  # type: ignore[assignment]
    charge: Floats = None  # type: ignore[assignment]
    budget: float = math.inf
    cliques: tuple[Ints, ...] = field(default=(), repr=False)
    keep: float = 0.0
    floor: float = 0.0

    def __post_init__(self) -> None:
        choices, targets = self.problem.matrix.shape
        set_ = object.__setattr__
        set_(self, "weights", _numbers("weights", self.weights, targets, np.ones(targets)))
        set_(self, "cost", _numbers("cost", self.cost, choices, self.problem.costs))
        set_(self, "charge", _numbers("charge", self.charge, choices, self.problem.costs))
        if not self.budget >= 0:
            raise InputError(
                "is not usable", where="budget", found=self.budget, allowed="0 or more"
            )
        if not 0 <= self.keep <= 1:
            raise InputError("is no share", where="keep", found=self.keep, allowed="0 to 1")
        if not (math.isfinite(self.worth) and self.worth >= 0):
            raise InputError("is not usable", where="price", found=self.worth, allowed="0 or more")

    @cached_property
    def total(self) -> float:
        """Weight of all targets that ask for something."""
        return math.fsum(self.weights[self.problem.at_least > 0])

    @property
    def out_of_reach(self) -> bool:
        """Whether V is asked to be more than the weight of all targets."""
        return self.floor * (1 - 1e-9) > self.total

    @cached_property
    def spendable(self) -> float:
        """Budget as far as charges can use it, with room for rounding."""
        if not math.isfinite(self.budget):
            return math.inf
        positive = self.charge[self.charge > 0]
        step = objective_step(positive) if len(positive) else 0.0
        most = self.budget * (1 + _ROUNDING)
        used = math.floor(most / step + 1e-9) * step if step else self.budget
        return used * (1 + _ROUNDING)

    @cached_property
    def exclusive(self) -> sparse.csr_matrix:
        """Cliques and groups, (sets, choices): at most one choice of each set."""
        group = alone_to_none(self.problem.groups)
        member = np.flatnonzero(group >= 0)
        sets = int(group.max(initial=-1)) + 1
        cliques = [np.full(len(c), sets + k) for k, c in enumerate(self.cliques)]
        set_of = np.concatenate([group[member], *cliques])
        choice = np.concatenate([member, *self.cliques])
        shape = (sets + len(self.cliques), len(group))
        return sparse.csr_matrix((np.ones(len(choice), np.int32), (set_of, choice)), shape=shape)

    @cached_property
    def step(self) -> float:
        """Number of which all objectives are whole multiples; 0 where there is none."""
        if self.worth and 0 < self.keep < 1:
            return 0.0
        parts = [self.cost, self.worth * self.weights]
        values: Floats = np.concatenate(parts)
        step = objective_step(values[values > 0]) if (values > 0).any() else 1.0
        return step if step >= _LEAST_STEP * values.max(initial=0.0) else 0.0

    def goal(self, best: float) -> float:
        """Largest bound that still allows a better objective than ``best``."""
        if not math.isfinite(best):
            return math.inf
        return best - self.step * (1 - 1e-6) if self.step else best - self.near(best)

    def shown(self, objective: float) -> float:
        """Covered weight of a budget, cost of choices and of what they leave for a price."""
        counts = not self.complete and not np.asarray(self.cost).any()
        return -objective if counts else objective + (0.0 if self.complete else self.shift)

    @cached_property
    def shift(self) -> float:
        """What counts objectives from full coverage down, so that gaps of a price are of costs."""
        return self.worth * self.total if np.asarray(self.cost).any() else 0.0

    def near(self, best: float) -> float:
        """How near to ``best`` an objective without a step is proven."""
        rounded = ROUNDED * (abs(best) + self.worth * self.total)
        return max(NEAR * abs(best + self.shift), rounded, sys.float_info.min)

    def normalised(self) -> tuple[Deployment, float, float]:
        """The same in units of its own size, the unit of cost, and that of weight.

        Solvers' tolerances are absolute. Weights are divided by the greatest, charges too, costs by
        what the target that is dearest to see, or to leave unseen, costs at least. All units are
        powers of two, by which nothing is rounded. Choices that the budget excludes are forbidden,
        so that the greatest charge is one that can be spent.
        """
        out = self.problem.forbidden
        out = out | ((self.charge > self.spendable) & ~self.problem.mandatory)
        charges = np.where(out, 0.0, self.charge)
        weight = power_of_two(
            float(np.max(self.weights, initial=0.0, where=self.problem.at_least > 0))
        )
        charge = power_of_two(float(np.max(charges, initial=0.0)))
        cost = power_of_two(self._least() or self.worth * weight or float(self.cost.max(initial=0)))
        return (
            replace(
                self,
                problem=self.problem.changed(forbidden=np.flatnonzero(out)),
                weights=self.weights / weight,
                worth=self.worth * weight / cost,
                cost=self.cost / cost,
                charge=charges / charge,
                budget=self.budget / charge,
                floor=self.floor / weight,
            ),
            cost,
            weight,
        )

    def _least(self) -> float:
        """Least cost of the target that is dearest to see, or to leave unseen; 0 where unknown."""
        by_target = self.problem.matrix.tocsc()
        often = np.where(np.diff(by_target.indptr) > 0, self.problem.at_least, 0)
        seen = np.flatnonzero(often)
        if not len(seen):
            return 0.0
        cost = np.asarray(self.cost)[by_target.indices]
        least = np.minimum.reduceat(cost, by_target.indptr[seen]) * often[seen]
        if not self.complete:
            least = np.minimum(least, self.worth * self.weights[seen])
        return float(least.max())

    def round_up(self, bound: float) -> float:
        """Bound lifted to the next possible objective."""
        if not self.step or not math.isfinite(bound):
            return bound
        return math.ceil(bound / self.step - 1e-6) * self.step

    def guaranteed(self, chosen: Ints) -> float:
        """V of sorted choices."""
        need, weights = self.problem.at_least, self.weights
        matrix = self.problem.matrix
        rows = matrix.indptr, matrix.indices, chosen
        count = count_of_rows(*rows, len(need))
        asked = need > 0
        covered = math.fsum(weights[(count >= need) & asked])
        if not self.keep or not len(chosen):
            return covered
        critical = np.where((count == need) & asked, weights, 0.0)
        lost = sums_of_rows(*rows, critical).max()
        return min(covered, max(covered - lost, 0.0) / self.keep)

    def objective(self, chosen: Ints) -> float:
        """Objective of sorted choices; infinite where they are not allowed."""
        if self.broken(chosen):
            return math.inf
        value = self.guaranteed(chosen)
        least = max(self.total, self.floor) if self.complete else self.floor
        if value < least * (1 - 1e-9):
            return math.inf
        if self.complete:
            need, matrix = self.problem.at_least, self.problem.matrix
            count = count_of_rows(matrix.indptr, matrix.indices, chosen, len(need))
            if (count < need).any():
                return math.inf
        return math.fsum(self.cost[chosen]) - self.worth * value

    def broken(self, chosen: Ints) -> bool:
        """Whether choices break the budget, a clique, a group, or what must (not) be taken."""
        mask = np.zeros(len(self.problem.costs), np.int32)
        mask[chosen] = 1
        problem = self.problem
        if (problem.mandatory & (mask == 0)).any() or (problem.forbidden & (mask > 0)).any():
            return True
        if math.fsum(self.charge[chosen]) > self.spendable:
            return True
        return bool((self.exclusive @ mask > 1).any())


def _numbers(name: str, values: ArrayLike | None, length: int, default: Floats) -> Floats:
    array = default if values is None else np.asarray(values, np.float64)
    if array.shape != (length,) or not np.isfinite(array).all() or (array < 0).any():
        raise InputError(
            "is no array of numbers of 0 or more",
            where=name,
            found=f"shape {array.shape}",
            allowed=f"finite, shape ({length},)",
        )
    return array.astype(np.float64)


def spacing_cliques(xy_m: Floats, spacing_m: float) -> tuple[Ints, ...]:
    """Sets of positions that lie nearer to each other than a spacing, or at one place.

    Every two positions nearer than the spacing share a set, and a set holds no others. Sets grow
    until no position can join, so that there are few of them and relaxations are tight.

    Parameters
    ----------
    xy_m : (n, 2) positions, local metres; equal ones stand at one place.
    """
    places, member = np.unique(np.asarray(xy_m, np.float64), axis=0, return_inverse=True)
    member = member.reshape(-1)
    order = np.argsort(member, kind="stable")
    choices_at = np.split(order, np.cumsum(np.bincount(member, minlength=len(places)))[:-1])
    # Places nearer than the spacing to each; exactly the spacing is far enough.
    near: list[set[int]] = [set() for _ in range(len(places))]
    if len(places) > 1:
        pairs = cKDTree(places).query_pairs(spacing_m, output_type="ndarray")
        length_m = np.linalg.norm(places[pairs[:, 0]] - places[pairs[:, 1]], axis=1)
        for a, b in pairs[length_m < spacing_m * (1 - 1e-9)].tolist():
            near[a].add(b)
            near[b].add(a)
    cliques = _edge_cliques(near)
    lonely = [{p} for p in range(len(places)) if not near[p] and len(choices_at[p]) > 1]
    sets = [*cliques, *lonely]
    return tuple(np.sort(np.concatenate([choices_at[p] for p in sorted(s)])) for s in sets)


def _edge_cliques(near: list[set[int]]) -> list[set[int]]:
    """Maximal cliques that hold every edge of a graph at least once."""
    done: set[tuple[int, int]] = set()
    cliques = []
    for a in range(len(near)):
        for b in sorted(near[a]):
            if b < a or (a, b) in done:
                continue
            clique, common = {a, b}, near[a] & near[b]
            while common:
                # The member that holds most edges that are still open, the first of equals.
                best = max(
                    sorted(common),
                    key=lambda c: sum((min(c, p), max(c, p)) not in done for p in clique),
                )
                clique.add(best)
                common = common & near[best]
            done |= {(p, q) for p in clique for q in clique if p < q}
            cliques.append(clique)
    return cliques
