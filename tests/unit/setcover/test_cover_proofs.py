import itertools

import numpy as np
import pytest
from scipy import sparse

from roadsight.setcover import CoverProblem, solve_cover_problem
from roadsight.setcover.common.cuts import (
    Constraint,
    _descend,
    balas_ng_cuts,
    distinct,
    parity_cuts,
    stacked,
)
from roadsight.setcover.common.deadline import Deadline, WorkLimit
from roadsight.setcover.common.reductions import reduce_problem
from roadsight.setcover.common.relaxation import Node, Relaxation
from roadsight.setcover.cover import local_search as long_search
from roadsight.setcover.cover import search as core
from roadsight.setcover.cover import solve as handover
from roadsight.setcover.cover import solve as interior
from roadsight.setcover.cover.local_search import LocalSearch, LongSearch, greedy_cover


def relaxed(matrix, at_least=1):
    """Relaxation of the one part of a problem, its node and its solution."""
    (part,) = reduce_problem(CoverProblem(matrix, at_least=at_least)).parts
    relaxation = Relaxation(part)
    everything = np.ones(part.shape[0], bool)
    node = Node(everything, ~everything)
    return relaxation, node, relaxation.solve(node, np.inf, Deadline(None))


def ring(size, width):
    """Each choice covers some targets in turn on a ring."""
    away = (np.arange(size) - np.arange(size)[:, None]) % size
    return sparse.csr_matrix(away < width)


def covers(part):
    """All whole covers of an instance, brute force."""
    dense = part.by_choice.toarray()
    for bits in itertools.product([0, 1], repeat=part.shape[0]):
        x = np.array(bits)
        if (x @ dense >= part.need).all():
            yield x


def strengthened(relaxation, node, solution, parity=True, rounds=20):
    """Solution after so many rounds of cuts, and all cuts that were made."""
    cuts = {}
    for _ in range(rounds):
        stronger = relaxation.strengthen(node, solution, np.inf, Deadline(None), parity)
        if stronger is solution:
            break
        assert stronger.bound >= solution.bound - 1e-7
        solution = stronger
        cuts |= relaxation.cuts
    return solution, list(cuts.values())


def test_an_odd_ring_is_proven_by_one_cut():
    relaxation, node, solution = relaxed(ring(7, 2))
    assert solution.bound == pytest.approx(3.5)
    after, cuts = strengthened(relaxation, node, solution)
    assert after.bound == pytest.approx(4.0)
    assert cuts[0].low == 4
    np.testing.assert_array_equal(cuts[0].value, 1.0)


@pytest.mark.parametrize(("width", "need", "least"), [(2, 1, 4), (4, 3, 6)])
def test_where_no_set_of_targets_needs_two_parity_is_tried_at_once(width, need, least):
    relaxation, node, solution = relaxed(ring(7, width), need)
    assert solution.bound == pytest.approx(7 * need / width)
    after, _ = strengthened(relaxation, node, solution, parity=False)
    assert after.bound == pytest.approx(least)


def test_targets_that_no_choice_covers_together_need_two():
    relaxation, node, solution = relaxed(sparse.csr_matrix(~np.eye(4, dtype=bool)))
    assert solution.bound == pytest.approx(4 / 3)
    after, cuts = strengthened(relaxation, node, solution, parity=False)
    assert after.bound == pytest.approx(2.0)
    assert {cut.low for cut in cuts} == {2.0}


@pytest.mark.parametrize(("most", "parity"), [(1, False), (1, True), (3, True)])
def test_no_whole_cover_breaks_a_cut(most, parity):
    rng = np.random.default_rng(8)
    made = sharper = 0
    for _ in range(180):
        matrix = sparse.csr_matrix(rng.random((12, 25)) < rng.uniform(0.25, 0.45))
        matrix = matrix[:, np.asarray(matrix.sum(axis=0)).ravel() > most]
        at_least = rng.integers(1, most + 1, matrix.shape[1])
        if len(reduce_problem(CoverProblem(matrix, at_least=at_least)).parts) != 1:
            continue
        relaxation, node, solution = relaxed(matrix, at_least)
        after, cuts = strengthened(relaxation, node, solution, parity)
        every = list(covers(relaxation.instance))
        for cut in cuts:
            assert min(cut.value @ x[cut.index] for x in every) >= cut.low
        assert after.bound <= min(x.sum() for x in every) + 1e-6
        made += len(cuts)
        sharper += after.bound > solution.bound + 1e-3
    assert made > 50
    assert sharper > 15


def tight_constraints(relaxation, solution):
    """Constraints of the targets that a solution covers exactly."""
    seen = relaxation.instance.by_choice.T @ solution.x
    tight = np.flatnonzero(np.abs(seen - 1) < 1e-7)
    covered_by = [relaxation.instance.by_target[:, [t]].indices.astype(np.int32) for t in tight]
    return [Constraint(index, np.ones(len(index)), 1.0) for index in covered_by]


@pytest.mark.parametrize(("separate", "rounding"), [(balas_ng_cuts, 1e-12), (parity_cuts, 0.0)])
def test_each_cut_is_broken_by_the_solution_it_was_made_for(separate, rounding):
    relaxation, _, solution = relaxed(random_matrix(np.random.default_rng(3)))
    cuts, work_s = separate(tight_constraints(relaxation, solution), solution.x)
    assert len(cuts) > 3
    assert work_s > 0
    missing = [cut.low - cut.value @ solution.x[cut.index] for cut in cuts]
    assert min(missing) > 0.01
    assert (np.diff(missing) <= rounding).all()
    assert separate([], solution.x) == ([], 0.0)


def left_side(pattern, x, chosen):
    """Shares of what covers some of the chosen targets, and once more of what covers them all."""
    inside = pattern[:, chosen]
    return x @ inside.any(axis=1) + x @ inside.all(axis=1)


def test_descents_end_where_no_single_target_helps():
    rng = np.random.default_rng(1)
    away = rng.random((300, 1, 2)) - rng.random((2000, 2))
    matrix = sparse.csr_matrix(np.hypot(*away.transpose(2, 0, 1)) < 0.15)
    matrix = matrix[:, np.asarray(matrix.sum(axis=0)).ravel() > 1]
    relaxation, _, solution = relaxed(matrix)
    support = np.flatnonzero(solution.x > 1e-9)
    tight = stacked(tight_constraints(relaxation, solution), len(solution.x))[:, support].toarray()
    pattern, x = np.ascontiguousarray(tight[distinct(tight > 0)].T), solution.x[support]
    pairs = np.array(list(itertools.combinations(range(pattern.shape[1]), 2)))
    sets, left, moves = _descend(pattern, x, pairs)
    assert moves > 0
    grown = np.flatnonzero(sets.sum(axis=1) > 2)
    assert not np.take_along_axis(sets, pairs, axis=1)[grown].all()
    for chosen, least in zip(sets[grown], left[grown], strict=True):
        assert least == pytest.approx(left_side(pattern > 0, x, chosen))
        for target in range(len(chosen)):
            other = chosen.copy()
            other[target] = not other[target]
            if other.sum() > 2:
                assert left_side(pattern > 0, x, other) > least - 2e-4


def random_matrix(rng, choices=30, targets=100):
    """Choices that cover a sixth of the targets each, without rhyme or reason: far from whole."""
    matrix = sparse.csr_matrix(rng.random((choices, targets)) < 0.16)
    return matrix[:, np.asarray(matrix.sum(axis=0)).ravel() > 1]


@pytest.fixture(params=["large", "mid"])
def on_cores(request, monkeypatch):
    """Sends small instances to a core: as large ones go, before any cuts, or after cuts."""

    def send():
        if request.param == "large":
            monkeypatch.setattr(interior, "_LARGE", 0)
            monkeypatch.setattr(interior, "_LEAST_TARGETS", 40)
        else:
            monkeypatch.setattr(core, "_LARGEST_SHARE", 1.0)
            monkeypatch.setattr(handover, "_MOST_ENTRIES", -1)

    return send


@pytest.mark.parametrize("kind", ["equal", "costs", "groups", "twice"])
def test_cores_prove_what_all_targets_prove(kind, on_cores, monkeypatch):
    used = []
    prove = core.prove_on_core
    monkeypatch.setattr(
        "roadsight.setcover.cover.solve.prove_on_core", lambda *a: used.append(a) or prove(*a)
    )
    monkeypatch.setattr(core, "_LARGEST_SHARE", 0.0)
    problems = [problem_of(kind, np.random.default_rng(seed)) for seed in range(14)]
    plain = [solve_cover_problem(problem) for problem in problems]
    assert not used
    on_cores()
    for problem, whole in zip(problems, plain, strict=True):
        cover = solve_cover_problem(problem)
        assert cover.status == whole.status
        assert cover.objective == whole.objective
        if cover.status == "optimal":
            assert cover.bound == cover.objective
            assert (problem.matrix[cover.chosen].sum(axis=0) >= problem.at_least).all()
    assert len(used) > 1


def problem_of(kind, rng):
    """A random matrix, with costs, with groups, or with targets to be seen twice."""
    return CoverProblem(
        random_matrix(rng, 40, 150) if kind == "twice" else random_matrix(rng),
        rng.integers(2, 7, 30) if kind == "costs" else None,
        rng.integers(-20, 10, 30) if kind == "groups" else None,
        2 if kind == "twice" else 1,
    )


def test_a_core_that_runs_out_of_work_keeps_its_bound(on_cores):
    on_cores()
    problem = CoverProblem(random_matrix(np.random.default_rng(5), 40, 150))
    found = [solve_cover_problem(problem, WorkLimit(limit_s)) for limit_s in (0.05, 0.2, 60.0)]
    best = found[-1]
    assert best.status == "optimal"
    for cover in found:
        assert cover.bound <= best.objective <= cover.objective
        assert cover.status == ("optimal" if cover.bound == cover.objective else "time_limit")


class _Endless(Deadline):
    """No limit, but it counts work, and refuses to go on for ever."""

    def __init__(self):
        super().__init__(None)
        self.work_s = 0.0

    def spent_s(self):
        return self.work_s

    def spend(self, seconds):
        self.work_s += seconds
        assert self.work_s < 5.0, "goes on for ever"


def _searched(bound, deadline):
    (part,) = reduce_problem(CoverProblem(ring(15, 4))).parts
    every, targets = np.zeros(part.shape[0]), np.ones(part.shape[1], bool)
    local = LocalSearch(part, greedy_cover(part), targets, np.random.default_rng(1))
    LongSearch(local, every, deadline).to_the_end(bound, deadline)
    return local.cost


def test_a_search_without_proof_and_without_a_limit_ends(monkeypatch):
    monkeypatch.setattr(long_search, "_BESIDE_S", 0.5)
    deadline = _Endless()
    assert _searched(0.0, deadline) == 4
    assert deadline.work_s >= 0.5
    proven = _Endless()
    _searched(4.0, proven)
    assert proven.work_s < 0.5


def test_a_search_without_proof_uses_all_of_its_limit():
    limit = WorkLimit(0.3)
    assert _searched(0.0, limit) == 4
    assert limit.passed()
