"""A plan as one integer program that HiGHS solves or checks, without any method of ours.

With x_i = 1 where choice i is taken:

    minimise    sum_i cost_i x_i - worth V
    subject to  sum_i a_ij x_i >= k_j               each target j, where all must be seen
                sum_i a_ij x_i >= k_j y_j           each target j of a weight, where not
                sum_i charge_i x_i <= budget
                sum_{i in s} x_i <= 1               each group and clique s
                V <= S = sum_j w_j y_j,  V >= floor
                x binary, mandatory ones 1, forbidden ones 0, 0 <= y_j <= 1

y_j is whole where k_j > 1 or a share r of V is to be kept (and 1 where all must be seen). In this
case u_j marks targets that are seen just often enough, and lost where one of their choices fails:

                u_j >= (k_j + 1) y_j - sum_i a_ij x_i,  u_j >= 0
                r V <= S - sum_j a_ij w_j u_j + (1 - x_i) sum_j a_ij w_j    each choice i

Where all must be seen, V = S is the weight of all targets. What sums do not say (targets in sight
together past common traffic) is no plan of this kind: `joint` asks for more as it goes.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from roadsight.base import SEED
from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.errors import InputError
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import (
    HIGHS,
    OPTIMAL,
    TIME_LIMIT,
    WITHIN_GAP,
    Cover,
    infeasible,
    relative_gap,
)
from roadsight.setcover.common.program import Program, run_program, version
from roadsight.setcover.common.reductions import uncoverable_targets
from roadsight.setcover.plans.construct import Builder
from roadsight.setcover.plans.cuts import Cuts
from roadsight.setcover.plans.deployment import Deployment

# Integer gap of the placement paper (its section 3.2): smaller ones are not asked for.
PUBLISHED_GAP = 1e-5
# Most by which the greatest number may exceed the least one: the solver's tolerances are 1e-9 of
# the greatest. Of 3,000 random plans it proved two wrongly (weights 1e9 apart and more) and called
# one impossible that is not (weights 8e7 apart).
_FARTHEST = 1e6


class ContradictionError(Exception):
    """Two solvers say of one plan what cannot both be true."""


@dataclass(frozen=True)
class Verified:
    """What an independent run says of an answer.

    Parameters
    ----------
    confirmed : its bound is as good. bound : its bound, as `Deployment.shown`; None where numbers
    are too far apart to ask for one. seconds : limit of work that it had.
    """

    confirmed: bool
    bound: float | None
    seconds: float

    def record(self) -> dict[str, str | float | None]:
        """What is written of it."""
        if self.bound is None:
            result = "not checked: costs or weights are too far apart for HiGHS"
        elif self.confirmed:
            result = "confirmed"
        else:
            result = f"not confirmed in {self.seconds:g} s: HiGHS bound {self.bound:g}"
        return {"by": version(), "result": result, "bound": self.bound}


def solve_whole(deployment: Deployment, limit: Deadline | float | None, gap: float = 0.0) -> Cover:
    """Best choices by HiGHS alone, to the published gap or a larger one.

    "optimal" is what is proven as far as `solve_deployment` proves it. Where that is less, as the
    objective has no step, it is "within_gap".

    Raises
    ------
    InputError : its numbers are too far apart for the solver's tolerances.
    """
    start = time.process_time()
    deadline = limit if isinstance(limit, Deadline) else Deadline(limit)
    scaled, unit, _ = deployment.normalised()
    if (apart := _range(scaled)) > _FARTHEST:
        raise InputError(
            "has costs or weights that are too far apart for HiGHS to prove anything",
            where="the plan",
            found=f"the greatest is {apart:.1g} times the least",
            allowed=f"{_FARTHEST:g} times, or cover.solver: own",
        )
    nothing = np.empty(0, np.int64)
    if deployment.out_of_reach:
        return infeasible(start, solver=HIGHS, proved_by=HIGHS)
    if deployment.complete and len(missing := uncoverable_targets(deployment.problem)):
        return infeasible(start, uncoverable=missing, solver=HIGHS, proved_by=HIGHS)
    program, constant = whole_program(scaled)
    step = scaled.step
    found = run_program(program, deadline, max(gap, PUBLISHED_GAP), step)
    if found.x is None and math.isinf(found.bound) and found.bound > 0:
        return infeasible(start, solver=HIGHS, proved_by=HIGHS)
    builder = Builder(Cuts(scaled), np.random.default_rng(SEED))
    if found.x is not None:
        chosen = np.flatnonzero(found.x[: len(scaled.cost)] > 0.5)
        builder.offer(chosen)
        if builder.best is None:  # allowed within the solver's tolerance only
            builder.build(chosen)
    if builder.best is None:
        if (allowed := any_allowed(scaled, deadline)) is None:
            return infeasible(start, solver=HIGHS, proved_by=HIGHS)
        builder.offer(allowed)
    least = max(found.bound + constant, -scaled.worth * scaled.total)
    value, bound = builder.value, scaled.round_up(least)
    proven, bound = bound > scaled.goal(value), min(bound, value)
    distance = relative_gap(value + scaled.shift, bound + scaled.shift)
    near = distance <= max(gap, PUBLISHED_GAP)
    return Cover(
        OPTIMAL if proven else WITHIN_GAP if near else TIME_LIMIT,
        nothing if builder.best is None else builder.best,
        value * unit,
        (value if proven else bound) * unit,
        0.0 if proven else distance,
        time.process_time() - start,
        reductions={"rows": deployment.problem.matrix.shape[0],
                    "columns": deployment.problem.matrix.shape[1]},
        nodes=found.nodes,
        solver=HIGHS,
        proved_by=HIGHS,
    )  # fmt: skip


def _range(deployment: Deployment) -> float:
    """Greatest by least positive cost, charge or weight, whichever is farthest apart.

    Only numbers of choices that are not forbidden, and those that the program holds, count.
    """
    free = ~deployment.problem.forbidden
    parts = [np.asarray(deployment.cost)[free]]
    if math.isfinite(deployment.budget):
        parts.append(np.asarray(deployment.charge)[free])
    if deployment.keep or deployment.floor or not deployment.complete:
        parts.append(np.asarray(deployment.weights)[deployment.problem.at_least > 0])
    positive = (part[part > 0] for part in parts)
    return max((float(part.max() / part.min()) for part in positive if len(part)), default=1.0)


def any_allowed(deployment: Deployment, deadline: Deadline) -> Ints | None:
    """Sorted choices that are allowed, whatever they cost; empty if not found, None if none are.

    Costs over many orders of magnitude leave a solver's tolerances no meaning. Without them what
    is impossible is proven.
    """
    free = replace(deployment, cost=np.zeros(len(deployment.cost)), worth=0.0)
    if deadline.passed() or _range(free) > _FARTHEST:
        return np.empty(0, np.int64)
    found = run_program(whole_program(free)[0], deadline)
    if found.x is None:
        return None if math.isinf(found.bound) and found.bound > 0 else np.empty(0, np.int64)
    return np.flatnonzero(found.x[: len(deployment.cost)] > 0.5)


def verify(deployment: Deployment, cover: Cover, limit: Deadline) -> Verified:
    """Whether HiGHS, which is told nothing of an answer, comes to a bound that is as good.

    Parameters
    ----------
    cover : an answer of the deployment, with its objective and bound.

    Raises
    ------
    ContradictionError : the choices do not cost what is said, or are not allowed; HiGHS proves more
        than they cost, or finds others below the bound.
    """
    scaled, unit, _ = deployment.normalised()
    seconds = limit.left_s()
    if _range(scaled) > _FARTHEST:
        return Verified(False, None, seconds)
    program, constant = whole_program(scaled)
    ours, value = cover.bound / unit, cover.objective / unit
    room = max(scaled.near(value), 1e-6 * scaled.step)
    if not abs(scaled.objective(cover.chosen) - value) <= room:
        raise ContradictionError(
            f"the answer is said to cost {cover.objective:.10g}, but its choices cost"
            f" {scaled.objective(cover.chosen) * unit:.10g}"
        )
    least = ours - (scaled.step * (1 - 1e-6) if scaled.step else room)
    found = run_program(program, limit, 0.0, scaled.step, enough=least - constant + room)
    # A run that is stopped early has no bound yet.
    bound = scaled.round_up(max(found.bound + constant, -scaled.worth * scaled.total))
    objective = math.inf
    if found.x is not None:
        objective = scaled.objective(np.flatnonzero(found.x[: len(scaled.cost)] > 0.5))
    if bound > value + room or objective < ours - room:
        raise ContradictionError(
            f"the answer costs {cover.objective:.10g} and is proven to cost at least"
            f" {cover.bound:.10g}, but {version()} found {objective * unit:.10g} and proves"
            f" {bound * unit:.10g}"
        )
    return Verified(bound >= ours - room, deployment.shown(bound * unit), seconds)


def whole_program(deployment: Deployment) -> tuple[Program, float]:
    """The program of a deployment, as above, and what its objective lacks.

    Variables are choices, then y and u of the targets that have them, then V and S.
    """
    problem, weights = deployment.problem, np.asarray(deployment.weights)
    build = _Rows(len(problem.costs))
    must, ban = problem.mandatory.astype(float), (~problem.forbidden).astype(float)
    x = build.variables(np.asarray(deployment.cost), must, ban, whole=True)
    by_target = problem.matrix.T.tocsr().astype(np.float64)
    need = problem.at_least.astype(np.float64)
    asked = np.flatnonzero(need > 0)
    valued = np.flatnonzero((need > 0) & (weights > 0))
    if deployment.complete:
        build.rows([(x, by_target[asked])], need[asked], np.inf)
    if math.isfinite(deployment.spendable):
        build.rows([(x, _row(deployment.charge))], -np.inf, deployment.spendable)
    if deployment.exclusive.shape[0]:
        build.rows([(x, deployment.exclusive)], -np.inf, 1.0)
    sees, one = by_target[valued], sparse.identity(len(valued), format="csr")
    if deployment.complete:
        if deployment.keep:
            u = build.variables(np.zeros(len(valued)), 0.0, 1.0, whole=False)
            build.rows([(u, one), (x, sees)], need[valued] + 1, np.inf)
            lost = sparse.csr_matrix(problem.matrix[:, valued].multiply(weights[valued]))
            least = np.asarray(lost.sum(axis=1)).ravel()
            spare = (1 - deployment.keep) * deployment.total
            tight = np.flatnonzero(least > spare)
            eye = sparse.identity(len(least), format="csr")[tight]
            excess = sparse.diags_array(least, format="csr")[tight] - spare * eye
            build.rows([(u, lost[tight]), (x, excess)], -np.inf, least[tight])
        return build.program(), -deployment.worth * deployment.total
    twice = (need[valued] > 1) | bool(deployment.keep)
    price = np.zeros(len(valued)) if deployment.keep else -deployment.worth * weights[valued]
    y = build.variables(price, 0.0, 1.0, whole=twice)
    build.rows([(x, sees), (y, -sparse.diags_array(need[valued], format="csr"))], 0.0, np.inf)
    total = _row(weights[valued])
    if not deployment.keep:
        if deployment.floor:
            build.rows([(y, total)], deployment.floor * (1 - 1e-9), np.inf)
        return build.program(), 0.0
    u = build.variables(np.zeros(len(valued)), 0.0, 1.0, whole=False)
    short = sparse.diags_array(need[valued] + 1, format="csr")
    build.rows([(u, one), (x, sees), (y, -short)], 0.0, np.inf)
    floor = deployment.floor * (1 - 1e-9)
    v = build.variables(np.array([-deployment.worth]), floor, np.inf, whole=False)
    s = build.variables(np.zeros(1), 0.0, np.inf, whole=False)
    unit = _row(np.ones(1))
    build.rows([(s, unit), (y, -total)], 0.0, 0.0)
    build.rows([(v, unit), (s, -unit)], -np.inf, 0.0)
    lost = sparse.csr_matrix(problem.matrix[:, valued].multiply(weights[valued]))
    most = np.asarray(lost.sum(axis=1)).ravel()
    every = sparse.csr_matrix(np.ones((len(most), 1)))
    parts = [(u, lost), (x, sparse.diags_array(most, format="csr"))]
    build.rows([*parts, (v, deployment.keep * every), (s, -every)], -np.inf, most)
    return build.program(), 0.0


class _Rows:
    """Variables and constraints, block by block."""

    def __init__(self, choices: int) -> None:
        self._columns: list[tuple[Floats, Floats, Floats, Floats]] = []
        self._blocks: list[list[tuple[int, sparse.csr_matrix]]] = []
        self._limits: list[tuple[Floats, Floats]] = []

    def variables(
        self, price: Floats, least: Floats | float, most: Floats | float, whole: Bools | bool
    ) -> int:
        """Number of a new block of variables."""
        columns = (np.broadcast_to(part, len(price)) for part in (price, least, most, whole))
        self._columns.append(tuple(columns))  # type: ignore[arg-type]
        return len(self._columns) - 1

    def rows(
        self, parts: list[tuple[int, sparse.csr_matrix]], low: Floats | float, high: Floats | float
    ) -> None:
        """Add constraints: matrices of the blocks of variables that are in them."""
        count = parts[0][1].shape[0]
        self._blocks.append(parts)
        limits = (np.broadcast_to(part, count).astype(np.float64) for part in (low, high))
        self._limits.append(tuple(limits))  # type: ignore[arg-type]

    def program(self) -> Program:
        """All of it together."""
        price, least, most, whole = (
            np.concatenate(part) for part in zip(*self._columns, strict=True)
        )
        sizes = [len(columns[0]) for columns in self._columns]
        table = []
        for parts, (low, _) in zip(self._blocks, self._limits, strict=True):
            line = [sparse.csr_matrix((len(low), size)) for size in sizes]
            for block, matrix in parts:
                line[block] = sparse.csr_matrix(matrix)
            table.append(sparse.hstack(line, format="csr"))
        rows = sparse.vstack([sparse.csr_matrix((0, sum(sizes))), *table], format="csr")
        low, high = (
            np.concatenate([np.empty(0), *part])
            for part in (
                [limits[0] for limits in self._limits],
                [limits[1] for limits in self._limits],
            )
        )
        return Program(price, rows, low, high, least, most, whole.astype(bool))


def _row(values: Floats) -> sparse.csr_matrix:
    return sparse.csr_matrix(np.asarray(values, np.float64)[None])
