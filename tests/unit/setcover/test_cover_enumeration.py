import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import linprog

from roadsight.setcover import CoverProblem, solve_cover_problem
from roadsight.setcover.common import relaxation as relaxation_module
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.kernels import reduced_costs
from roadsight.setcover.common.problem import Instance
from roadsight.setcover.common.reductions import reduce_problem
from roadsight.setcover.common.relaxation import Node, Relaxation, Solution
from roadsight.setcover.cover import enumeration
from roadsight.setcover.cover import search as closing
from roadsight.setcover.cover import solve as handover
from roadsight.setcover.cover.enumeration import _lowest, _ones, affordable_pairs, enumerate_covers
from roadsight.setcover.cover.local_search import LocalSearch, greedy_cover

CHOICES, TARGETS = 11, 24


def instance(seed, kind="plain"):
    """Random instance of one of some kinds, unreduced."""
    rng = np.random.default_rng(seed)
    matrix = rng.random((CHOICES, TARGETS)) < rng.uniform(0.25, 0.5)
    matrix[rng.integers(0, CHOICES, TARGETS), np.arange(TARGETS)] = True
    need, group = np.ones(TARGETS, np.int32), np.full(CHOICES, -1)
    if kind == "twice":
        need = np.minimum(rng.integers(1, 3, TARGETS), matrix.sum(axis=0)).astype(np.int32)
    if kind == "groups":
        group = np.sort(rng.integers(0, 5, CHOICES))
    costs = kind in ("costs", "fractions")
    cost = rng.integers(2, 7, CHOICES).astype(float) if costs else np.ones(CHOICES)
    cost *= 0.37 if kind == "fractions" else 1.0
    by_choice, group = sparse.csr_matrix(matrix), group.astype(np.int64)
    return Instance(by_choice, cost, need, group, np.arange(CHOICES), kind != "fractions")


def everything():
    return Node(np.ones(CHOICES, bool), np.zeros(CHOICES, bool))


def every_choice():
    """All sets of choices, (2^CHOICES, CHOICES)."""
    return np.array(list(itertools.product([0, 1], repeat=CHOICES)))


def cheapest(part, node):
    """Least cost of the covers of a node, brute force; infinite where there are none."""
    x = every_choice()
    allowed = (x <= node.alive).all(axis=1) & (x >= node.fixed).all(axis=1)
    allowed &= (x @ part.by_choice.toarray().astype(int) >= part.need).all(axis=1)
    for group in set(part.group[part.group >= 0].tolist()):
        allowed &= x[:, part.group == group].sum(axis=1) <= 1
    return float((x[allowed] @ part.cost).min(initial=np.inf))


def solved(part, node, rounds=0):
    """Relaxation of a node after some rounds of cuts."""
    relaxation = Relaxation(part)
    solution = relaxation.solve(node, np.inf, Deadline(None))
    for _ in range(rounds):
        solution = relaxation.strengthen(node, solution, np.inf, Deadline(None), True)
    return solution


def of_duals(part, node, dual):
    """What any duals of targets say, good or not."""
    matrix = part.by_choice
    cost = reduced_costs(matrix.indptr, matrix.indices, part.cost, dual)
    bound = dual @ part.need + cost[node.fixed].sum()
    bound += np.minimum(cost[node.alive & ~node.fixed], 0).sum()
    return Solution(float(bound), np.full(CHOICES, 0.4), cost, dual, True)


def check(part, node, solution, least):
    """Enumerations below, at and above the least cost."""
    for goal in (least - 0.2, least, least + 0.3):
        if not np.isfinite(goal) or goal < solution.bound:
            continue
        answer = enumerate_covers(part, node, solution, goal, np.inf)
        assert answer.excluded == (goal < least)
        assert answer.work_s > 0
        if answer.excluded:
            assert answer.cover is None
            continue
        assert part.cost[answer.cover].sum() <= goal + 1e-6
        assert (answer.cover @ part.by_choice.toarray().astype(int) >= part.need).all()
        assert (answer.cover >= node.fixed).all()
        assert not (answer.cover & ~node.alive).any()
        taken = part.group[answer.cover & (part.group >= 0)]
        assert len(taken) == len(set(taken))


KINDS = ("plain", "twice", "groups", "costs", "fractions")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rounds", [0, 3])
def test_covers_are_found_or_excluded_as_by_brute_force(kind, rounds):
    tried = 0
    for seed in range(12):
        part, node = instance(seed, kind), everything()
        solution = solved(part, node, rounds)
        least = cheapest(part, node)
        if np.isinf(solution.bound) or np.isinf(least):
            continue
        tried += 1
        check(part, node, solution, least)
    assert tried > 3


@pytest.mark.parametrize("kind", KINDS)
def test_it_holds_for_any_duals_and_below_any_node(kind):
    tried = 0
    for seed in range(25):
        part, rng = instance(seed, kind), np.random.default_rng(seed)
        fixed = np.zeros(CHOICES, bool)
        fixed[rng.integers(0, CHOICES, rng.integers(0, 3))] = True
        mates = np.isin(part.group, part.group[fixed & (part.group >= 0)])
        node = Node(fixed | ((rng.random(CHOICES) < 0.9) & ~mates), fixed)
        least = cheapest(part, node)
        if np.isfinite(least):
            tried += 1
            dual = rng.uniform(0, 0.25, TARGETS) * part.cost.mean()
            check(part, node, of_duals(part, node, dual), least)
    assert tried > 5


def test_what_fixed_choices_cover_needs_no_others():
    part = instance(3)
    node = Node(np.ones(CHOICES, bool), np.ones(CHOICES, bool))
    node.fixed[0] = part.by_choice[1:].toarray().any(axis=0).sum() < TARGETS
    answer = enumerate_covers(part, node, of_duals(part, node, np.zeros(TARGETS)), 20.0, np.inf)
    assert not answer.excluded  # nothing can join, and nothing was looked at
    free = replace(node, fixed=node.fixed & (np.arange(CHOICES) > 0))
    answer = enumerate_covers(part, free, of_duals(part, free, np.zeros(TARGETS)), 20.0, np.inf)
    np.testing.assert_array_equal(answer.cover[1:], True)


def test_without_work_nothing_is_said():
    part = instance(5)
    solution = of_duals(part, everything(), np.zeros(TARGETS))
    least = cheapest(part, everything())
    answer = enumerate_covers(part, everything(), solution, least - 0.5, 0.0)
    assert not answer.excluded
    assert answer.cover is None
    assert enumerate_covers(part, everything(), solution, least - 0.5, 1.0).excluded


@pytest.mark.parametrize("limit", ["_MOST_CHOICES", "_MOST_WORDS"])
def test_large_instances_are_left_alone(monkeypatch, limit):
    monkeypatch.setattr(enumeration, limit, 5)
    part = instance(5)
    answer = enumerate_covers(part, everything(), solved(part, everything()), 9.0, np.inf)
    assert (answer.excluded, answer.cover, answer.work_s) == (False, None, 0.0)


@pytest.mark.parametrize("kind", ["plain", "twice", "groups"])
def test_pairs_are_those_whose_prices_stay_within_the_slack(kind):
    for seed in range(5):
        part, node = instance(seed, kind), everything()
        solution, every = solved(part, node, 2), np.arange(CHOICES)
        slack = 0.4
        prices, left = enumeration._prices(part, solution, every, every[:0], slack)
        assert left == slack
        bits = affordable_pairs(prices, part.group, slack)
        for i, j in itertools.product(every, every):
            both = prices.value[:, i] + prices.value[:, j]
            price = prices.reduced[[i, j]].sum() + prices.dual @ (
                np.maximum(both - prices.low, 0)
                - np.maximum(prices.value[:, i] - prices.low, 0)
                - np.maximum(prices.value[:, j] - prices.low, 0)
            )
            apart = part.group[i] < 0 or part.group[i] != part.group[j]
            allowed = i != j and apart and price <= slack
            if abs(price - slack) > 1e-9:
                assert bool(int(bits[i, 0]) >> int(j) & 1) == allowed


def test_what_a_cover_costs_above_the_bound_it_pays():
    part, node = instance(2), everything()
    solution = solved(part, node, 2)
    prices, _ = enumeration._prices(part, solution, np.arange(CHOICES), np.empty(0, np.int64), 1.0)
    for x in every_choice():
        if (x @ part.by_choice.toarray() >= 1).all():
            over = prices.value @ x - prices.low
            alone = np.maximum(prices.value - prices.low[:, None], 0) @ x
            paid = prices.reduced @ x + prices.dual @ (np.maximum(over, 0) - alone)
            negative = np.minimum(solution.reduced_cost, 0)
            assert paid - negative @ (1 - x) == pytest.approx(x.sum() - solution.bound, abs=1e-6)


@pytest.mark.parametrize("word", [1, 2, 3, 2**63, 2**64 - 1, 0x8000000100000000, 0xF0F0])
def test_bits_of_a_word(word):
    assert _ones(np.uint64(word)) == word.bit_count()
    assert _lowest(np.uint64(word)) == (word & -word).bit_length() - 1
    assert _ones(np.uint64(0)) == 0


def road(seed, at_least=1):
    """Problem of candidates along a road, each of which sees most of what is near."""
    rng = np.random.default_rng(seed)
    near = np.abs(rng.uniform(0, 150, 300) - rng.uniform(0, 150, 70)[:, None]) < 20
    seen = near & (rng.random(near.shape) < 0.9)
    return CoverProblem(sparse.csr_matrix(seen[:, seen.sum(axis=0) > at_least]), at_least=at_least)


@pytest.mark.parametrize("at_least", [1, 2])
def test_answers_are_the_same_with_and_without(monkeypatch, at_least):
    monkeypatch.setattr(handover, "_MOST_ENTRIES", -1)  # what is left is enumerated
    made = []

    def noted(*arguments):
        made.append(enumerate_covers(*arguments))
        return made[-1]

    with monkeypatch.context() as patch:
        patch.setattr(closing, "enumerate_covers", noted)
        found = [solve_cover_problem(road(seed, at_least)) for seed in range(3)]
    assert any(answer.excluded for answer in made)
    monkeypatch.setattr(closing, "_ROOT_SLACK", -1.0)
    monkeypatch.setattr(closing, "_NODE_SLACK", -1.0)
    without = [solve_cover_problem(road(seed, at_least)) for seed in range(3)]
    assert [cover.objective for cover in found] == [cover.objective for cover in without]
    assert {cover.status for cover in found + without} == {"optimal"}


def closing_of(problem, gap=0.0, ceiling=np.inf):
    """How a problem's root is closed, its node, and its solution."""
    (part,) = reduce_problem(problem).parts
    root = Node(np.ones(part.shape[0], bool), np.zeros(part.shape[0], bool))
    relaxation = Relaxation(part)
    solution = relaxation.solve(root, np.inf, Deadline(None))
    local = LocalSearch(
        part, greedy_cover(part), solution.target_dual > 0, np.random.default_rng(1)
    )
    return closing.Closing(relaxation, local, gap, ceiling), root, solution


def test_cuts_end_with_what_is_enough():
    until_proven, root, solution = closing_of(road(3))
    proven = until_proven.strengthen(root, solution, Deadline(None), at_root=True)
    assert solution.bound < proven.bound
    assert until_proven.relaxation.cuts
    greedy = closing_of(road(3))[0].local.cost
    for enough in ({"gap": 0.9}, {"ceiling": greedy + 1}):
        near, root, solution = closing_of(road(3), **enough)
        assert near.strengthen(root, solution, Deadline(None), at_root=True) is solution
        assert not near.relaxation.cuts


def test_near_the_goal_the_relaxation_stops_before_the_goal(monkeypatch):
    near, root, solution = closing_of(road(3))
    near.local.run(5_000, solution.bound, Deadline(None))
    goals = []

    def noted(node, before, goal, *others):
        goals.append((before.bound, goal, near.goal))
        return before

    monkeypatch.setattr(near.relaxation, "strengthen", noted)
    monkeypatch.setattr(closing, "_ROOT_SLACK", -1.0)
    assert near.strengthen(root, solution, Deadline(None), at_root=True) is solution
    far = replace(solution, bound=near.goal - 0.05)
    assert near.strengthen(root, far, Deadline(None), at_root=True) is far
    assert [goal for _, goal, _ in goals] == [near.goal - closing._NEAR, near.goal]


@pytest.mark.parametrize("first", [5, 10_000])
def test_targets_that_leave_the_relaxation_do_not_change_it(monkeypatch, first):
    monkeypatch.setattr(relaxation_module, "FIRST_TARGETS", first)
    monkeypatch.setattr(relaxation_module, "ADDED_TARGETS", 7)
    problem = road(4)
    every = np.ones(problem.matrix.shape[0], bool)
    part = Instance(problem.matrix, problem.costs, problem.at_least.astype(np.int32),
                    problem.groups, np.arange(len(every)), True)  # fmt: skip
    relaxation = Relaxation(part)
    solution = relaxation.solve(Node(every, ~every), np.inf, Deadline(None))
    least = linprog(part.cost, A_ub=-part.by_choice.T, b_ub=-part.need, bounds=(0, 1)).fun
    assert solution.complete
    assert solution.bound == pytest.approx(least, abs=1e-6)
    inside = relaxation.targets_inside()
    assert (len(inside) == part.shape[1]) == (first > part.shape[1])
    assert len(inside) == len(set(inside.tolist()))
