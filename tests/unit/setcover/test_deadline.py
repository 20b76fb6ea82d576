"""Limits of work, and searches that end where nothing moves."""

import numpy as np
import pytest
from scipy import sparse

from roadsight.setcover import CoverProblem, solve_cover_problem
from roadsight.setcover.common import deadline
from roadsight.setcover.common.deadline import Deadline, Effort, WorkLimit


def test_patience_grows_with_the_work_that_moves_took():
    limit = WorkLimit(1000, patience=2.0)
    assert not limit.stalled("a")
    limit.spend(4)
    assert not limit.stalled("a")  # 5 s are always borne
    limit.spend(6)
    assert limit.stalled("a")
    assert not limit.stalled("b")  # moved, after 10 s
    limit.spend(20)
    assert not limit.stalled("b")
    limit.spend(0.1)
    assert limit.stalled("b")


def test_without_patience_a_search_goes_on():
    for limit in (WorkLimit(1000), Deadline(1000)):
        limit.spend(900)
        assert not limit.stalled("a")
        assert not limit.stalled("a")


def test_parts_share_the_patience_of_their_payer():
    whole = Effort(1000, 1.0).limit()
    part = whole.part(2)
    assert not part.stalled("a")
    part.spend(5.1)
    assert part.stalled("a")
    assert whole.stalled("a")


@pytest.mark.parametrize("seed", range(2))
def test_a_plan_without_patience_has_a_true_bound(seed, monkeypatch):
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
