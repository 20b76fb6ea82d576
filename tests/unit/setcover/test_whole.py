import numpy as np
import pytest

from roadsight.setcover import CoverProblem, solve_cover_problem
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.setcover.plans.deploy import solve_deployment
from roadsight.setcover.plans.deployment import Deployment
from roadsight.setcover.plans.whole import ContradictionError, solve_whole, verify


def problem(seed=1, choices=30, targets=60, share=0.2, **rest):
    rng = np.random.default_rng(seed)
    matrix = rng.random((choices, targets)) < share
    matrix[rng.integers(0, choices, targets), np.arange(targets)] = True
    return CoverProblem(matrix, **rest)


def hard():
    return problem(2, 60, 200)


def test_a_limit_by_work_gives_the_same_answer_and_a_bound_that_holds():
    best = solve_cover_problem(hard()).objective
    first, second = (solve_whole(Deployment(hard()), WorkLimit(0.05)) for _ in range(2))
    assert first.status == "time_limit"
    assert first.bound < best <= first.objective
    assert (first.bound, first.chosen.tolist()) == (second.bound, second.chosen.tolist())


def test_what_nothing_covers_is_named():
    cover = solve_whole(Deployment(CoverProblem([[1, 0, 1], [1, 0, 1]], at_least=[2, 1, 3])), None)
    assert (cover.status, cover.uncoverable.tolist()) == ("infeasible", [1, 2])


def test_a_floor_out_of_reach_is_infeasible():
    asked = Deployment(problem(), complete=False, floor=61.0)
    assert solve_whole(asked, None).status == "infeasible"


def test_a_gap_is_kept_to():
    cover = solve_whole(Deployment(hard()), None, 0.2)
    assert cover.status in ("optimal", "within_gap")
    assert cover.gap <= 0.2


def test_a_check_out_of_time_tells_how_far_it_came():
    asked = Deployment(hard())
    found = verify(asked, solve_cover_problem(hard()), WorkLimit(0.02))
    assert not found.confirmed
    assert found.record()["result"].startswith("not confirmed in 0.02 s: HiGHS bound ")


@pytest.mark.parametrize("change", [-1.0, 1.0])
def test_a_bound_that_cannot_be_true_is_contradicted(change):
    asked = Deployment(problem())
    cover = solve_deployment(asked).cover
    object.__setattr__(cover, "bound", cover.bound + change)
    object.__setattr__(cover, "objective", cover.objective + change)
    with pytest.raises(ContradictionError):
        verify(asked, cover, WorkLimit(60.0))
