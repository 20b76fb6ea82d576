"""What must not change the cost of the best cover."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from roadsight.setcover import CoverProblem, solve_cover_problem
from roadsight.setcover.common.reductions import reduce_problem


@st.composite
def problems(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    m, n = draw(st.integers(2, 30)), draw(st.integers(1, 40))
    matrix = rng.random((m, n)) < draw(st.floats(0.1, 0.5))
    matrix[rng.integers(0, m, n), np.arange(n)] = True
    costs = rng.integers(1, 8, m).astype(float) if draw(st.booleans()) else np.ones(m)
    return matrix, costs, rng


def cost(matrix, costs, **rest):
    cover = solve_cover_problem(CoverProblem(sparse.csr_matrix(matrix), costs, **rest))
    assert cover.status == "optimal"
    return cover.objective


@settings(max_examples=40, deadline=None)
@given(problems())
def test_order_of_choices_and_targets(case):
    matrix, costs, rng = case
    choices, targets = (rng.permutation(size) for size in matrix.shape)
    assert cost(matrix[choices][:, targets], costs[choices]) == cost(matrix, costs)


@settings(max_examples=40, deadline=None)
@given(problems())
def test_repeated_choices_and_targets(case):
    matrix, costs, rng = case
    choices, targets = (np.append(np.arange(s), rng.integers(0, s, 5)) for s in matrix.shape)
    assert cost(matrix[choices][:, targets], costs[choices]) == cost(matrix, costs)


@settings(max_examples=40, deadline=None)
@given(problems())
def test_parts_that_share_nothing_add_up(case):
    matrix, costs, _ = case
    both = sparse.block_diag([sparse.csr_matrix(matrix), sparse.csr_matrix(matrix)])
    assert cost(both, np.tile(costs, 2)) == 2 * cost(matrix, costs)


@settings(max_examples=40, deadline=None)
@given(problems())
def test_bounds_enclose_the_optimum_at_any_time(case):
    matrix, costs, _ = case
    quick = solve_cover_problem(CoverProblem(sparse.csr_matrix(matrix), costs), 0.0)
    assert quick.bound <= cost(matrix, costs) <= quick.objective


@settings(max_examples=40, deadline=None)
@given(problems())
def test_reductions_leave_no_choice_that_another_replaces(case):
    matrix, costs, _ = case
    for part in reduce_problem(CoverProblem(sparse.csr_matrix(matrix), costs)).parts:
        dense = part.by_choice.toarray() > 0
        for i, j in np.ndindex(len(dense), len(dense)):
            assert i == j or part.cost[j] > part.cost[i] or (dense[i] & ~dense[j]).any()
