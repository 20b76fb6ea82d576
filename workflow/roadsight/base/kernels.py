"""How kernels are compiled: with no more than their callers need, and kept between runs.

Numba makes two wrappers around each function, one that Python calls and one that C calls. With
tuples of arrays among the arguments, the wrappers are larger than the function: without them the
kernels of a cover compile in two thirds of the time. What stands for NumPy's functions in a kernel
(`np.empty`, `np.take`) has the second of them too, which nothing calls: kernels compile in 5 % less
time without it. And Numba compiles a function that other kernels call anew for each constant that
they hand to it, which is no faster to run.

What NumPy does in one line may compile dearly in a kernel: setting an array or a tuple into a slice
takes 1.5 CPU s, for the message about shapes that differ (a number is cheap), `np.unique` and
`np.median` take 1 s, `np.cumsum` and `np.arange` 0.15 s, in each step that compiles one. Loops take
a tenth of that.

Steps that run beside each other use the same kernels: the first of them compiles one, the others
wait and take it from the disk.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from numba import njit, types
from numba.core import extending
from numba.core.compiler_lock import global_compiler_lock

try:
    import fcntl
except ImportError:  # on Windows each process compiles for itself
    fcntl = None  # type: ignore[assignment]

# A process that has waited longer in all, for one that was halted say, compiles for itself. All the
# kernels of a step compile in less.
_LONGEST_WAIT_S = 120.0
_POLL_S = 0.05
_waited_s = [0.0]  # how long this process has waited
# Before Numba declares its stand-ins, which it does when it first compiles. The name is its own, so
# that another version may lack it and compiles a little longer.
getattr(extending, "_overload_default_jit_options", {})["no_cfunc_wrapper"] = True
_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[_Function], _Function]:
    """Decorator of a compiled function that Python calls; ``options`` are Numba's."""
    # The type stubs of Numba do not list all options.
    compiler: Any = njit(cache=True, no_cfunc_wrapper=True, **options)  # type: ignore[call-overload]

    def decorate(function: _Function) -> _Function:
        kernel = compiler(function)
        kernel.get_call_template = partial(_template_of_numbers, kernel)
        kernel.compile = partial(_compile_once, kernel)
        return kernel

    return decorate


def compiled_part(**options: Any) -> Callable[[_Function], _Function]:
    """The same of one that kernels alone call: a call from Python would end the process."""
    return compiled(no_cpython_wrapper=True, **options)


def _template_of_numbers(kernel: Any, args: Any, kws: Any) -> Any:
    """What a call from another kernel compiles: for any number where that hands on a constant."""
    named = {name: types.unliteral(kind) for name, kind in dict(kws).items()}
    return type(kernel).get_call_template(kernel, tuple(map(types.unliteral, args)), named)


def _compile_once(kernel: Any, signature: Any) -> Any:
    """Compile for types of arguments, or take what another process compiled meanwhile.

    Kernels lock in the order of their calls, which has no circle. Numba's own lock comes first, or
    two threads could wait for each other.
    """
    with global_compiler_lock, _alone(kernel):
        return type(kernel).compile(kernel, signature)


@contextmanager
def _alone(kernel: Any) -> Iterator[None]:
    """Keep other processes from compiling the same kernel; where no file can be locked, do not."""
    try:
        folder = Path(kernel._cache.cache_path)
        folder.mkdir(parents=True, exist_ok=True)
        stream = (folder / f"{kernel.__module__}.{kernel.__qualname__}.lock").open("ab")
    except OSError:
        yield
        return
    with stream:
        while not _locks(stream) and _waited_s[0] < _LONGEST_WAIT_S:
            time.sleep(_POLL_S)
            _waited_s[0] += _POLL_S
        yield


def _locks(stream: BinaryIO) -> bool:
    """Whether a file is locked now, or never will be."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # some network folders know no locks
        return True
    return True
