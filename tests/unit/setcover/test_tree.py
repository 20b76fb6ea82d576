import itertools

import numpy as np
import pytest
from scipy import sparse

from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.relaxation import Node
from roadsight.setcover.common.tree import (
    BestFirst,
    choices_of_both,
    divide_by_choice,
    divide_by_choices,
    is_settled,
    tighten,
)

CHOICES = 5
BOUNDS = {(): 1.0, (0,): 2.0, (1,): 1.5, (1, 0): 1.5, (1, 1): 1.8, (1, 0, 0): 4.0}
"""Bounds of a tree of two children each; what is not named has none."""


class Told(BestFirst):
    """Tree of `BOUNDS`; the path of a node tells which it is."""

    def __init__(self, goal=9.0, enough=np.inf, out=None):
        super().__init__(0.0)
        self.told, self.enough, self.out = goal, enough, out
        self.seen, self.next = [], []

    @property
    def goal(self):
        return self.told

    def round_up(self, bound):
        return bound

    def is_enough(self, bound, deadline):
        return bound >= self.enough

    def between(self, bound, deadline):
        self.next.append(bound)

    def expand(self, node, deadline):
        self.seen.append(node.path)
        bound = BOUNDS[node.path]
        if node.path == self.out:
            return bound, None
        paths = [(*node.path, k) for k in (0, 1)]
        return bound, tuple(Node(node.alive, node.fixed, p) for p in paths if p in BOUNDS)


def everything():
    return Node(np.ones(CHOICES, bool), np.zeros(CHOICES, bool))


def test_the_best_bound_comes_first_and_the_deepest_of_equals():
    tree = Told()
    assert tree.prove(everything(), 0.0, Deadline(None)) is None
    assert tree.seen == [(), (1,), (0,), (1, 1), (1, 0), (1, 0, 0)]
    assert tree.nodes == len(tree.seen)
    # A child waits with its parent's bound: its own is known once it is expanded. Beside a tree
    # that is empty, nothing is done.
    assert tree.next == [1.0, 1.0, 1.5, 1.5, 1.5]


@pytest.mark.parametrize(("goal", "seen"), [(-1.0, 0), (0.5, 1), (1.2, 3), (9.0, 6)])
def test_nodes_above_the_goal_are_not_expanded(goal, seen):
    tree = Told(goal)
    assert tree.prove(everything(), 0.0, Deadline(None)) is None
    assert tree.nodes == seen


def test_where_it_stops_the_least_bound_that_is_left_is_proven():
    assert Told(enough=1.0).prove(everything(), 0.0, Deadline(None)) == 1.0
    assert Told(out=()).prove(everything(), 0.0, Deadline(None)) == 1.0
    assert Told(out=(1, 1)).prove(everything(), 0.0, Deadline(None)) == 1.5
    assert Told(out=(0,)).prove(everything(), 0.0, Deadline(None)) == 1.5
    assert Told(out=(1, 0, 0)).prove(everything(), 0.0, Deadline(None)) == 4.0


def test_bounds_never_fall_on_the_way_down():
    tree = Told(enough=1.0)
    assert tree.prove(everything(), 1.4, Deadline(None)) == 1.4
    tree = Told(out=(1,))
    assert tree.prove(everything(), 1.2, Deadline(None)) == 1.2


def test_tightening_keeps_all_that_may_cost_less_than_the_goal():
    rng = np.random.default_rng(2)
    for _ in range(50):
        fixed = rng.random(CHOICES) < 0.2
        node = Node(fixed | (rng.random(CHOICES) < 0.8), fixed, (3,))
        price = rng.normal(0, 1, CHOICES)
        free = node.alive & ~node.fixed
        bound = np.minimum(price[free], 0).sum()
        goal = bound + 1.0
        tighter = tighten(node, bound, price, goal)
        assert tighter.path == node.path
        assert (tighter.fixed <= tighter.alive).all()
        for bits in itertools.product([False, True], repeat=CHOICES):
            x = np.array(bits)
            inside = (x <= node.alive).all() and (x >= node.fixed).all()
            if inside and price[x & free].sum() <= goal - 1e-9:
                assert (x <= tighter.alive).all()
                assert (x >= tighter.fixed).all()


def test_a_choice_that_costs_too_much_either_way_stays():
    tighter = tighten(everything(), 5.0, np.zeros(CHOICES), 4.0)
    assert tighter.alive.all()
    assert not tighter.fixed.any()


def test_few_changes_settle_a_node():
    before = Node(np.ones(100, bool), np.zeros(100, bool))
    fewer = before.alive.copy()
    fewer[:4] = False
    assert is_settled(before, before)
    assert is_settled(before, Node(fewer, before.fixed))
    fewer[:8] = False
    assert not is_settled(before, Node(fewer, before.fixed))


def test_divisions_share_out_a_node():
    node = everything()
    without, with_it = divide_by_choice(node, 2)
    assert without.alive.tolist() == [True, True, False, True, True]
    assert with_it.fixed.tolist() == [False, False, True, False, False]
    none, some = divide_by_choices(node, np.array([1, 3], np.int32), 7)
    assert none.alive.tolist() == [True, False, True, False, True]
    assert (none.path, some.path) == ((), (7,))
    assert some.alive.all()
    assert node.alive.all()
    assert not node.fixed.any()


def test_choices_of_both_targets_are_free_and_sorted():
    covers = sparse.csc_matrix(np.array([[1, 1], [1, 0], [1, 1], [0, 1], [1, 1]]))
    free = np.array([True, True, False, True, True])
    assert choices_of_both(covers, 0, 1, free).tolist() == [0, 4]
    assert choices_of_both(covers, 1, 1, free).tolist() == [0, 3, 4]
