"""Wall-clock limit of a computation."""

from __future__ import annotations

import time


class Deadline:
    """End of the time allowed, from now on."""

    def __init__(self, seconds: float | None) -> None:
        self._end = None if seconds is None else time.perf_counter() + seconds

    def left_s(self) -> float:
        """Seconds left, infinite without a limit, never negative."""
        return float("inf") if self._end is None else max(self._end - time.perf_counter(), 0.0)

    def passed(self) -> bool:
        """Whether no time is left."""
        return self.left_s() <= 0.0
