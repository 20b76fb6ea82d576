"""Good covers quickly: greedy start, then local search with weights on hard targets."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Bools, Ints
from roadsight.setcover.common.deadline import Deadline
from roadsight.setcover.common.problem import Instance
from roadsight.setcover.common.reductions import arrays
from roadsight.setcover.cover.exchanges import exchange, fill

FIRST_STEPS = 2_000
"""Steps of a search where the bound leaves one choice to spare at most."""
_SPARE_STEPS = 4_000
"""Steps more for each further choice that the bound leaves."""
MOST_SPARE = 50
"""Choices that the bound leaves beyond this make a search no longer."""
_CHUNK = 2_000
"""Steps between two looks at the limit."""
_NEW_TARGETS = 50
"""Most open targets that join at once, unless the share below is more."""
_NEW_SHARE = 1 / 50
"""Most open targets that join at once, as a share of all: the fewer join, the more trials a long
road takes before all that matter are in."""
_STEP_S = 1e-6
"""Fixed work of a step, in seconds, measured."""
_ENTRY_S = 1.2e-9
"""Work by entry of the matrix that a step reads, in seconds, measured."""


def greedy_cover(instance: Instance) -> Bools | None:
    """Choices by weight gained per cost, without the superfluous ones; None if it got stuck."""
    inside = np.zeros(instance.shape[0], bool)
    done = fill(*arrays(instance), instance.cost, instance.need, instance.group, inside)
    return inside if done else None


class LocalSearch:
    """Search for cheaper covers that can go on where it stopped.

    It looks at some targets only; others join once a trial leaves them open.

    Parameters
    ----------
    best : (m,) a cover, or None.
    first : (n,) targets to look at first.

    Attributes
    ----------
    active : (n,) targets that it looks at.
    """

    def __init__(
        self,
        instance: Instance,
        best: Bools | None,
        first: Bools,
        rng: np.random.Generator,
    ) -> None:
        self.instance, self.best, self._rng = instance, best, rng
        self.active = first.copy()
        self._trial = np.zeros(instance.shape[0], bool) if best is None else best
        self._weight = np.ones(instance.shape[1], np.int64)

    @property
    def cost(self) -> float:
        """Cost of the best cover so far, in steps."""
        return np.inf if self.best is None else float(self.instance.cost[self.best].sum())

    def run(self, steps: int, bound: float, deadline: Deadline) -> None:
        """Search for a number of steps, or until the cost is down to a proven ``bound``."""
        while steps > 0:
            steps = self.improve(steps, bound, deadline)

    def improve(
        self, steps: int, bound: float, deadline: Deadline, scope: Bools | None = None
    ) -> int:
        """Search for a cheaper cover; steps left once there is one, 0 where none is sought.

        ``scope`` (m,): choices that may be taken, the best cover's among them; None: all.
        """
        before = self.cost
        choices = np.ones(self.instance.shape[0], bool) if scope is None else scope
        self._trial = self._trial & choices
        while steps > 0 and self.instance.round_up(bound) < before:
            part = self.instance.select(choices, self.active)
            grown = False
            while steps > 0 and not grown:
                if deadline.passed():
                    return 0
                used, grown = self._chunk(part, choices, min(steps, _CHUNK), deadline)
                steps -= used
                if self.cost < before:
                    return steps
        return 0

    def _chunk(
        self, part: Instance, choices: Bools, steps: int, deadline: Deadline
    ) -> tuple[int, bool]:
        """Steps used (a target that joins counts as one), and whether targets joined."""
        weight = self._weight[self.active]
        goal = self.instance.goal(self.cost)
        members, found, used, entries = exchange(
            *arrays(part),
            part.cost,
            part.need,
            part.group,
            self._trial[choices],
            goal,
            steps,
            weight,
            self._rng,
        )
        self._trial = np.zeros(len(choices), bool)
        self._trial[choices] = members
        self._weight[self.active] = weight
        deadline.spend(used * _STEP_S + entries * _ENTRY_S)
        if not found:
            return used, False
        before = self.active.sum()
        complete = self.accept(self._trial)
        return used + int(self.active.sum() - before), not complete

    def accept(self, trial: Bools) -> bool:
        """Whether a cheap trial covers everything: then it is the best, else targets join."""
        missing = self._missing(trial)
        self._trial = trial.copy()
        # Costs that the search has added up along its way are rounded: they are added anew.
        if not len(missing) and float(self.instance.cost[trial].sum()) < self.cost:
            self.best = trial.copy()
        self.active[missing] = True
        return not len(missing)

    def _missing(self, trial: Bools) -> Ints:
        """Some of the targets that a trial leaves open, from all over the road."""
        taken = self.instance.by_choice[np.flatnonzero(trial)]
        seen = np.bincount(taken.indices, minlength=taken.shape[1])
        missing = np.flatnonzero(seen < self.instance.need)
        most = max(_NEW_TARGETS, round(_NEW_SHARE * len(seen)))
        if len(missing) <= most:
            return missing
        return missing[np.linspace(0, len(missing) - 1, most).astype(np.int64)]


def search_while_it_pays(
    local: LocalSearch,
    bound: float,
    deadline: Deadline,
    apart: float = 0.0,
    most_spare: int = MOST_SPARE,
) -> None:
    """Search the longer, the more choices the bound leaves, and again after each find.

    Parameters
    ----------
    apart : it pays while a cheaper cover may cost more than so many mean costs above the bound.
    most_spare : so many of the choices that the bound leaves make it longer at most.
    """
    instance = local.instance
    enough = instance.round_up(bound)
    while instance.goal(local.cost) - bound > apart * instance.cost.mean():
        spare = 1.0
        if local.best is not None:
            spare = local.best.sum() * (local.cost - enough) / local.cost
        before = local.cost
        more = int(np.clip(spare, 1, most_spare)) - 1
        local.improve(FIRST_STEPS + _SPARE_STEPS * more, enough, deadline)
        if not local.cost < before:
            return
