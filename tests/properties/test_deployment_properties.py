"""Deployments, curves and alternatives against brute force on small random problems."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.base.errors import InputError
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.setcover.plans.alternatives import most_different, replacements
from roadsight.setcover.plans.curve import coverage_curve
from roadsight.setcover.plans.deploy import solve_costly_cover, solve_deployment
from roadsight.setcover.plans.deployment import spacing_cliques
from tests.fuzz.covers import GOALS, least_objective, number, objectives, posed_deployment, subsets

seeds = st.integers(0, 2**32 - 1)


def posed(seed, goal):
    rng = np.random.default_rng(seed)
    return posed_deployment(rng, goal, span=0), rng


@pytest.mark.parametrize("goal", GOALS)
@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_bounds_hold_without_any_time(goal, seed):
    deployment, _ = posed(seed, goal)
    best, quick = least_objective(deployment)[0], solve_deployment(deployment, 0.0).cover
    assert quick.bound <= best + 1e-6
    assert quick.objective >= best - 1e-6
    if np.isfinite(quick.objective):
        found = objectives(deployment)[0][number(quick.chosen)]
        assert found == pytest.approx(quick.objective, abs=1e-6)


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_budgets_below_the_cheapest_cover_never_claim_to_see_everything(seed):
    deployment = replace(posed(seed, "cover")[0], keep=0.0)
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
        best = -least_objective(replace(soft, budget=point.budget))[0]
        assert point.value <= best + 1e-6 <= point.bound + 2e-6


@pytest.mark.parametrize("goal", ["cover", "budget", "price"])
@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_replacements_are_all_choices_that_keep_the_answer_as_good(goal, seed):
    deployment, _ = posed(seed, goal)
    cover = solve_deployment(deployment).cover
    if cover.status == "infeasible":
        return
    chosen, cost, objective = cover.chosen, deployment.cost, objectives(deployment)[0]
    found = replacements(deployment, chosen)
    for one, others in zip(chosen, found, strict=True):
        rest = chosen[chosen != one]
        expected = [
            other
            for other in np.setdiff1d(np.arange(len(cost)), chosen)
            if cost[other] == pytest.approx(cost[one])
            and objective[number(np.append(rest, other))] <= cover.objective + 1e-7
        ]
        assert others.tolist() == expected


@pytest.mark.parametrize("goal", ["cover", "budget", "price"])
@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_most_different_answer_shares_as_few_places_as_any(goal, seed):
    deployment, rng = posed(seed, goal)
    cover = solve_deployment(deployment).cover
    if cover.status == "infeasible":
        return
    place = rng.integers(0, 5, len(deployment.cost))
    found = most_different(deployment, cover.chosen, place)
    mine = place[cover.chosen]
    objective, value = objectives(deployment)
    cost, least = deployment.cost[cover.chosen].sum(), value[number(cover.chosen)]
    shared = {
        tuple(chosen): np.isin(place[chosen], mine).sum()
        for chosen in map(np.flatnonzero, subsets(len(place)))
        if np.isfinite(objective[number(chosen)])
        and deployment.cost[chosen].sum() <= cost + 1e-7
        and (goal == "cover" or value[number(chosen)] >= least - 1e-7)
    }
    assert tuple(found.chosen) in shared
    assert np.isin(place[found.chosen], mine).sum() == min(shared.values())
    assert found.least_shared <= found.shared


@pytest.mark.parametrize("work_s", [0.0, 1e-4, 10.0])
@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_costly_covers_are_covers_with_valid_bounds(work_s, seed):
    deployment = replace(posed(seed, "cover")[0], keep=0.0, cliques=())
    best = least_objective(deployment)[0]
    cover = solve_costly_cover(deployment.problem, WorkLimit(work_s))
    if np.isinf(best):
        assert not np.isfinite(cover.objective)
        return
    assert cover.bound <= best + 1e-6
    if np.isfinite(cover.objective):
        found = objectives(deployment)[0][number(cover.chosen)]
        assert found == pytest.approx(cover.objective)
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
