"""Good deployments quickly: greedy fills, and taking some rows out to fill again."""

from __future__ import annotations

import math
from collections import namedtuple

import numpy as np
from numba import njit

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.plans.cuts import Cuts

_ENTRY_S = 2e-9  # work of a fill by entry of the matrix, measured
_LEAST, _MOST = 0.1, 0.5
_PULL = 1.3

_Rules = namedtuple(
    "_Rules",
    "start index tstart tindex weight need divisor charge set_start sets allowed liking",
)
"""Rows and targets, what targets weigh and need, what rows cost, their sets and their liking."""


class Builder:
    """Builds deployments and keeps the best one.

    Parameters
    ----------
    best : sorted rows, or None. value : their objective, infinite for None.
    """

    def __init__(self, cuts: Cuts, rng: np.random.Generator) -> None:
        self.cuts, self.deployment, self._rng = cuts, cuts.deployment, rng
        self.best: Ints | None = None
        self.value = math.inf
        problem = self.deployment.problem
        self._allowed = ~problem.forbidden
        by_row = self.deployment.exclusive.T.tocsr()
        by_row.sort_indices()
        self._sets = by_row.indptr, by_row.indices
        self._must = np.flatnonzero(problem.mandatory)
        self._pull = np.ones(len(cuts.need))

    def offer(self, rows: Ints) -> bool:
        """Take rows over if they are allowed and better than the best."""
        chosen = np.unique(rows).astype(np.int64)
        value = self.deployment.objective(chosen)
        if value < self.value - 1e-9 * max(1.0, abs(value)):
            self.best, self.value = chosen, value
            return True
        return False

    def build(self, start: Ints, liking: Floats | None = None) -> None:
        """Fill up from some rows (those that break a set are left out), tidy up and offer."""
        inside = self._compatible(start)
        liking = np.ones(self.cuts.choices) if liking is None else liking
        self._fill(inside, self.cuts.weight, self.cuts.need, liking)
        chosen = np.flatnonzero(inside)
        if self.deployment.keep:
            chosen = self._second_sight(inside, liking)
        tidy = self._tidy(chosen)
        self.offer(tidy)
        if self._complete and self.best is None:
            count = np.asarray(self.cuts.rows[tidy].sum(axis=0, dtype=np.int64)).ravel()
            self._pull[count < self.cuts.need] *= _PULL

    def improve(self, steps: int, goal: float, deadline: Deadline) -> None:
        """Take out a part of the best rows and fill again, so often.

        As long as there is none, targets that a trial leaves unseen draw more in the next.
        """
        for _ in range(steps):
            if self.value <= goal or deadline.passed():
                return
            deadline.spend(_ENTRY_S * self.cuts.rows.nnz)
            start = np.empty(0, np.int64) if self.best is None else self.best
            out = self._rng.random(len(start)) < self._rng.uniform(_LEAST, _MOST)
            liking = self._rng.uniform(0.7, 1.0, self.cuts.choices)
            self.build(start[~out], liking)

    def _compatible(self, start: Ints) -> Bools:
        """Mandatory rows, then those of ``start`` that fit beside them."""
        inside = np.zeros(self.cuts.choices, bool)
        used = np.zeros(self.deployment.exclusive.shape[0], bool)
        first, sets = self._sets
        spent, charge = 0.0, np.asarray(self.deployment.charge)
        for row in (*self._must, *start):
            these = sets[first[row] : first[row + 1]]
            fits = spent + charge[row] <= self.deployment.spendable
            if inside[row] or not self._allowed[row] or used[these].any() or not fits:
                continue
            inside[row] = True
            used[these] = True
            spent += charge[row]
        return inside

    def _fill(
        self,
        inside: Bools,
        weight: Floats,
        need: Ints,
        liking: Floats,
    ) -> None:
        deployment, rows, columns = self.deployment, self.cuts.rows, self.cuts.columns
        # A target that must be seen draws whatever its weight.
        each = np.ones(len(need)) if deployment.complete else weight
        wanted = np.where(need > 0, self._pull * each, 0.0)
        charge = np.asarray(deployment.charge)
        finite = math.isfinite(deployment.spendable)
        divisor = charge if finite else np.asarray(deployment.cost)
        least = 0.0 if self._complete or finite else 1.0 / deployment.worth
        low = 1e-3 * max(divisor.max(initial=1.0), 1e-9)
        rules = _Rules(
            rows.indptr,
            rows.indices,
            columns.indptr,
            columns.indices,
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
        """Rows with more beside them until no failure of one takes too much."""
        need, weight = self.cuts.need, self.cuts.weight
        while True:
            chosen = np.flatnonzero(inside)
            rows = self.cuts.rows[chosen]
            count = np.asarray(rows.sum(axis=0, dtype=np.int64)).ravel()
            critical = (count == need) & (need > 0)
            covered = weight[count >= need].sum()
            lost = rows @ np.where(critical, weight, 0.0)
            bad = lost > (1 - self.deployment.keep) * covered * (1 + 1e-9)
            if not bad.any():
                return chosen
            hit = critical & (np.asarray(rows[np.flatnonzero(bad)].sum(axis=0)).ravel() > 0)
            gain = (self.cuts.rows @ np.where(hit, weight, 0.0)) * liking
            row = self._best_addition(inside, gain)
            if row < 0:
                return chosen
            inside[row] = True

    def _best_addition(self, inside: Bools, gain: Floats) -> int:
        """Row that may be added and gains most for what it costs; -1: none."""
        exclusive, deployment = self.deployment.exclusive, self.deployment
        used = exclusive @ inside.astype(np.int32) > 0
        charge = np.asarray(deployment.charge)
        left = deployment.spendable - charge[inside].sum()
        free = self._allowed & ~inside & (charge <= left) & (exclusive.T @ used == 0)
        price = charge if math.isfinite(deployment.budget) else np.asarray(deployment.cost)
        score = np.where(free, gain, 0.0) / np.maximum(price, 1e-9)
        return int(np.argmax(score)) if (score > 0).any() else -1

    def _tidy(self, chosen: Ints) -> Ints:
        """Without rows that are worth less than they cost, the least useful first."""
        deployment = self.deployment
        value = deployment.objective(chosen)
        kept = chosen
        while len(kept):
            rows = self.cuts.rows[kept]
            count = np.asarray(rows.sum(axis=0, dtype=np.int64)).ravel()
            lost = rows @ np.where(count == self.cuts.need, self.cuts.weight, 0.0)
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


@njit(cache=True)
def _begin(rules, inside, count, used, gain):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Counts of targets, sets used and gains of rows where some rows are taken; their charge."""
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


@njit(cache=True)
def _fill(rules, inside, used, budget, least):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds the row that gains most for its divisor, until none that may be added gains enough."""
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
