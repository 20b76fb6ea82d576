"""How kernels are compiled: with no more than their callers need, and kept between runs.

Numba makes two wrappers around each function, one that Python calls and one that C calls. With
tuples of arrays among the arguments, the wrappers are larger than the function: without them the
kernels of a cover compile in two thirds of the time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[_Function], _Function]:
    """Decorator of a compiled function that Python calls; ``options`` are Numba's."""
    # The type stubs of Numba do not list all options.
    return njit(cache=True, no_cfunc_wrapper=True, **options)  # type: ignore[call-overload]


def compiled_part(**options: Any) -> Callable[[_Function], _Function]:
    """The same of one that kernels alone call: a call from Python would end the process."""
    return compiled(no_cpython_wrapper=True, **options)
