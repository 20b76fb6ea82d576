import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import linprog

from roadsight.setcover import CoverProblem, solve_cover_problem
from roadsight.setcover.common.deadline import Deadline, WorkLimit
from roadsight.setcover.common.reductions import reduce_problem
from roadsight.setcover.common.relaxation import (
    ADDED_TARGETS,
    COMPARED_TARGETS,
    Relaxation,
    Solution,
)
from roadsight.setcover.cover import solve as interior
from roadsight.setcover.cover.local_search import LocalSearch, greedy_cover
from roadsight.setcover.cover.solve import interior_bound, is_large

LENGTH_M, REACH_M = 300, 25


@pytest.fixture(autouse=True)
def every_instance_is_large(monkeypatch):
    monkeypatch.setattr(interior, "_LARGE", 0)
    monkeypatch.setattr(interior, "_LEAST_TARGETS", 40)


def road(seed, share=0.8):
    """Candidates along a road, each of which sees most of what is near."""
    rng = np.random.default_rng(seed)
    targets = rng.uniform(0, LENGTH_M, 400)
    near = np.abs(targets - rng.uniform(0, LENGTH_M, 90)[:, None]) < REACH_M
    seen = near & (rng.random(near.shape) < share)
    return sparse.csr_matrix(seen[:, seen.sum(axis=0) > 2])


def problem_of(seed, kind):
    matrix, rng = road(seed, 0.97), np.random.default_rng(seed)
    if kind == "costs":
        return CoverProblem(matrix, rng.integers(2, 9, matrix.shape[0]))
    if kind == "twice":
        return CoverProblem(matrix, at_least=2)
    return CoverProblem(matrix)


def relaxed(part):
    """Optimum of the whole linear relaxation, by another way."""
    found = linprog(part.cost, A_ub=-part.by_choice.T, b_ub=-part.need, bounds=(0, 1))
    return found.fun


def proven_by(part, dual):
    """Lagrangian bound of duals, choice by choice."""
    covers = part.by_choice.toarray() > 0
    spare = [
        min(price - dual[these].sum(), 0) for price, these in zip(part.cost, covers, strict=True)
    ]
    return sum(spare) + dual @ part.need


@pytest.mark.parametrize("kind", ["plain", "costs", "twice"])
def test_the_bound_is_next_to_that_of_the_whole_relaxation(kind):
    for seed in range(4):
        for part in reduce_problem(problem_of(seed, kind)).parts:
            found = interior_bound(part, np.random.default_rng(1), Deadline(None))
            assert (found.target_dual >= 0).all()
            assert found.bound == pytest.approx(proven_by(part, found.target_dual))
            assert 0.99 * relaxed(part) <= found.bound <= relaxed(part) + 1e-6


def test_no_time_leaves_a_bound_that_holds():
    (part,) = reduce_problem(CoverProblem(road(3))).parts
    for limit in (Deadline(0.0), WorkLimit(0.0), WorkLimit(1e-3)):
        found = interior_bound(part, np.random.default_rng(1), limit)
        assert 0 <= found.bound <= relaxed(part) + 1e-6


@pytest.mark.parametrize("kind", ["plain", "costs", "twice"])
def test_large_instances_are_proven_alike(kind, monkeypatch):
    found = [solve_cover_problem(problem_of(seed, kind)) for seed in range(4)]
    monkeypatch.setattr(interior, "_LARGE", 2**62)
    for seed, cover in enumerate(found):
        other = solve_cover_problem(problem_of(seed, kind))
        assert cover.status == other.status == "optimal"
        assert cover.objective == other.objective == cover.bound


def test_groups_are_kept_and_may_be_infeasible():
    matrix = road(5)
    pairs = np.arange(matrix.shape[0]) // 2
    cover = solve_cover_problem(CoverProblem(matrix, groups=pairs))
    assert cover.status == "optimal"
    assert len(np.unique(pairs[cover.chosen])) == len(cover.chosen)
    one = solve_cover_problem(CoverProblem(matrix, groups=np.zeros(matrix.shape[0], int)))
    assert one.status == "infeasible"


def test_a_limit_by_work_gives_the_same_cover_twice():
    first, second = (
        solve_cover_problem(CoverProblem(road(6, 0.4)), WorkLimit(0.3)) for _ in range(2)
    )
    np.testing.assert_array_equal(first.chosen, second.chosen)
    assert first.bound == second.bound


def test_local_search_has_its_share_of_a_short_limit(monkeypatch):
    """A relaxation that takes as long as it may does not keep covers from getting better."""

    def endless(part, rng, deadline):
        deadline.spend(deadline.left_s())
        return Solution(0.0, *(np.zeros(size) for size in (*part.shape[:1], *part.shape)), False)

    monkeypatch.setattr("roadsight.setcover.cover.solve.interior_bound", endless)
    problem = CoverProblem(road(7))
    from_greedy = solve_cover_problem(problem, WorkLimit(1e-6))
    assert solve_cover_problem(problem, WorkLimit(2.0)).objective < from_greedy.objective


def test_published_sizes_are_not_large(monkeypatch):
    monkeypatch.undo()
    (part, *_) = reduce_problem(CoverProblem(road(1))).parts
    assert not is_large(part)
    assert interior._LARGE > 2_019 * 8_219


def test_open_targets_join_local_search_from_all_over_the_road():
    (part, *_) = reduce_problem(CoverProblem(road(4))).parts
    none = np.zeros(part.shape[1], bool)
    local = LocalSearch(part, greedy_cover(part), none, np.random.default_rng(1))
    trial = np.zeros(part.shape[0], bool)
    trial[:3] = True
    is_open = part.by_choice[trial].sum(axis=0).A1 == 0
    assert not local.accept(trial)
    joined = np.flatnonzero(local.active)
    assert len(joined) == 50
    assert is_open[joined].all()
    assert joined[[0, -1]].tolist() == np.flatnonzero(is_open)[[0, -1]].tolist()
    assert local.accept(local.best)


def test_local_search_stops_at_a_find_and_says_what_is_left():
    (part, *_) = reduce_problem(CoverProblem(road(4))).parts
    everything = np.ones(part.shape[1], bool)
    local = LocalSearch(part, np.ones(part.shape[0], bool), everything, np.random.default_rng(1))
    assert 0 < local.improve(500, 0.0, Deadline(None)) < 500
    found = local.cost
    assert found < part.shape[0]
    assert local.improve(500, found, Deadline(None)) == 0
    assert local.cost == found


def test_of_many_targets_no_neighbours_join_the_relaxation_at_once():
    rng = np.random.default_rng(1)
    place = np.linspace(0, LENGTH_M, 1_500)
    near = np.abs(place - rng.uniform(0, LENGTH_M, 300)[:, None]) < REACH_M
    problem = CoverProblem(sparse.csr_matrix(near & (rng.random(near.shape) < 0.9)))
    (part, *_) = reduce_problem(problem).parts
    relaxation = Relaxation(part)
    before = relaxation.targets_inside()
    assert part.shape[1] - len(before) > 2 * COMPARED_TARGETS
    assert relaxation._separate(np.zeros(part.shape[0]))
    joined = np.setdiff1d(relaxation.targets_inside(), before)
    assert len(joined) == ADDED_TARGETS
    absent = np.setdiff1d(np.arange(part.shape[1]), before)
    assert np.diff(np.searchsorted(absent, joined)).min() > 1
