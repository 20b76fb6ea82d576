import itertools
import os
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from roadsight.base.errors import InputError
from roadsight.io.records.matrices import read_element_list, read_set_list
from roadsight.setcover import CoverProblem, maximise_coverage, solve_cover_problem
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.setcover.common.problem import objective_step
from roadsight.setcover.cover import solve as handover
from roadsight.setcover.plans.deploy import solve_deployment
from roadsight.setcover.plans.deployment import Deployment


def subsets(choices):
    return (np.array(bits, bool) for bits in itertools.product([0, 1], repeat=choices))


def allowed(problem, chosen):
    groups = problem.groups[chosen & (problem.groups >= 0)]
    forced = (problem.mandatory & ~chosen).any() or (problem.forbidden & chosen).any()
    return not forced and len(groups) == len(np.unique(groups))


def check_feasible(problem, cover):
    chosen = np.zeros(len(problem.costs), bool)
    chosen[cover.chosen] = True
    assert allowed(problem, chosen)
    assert (problem.matrix[cover.chosen].sum(axis=0) >= problem.at_least).all()
    assert cover.objective == pytest.approx(problem.costs[chosen].sum())
    assert (np.diff(cover.chosen) > 0).all()


def milp_optimum(problem):
    from scipy.optimize import Bounds, LinearConstraint, milp

    shared = [problem.groups == g for g in np.unique(problem.groups[problem.groups >= 0])]
    groups = np.array([*shared, np.zeros(len(problem.costs))], float)
    answer = milp(
        problem.costs,
        constraints=[
            LinearConstraint(problem.matrix.T.astype(float), lb=problem.at_least),
            LinearConstraint(groups, ub=1),
        ],
        integrality=np.ones(len(problem.costs)),
        bounds=Bounds(0, 1),
        options={"mip_rel_gap": 0},
    )
    return np.inf if answer.x is None else answer.fun


def test_search_tree_agrees_with_an_integer_programming_solver(monkeypatch):
    monkeypatch.setattr(handover, "_MOST_ENTRIES", -1)  # our own tree, whose nodes are counted
    nodes = 0
    for seed in range(50):
        rng = np.random.default_rng(seed)
        m, n = rng.integers(20, 60), rng.integers(20, 80)
        matrix = sparse.csr_matrix(rng.random((m, n)) < rng.uniform(0.1, 0.3))
        costs = [None, rng.integers(1, 30, m), rng.uniform(0.5, 3, m)][rng.integers(3)]
        groups = rng.integers(-1, m // 3, m) if seed % 2 else None
        problem = CoverProblem(matrix, costs, groups, int(rng.integers(1, 4)))
        cover, best = solve_cover_problem(problem), milp_optimum(problem)
        assert cover.status == ("infeasible" if np.isinf(best) else "optimal"), seed
        assert cover.objective == pytest.approx(best, abs=1e-5), seed
        nodes += cover.nodes
    assert nodes > 100


def hard_problem():
    rng = np.random.default_rng(3)
    return CoverProblem(sparse.csr_matrix(rng.random((80, 100)) < 0.08))


def test_without_time_a_cover_is_given_but_not_called_optimal():
    problem = hard_problem()
    proven = solve_cover_problem(problem)
    quick = solve_cover_problem(problem, 0.0)
    assert proven.status == "optimal"
    assert quick.status == "time_limit"
    check_feasible(problem, quick)
    assert quick.bound <= proven.objective <= quick.objective
    assert 0 < quick.gap <= 1


@pytest.mark.parametrize("gap", [0.05, 0.15, 0.3, 0.6])
def test_with_a_gap_the_cover_is_proven_as_far_as_asked_and_no_further(gap):
    problem = hard_problem()
    best, near = solve_cover_problem(problem), solve_cover_problem(problem, gap=gap)
    check_feasible(problem, near)
    assert near.gap <= gap
    assert near.bound <= best.objective <= near.objective <= best.objective / (1 - gap) + 1e-9
    assert near.nodes <= best.nodes
    assert near.status == ("optimal" if near.bound == near.objective else "within_gap")


def test_some_gap_saves_the_search():
    nodes = [solve_cover_problem(hard_problem(), gap=gap).nodes for gap in (0.0, 0.6)]
    assert nodes[1] < nodes[0]


def test_same_seed_same_answer():
    problem = hard_problem()
    first, second = (solve_cover_problem(problem, seed=4) for _ in range(2))
    np.testing.assert_array_equal(first.chosen, second.chosen)
    assert first.nodes == second.nodes


def test_names_the_targets_that_nobody_covers():
    cover = solve_cover_problem(CoverProblem([[1, 0, 1, 0], [1, 0, 0, 0]]))
    assert cover.status == "infeasible"
    assert cover.uncoverable.tolist() == [1, 3]


def test_one_choice_of_a_group_counts_once_for_what_can_be_covered():
    cover = solve_cover_problem(CoverProblem([[1], [1]], groups=[7, 7], at_least=2))
    assert cover.uncoverable.tolist() == [0]


def test_groups_can_contradict_each_other_with_every_target_coverable():
    cover = solve_cover_problem(CoverProblem([[1, 0], [0, 1]], groups=[0, 0]))
    assert cover.status == "infeasible"
    assert len(cover.uncoverable) == 0


@pytest.mark.parametrize("shape", [(0, 0), (3, 0)])
def test_no_targets_need_no_choices(shape):
    cover = solve_cover_problem(CoverProblem(sparse.csr_matrix(shape)))
    assert (cover.status, cover.objective, cover.gap) == ("optimal", 0.0, 0.0)


def test_no_choices_cover_no_targets():
    assert solve_cover_problem(CoverProblem(sparse.csr_matrix((0, 2)))).uncoverable.size == 2


def test_mandatory_choices_are_taken_even_if_useless():
    cover = solve_cover_problem(CoverProblem([[1, 1], [0, 0]], mandatory=[1]))
    assert cover.chosen.tolist() == [0, 1]


def test_of_equal_choices_the_lowest_is_taken():
    cover = solve_cover_problem(CoverProblem(np.ones((4, 3))))
    assert cover.chosen.tolist() == [0]


def test_a_dominated_choice_stays_where_several_are_needed_or_groups_forbid_the_other():
    twice = solve_cover_problem(CoverProblem([[1, 1], [1, 1], [1, 0]], at_least=[2, 1]))
    assert twice.objective == 2
    # Choice 1 covers more than choice 2, but its group is needed for choice 0.
    grouped = CoverProblem([[1, 0, 0], [0, 1, 1], [0, 1, 0], [0, 0, 1]], groups=[0, 0, -1, -1])
    assert solve_cover_problem(grouped).chosen.tolist() == [0, 2, 3]


def test_stored_zeros_do_not_cover_and_repeated_entries_do_once():
    stored = sparse.coo_matrix(([0.0, 1, 1, 1], ([0, 0, 1, 1], [0, 1, 0, 0])), shape=(2, 2))
    cover = solve_cover_problem(CoverProblem(stored))
    assert cover.chosen.tolist() == [0, 1]


def _hard(seed, choices=36, targets=120):
    rng = np.random.default_rng(seed)
    matrix = rng.random((choices, targets)) < 0.2
    matrix[rng.integers(0, choices, targets), np.arange(targets)] = True
    return matrix


def _work(matrix):
    limit = WorkLimit(1e6)
    assert solve_cover_problem(CoverProblem(matrix), limit).status == "optimal"
    return limit.spent_s()


@pytest.mark.parametrize("easy_last", [False, True])
def test_what_an_easy_part_leaves_of_the_limit_goes_to_a_hard_one(easy_last):
    hard, easy = _hard(1), np.eye(40, 80) + np.eye(40, 80, 40)
    parts = [hard, easy] if easy_last else [easy, hard]
    problem = CoverProblem(sparse.block_diag(parts))
    work_s = _work(hard)
    cover = solve_cover_problem(problem, WorkLimit(1.5 * work_s))
    assert (cover.status, len(cover.chosen)) == ("optimal", solved_size(hard) + 40)


def test_what_a_large_easy_part_leaves_goes_back_to_a_small_hard_one():
    hard = _hard(1)
    # Larger than the hard part, and proven at once: pairs of choices of which either will do.
    large = np.repeat(np.kron(np.eye(60), np.ones((2, 2))), 30, axis=1)
    large[::2, ::60] = False
    problem = CoverProblem(sparse.block_diag([sparse.csr_matrix(hard), sparse.csr_matrix(large)]))
    cover = solve_cover_problem(problem, WorkLimit(1.5 * _work(hard)))
    assert cover.status == "optimal"


def solved_size(matrix):
    return len(solve_cover_problem(CoverProblem(matrix)).chosen)


@pytest.mark.parametrize("layout", [sparse.coo_matrix, sparse.csr_matrix, "csr"])
@pytest.mark.parametrize("dtype", ["int8", "uint8", "int16", "uint16"])
def test_repeated_entries_never_wrap_to_nothing(dtype, layout):
    times = 2 ** (8 * np.dtype(dtype).itemsize)
    row, col = np.append(np.zeros(times, int), 1), np.append(np.zeros(times, int), 0)
    data = np.ones(times + 1, dtype)
    if layout == "csr":
        start = np.array([0, times, times + 1])
        matrix = sparse.csr_matrix((data, col, start), shape=(2, 1))
    else:
        matrix = sparse.coo_matrix((data, (row, col)), shape=(2, 1))
    cover = solve_cover_problem(CoverProblem(matrix, [1.0, 5.0]))
    assert (cover.chosen.tolist(), cover.objective) == ([0], 1.0)


@pytest.mark.parametrize("entry", [np.nan, np.inf, -1.0])
def test_an_entry_that_is_no_count_is_refused_also_beside_a_larger_one(entry):
    matrix = sparse.coo_matrix(([5.0, entry], ([0, 0], [0, 0])), shape=(1, 1))
    with pytest.raises(InputError, match="negative or not finite"):
        CoverProblem(matrix)


@pytest.mark.parametrize("unit", [1e-12, 1e-9, 1.0, 1e12])
def test_a_greedy_cover_is_no_proof_whatever_the_unit(unit):
    # Greedy takes 8, 4 and 2 targets; two rows of 7 do as well.
    rows = [range(7), range(7, 14), [0, 1, 2, 3, 7, 8, 9, 10], [4, 5, 11, 12], [6, 13]]
    matrix = np.array([np.isin(np.arange(14), row) for row in rows])
    for costs in (np.ones(5), np.array([1.01, 1.02, 1.0, 1.0, 1.0]), np.full(5, np.pi)):
        cover = solve_cover_problem(CoverProblem(matrix, costs * unit))
        assert (cover.status, cover.chosen.tolist()) == ("optimal", [0, 1])
        plan = solve_deployment(Deployment(CoverProblem(matrix, costs * unit), keep=0.0)).cover
        assert (plan.status, plan.chosen.tolist()) == ("optimal", [0, 1])
    budget = maximise_coverage(CoverProblem(matrix), 2, np.full(14, unit))
    assert (budget.status, budget.chosen.tolist()) == ("optimal", [0, 1])


def test_costs_that_are_far_apart_are_proven_relative_to_the_objective():
    # Choice 0 would set the scale of costs, and nobody needs it.
    matrix = [[1, 1, 1], [1, 1, 0], [0, 1, 1], [1, 0, 1]]
    cover = solve_cover_problem(CoverProblem(matrix, [1e12, 2e-9, 3e-9, 4e-9]))
    assert (cover.status, cover.chosen.tolist()) == ("optimal", [1, 2])
    assert cover.objective == pytest.approx(5e-9)


@pytest.mark.parametrize(
    ("costs", "step"),
    [
        ([4.0, 6.0], 2.0), ([0.5, 0.75], 0.25), ([1.0], 1.0), ([np.pi, 1.0], 0.0), ([3e20], 3e20),
        ([1e-9, 3e-9], 1e-9), ([1.0, 1e13], 0.0),
    ],
)  # fmt: skip
def test_objective_step(costs, step):
    assert objective_step(np.array(costs)) == pytest.approx(step)


@pytest.mark.parametrize(
    "change",
    [
        {"matrix": [[1, -1]]}, {"matrix": [[1, np.nan]]}, {"matrix": np.ones((2, 2, 2))},
        {"matrix": np.array([["a"]])}, {"costs": [1.0]}, {"costs": [1.0, 0.0]},
        {"costs": [1.0, np.inf]}, {"groups": [0.5, 1.0]}, {"at_least": -1}, {"mandatory": [2]},
        {"mandatory": [0], "forbidden": [0]},
    ],
)  # fmt: skip
def test_refuses(change):
    with pytest.raises(InputError):
        CoverProblem(**({"matrix": [[1, 1], [0, 1]]} | change))


def best_value(problem, budget, weights):
    dense = problem.matrix.toarray() > 0
    return max(
        weights[dense[x].any(axis=0)].sum()
        for x in subsets(len(problem.costs))
        if allowed(problem, x) and problem.costs[x].sum() <= budget + 1e-9
    )


def test_budget_equals_brute_force():
    rng = np.random.default_rng(8)
    for _ in range(100):
        m, n = rng.integers(1, 9), rng.integers(0, 12)
        matrix = sparse.csr_matrix(rng.random((m, n)) < 0.35)
        groups = rng.integers(-1, 3, m) if rng.random() < 0.5 else None
        problem = CoverProblem(matrix, rng.integers(1, 5, m) * 0.1, groups)
        weights = rng.integers(0, 4, n).astype(float)
        budget = rng.integers(0, 12) * 0.1
        cover = maximise_coverage(problem, budget, weights)
        assert cover.status == "optimal"
        assert cover.objective == pytest.approx(best_value(problem, budget, weights))
        assert problem.costs[cover.chosen].sum() <= budget + 1e-9


def test_budget_without_time_is_bounded():
    problem = hard_problem()
    proven = maximise_coverage(problem, 4)
    quick = maximise_coverage(problem, 4, time_limit_s=0.0)
    assert proven.status == "optimal"
    assert quick.status == "time_limit"
    assert quick.objective <= proven.objective <= quick.bound


@pytest.mark.parametrize("budget", [-1.0, np.nan, np.inf])
def test_budget_refuses(budget):
    with pytest.raises(InputError):
        maximise_coverage(CoverProblem([[1]]), budget)


def test_budget_refuses_mandatory_choices_that_do_not_fit():
    with pytest.raises(InputError):
        maximise_coverage(CoverProblem([[1], [1]], mandatory=[0, 1]), 1)


def public(name):
    root = os.environ.get("ROADSIGHT_DATA")
    if not root:
        pytest.skip("ROADSIGHT_DATA is not set")
    path = Path(root) / "setcover" / name
    if "camera" in name:
        return CoverProblem(read_element_list(path))
    return CoverProblem(*read_set_list(path))


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "best"),
    [("camera_placement_ac01.txt", 7), ("sc_157_0.txt", 94_400), ("sc_1000_11.txt", 146)],
)
def test_public_optimum(name, best):
    problem = public(name)
    cover = solve_cover_problem(problem)
    assert (cover.status, cover.objective, cover.bound) == ("optimal", best, best)
    check_feasible(problem, cover)


@pytest.mark.full
@pytest.mark.real
@pytest.mark.parametrize(("name", "known"), [("sc_330_0.txt", 27), ("sc_5000_1.txt", 31)])
def test_public_open_instance(name, known):
    problem = public(name)
    cover = solve_cover_problem(problem, 10.0)
    assert cover.objective <= known
    assert cover.bound <= cover.objective
    assert cover.bound >= cover.lp_bound
    assert cover.status == ("optimal" if cover.bound == cover.objective else "time_limit")
    check_feasible(problem, cover)


def test_a_work_limit_stops_at_the_same_cover_every_time() -> None:
    rng = np.random.default_rng(4)
    matrix = sparse.csr_matrix(rng.random((120, 400)) < 0.06)
    problem = CoverProblem(matrix[:, np.flatnonzero(matrix.sum(axis=0))])
    found = [solve_cover_problem(problem, WorkLimit(0.2)) for _ in range(2)]
    assert found[0].status == "time_limit"
    assert found[0].bound < found[0].objective
    for name in ("objective", "bound", "nodes"):
        assert getattr(found[0], name) == getattr(found[1], name)
    np.testing.assert_array_equal(found[0].chosen, found[1].chosen)


def test_parts_share_a_work_limit() -> None:
    limit = WorkLimit(6.0)
    part = limit.part(3)
    part.spend(1.5)
    assert part.left_s() == 0.5
    assert limit.left_s() == 4.5
    assert limit.clock_left_s() == np.inf
    assert limit.count_left(0.5) == 9
    part.spend(1.0)
    assert part.passed()
    assert part.count_left(0.5) == 1
