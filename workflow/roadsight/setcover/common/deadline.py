"""Limits of a computation: by the clock, or by the work done."""

from __future__ import annotations

import time

_MANY = 2**31 - 1
"""Most steps that are allowed at once: the largest limit that solvers take as 32-bit integer."""


class Deadline:
    """End of the time allowed, from now on, by the clock."""

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
    """

    def __init__(self, seconds: float, payer: WorkLimit | None = None) -> None:
        self._left, self._payer = seconds, payer
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
        return WorkLimit(self.left_s() / parts, self)
