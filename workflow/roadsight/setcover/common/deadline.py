"""Limits of a computation: by the clock, or by the work done."""

from __future__ import annotations

import time
from collections.abc import Hashable
from dataclasses import dataclass

from roadsight.setcover.common.problem import OWN

# Work without a move that is always borne: with 5 s a plan of six sensors on a real street stayed
# unproven, with this it is proven. Bounds of hard plans (16 and 32 channels along 250 m of highway)
# move after 1, 2, 8 and 35 s of work, about four times later each time.
_LEAST_PATIENCE_S = 30.0
_MANY = 2**31 - 1  # most steps allowed at once: the largest limit that solvers take (32 bits)


class Deadline:
    """End of the time allowed, from now on, by the clock."""

    # A search ends where nothing has moved for so many times the work up to the last move; 0: it
    # goes on until the limit.
    patience = 0.0

    def __init__(self, seconds: float | None) -> None:
        self._start = time.perf_counter()
        self._end = None if seconds is None else self._start + seconds

    def left_s(self) -> float:
        """Seconds left, infinite without a limit, never negative."""
        return float("inf") if self._end is None else max(self._end - time.perf_counter(), 0.0)

    def spent_s(self) -> float:
        """Seconds since it began."""
        return time.perf_counter() - self._start

    def passed(self) -> bool:
        """Whether no time is left."""
        return self.left_s() <= 0.0

    def clock_left_s(self) -> float:
        """Time left by the clock, infinite where work is counted instead."""
        return self.left_s()

    def count_left(self, seconds_each: float) -> int:
        """How many steps of so much work each are left where work is counted."""
        return _MANY

    def spend(self, seconds: float) -> None:
        """Count work of about so many seconds; the clock has counted it already."""

    def part(self, parts: int) -> Deadline:
        """Limit of the next of so many parts that share what is left."""
        left = self.left_s()
        return Deadline(None if left == float("inf") else left / parts)


class WorkLimit(Deadline):
    """Limit by counted work, in seconds that it takes about: the same on any machine, any time.

    Parameters
    ----------
    seconds : work allowed. payer : limit that pays for this one's work too.
    patience : see `Deadline`.
    """

    def __init__(
        self, seconds: float, payer: WorkLimit | None = None, patience: float = 0.0
    ) -> None:
        self._left, self._payer, self.patience = seconds, payer, patience
        self._spent = 0.0

    def left_s(self) -> float:
        """Work left, never negative."""
        return max(self._left, 0.0)

    def spent_s(self) -> float:
        """Work counted so far."""
        return self._spent

    def clock_left_s(self) -> float:
        """The clock does not matter."""
        return float("inf")

    def count_left(self, seconds_each: float) -> int:
        """Steps that the work left allows, at least 1."""
        return int(min(max(self.left_s() / seconds_each, 1), _MANY))

    def spend(self, seconds: float) -> None:
        """Count work."""
        self._left -= seconds
        self._spent += seconds
        if self._payer is not None:
            self._payer.spend(seconds)

    def part(self, parts: int) -> WorkLimit:
        """Limit of the next of so many parts that share what is left."""
        return WorkLimit(self.left_s() / parts, self, self.patience)


class Patience:
    """Whether a search that begins now still moves, see `Deadline.patience`."""

    def __init__(self, deadline: Deadline) -> None:
        self._deadline, self._begun_s = deadline, deadline.spent_s()
        self._moved_s = 0.0
        self._state: Hashable = None

    def is_over(self, state: Hashable) -> bool:
        """Whether the state has not moved for longer than is borne."""
        if not self._deadline.patience:
            return False
        spent_s = self._deadline.spent_s() - self._begun_s
        if state != self._state:
            self._state, self._moved_s = state, spent_s
        borne_s = max(self._deadline.patience * self._moved_s, _LEAST_PATIENCE_S)
        return spent_s - self._moved_s > borne_s


@dataclass(frozen=True)
class Effort:
    """Work and patience for each search of a plan, see `WorkLimit`, and who searches.

    ``solver``: "own", or "highs" for HiGHS on the whole program.
    """

    seconds: float
    patience: float = 0.0
    solver: str = OWN

    def limit(self) -> WorkLimit:
        """The limit of one search."""
        return WorkLimit(self.seconds, patience=self.patience)
