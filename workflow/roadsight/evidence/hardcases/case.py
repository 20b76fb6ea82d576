"""What a hard case is, and how it is measured."""

from __future__ import annotations

import math
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any, SupportsFloat

import numpy as np

Errors = tuple[SupportsFloat, SupportsFloat]
Run = Callable[[np.random.Generator], Errors]


@dataclass(frozen=True)
class HardCase:
    """One hazard.

    Parameters
    ----------
    name : of the case. stage : the stage whose functions meet the hazard.
    hazard : what goes wrong, in one sentence. bound : greatest error that is allowed, positive.
    unit : of the errors and the bound.
    run : does the work both ways; gives the naive way's error and ours.
    """

    name: str
    stage: str
    hazard: str
    bound: float
    unit: str
    run: Run


@dataclass(frozen=True)
class CaseResult:
    """Both errors of a case; ``passed`` if ours is within the bound and the naive one is not."""

    case: HardCase
    naive_error: float
    our_error: float

    @property
    def passed(self) -> bool:
        """Whether our way holds the bound and the case is shown to be hard."""
        return self.our_error <= self.case.bound < self.naive_error


def hard_case(stage: str, *, bound: float, unit: str) -> Callable[[Run], HardCase]:
    """Decorator that makes a case of a function: its name and the sentence of its docstring."""

    def make(run: Run) -> HardCase:
        hazard = " ".join((run.__doc__ or "").split())
        return HardCase(run.__name__, stage, hazard, bound, unit, run)

    return make


def cases_of(module: ModuleType) -> list[HardCase]:
    """Cases of a module in the order of its text."""
    return [value for value in vars(module).values() if isinstance(value, HardCase)]


def measure(case: HardCase, seed: int) -> CaseResult:
    """Run a case both ways; its randomness depends on the seed and its name alone.

    Raises
    ------
    ValueError : an error is negative or not finite, so that nothing is shown.
    """
    rng = np.random.default_rng([seed, zlib.crc32(case.name.encode())])
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        errors = case.run(rng)
    naive, ours = (float(error) for error in errors)
    if not all(math.isfinite(error) and error >= 0 for error in (naive, ours)):
        raise ValueError(f"{case.name}: errors {naive}, {ours} are no sizes")
    return CaseResult(case, naive, ours)


def fails(
    function: Callable[..., object],
    *arguments: Any,
    expected: tuple[type[Exception], ...] = (),
) -> float:
    """1 if a call breaks down by an exception that is not one of ``expected``, else 0."""
    try:
        function(*arguments)
    except expected:
        return 0.0
    except Exception:
        return 1.0
    return 0.0
