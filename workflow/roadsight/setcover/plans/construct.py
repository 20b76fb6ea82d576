"""Good deployments quickly: greedy fills, and taking some choices out to fill again."""

from __future__ import annotations

import math
from collections import namedtuple

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.kernels import compiled, compiled_part
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.kernels import count_of_rows, sums_of_rows
from roadsight.setcover.plans.cuts import Cuts

_ENTRY_S = 2e-9  # work of a fill by entry of the matrix, in seconds, measured
_LEAST = 0.1  # least share of the best choices that a trial takes out
_MOST = 0.5  # most of them: with more, a trial is a new greedy fill that forgets what was good
_NEARER = 1e-2  # share of what is proven by which an answer must be better: sums are rounded
_PULL = 1.3  # factor by which unseen targets draw more in the next trial, while there is no answer
# Matrix by choice and by target, what targets weigh and need, what choices cost (``divisor``: as
# gains are divided by it), their sets and how much each is liked.
_Rules = namedtuple(
    "_Rules", "start index tstart tindex weight need divisor charge set_start sets allowed liking"
)


class Builder:
    """Builds deployments and keeps the best one.

    Parameters
    ----------
    best : sorted choices, or None. value : their objective, infinite for None.
    """

    def __init__(self, cuts: Cuts, rng: np.random.Generator) -> None:
        self.cuts, self.deployment, self._rng = cuts, cuts.deployment, rng
        self.best: Ints | None = None
        self.value = math.inf
        problem = self.deployment.problem
        self._allowed = ~problem.forbidden
        by_choice = self.deployment.exclusive.T.tocsr()
        by_choice.sort_indices()
        self._sets = by_choice.indptr, by_choice.indices
        self._matrix = cuts.by_choice.indptr, cuts.by_choice.indices
        self._must = np.flatnonzero(problem.mandatory)
        self._pull = np.ones(len(cuts.need))

    def offer(self, choices: Ints) -> bool:
        """Take choices over if they are allowed and better than the best."""
        chosen = np.unique(choices).astype(np.int64)
        value = self.deployment.objective(chosen)
        if value < math.inf and value < self.value - _NEARER * self.deployment.near(value):
            self.best, self.value = chosen, value
            return True
        return False

    def build(self, start: Ints, liking: Floats | None = None) -> None:
        """Fill up from some choices (those that break a set are left out), tidy up and offer."""
        inside = self._compatible(start)
        liking = np.ones(self.cuts.choices) if liking is None else liking
        self._fill(inside, liking)
        chosen = np.flatnonzero(inside)
        if self.deployment.keep:
            chosen = self._second_sight(inside, liking)
        tidy = self._tidy(chosen)
        self.offer(tidy)
        if self._complete and self.best is None:
            count = count_of_rows(*self._matrix, tidy, len(self.cuts.need))
            self._pull[count < self.cuts.need] *= _PULL

    def improve(self, steps: int, goal: float, deadline: Deadline) -> None:
        """Take out a part of the best choices and fill again, so often.

        As long as there is none, targets that a trial leaves unseen draw more in the next.
        """
        for _ in range(steps):
            if self.value <= goal or deadline.passed():
                return
            deadline.spend(_ENTRY_S * self.cuts.by_choice.nnz)
            start = np.empty(0, np.int64) if self.best is None else self.best
            out = self._rng.random(len(start)) < self._rng.uniform(_LEAST, _MOST)
            liking = self._rng.uniform(0.7, 1.0, self.cuts.choices)
            self.build(start[~out], liking)

    def _compatible(self, start: Ints) -> Bools:
        """Mandatory choices, then those of ``start`` that fit beside them."""
        inside = np.zeros(self.cuts.choices, bool)
        used = np.zeros(self.deployment.exclusive.shape[0], bool)
        first, sets = self._sets
        spent, charge = 0.0, np.asarray(self.deployment.charge)
        for choice in (*self._must, *start):
            these = sets[first[choice] : first[choice + 1]]
            fits = spent + charge[choice] <= self.deployment.spendable
            if inside[choice] or not self._allowed[choice] or used[these].any() or not fits:
                continue
            inside[choice] = True
            used[these] = True
            spent += charge[choice]
        return inside

    def _fill(self, inside: Bools, liking: Floats) -> None:
        deployment, by_choice, by_target = self.deployment, self.cuts.by_choice, self.cuts.by_target
        need = self.cuts.need
        # A target that must be seen draws whatever its weight.
        each = np.ones(len(need)) if deployment.complete else self.cuts.weight
        wanted = np.where(need > 0, self._pull * each, 0.0)
        charge = np.asarray(deployment.charge)
        finite = math.isfinite(deployment.spendable)
        divisor = charge if finite else np.asarray(deployment.cost)
        least = 0.0 if self._complete or finite else 1.0 / deployment.worth
        low = 1e-3 * max(divisor.max(initial=1.0), 1e-9)
        rules = _Rules(
            by_choice.indptr,
            by_choice.indices,
            by_target.indptr,
            by_target.indices,
            wanted,
            need,
            np.maximum(divisor, low),
            charge,
            *self._sets,
            self._allowed,
            liking,
        )
        used = np.zeros(deployment.exclusive.shape[0] + 1, bool)
        _fill(rules, inside, used, deployment.spendable, least)

    @property
    def _complete(self) -> bool:
        return self.deployment.complete or self.deployment.floor > 0

    def _second_sight(self, inside: Bools, liking: Floats) -> Ints:
        """Choices with more beside them until no failure of one takes too much."""
        need, weight, deployment = self.cuts.need, self.cuts.weight, self.deployment
        charge = np.asarray(deployment.charge)
        price = charge if math.isfinite(deployment.budget) else np.asarray(deployment.cost)
        while True:
            chosen = np.flatnonzero(inside)
            count = count_of_rows(*self._matrix, chosen, len(need))
            critical = (count == need) & (need > 0)
            covered = weight[count >= need].sum()
            lost = sums_of_rows(*self._matrix, chosen, np.where(critical, weight, 0.0))
            bad = lost > (1 - deployment.keep) * covered * (1 + 1e-9)
            if not bad.any():
                return chosen
            hit = critical & (count_of_rows(*self._matrix, chosen[bad], len(need)) > 0)
            gain = (self.cuts.by_choice @ np.where(hit, weight, 0.0)) * liking
            used = deployment.exclusive @ inside.astype(np.int32) > 0
            left = deployment.spendable - charge[inside].sum()
            free = self._allowed & ~inside & (charge <= left)
            free &= deployment.exclusive.T @ used == 0
            score = np.where(free, gain, 0.0) / np.maximum(price, 1e-9)
            if not (score > 0).any():
                return chosen
            inside[int(np.argmax(score))] = True

    def _tidy(self, chosen: Ints) -> Ints:
        """Without choices that are worth less than they cost, the least useful first."""
        deployment = self.deployment
        value = deployment.objective(chosen)
        kept = chosen
        while len(kept):
            count = count_of_rows(*self._matrix, kept, len(self.cuts.need))
            critical = np.where(count == self.cuts.need, self.cuts.weight, 0.0)
            lost = sums_of_rows(*self._matrix, kept, critical)
            saved = np.asarray(deployment.cost)[kept] - deployment.worth * lost
            for k in np.argsort(-saved, kind="stable"):
                if saved[k] < 0 or (self._complete and lost[k] > 1e-9 and not deployment.floor):
                    continue
                fewer = np.delete(kept, k)
                trial = deployment.objective(fewer)
                if trial <= value and math.isfinite(trial):
                    kept, value = fewer, trial
                    break
            else:
                return kept
        return kept


@compiled_part()
def _begin(rules, inside, count, used, gain):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Counts of targets, sets used and gains where some choices are taken; their charge."""
    spent = 0.0
    for i in range(len(inside)):
        if not inside[i]:
            continue
        spent += rules.charge[i]
        used[rules.sets[rules.set_start[i] : rules.set_start[i + 1]]] = True
        for p in range(rules.start[i], rules.start[i + 1]):
            count[rules.index[p]] += 1
    for i in range(len(inside)):
        for p in range(rules.start[i], rules.start[i + 1]):
            t = rules.index[p]
            if count[t] < rules.need[t]:
                gain[i] += rules.weight[t] / rules.need[t]
    return spent


@compiled()
def _fill(rules, inside, used, budget, least):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds the choice that gains most for its divisor, until none that is allowed gains enough."""
    count, gain = np.zeros(len(rules.need), np.int64), np.zeros(len(inside))
    spent = _begin(rules, inside, count, used, gain)
    while True:
        best, most = -1, 0.0
        for i in range(len(inside)):
            if inside[i] or not rules.allowed[i]:
                continue
            if gain[i] <= max(1e-12, least * rules.divisor[i]) or spent + rules.charge[i] > budget:
                continue
            score = gain[i] * rules.liking[i] / rules.divisor[i]
            sets = rules.sets[rules.set_start[i] : rules.set_start[i + 1]]
            if score > most and not used[sets].any():
                best, most = i, score
        if best < 0:
            return
        inside[best] = True
        spent += rules.charge[best]
        used[rules.sets[rules.set_start[best] : rules.set_start[best + 1]]] = True
        for p in range(rules.start[best], rules.start[best + 1]):
            t = rules.index[p]
            count[t] += 1
            if count[t] == rules.need[t]:
                for q in range(rules.tstart[t], rules.tstart[t + 1]):
                    gain[rules.tindex[q]] -= rules.weight[t] / rules.need[t]
