"""Decorators of the small functions that a ray runs through.

They allocate nothing, so counting references to their arrays (which costs more than the arithmetic)
is off; they are inlined into the loops that call them.
"""

from __future__ import annotations

from roadsight.base.kernels import compiled, compiled_part

_OPTIONS = {"error_model": "numpy", "forceinline": True, "_nrt": False}
kernel = compiled_part(**_OPTIONS)
compiled_kernel = compiled(**_OPTIONS)  # The same of what Python calls as well.
