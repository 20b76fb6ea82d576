"""What networks that refine depth maps, and their training, agree on (paper 1, Table 1)."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Floats32

STEP_DEG = 0.1
"""Cells of the fine grid, both ways."""
MULTIPLE_CELLS = 8
"""Both sides of what a network sees are multiples of this."""


def normalised(depth_m: Floats32) -> tuple[Floats32, float, float]:
    """A map brought to 0 to 1, and its least and greatest range, m.

    Cells without return count as range 0, and so become 0. A map of one value everywhere has no
    contrast to stretch and is all 0.
    """
    low, high = float(depth_m.min(initial=np.inf)), float(depth_m.max(initial=0.0))
    if not high > low:
        return np.zeros_like(depth_m), high, high
    return ((depth_m - np.float32(low)) / np.float32(high - low)).astype(np.float32), low, high
