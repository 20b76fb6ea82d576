"""Types that all rooms pass on: arrays, and names of files."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]  # measures and coordinates
Floats32 = NDArray[np.float32]  # the same where memory counts: near a local origin only
Ints = NDArray[np.int64]  # numbers of things, counts
Ints32 = NDArray[np.int32]  # the same as solvers and kernels take them
Bools = NDArray[np.bool_]  # masks
Bytes = NDArray[np.uint8]  # classes and pixels
Numbers = NDArray[Any]  # any of them
AnyPath = str | os.PathLike[str]  # a file or folder
