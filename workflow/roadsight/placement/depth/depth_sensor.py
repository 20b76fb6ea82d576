"""Sensors of training pairs (paper 1, section 2.4 and Table 1)."""

from __future__ import annotations

import numpy as np

from roadsight.placement.depth.normalising import STEP_DEG
from roadsight.placement.depth.unet import grid_sensor
from roadsight.placement.sensors.sensors import Sensor

ROWS = 500
"""Rows of the paper's maps: -25 to 25 degrees (Table 1)."""
RANGES_M = tuple(range(50, 201, 10))
"""Ranges of the paper's pairs (Table 1)."""
HEIGHTS_M = (4.0, 20.0)
"""Heights of the paper's sensors above the ground."""


def training_sensor(rng: np.random.Generator, span_deg: float) -> Sensor:
    """Sensor of Table 1 with a random range that looks ``span_deg`` wide in a random direction."""
    # On the lattice of the fine grid, and with the seam at 180 degrees never inside.
    first = STEP_DEG * int(rng.integers(-1800, 1800 - round(span_deg / STEP_DEG) + 1))
    range_m = float(rng.choice(RANGES_M))
    return grid_sensor((first, first + span_deg), (-ROWS // 2, ROWS // 2), range_m)
