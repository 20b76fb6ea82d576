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
    known : why ours does not hold the bound yet, a known failure; "" where it does.
    """

    name: str
    stage: str
    hazard: str
    bound: float
    unit: str
    run: Run
    known: str = ""


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


def hard_case(stage: str, *, bound: float, unit: str, known: str = "") -> Callable[[Run], HardCase]:
    """Decorator that makes a case of a function: its name and the sentence of its docstring."""

    def make(run: Run) -> HardCase:
        hazard = " ".join((run.__doc__ or "").split())
        return HardCase(run.__name__, stage, hazard, bound, unit, run, known)

    return make


def cases_of(module: ModuleType) -> list[HardCase]:
    """Cases of a module in the order of its text."""
    return [value for value in vars(module).values() if isinstance(value, HardCase)]


def measure(case: HardCase, seed: int) -> CaseResult:
    """Run a case both ways; its randomness depends on the seed and its name alone.

    An error that is NaN is infinite, for either way. Where the truth says that there is no answer,
    the case itself counts a withheld one as no error.

    Raises
    ------
    ValueError : an error is negative.
    """
    rng = np.random.default_rng([seed, zlib.crc32(case.name.encode())])
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        errors = case.run(rng)
    naive, ours = (float(error) for error in errors)
    if min(naive, ours) < 0:
        raise ValueError(f"{case.name}: errors {naive}, {ours} are no sizes")
    return CaseResult(case, *(math.inf if math.isnan(error) else error for error in (naive, ours)))


def fails(
    function: Callable[..., object], *arguments: Any, expected: tuple[type[Exception], ...] = ()
) -> float:
    """1 if a call breaks down by an exception that is not one of ``expected``, else 0."""
    try:
        function(*arguments)
    except expected:
        return 0.0
    except Exception:
        return 1.0
    return 0.0
