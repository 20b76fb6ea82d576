"""How kernels are compiled: with no more than their callers need, and kept between runs.

Numba makes two wrappers around each function, one that Python calls and one that C calls. With
tuples of arrays among the arguments, the wrappers are larger than the function: without them the
kernels of a cover compile in two thirds of the time. And it compiles a function that other kernels
call anew for each constant that they hand to it, which is no faster to run.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

from numba import njit, types

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[_Function], _Function]:
    """Decorator of a compiled function that Python calls; ``options`` are Numba's."""
    # The type stubs of Numba do not list all options.
    compiler: Any = njit(cache=True, no_cfunc_wrapper=True, **options)  # type: ignore[call-overload]

    def decorate(function: _Function) -> _Function:
        kernel = compiler(function)
        kernel.get_call_template = partial(_template_of_numbers, kernel)
        return kernel

    return decorate


def compiled_part(**options: Any) -> Callable[[_Function], _Function]:
    """The same of one that kernels alone call: a call from Python would end the process."""
    return compiled(no_cpython_wrapper=True, **options)


def _template_of_numbers(kernel: Any, args: Any, kws: Any) -> Any:
    """What a call from another kernel compiles: for any number where that hands on a constant."""
    named = {name: types.unliteral(kind) for name, kind in dict(kws).items()}
    return type(kernel).get_call_template(kernel, tuple(map(types.unliteral, args)), named)
