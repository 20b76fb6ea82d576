"""Inequalities that hold for every deployment, found where a relaxation breaks them.

Targets have no variables. The weight V that a block of targets contributes is bounded by cuts: for
any set T of its targets, ``V <= w(not T) + sum_i x_i sum_{j in T} a_ij w_j / k_j`` (Benders cuts of
maximal covering; k_j is how often target j must be seen). The set T of targets that x sees less
than k_j times gives the most violated one.
"""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Floats, Ints, Ints32
from roadsight.base.kernels import compiled
from roadsight.setcover.common.cuts import Constraint
from roadsight.setcover.plans.deployment import Deployment

# Neighbouring targets that share a variable. With one variable for all targets the relaxation of
# "five OS-128" on the sample site had not converged after 44 s; with one for each 100 it takes 3 s.
BLOCK_TARGETS = 100
TARGETS_AT_ONCE = 60  # most unseen targets that join at once, those that miss most
FAILURES_AT_ONCE = 30  # most cuts of failures that join at once, the most violated ones
_VIOLATION = 1e-6  # what breaks a cut, as a share of its size: ten times the solver's own tolerance


class Cuts:
    """Separation for one deployment.

    ``blocks`` is how many V variables there are (none where all targets must be seen), ``block``
    the number of each target's block: neighbours in the order of targets, which is that of a grid.
    """

    def __init__(self, deployment: Deployment) -> None:
        self.deployment = deployment
        problem = deployment.problem
        self.by_choice = problem.matrix
        self.by_target = problem.matrix.tocsc()
        self.choices, self.targets = problem.matrix.shape
        self.need = problem.at_least
        self.weight = np.where(self.need > 0, deployment.weights, 0.0)
        self.share = self.weight / np.maximum(self.need, 1)
        self.blocks = 0 if deployment.complete else max(1, -(-self.targets // BLOCK_TARGETS))
        self.block = np.arange(self.targets) * max(self.blocks, 1) // max(self.targets, 1)
        self.block_weight = np.bincount(self.block, self.weight, minlength=self.blocks)
        self.exclusive = deployment.exclusive
        self.loss = (1 - deployment.keep) * deployment.total

    def count(self, x: Floats) -> Floats:
        """How often each target is seen."""
        return _count(self.by_choice.indptr, self.by_choice.indices, x, self.targets)

    def violated(self, x: Floats, value: Floats) -> list[Constraint]:
        """Cuts that shares of choices (m,) and values of blocks break."""
        count = self.count(x)
        crowded = np.flatnonzero(self.exclusive @ x > 1 + _VIOLATION)
        start, index = self.exclusive.indptr, self.exclusive.indices
        members = [np.sort(index[start[k] : start[k + 1]]).astype(np.int32) for k in crowded]
        found = [Constraint(choices, -np.ones(len(choices)), -1.0) for choices in members]
        if self.deployment.complete:
            missing = self.need - count
            bad = np.flatnonzero(missing > _VIOLATION)
            bad = bad[np.argsort(-missing[bad], kind="stable")[:TARGETS_AT_ONCE]]
            found += [self._target(int(t)) for t in bad]
        else:
            found += self._coverage(count, value)
        if self.deployment.keep:
            found += self._failures(x, count, value)
        return found

    def first(self) -> list[Constraint]:
        """Cuts to begin with: the budget, the floor, and the targets that few choices see."""
        found = []
        if np.isfinite(self.deployment.spendable):
            charge = np.asarray(self.deployment.charge)
            used = np.flatnonzero(charge > 0).astype(np.int32)
            found.append(Constraint(used, -charge[used], -self.deployment.spendable))
        if self.blocks and self.deployment.floor > 0:
            every = np.arange(self.choices, self.choices + self.blocks, dtype=np.int32)
            found.append(Constraint(every, np.ones(self.blocks), self.deployment.floor))
        if self.deployment.complete:
            asked = np.flatnonzero(self.need > 0)
            seen = np.diff(self.by_target.indptr)[asked]
            rare = asked[np.argsort(seen, kind="stable")[: 5 * TARGETS_AT_ONCE]]
            found += [self._target(int(t)) for t in np.sort(rare)]
        return found

    def _target(self, target: int) -> Constraint:
        start = self.by_target.indptr
        choices = self.by_target.indices[start[target] : start[target + 1]].astype(np.int32)
        return Constraint(choices, np.ones(len(choices)), float(self.need[target]))

    def _coverage(self, count: Floats, value: Floats) -> list[Constraint]:
        part = np.minimum(count, self.need) * self.share
        seen = np.bincount(self.block, part, minlength=self.blocks)
        open_ = (count < self.need) & (self.weight > 0)
        found = []
        for b in np.flatnonzero(value > seen + _VIOLATION * np.maximum(1.0, self.block_weight)):
            these = np.flatnonzero(open_ & (self.block == b))
            gain = self._gain(these)
            choices = np.flatnonzero(gain).astype(np.int32)
            index = np.append(choices, np.int32(self.choices + b))
            low = self.weight[these].sum() - self.block_weight[b]
            found.append(Constraint(index, np.append(gain[choices], -1.0), low))
        return found

    def _gain(self, targets: Ints) -> Floats:
        """Weight over need of some targets that each choice sees."""
        by_target = self.by_target
        return _gain(by_target.indptr, by_target.indices, targets, self.share, self.choices)

    def _failures(self, x: Floats, count: Floats, value: Floats) -> list[Constraint]:
        """What is left when a choice fails: ``keep V <= f(x without it)``; most violated first."""
        deployment = self.deployment
        goal = deployment.keep * (deployment.total if deployment.complete else value.sum())
        found = []
        for choice in np.flatnonzero(x > _VIOLATION):
            left = count.copy()
            left[self._seen(int(choice))] -= x[choice]
            part = float((np.minimum(left, self.need) * self.share).sum())
            short = goal - part
            if short > _VIOLATION * max(1.0, deployment.total):
                found.append((-short, int(choice), np.flatnonzero(left < self.need - 1e-9)))
        found.sort(key=lambda entry: entry[:2])
        cuts = [self._failure(choice, these) for _, choice, these in found[:FAILURES_AT_ONCE]]
        return cuts + (self._critical(x, count) if deployment.complete else [])

    def _failure(self, choice: int, targets: Ints) -> Constraint:
        gain = self._gain(targets[self.weight[targets] > 0])
        gain[choice] = 0.0
        outside = self.deployment.total - self.weight[targets].sum()
        keep = self.deployment.keep
        if self.deployment.complete:
            low = keep * self.deployment.total - outside
            others = np.flatnonzero(gain).astype(np.int32)
            return Constraint(others, np.minimum(gain[others], low), low)
        others = np.flatnonzero(gain).astype(np.int32)
        every = np.arange(self.choices, self.choices + self.blocks, dtype=np.int32)
        value = np.concatenate([gain[others], np.full(self.blocks, -keep)])
        return Constraint(np.concatenate([others, every]), value, -outside)

    def _critical(self, x: Floats, count: Floats) -> list[Constraint]:
        """Targets that are seen just often enough belong to choices that may lose so much each.

        ``u_j >= k_j + 1 - count_j`` marks such targets. Each is lost with any of its k_j choices,
        and no choice may lose more than (1 - keep) of all weight.
        """
        asked = (self.need > 0) & (self.weight > 0)
        these = np.flatnonzero(asked & (count < self.need + 1 - 1e-9))
        by_target, need = self.by_target, self.need.astype(np.float64)
        lost = _gain(by_target.indptr, by_target.indices, these, self.weight, self.choices)
        times = self.weight * need
        seen = _gain(by_target.indptr, by_target.indices, these, times, self.choices)
        low = float((times[these] * (need[these] + 1)).sum())
        value = seen + np.minimum(lost, self.loss)
        if value @ x > low - _VIOLATION * max(1.0, low):
            return []
        choices = np.flatnonzero(value).astype(np.int32)
        return [Constraint(choices, value[choices], low)]

    def forbids(self, chosen: Ints) -> list[Constraint]:
        """Cuts of whole choices that see every target but lose too much when one fails.

        What choice i alone keeps seen often enough must be seen by others that are not taken.
        """
        deployment = self.deployment
        if not (deployment.complete and deployment.keep):
            return []
        count = np.asarray(self.by_choice[chosen].sum(axis=0, dtype=np.int64)).ravel()
        critical = (count == self.need) & (self.weight > 0)
        cuts = []
        for choice in chosen:
            seen = self._seen(choice)
            these = seen[critical[seen]]
            short = self.weight[these].sum() - self.loss
            if short <= 1e-9 * max(1.0, deployment.total):
                continue
            gain = _gain(
                self.by_target.indptr,
                self.by_target.indices,
                these.astype(np.int64),
                self.weight,
                self.choices,
            )
            gain[chosen] = 0.0
            value = np.minimum(gain, short)
            value[choice] = -short
            choices = np.flatnonzero(value).astype(np.int32)
            cuts.append(Constraint(choices, value[choices], 0.0))
        return cuts

    def _seen(self, choice: int) -> Ints32:
        """Targets that a choice sees."""
        start = self.by_choice.indptr
        return self.by_choice.indices[start[choice] : start[choice + 1]]


@compiled()
def _count(start, index, x, targets):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    total = np.zeros(targets)
    for i in range(len(x)):
        if x[i] > 1e-12:
            for p in range(start[i], start[i + 1]):
                total[index[p]] += x[i]
    return total


@compiled()
def _gain(start, index, targets, amount, choices):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    gain = np.zeros(choices)
    for t in targets:
        for p in range(start[t], start[t + 1]):
            gain[index[p]] += amount[t]
    return gain
