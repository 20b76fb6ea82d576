"""How many points, or pixels, a plan's sensors together have of targets, by height."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bools, Floats

BANDS = 4
"""Targets are cut into so many equal parts of their height."""


def heights_of_plan(
    on_targets: dict[str, Floats], seen: Bools, height_m: float
) -> list[dict[str, Any]]:
    """Bands of height, the lowest first, for what each kind of sensor measures.

    Parameters
    ----------
    on_targets : by unit, (targets, bands) of all sensors together. seen : (targets,) by the plan;
        only these count. height_m : of every target.

    Returns
    -------
    unit, and bands: from_m and to_m above the foot, mean and median of the targets, and share_none
    of them that have less than one point there
    """
    if not seen.any():
        return []
    return [
        {"unit": unit, "bands": [_band(k, part[seen], height_m) for k in range(part.shape[1])]}
        for unit, part in on_targets.items()
    ]


def _band(number: int, part: Floats, height_m: float) -> dict[str, float]:
    count, here = part.shape[1], part[:, number]
    return {
        "from_m": height_m * number / count,
        "to_m": height_m * (number + 1) / count,
        "mean": float(here.mean()),
        "median": float(np.median(here)),
        "share_none": float((here < 1).mean()),
    }


def height_columns(on_targets: dict[str, Floats]) -> pd.DataFrame:
    """Columns ``points_1`` (lowest) and so on of each target, rounded to a tenth."""
    return pd.DataFrame(
        {
            f"{unit}_{band + 1}": part[:, band].round(1)
            for unit, part in on_targets.items()
            for band in range(part.shape[1])
        }
    )
