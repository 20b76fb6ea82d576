import numpy as np
from scipy import sparse

from roadsight.setcover import CoverProblem
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.setcover.common.kernels import count_of_rows, sums_of_rows
from roadsight.setcover.plans.construct import Builder
from roadsight.setcover.plans.curve import budgeted, coverage_curve
from roadsight.setcover.plans.cuts import Cuts
from roadsight.setcover.plans.deploy import solve_deployment
from roadsight.setcover.plans.deployment import Deployment
from roadsight.setcover.plans.tree import Master, Relaxed


def test_a_price_on_coverage_changes_no_complete_answer():
    """Where all must be seen, what coverage is worth is a constant, free choices or not."""
    rng = np.random.default_rng(3)
    for _ in range(25):
        seen = sparse.csr_matrix(rng.random((9, 14)) < 0.4)
        cost = rng.integers(1, 5, 9) * 1.0
        cost[rng.integers(9)] = 0.0
        problem = CoverProblem(seen, np.ones(9))
        plain = solve_deployment(Deployment(problem, cost=cost)).cover
        priced = solve_deployment(Deployment(problem, cost=cost, worth=1.0)).cover
        assert plain.status == priced.status
        if plain.status == "optimal":
            assert np.isclose(priced.objective, plain.objective - 14)


def test_points_within_the_gap_are_named_so():
    rng = np.random.default_rng(8)
    seen = sparse.csr_matrix(rng.random((40, 300)) < 0.12)
    deployment = Deployment(CoverProblem(seen, np.ones(40)), complete=False, worth=1.0)
    points = coverage_curve(deployment, [4.0, 8.0], 0.0, gap=0.9)
    assert {point.status for point in points} <= {"optimal", "within_gap"}
    assert {p.status for p in coverage_curve(deployment, [4.0, 8.0], 0.0)} == {"time_limit"}


def test_a_relaxation_without_end_leaves_time_to_look_for_better(monkeypatch):
    rng = np.random.default_rng(4)
    seen = sparse.csr_matrix(rng.random((60, 400)) < 0.12)
    deployment = budgeted(CoverProblem(seen), 9.0, None)
    builder = Builder(Cuts(deployment), np.random.default_rng(1))
    builder.build(np.empty(0, np.int64))

    def endless(master, node, goal, deadline, rounds):
        deadline.spend(deadline.left_s())
        return Relaxed(-400.0, np.zeros(60), np.zeros(60), complete=False)

    monkeypatch.setattr(Master, "solve", endless)
    found = solve_deployment(deployment, WorkLimit(0.01)).cover
    assert found.objective < builder.value
    assert found.bound == -400.0


def test_counts_and_sums_of_rows_are_those_of_a_sparse_product():
    rng = np.random.default_rng(5)
    for rows, columns, taken in ((8, 12, 4), (40, 300, 0), (200, 900, 60)):
        matrix = sparse.csr_matrix((rng.random((rows, columns)) < 0.2).astype(np.int8))
        chosen = np.sort(rng.choice(rows, taken, replace=False)).astype(np.int64)
        value = rng.random(columns)
        slice_ = matrix[chosen]
        count = count_of_rows(matrix.indptr, matrix.indices, chosen, columns)
        np.testing.assert_array_equal(count, np.asarray(slice_.sum(axis=0, dtype=int)).ravel())
        total = sums_of_rows(matrix.indptr, matrix.indices, chosen, value)
        np.testing.assert_array_equal(total, slice_ @ value)
