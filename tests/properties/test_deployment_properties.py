"""Deployments, curves and alternatives against brute force on small random problems."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from roadsight.base.errors import InputError
from roadsight.setcover import CoverProblem
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.setcover.plans.alternatives import most_different, replacements
from roadsight.setcover.plans.curve import coverage_curve
from roadsight.setcover.plans.deploy import solve_costly_cover, solve_deployment
from roadsight.setcover.plans.deployment import Deployment, spacing_cliques

GOALS = ("cover", "budget", "price", "overlap")


def subsets(choices):
    for bits in itertools.product([0, 1], repeat=choices):
        yield np.flatnonzero(bits)


def slow_value(deployment, chosen):
    """Guaranteed coverage by its definition, one failure after the other."""
    seen = deployment.problem.matrix.toarray() > 0
    need = deployment.problem.at_least

    def covered(taken):
        enough = (seen[taken].sum(axis=0) >= need) & (need > 0)
        return deployment.weights[enough].sum()

    value = covered(chosen)
    if deployment.keep:
        left = [covered(chosen[chosen != one]) for one in chosen]
        value = min([value, *(part / deployment.keep for part in left)])
    return value


def slow_objective(deployment, chosen):
    problem = deployment.problem
    mask = np.zeros(len(problem.costs), bool)
    mask[chosen] = True
    groups = problem.groups[mask & (problem.groups >= 0)]
    wrong = (problem.mandatory & ~mask).any() or (problem.forbidden & mask).any()
    wrong |= len(groups) > len(np.unique(groups))
    wrong |= any(mask[clique].sum() > 1 for clique in deployment.cliques)
    wrong |= deployment.charge[mask].sum() > deployment.budget + 1e-9
    value = slow_value(deployment, chosen)
    if deployment.complete:
        seen = problem.matrix.toarray()[chosen].sum(axis=0)
        wrong |= (seen < problem.at_least).any() or value < deployment.total - 1e-9
    wrong |= value < deployment.floor - 1e-9
    return np.inf if wrong else deployment.cost[mask].sum() - deployment.worth * value


def posed(rng, goal):
    m, n = rng.integers(2, 8), rng.integers(1, 12)
    seen = sparse.csr_matrix(rng.random((m, n)) < rng.uniform(0.2, 0.7))
    costs = [np.ones(m), rng.integers(1, 6, m) * 1.0, rng.uniform(0.5, 3, m)][rng.integers(3)]
    often = rng.integers(0, 3, n) if rng.random() < 0.3 else int(rng.integers(1, 3))
    groups = rng.integers(-1, 3, m) if rng.random() < 0.3 else None
    must = rng.random(m) < 0.05
    ban = (rng.random(m) < 0.05) & ~must
    problem = CoverProblem(seen, costs, groups, often, np.flatnonzero(must), np.flatnonzero(ban))
    cliques = tuple(np.sort(rng.choice(m, 2, replace=False)) for _ in range(rng.integers(0, 3)))
    rest = {
        "cover": {},
        "budget": {"complete": False, "worth": 1.0, "cost": np.zeros(m), "charge": costs,
                   "budget": float(rng.uniform(0, costs.sum()))},
        "price": {"complete": False, "worth": float(rng.choice([0.2, 0.5, 0.37]))},
        "overlap": {"complete": bool(rng.integers(2)), "cost": (rng.random(m) < 0.5) * 1.0,
                    "charge": costs, "budget": float(rng.uniform(0, costs.sum())),
                    "floor": float(rng.integers(0, n))},
    }[goal]  # fmt: skip
    weights = rng.integers(0, 4, n) * 1.0 if rng.random() < 0.5 else None
    keep = float(rng.choice([0, 0, 0.5, 0.8, 1.0]))
    return Deployment(problem, weights, cliques=cliques, keep=keep, **rest)


def best_of(deployment):
    every = subsets(len(deployment.problem.costs))
    return min(slow_objective(deployment, chosen) for chosen in every)


seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("goal", GOALS)
@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_deployment_is_the_best_of_all_subsets(goal, seed):
    deployment = posed(np.random.default_rng(seed), goal)
    best, cover = best_of(deployment), solve_deployment(deployment).cover
    if np.isinf(best):
        assert cover.status == "infeasible"
        return
    assert cover.status == "optimal"
    assert cover.objective == pytest.approx(best, abs=1e-6)
    assert slow_objective(deployment, cover.chosen) == pytest.approx(best, abs=1e-6)


@pytest.mark.parametrize("goal", GOALS)
@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_bounds_hold_without_any_time(goal, seed):
    deployment = posed(np.random.default_rng(seed), goal)
    best, quick = best_of(deployment), solve_deployment(deployment, 0.0).cover
    assert quick.bound <= best + 1e-6
    assert quick.objective >= best - 1e-6
    if np.isfinite(quick.objective):
        found = slow_objective(deployment, quick.chosen)
        assert found == pytest.approx(quick.objective, abs=1e-6)


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_curve_holds_the_best_of_each_budget_and_never_falls(seed):
    rng = np.random.default_rng(seed)
    deployment = replace(posed(rng, "budget"), keep=float(rng.choice([0.0, 0.0, 0.7])))
    problem = deployment.problem
    deployment = replace(deployment, problem=CoverProblem(problem.matrix, problem.costs,
                                                          at_least=problem.at_least))  # fmt: skip
    budgets = np.linspace(0, problem.costs.sum(), 5).tolist()
    for limit, exact in ((None, True), (0.0, False)):
        points = coverage_curve(deployment, budgets, limit)
        assert [point.budget for point in points] == budgets
        values, bounds = ([getattr(p, name) for p in points] for name in ("value", "bound"))
        assert values == sorted(values)
        assert bounds == sorted(bounds)
        for point in points:
            best = -best_of(replace(deployment, budget=point.budget))
            assert point.value <= best + 1e-6 <= point.bound + 2e-6
            assert point.spent <= point.budget + 1e-9
            assert slow_value(deployment, point.chosen) == pytest.approx(point.value)
            if exact:
                assert (point.status, point.value) == ("optimal", pytest.approx(best))


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_budgets_below_the_cheapest_cover_never_claim_to_see_everything(seed):
    rng = np.random.default_rng(seed)
    deployment = replace(posed(rng, "cover"), keep=0.0)
    cover = solve_deployment(deployment).cover
    if cover.status == "infeasible" or not len(cover.chosen):
        return
    budgets = np.linspace(0, cover.objective, 4)[1:].tolist()
    try:
        points = coverage_curve(deployment, budgets, 0.0, full=cover.bound)
    except InputError:
        return
    for point in points:
        soft = replace(deployment, complete=False, worth=1.0, cost=np.zeros(len(deployment.cost)))
        best = -best_of(replace(soft, budget=point.budget))
        assert point.value <= best + 1e-6 <= point.bound + 2e-6


@pytest.mark.parametrize("goal", ["cover", "budget", "price"])
@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_replacements_are_all_choices_that_keep_the_answer_as_good(goal, seed):
    deployment = posed(np.random.default_rng(seed), goal)
    cover = solve_deployment(deployment).cover
    if cover.status == "infeasible":
        return
    chosen, cost = cover.chosen, deployment.cost
    found = replacements(deployment, chosen)
    for one, others in zip(chosen, found, strict=True):
        rest = chosen[chosen != one]
        expected = [
            other
            for other in np.setdiff1d(np.arange(len(cost)), chosen)
            if cost[other] == pytest.approx(cost[one])
            and slow_objective(deployment, np.sort(np.append(rest, other)))
            <= cover.objective + 1e-7
        ]
        assert others.tolist() == expected


@pytest.mark.parametrize("goal", ["cover", "budget", "price"])
@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_most_different_answer_shares_as_few_places_as_any(goal, seed):
    rng = np.random.default_rng(seed)
    deployment = posed(rng, goal)
    cover = solve_deployment(deployment).cover
    if cover.status == "infeasible":
        return
    place = rng.integers(0, 5, len(deployment.cost))
    found = most_different(deployment, cover.chosen, place)
    mine = place[cover.chosen]
    value = slow_value(deployment, cover.chosen)
    cost = deployment.cost[cover.chosen].sum()
    shared = {
        tuple(chosen): np.isin(place[chosen], mine).sum()
        for chosen in subsets(len(place))
        if np.isfinite(slow_objective(deployment, chosen))
        and deployment.cost[chosen].sum() <= cost + 1e-7
        and (goal == "cover" or slow_value(deployment, chosen) >= value - 1e-7)
    }
    assert tuple(found.chosen) in shared
    assert np.isin(place[found.chosen], mine).sum() == min(shared.values())
    assert found.least_shared <= found.shared


@pytest.mark.parametrize("work_s", [0.0, 1e-4, 10.0])
@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_costly_covers_are_covers_with_valid_bounds(work_s, seed):
    rng = np.random.default_rng(seed)
    deployment = replace(posed(rng, "cover"), keep=0.0, cliques=())
    best = best_of(deployment)
    cover = solve_costly_cover(deployment.problem, WorkLimit(work_s))
    if np.isinf(best):
        assert not np.isfinite(cover.objective)
        return
    assert cover.bound <= best + 1e-6
    if np.isfinite(cover.objective):
        assert slow_objective(deployment, cover.chosen) == pytest.approx(cover.objective)
    if work_s == 10.0:
        assert (cover.status, cover.objective) == ("optimal", pytest.approx(best))


@settings(max_examples=60, deadline=None)
@given(seed=seeds)
def test_cliques_forbid_what_is_too_near_and_nothing_else(seed):
    rng = np.random.default_rng(seed)
    xy_m = rng.integers(0, 8, (rng.integers(1, 30), 2)).astype(float)
    spacing_m = float(rng.choice([1.0, 2.0, 2.5, 4.0]))
    near = np.hypot(*(xy_m[:, None] - xy_m[None]).transpose(2, 0, 1)) < spacing_m - 1e-9
    together = np.zeros_like(near)
    cliques = spacing_cliques(xy_m, spacing_m)
    for clique in cliques:
        together[np.ix_(clique, clique)] = True
        assert near[np.ix_(clique, clique)].all()
    np.fill_diagonal(near, False)
    np.fill_diagonal(together, False)
    np.testing.assert_array_equal(together, near)
    assert len(cliques) <= near.sum() // 2
