"""Of the cheapest covers the one that sees most again, against all of them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy import sparse

from roadsight.setcover import CoverProblem
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.setcover.plans.deploy import solve_deployment
from roadsight.setcover.plans.deployment import Deployment
from roadsight.setcover.plans.second import second_objective


def _case(rng):
    choices, targets = int(rng.integers(6, 11)), int(rng.integers(5, 25))
    sees = sparse.csr_matrix(rng.random((choices, targets)) < rng.uniform(0.25, 0.6))
    cost = rng.integers(1, 4, choices) if rng.random() < 0.5 else np.ones(choices)
    groups = rng.integers(0, 8, choices) if rng.random() < 0.5 else None
    needs = rng.integers(0, 3, targets) if rng.random() < 0.5 else 1
    first, second = (int(choice) for choice in rng.permutation(choices)[:2])
    mandatory = [first] if rng.random() < 0.3 else []
    forbidden = [second] if rng.random() < 0.3 else []
    problem = CoverProblem(sees, cost, groups, needs, mandatory, forbidden)
    weights = rng.integers(0, 4, targets) * 1.0 if rng.random() < 0.5 else None
    cliques = (np.sort(rng.permutation(choices)[:3]),) if rng.random() < 0.3 else ()
    return Deployment(problem, weights, cliques=cliques), rng.integers(-1, 6, targets)


def _value(deployment, stretch, chosen):
    problem = deployment.problem
    count = np.asarray(problem.matrix[chosen].sum(axis=0, dtype=np.int64)).ravel()
    asked = problem.at_least > 0
    once, twice = (asked & (count >= problem.at_least + more) for more in (1, 2))
    weight = np.asarray(deployment.weights)
    road = len(np.unique(stretch[once & (stretch >= 0)]))
    return float(weight[once].sum()), float(weight[twice].sum()), road


def _best(deployment, stretch, cost):
    """Of all allowed sets, which is slow and obvious."""
    found = []
    for size in range(len(deployment.problem.costs) + 1):
        for chosen in combinations(range(len(deployment.problem.costs)), size):
            rows = np.array(chosen, np.int64)
            if deployment.objective(rows) <= cost + 1e-9:
                found.append(_value(deployment, stretch, rows))
    return max(found)


def test_the_best_of_the_cheapest_covers_is_found_and_proven():
    rng = np.random.default_rng(7)
    solved = 0
    while solved < 40:
        deployment, stretch = _case(rng)
        cover = solve_deployment(deployment).cover
        if cover.status != "optimal":
            continue
        solved += 1
        found = second_objective(deployment, cover.chosen, WorkLimit(10.0), stretch)
        assert found.proven
        assert deployment.objective(found.chosen) == pytest.approx(cover.objective)
        value = (found.value[0], found.value[1], found.stretches)
        assert value == _value(deployment, stretch, found.chosen)
        assert value == _best(deployment, stretch, cover.objective)
        before = (found.before[0], found.before[1], found.stretches_before)
        assert before == _value(deployment, stretch, cover.chosen)
        assert found.bound == found.value[0]


def _road(choices=120, targets=400):
    """Sensors and targets along a line, each sensor with a range of its own."""
    rng = np.random.default_rng(2)
    at, place = rng.random(choices) * 100, rng.random(targets) * 100
    reach = rng.uniform(5, 12, choices)
    near = np.abs(at[:, None] - place) < reach[:, None]
    near &= rng.random(near.shape) < 0.95
    near[np.arange(targets) % choices, np.arange(targets)] = True
    return Deployment(CoverProblem(sparse.csr_matrix(near)))


def test_the_limit_of_work_decides_and_nothing_else():
    deployment = _road()
    cover = solve_deployment(deployment, WorkLimit(5.0)).cover
    one, two = (second_objective(deployment, cover.chosen, WorkLimit(0.05)) for _ in range(2))
    assert (one.chosen == two.chosen).all()
    assert one.bound == two.bound
    assert one.value[0] >= one.before[0]
    longer = second_objective(deployment, cover.chosen, WorkLimit(2.0))
    assert longer.value[0] >= one.value[0]
    assert longer.value[0] <= min(one.bound, longer.bound)
    assert len(longer.chosen) == len(cover.chosen)
    assert deployment.objective(longer.chosen) <= cover.objective


def test_no_target_is_no_trouble():
    problem = CoverProblem(sparse.csr_matrix((3, 0), dtype=bool))
    found = second_objective(Deployment(problem), np.empty(0, np.int64), WorkLimit(1.0))
    assert len(found.chosen) == 0
    assert found.proven
    assert found.total == 0.0
