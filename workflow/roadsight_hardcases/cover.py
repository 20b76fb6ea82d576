"""Set cover: proof, ties, what nobody covers."""

from __future__ import annotations

import math

import numpy as np
from scipy import sparse
from scipy.optimize import Bounds, LinearConstraint, linprog, milp

from roadsight.base.arrays import Numbers
from roadsight.placement.sight.detection import times_seen
from roadsight.setcover.common.problem import INFEASIBLE, OPTIMAL, CoverProblem
from roadsight.setcover.cover.solve import solve_cover_problem
from roadsight_hardcases.case import Errors, hard_case


def _greedy(matrix: Numbers, costs: Numbers, rounds: int) -> list[int]:
    """Rows by targets gained per cost until all are covered, or so many rounds."""
    chosen: list[int] = []
    left = np.ones(matrix.shape[1], bool)
    while left.any() and len(chosen) < rounds:
        best = int(np.argmax((matrix[:, left] > 0).sum(axis=1) / costs))
        chosen.append(best)
        left &= ~(matrix[best] > 0)
    return chosen


def _corridor(rng: np.random.Generator, choices: int, targets: int) -> Numbers:
    """Sensors along a road that see the targets near them, with holes."""
    gap = np.abs(np.linspace(0, 1, choices)[:, None] - np.linspace(0, 1, targets))
    return (gap < 0.09) & (rng.random((choices, targets)) < 0.8)


@hard_case("solve_cover", bound=0.5, unit="sensors too many")
def greedy_trap(rng: np.random.Generator) -> Errors:
    """Always taking the sensor that sees most needs twice as many as are enough."""
    sizes = 2 ** np.arange(6, 0, -1)
    half = sizes.sum()
    matrix = np.zeros((len(sizes) + 2, 2 * half), bool)
    starts = np.cumsum(sizes) - sizes
    for row, (start, size) in enumerate(zip(starts, sizes, strict=True)):
        matrix[row, np.r_[start : start + size, half + start : half + start + size]] = True
    matrix[-2, :half] = matrix[-1, half:] = True
    naive = len(_greedy(matrix, np.ones(len(matrix)), 100))
    return naive - 2, len(solve_cover_problem(CoverProblem(matrix)).chosen) - 2


@hard_case("solve_cover", bound=0.5, unit="targets left out unnoticed")
def target_that_nobody_sees(rng: np.random.Generator) -> Errors:
    """A greedy cover goes round for ever, or stops and says nothing, if a target has no sensor."""
    matrix = _corridor(rng, 60, 120)
    matrix[:, [7, 50]] = False
    chosen = _greedy(matrix, np.ones(60), 60)
    naive = np.count_nonzero(~matrix[chosen].any(axis=0))
    cover = solve_cover_problem(CoverProblem(matrix))
    named = cover.status == INFEASIBLE and cover.uncoverable.tolist() == [7, 50]
    return naive, 0.0 if named else naive


def _by_scipy(matrix: Numbers, costs: Numbers, **options: float) -> Numbers:
    """Rows (n,) bool of the cover that SciPy's solver calls optimal."""
    answer = milp(
        costs,
        integrality=np.ones(len(costs)),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(sparse.csr_matrix(matrix.T.astype(float)), lb=1),
        options=options,
    )
    return np.zeros(len(costs), bool) if answer.x is None else answer.x > 0.5


def _ours(matrix: Numbers, costs: Numbers) -> Numbers:
    """Rows (n,) bool of our cover, none unless it is proven."""
    cover = solve_cover_problem(CoverProblem(matrix, costs))
    chosen = np.zeros(len(costs), bool)
    chosen[cover.chosen] = cover.status == OPTIMAL
    return chosen


@hard_case("solve_cover", bound=0.5, unit="cost above the optimum")
def gap_of_a_hundredth_of_a_percent(rng: np.random.Generator) -> Errors:
    """SciPy calls optimal what lies within 1e-4 of its bound: hundreds of cents, in cents."""
    own = np.random.default_rng(1)  # an instance on which the solver does stop early
    gap = np.abs(np.linspace(0, 1, 80)[:, None] - np.linspace(0, 1, 80))
    matrix = (gap < 0.06) & (own.random((80, 80)) < 0.7)
    matrix = matrix[:, matrix.any(axis=0)]
    costs = 1_000_000.0 + own.integers(0, 1000, 80)
    best = costs[_by_scipy(matrix, costs, mip_rel_gap=0.0)].sum()
    naive, ours = (costs[way(matrix, costs)].sum() for way in (_by_scipy, _ours))
    return naive - best, abs(ours - best)


def _dearer(matrix: Numbers, costs: Numbers, chosen: Numbers, best: float) -> float:
    """How much dearer a cover is than the best, as a share of it; infinite if it is no cover."""
    whole = matrix[chosen].any(axis=0).all()
    return float(costs[chosen].sum() / best - 1) if whole else math.inf


@hard_case("solve_cover", bound=1e-6, unit="share of the cost")
def costs_of_a_billionth(rng: np.random.Generator) -> Errors:
    """Costs in another unit, below the tolerances of a solver, make every cover optimal."""
    naive = ours = 0.0
    for _ in range(3):
        matrix, costs = rng.random((60, 200)) < 0.08, np.full(60, 1e-9)
        matrix[0, ~matrix.any(axis=0)] = True
        best = _by_scipy(matrix, np.ones(60)).sum() * 1e-9
        naive = max(naive, _dearer(matrix, costs, _by_scipy(matrix, costs), best))
        ours = max(ours, _dearer(matrix, costs, _ours(matrix, costs), best))
    return naive, ours


@hard_case("solve_cover", bound=1e-6, unit="share of the cost of a road")
def costs_over_20_orders(rng: np.random.Generator) -> Errors:
    """Of five roads whose sensors cost from 1e-10 to 1e10, the cheap ones are not solved."""
    naive = ours = 0.0
    for _ in range(6):
        roads = [(rng.random((11, 20)) < 0.25, rng.integers(10, 20, 11)) for _ in range(5)]
        for matrix, _ in roads:
            matrix[0, ~matrix.any(axis=0)] = True
        best = [costs[_by_scipy(matrix, costs, mip_rel_gap=0.0)].sum() for matrix, costs in roads]
        whole = sparse.block_diag([matrix for matrix, _ in roads]).toarray().astype(bool)
        scale = np.repeat(10.0 ** np.arange(-10, 11, 5), 11)
        costs = np.concatenate([costs for _, costs in roads]) * scale
        off = []
        for way in (_by_scipy, _ours):
            parts = zip(roads, np.split(way(whole, costs), 5), best, strict=True)
            off.append(max(_dearer(*road, chosen, least) for road, chosen, least in parts))
        naive, ours = max(naive, off[0]), max(ours, off[1])
    return naive, ours


@hard_case("solve_cover", bound=0.5, unit="sensors that the bound claims too many")
def bound_rounded_up(rng: np.random.Generator) -> Errors:
    """Three sensors of 0.1 cost 0.30000000000000004: rounded up, the bound claims a fourth."""
    naive = ours = 0.0
    for sensors in range(2, 30):
        matrix, costs = np.eye(sensors).repeat(3, axis=1), np.full(sensors, 0.1)
        linear = linprog(costs, A_ub=-matrix.T, b_ub=-np.ones(3 * sensors), bounds=(0, 1))
        cover = solve_cover_problem(CoverProblem(matrix, costs))
        naive = max(naive, math.ceil(linear.fun / 0.1) - sensors)
        ours = max(ours, abs(cover.bound - cover.objective) / 0.1)
    return naive, ours


@hard_case("solve_cover", bound=0.5, unit="difference in sensors")
def order_of_equal_sensors(rng: np.random.Generator) -> Errors:
    """Among sensors that gain the same, the first row wins: another order, another plan."""
    naive = ours = 0.0
    for _ in range(4):
        matrix = _corridor(rng, 60, 120)
        matrix = matrix[:, matrix.any(axis=0)].repeat(2, axis=0)
        orders = [rng.permutation(len(matrix)) for _ in range(25)]
        found = [len(_greedy(matrix[o], np.ones(len(matrix)), len(matrix))) for o in orders]
        exact = [solve_cover_problem(CoverProblem(matrix[o])).objective for o in orders[:3]]
        naive, ours = max(naive, np.ptp(found)), max(ours, np.ptp(exact))
    return naive, ours


@hard_case("check_coverage", bound=0.5, unit="views miscounted")
def targets_seen_by_many(rng: np.random.Generator) -> Errors:
    """Views counted in 8 bits are lost when more than 127 sensors see a target."""
    matrix = sparse.csr_matrix(np.ones((300, 4), np.int8))
    naive = np.ones(300, bool) @ matrix
    ours = times_seen(matrix, np.arange(300))
    return np.abs(naive.astype(int) - 300).max(), np.abs(ours - 300).max()
