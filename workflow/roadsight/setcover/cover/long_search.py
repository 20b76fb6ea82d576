"""Local search that shares the time with the proof.

A proof that takes long leaves time in which a better cover may be found, and a better cover makes
the proof shorter. The search is `exchange`, row weighting local search (Gao, Weise and Li 2015),
mostly among the choices that are cheap by the relaxation's reduced costs: the core problem of
Caprara, Fischetti and Toth (1999).
"""

from __future__ import annotations

import math

import numpy as np

from roadsight.base.arrays import Bools, Floats
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import Instance
from roadsight.setcover.cover.local_search import LocalSearch

CHEAP_CHOICES = 10
"""Choices by target that are cheap. On a railway's crews (63,009 choices) the search got to 174 in
3 to 9 CPU s of 15 with 10 in two of three runs, to 175 with 5, 20 and 40, to 177 with all."""
_CHEAP_BURSTS = 3
"""Bursts among cheap choices before one among all: where no cover below the best consists of cheap
choices, only the latter finds one."""
_BURST_S = 0.25
"""Work of a burst: looking for targets and choices anew takes a hundredth of it."""
_BURST_STEPS = 20_000
"""Steps between two looks at the work."""
_HEAD_S = 2.0
"""Work of the proof before it shares: the ten corridors of the benchmark are proven about then."""
_AHEAD_SPARE = 3.0
"""So many mean costs between cover and bound, the search goes ahead of the proof: cuts close less
in seconds, and each cut is chosen for the cover known."""
_AHEAD_SHARE = 0.25
"""Share of the time left that it may take ahead of the proof."""
_AHEAD_S = 0.3
"""Work ahead of the proof without a find that ends it, more after late finds (see below)."""
_BESIDE_S = 10.0
"""The same beside the proof."""
_PATIENCE = 4.0
"""It goes on for so many times the work that its last find took, too."""


class LongSearch:
    """Local search beside a proof, as long as it pays.

    Parameters
    ----------
    local : the search; it keeps the best cover.
    reduced_cost : (m,) of the relaxation, in steps, as far as it was solved.
    deadline : that of the proof.
    """

    def __init__(self, local: LocalSearch, reduced_cost: Floats, deadline: Deadline) -> None:
        self._local = local
        self._cheap = cheap_choices(local.instance, reduced_cost)
        self._begun_s = deadline.spent_s()
        self._used_s = self._found_s = 0.0
        self._bursts = 0

    def ahead(self, bound: float, deadline: Deadline) -> None:
        """Search before a proof whose bound is far from the cover."""
        instance, local = self._local.instance, self._local
        most_s = self._used_s + _AHEAD_SHARE * deadline.left_s()
        spare = _AHEAD_SPARE * instance.cost.mean()
        while local.cost - instance.round_up(bound) >= spare:
            due_s = min(most_s, _AHEAD_S + _PATIENCE * self._found_s)
            if deadline.passed() or self._used_s >= due_s:
                break
            self._burst(due_s, bound, deadline)

    def to_the_end(self, bound: float, deadline: Deadline) -> None:
        """Search until the limit, where no proof will come; without one, as long as it pays."""
        instance, local = self._local.instance, self._local
        endless = math.isinf(deadline.left_s())
        while bound <= instance.goal(local.cost) and not deadline.passed():
            if endless and self._used_s >= _BESIDE_S + _PATIENCE * self._found_s:
                break
            self._burst(self._used_s + _BURST_S, bound, deadline)

    def catch_up(self, bound: float, deadline: Deadline) -> None:
        """Search until it has worked as long as the proof, or does not pay any more."""
        instance, local = self._local.instance, self._local
        proof_s = deadline.spent_s() - self._begun_s - self._used_s
        while bound <= instance.goal(local.cost) and not deadline.passed():
            due_s = min(proof_s - _HEAD_S, _BESIDE_S + _PATIENCE * self._found_s)
            if due_s - self._used_s < _BURST_S:
                break
            self._burst(due_s, bound, deadline)

    def _burst(self, due_s: float, bound: float, deadline: Deadline) -> None:
        """Search for a while among one set of choices."""
        self._bursts += 1
        local, scope = self._local, None
        if self._bursts % (_CHEAP_BURSTS + 1):
            scope = self._cheap if local.best is None else self._cheap | local.best
        before, cost = deadline.spent_s(), local.cost
        end_s = before + min(_BURST_S, due_s - self._used_s)
        while deadline.spent_s() < end_s and local.cost == cost and not deadline.passed():
            local.improve(_BURST_STEPS, bound, deadline, scope)
        self._used_s += deadline.spent_s() - before
        if local.cost < cost:
            self._found_s = self._used_s


def cheap_choices(instance: Instance, reduced_cost: Floats) -> Bools:
    """Choices (m,) that are among the `CHEAP_CHOICES` of least reduced cost of any target.

    Of equal ones all are: where costs and targets are alike, that is every choice.
    """
    by_target = instance.by_target
    cheap = np.zeros(instance.shape[0], bool)
    for first, last in zip(by_target.indptr[:-1], by_target.indptr[1:], strict=True):
        choices = by_target.indices[first:last]
        value = reduced_cost[choices]
        if len(value) > CHEAP_CHOICES:
            limit = np.partition(value, CHEAP_CHOICES - 1)[CHEAP_CHOICES - 1]
            choices = choices[value <= limit + 1e-9]
        cheap[choices] = True
    return cheap
