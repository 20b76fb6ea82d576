"""Decorator of the small functions that a ray runs through.

They allocate nothing, so counting references to their arrays (which costs more than the arithmetic)
is off; they are inlined into the loops that call them.
"""

from __future__ import annotations

from numba import njit

# Numba's type stubs do not list the option.
kernel = njit(cache=True, error_model="numpy", forceinline=True, _nrt=False)  # type: ignore[call-overload]
