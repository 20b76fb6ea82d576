"""Which function runs which levels of the schema.

A new level fails `test_every_level_has_a_run` until a run takes it: add it to the ``run_of`` line
of its field, or write a function that runs its stage and looks at the answer.
"""

from collections.abc import Callable
from dataclasses import dataclass

from tests.options.schema_levels import Level
from tests.properties.placement_job import PlacementJob
from tests.properties.poles_job import Lane, PolesJob


@dataclass(frozen=True)
class Finished:
    """Two small sites whose stages have all run: a street with a plan and a lane with poles."""

    street: PlacementJob
    poles: PolesJob
    lane: Lane


Run = Callable[[Finished, str], None]
RUNS: dict[Level, Run] = {}
OPEN: dict[Level, str] = {}
"""Levels whose run is known to fail, and why: one that is mended leaves the list."""


def run_of(path: str, *levels: str) -> Callable[[Run], Run]:
    """Decorator: the function runs these levels of a field to the end and looks at the answer."""

    def add(run: Run) -> Run:
        for level in levels:
            assert (path, level) not in RUNS, (path, level)
            RUNS[path, level] = run
        return run

    return add
