"""Types of the arrays that all rooms pass on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""Measures and coordinates."""
Floats32 = NDArray[np.float32]
"""The same where memory counts: near a local origin only."""
Ints = NDArray[np.int64]
"""Numbers of things, counts."""
Ints32 = NDArray[np.int32]
"""The same as solvers and kernels take them."""
Bools = NDArray[np.bool_]
"""Masks."""
Bytes = NDArray[np.uint8]
"""Classes and pixels."""
Numbers = NDArray[Any]
"""Any of them."""

__all__ = ["Bools", "Bytes", "Floats", "Floats32", "Ints", "Ints32", "Numbers"]
