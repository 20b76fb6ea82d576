import numpy as np
import pytest
from scipy import sparse

from roadsight.setcover import CoverProblem, solve_cover_problem
from roadsight.setcover.common import deadline
from roadsight.setcover.common.deadline import Deadline, Effort, Patience, WorkLimit
from roadsight.setcover.cover import solve as handover


def test_patience_grows_with_the_work_up_to_the_last_move():
    limit = WorkLimit(1000, patience=2.0)
    limit.spend(300)  # of others
    patience = Patience(limit)
    assert not patience.is_over("a")
    limit.spend(25)
    assert not patience.is_over("a")  # 30 s are always borne
    limit.spend(6)
    assert patience.is_over("a")
    assert not patience.is_over("b")  # moved, after 31 s
    limit.spend(62)
    assert not patience.is_over("b")
    limit.spend(0.1)
    assert patience.is_over("b")


def test_without_patience_a_search_goes_on():
    for limit in (WorkLimit(1000), Deadline(1000)):
        patience = Patience(limit)
        limit.spend(900)
        assert not patience.is_over("a")
        assert not patience.is_over("a")


def test_parts_are_as_patient_as_the_whole():
    part = Effort(1000, 1.0).limit().part(2)
    patience = Patience(part)
    assert not patience.is_over("a")
    part.spend(30.1)
    assert patience.is_over("a")


@pytest.mark.parametrize("seed", range(2))
def test_a_plan_that_is_given_up_has_a_true_bound(seed, monkeypatch):
    """A cover that a search gave up is one, and its bound is below what longer search proves."""
    rng = np.random.default_rng(seed)
    seen = rng.random((100, 200)) < 0.05
    seen[0] |= ~seen.any(axis=0)
    problem = CoverProblem(sparse.csr_matrix(seen), np.ones(100))
    best = solve_cover_problem(problem, WorkLimit(3.0))
    monkeypatch.setattr(deadline, "_LEAST_PATIENCE_S", 0.02)
    limit = WorkLimit(3.0, patience=0.01)
    early = solve_cover_problem(problem, limit)
    assert best.status == "optimal"
    assert early.status == "time_limit"
    assert limit.spent_s() < 1
    assert seen[early.chosen].any(axis=0).all()
    assert early.bound < best.bound == best.objective <= early.objective


def test_each_part_of_a_plan_is_tried(monkeypatch):
    """Two parts of equal numbers: the second is no standstill of the first."""
    rng = np.random.default_rng(0)
    seen = rng.random((100, 200)) < 0.05
    seen[0] |= ~seen.any(axis=0)
    twice = sparse.block_diag([seen, seen], "csr").astype(bool)
    monkeypatch.setattr(deadline, "_LEAST_PATIENCE_S", 0.02)
    monkeypatch.setattr(handover, "_MOST_ENTRIES", -1)  # our own tree, whose nodes are counted
    one, both = (
        solve_cover_problem(
            CoverProblem(matrix, np.ones(matrix.shape[0])), WorkLimit(6.0, patience=0.01)
        )
        for matrix in (sparse.csr_matrix(seen), twice)
    )
    assert one.status == both.status == "time_limit"
    assert one.nodes >= 1
    assert both.nodes >= 2
    assert both.bound == pytest.approx(2 * one.bound, abs=1)
