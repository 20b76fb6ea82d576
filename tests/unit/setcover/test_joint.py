import itertools

import numpy as np
import pytest
from scipy import sparse

from roadsight.base.errors import InputError
from roadsight.setcover.plans.joint import JointProblem, best_of_groups, least_number, solve_joint


def random_problem(rng, choices=9, targets=12, level=0.95, priced=True):
    share = rng.uniform(0.3, 0.99, (choices, targets)) * (rng.random((choices, targets)) < 0.6)
    gain = -np.log1p(-share)
    costs = rng.integers(1, 4, choices).astype(float) if priced else rng.uniform(1, 3, choices)
    groups = rng.integers(0, max(choices * 2 // 3, 1), choices)
    need = np.full(targets, -np.log(1 - level))
    return JointProblem(sparse.csr_matrix(gain), need, costs, groups), share


def every_set(problem, allowed=lambda chosen: True):
    """Cost of the cheapest set, by trying all; infinite where there is none."""
    best = np.inf
    choices = len(problem.costs)
    for size in range(choices + 1):
        for some in itertools.combinations(range(choices), size):
            chosen = np.array(some, np.int64)
            groups = problem.groups[chosen]
            if len(set(groups.tolist())) < len(groups):
                continue
            if (problem.given(chosen) < problem.need - 1e-9).any() or not allowed(chosen):
                continue
            best = min(best, problem.costs[chosen].sum())
    return best


@pytest.mark.parametrize("seed", range(12))
def test_answers_are_the_cheapest(seed):
    rng = np.random.default_rng(seed)
    problem, share = random_problem(rng, targets=6, level=0.9, priced=seed % 2 == 0)
    cover = solve_joint(problem)
    best = every_set(problem)
    if np.isinf(best):
        assert cover.status == "infeasible"
        return
    assert cover.status == "optimal"
    assert cover.objective == pytest.approx(best)
    assert cover.bound == pytest.approx(best)
    seen = 1 - np.prod(1 - share[cover.chosen], axis=0)
    assert (seen >= 0.9 - 1e-6).all()
    groups = problem.groups[cover.chosen]
    assert len(set(groups.tolist())) == len(groups)


@pytest.mark.parametrize("seed", range(12))
def test_an_oracle_of_dependent_choices_is_obeyed(seed):
    """Choices come in pairs that are hidden together: of a pair, only the better one counts."""
    rng = np.random.default_rng(100 + seed)
    problem, share = random_problem(rng, choices=8, targets=4, level=0.85)
    pair = np.arange(8) // 2

    def seen(chosen):
        hidden = np.ones(4)
        for number in set(pair[chosen].tolist()):
            hidden *= 1 - share[chosen[pair[chosen] == number]].max(axis=0)
        return 1 - hidden

    def oracle(chosen):
        short = np.flatnonzero(seen(chosen) < 0.85 - 1e-9)
        everything = [np.flatnonzero(share[:, t] > 0) for t in short]
        return [rest for e in everything if len(rest := np.setdiff1d(e, chosen))]

    best = every_set(problem, lambda chosen: (seen(chosen) >= 0.85 - 1e-9).all())
    cover = solve_joint(problem, oracle=oracle)
    if np.isfinite(best):
        assert cover.status == "optimal"
        assert cover.objective == pytest.approx(best)
        assert (seen(cover.chosen) >= 0.85 - 1e-9).all()


def test_of_no_group_more_than_one_choice():
    gain = sparse.csr_matrix(np.array([[1.0], [1.0], [1.0]]))
    problem = JointProblem(gain, np.array([2.0]), np.ones(3), np.array([0, 0, 1]))
    assert sorted(problem.groups[solve_joint(problem).chosen]) == [0, 1]
    alone = JointProblem(gain, np.array([3.0]), np.ones(3), np.array([0, 0, 1]))
    assert solve_joint(alone).status == "infeasible"
    assert not alone.reachable().any()


def test_the_bound_holds_when_the_limit_stops_the_search():
    rng = np.random.default_rng(5)
    problem, _ = random_problem(rng, choices=24, targets=80, level=0.9)
    cover = solve_joint(problem, limit_s=0.025)  # one node
    proven = solve_joint(problem, limit_s=60)
    assert proven.status == "optimal"
    assert cover.bound <= proven.objective <= cover.objective


def test_sums_between_two_tolerances_are_settled():
    """What the solver lets pass by its own tolerance is not asked of it for ever."""
    gain = sparse.csr_matrix(np.array([[0.5], [0.4999995], [0.6], [0.6]]))
    cover = solve_joint(JointProblem(gain, np.ones(1), np.array([1.0, 1, 2, 2]), np.arange(4)))
    assert (cover.status, cover.objective, cover.bound) == ("optimal", 3, 3)


def test_certain_choices_are_capped():
    gain = sparse.csr_matrix(np.array([[np.inf, 0.1], [0.1, 50.0]]))
    problem = JointProblem(gain, np.array([2.0, 3.0]), np.ones(2), np.arange(2))
    assert problem.gain.max() == 3.0
    assert solve_joint(problem).objective == 2


def test_best_of_groups_is_the_greatest_entry():
    rng = np.random.default_rng(2)
    dense = rng.random((10, 7)) * (rng.random((10, 7)) < 0.5)
    groups = rng.integers(0, 4, 10)
    expected = np.array([dense[groups == g].max(axis=0) for g in np.unique(groups)])
    np.testing.assert_array_equal(
        best_of_groups(sparse.csr_matrix(dense), groups).toarray(), expected
    )


def test_negative_gains_and_needs_are_refused():
    with pytest.raises(InputError):
        JointProblem(sparse.csr_matrix([[-1.0]]), np.ones(1), np.ones(1), np.zeros(1, int))
    with pytest.raises(InputError):
        JointProblem(sparse.csr_matrix([[1.0]]), np.zeros(1), np.ones(1), np.zeros(1, int))


def test_least_number_counts_the_best_choices_of_groups():
    share = np.array([0.6, 0.5, 0.3, 1.0])
    assert least_number(share, np.array([0, 1, 2, 3])) == 2
    assert least_number(share, np.array([0, 0, 1, 3])) == 2  # 0.6 and 0.3 are all there is
    assert least_number(np.array([1.0]), np.array([0])) == 1
