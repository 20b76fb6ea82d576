"""Where the cloud shows an edge near a click: a step in height, or a change of brightness."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from roadsight.base.arrays import Floats, Floats32

REACH_M = 1.0
"""Edges further from the click are not looked for."""
_MARGIN_M = 0.6
"""Points are taken from so far beyond the reach, so that slopes at its rim are right."""
_CELL_M = 0.1
"""Cells that height and brightness are averaged over."""
_BLUR_CELLS = 1.0
"""Standard deviation of the blur, which bridges cells without points."""
_STEP_M_PER_M = 0.12
"""Steepness that counts as much as `_BRIGHT_PER_M`: 12 mm of height in a cell."""
_BRIGHT_PER_M = 1.6
"""Change of brightness a metre, as a share of its spread: a sixth of it in a cell."""
_GROUND_M = 0.6
"""Points higher above the lowest tenth are left out: cars, plants, poles."""
_FEWEST = 60
"""With fewer points around the click there is no edge to tell."""
_LEAST_SCORE = 1.0
"""Edges no steeper than the two steepnesses above do not stand out."""


def snap_to_cloud(
    xyz_m: Floats32, intensity: NDArray, xy_m: tuple[float, float]
) -> tuple[float, float] | None:
    """Place of the strongest edge within `REACH_M` of a click; None where nothing stands out.

    Height and brightness of the points near the ground are averaged over cells. An edge is where
    either changes fast; near ones win over equal ones further off.

    Parameters
    ----------
    xyz_m : (n, 3) points around the click, local metres. intensity : (n,) any unit.
    """
    half = REACH_M + _MARGIN_M
    offset = xyz_m[:, :2].astype(np.float64) - xy_m
    inside = (np.abs(offset) < half).all(axis=1)
    if inside.sum() < _FEWEST:
        return None
    z = xyz_m[inside, 2].astype(np.float64)
    low = z < np.percentile(z, 10) + _GROUND_M
    offset, z, light = offset[inside][low], z[low], intensity[inside][low].astype(np.float64)
    score = np.hypot(
        _slope(offset, z - z.mean(), half) / _STEP_M_PER_M,
        _slope(offset, _standard(light), half) / _BRIGHT_PER_M,
    )
    middle = (np.arange(score.shape[0]) + 0.5) * _CELL_M - half
    x, y = np.meshgrid(middle, middle, indexing="ij")
    away = np.hypot(x, y)
    weighed = np.where(away <= REACH_M, score * np.exp(-((away / REACH_M) ** 2)), 0.0)
    best = np.unravel_index(np.argmax(weighed), weighed.shape)
    if not score[best] > _LEAST_SCORE or weighed[best] == 0.0:
        return None
    near = np.hypot(x - x[best], y - y[best]) < 2.5 * _CELL_M
    share = np.where(near, score**2, 0.0) / np.where(near, score**2, 0.0).sum()
    return float(xy_m[0] + (share * x).sum()), float(xy_m[1] + (share * y).sum())


def _standard(values: Floats) -> Floats:
    """Values by their spread between dark and bright; zero where they hardly differ."""
    low, high = np.percentile(values, [5, 95])
    spread = max(high - low, 0.1 * abs(high), 1e-9)
    return np.clip((values - low) / spread, 0.0, 1.0)


def _slope(offset_m: Floats, values: Floats, half_m: float) -> Floats:
    """Steepness (cells, cells), per metre, of values blurred over cells; gaps are bridged."""
    cells = int(np.ceil(2 * half_m / _CELL_M))
    index = np.clip(((offset_m + half_m) / _CELL_M).astype(int), 0, cells - 1)
    flat = index[:, 0] * cells + index[:, 1]
    count = np.bincount(flat, minlength=cells**2).reshape(cells, cells).astype(np.float64)
    total = np.bincount(flat, values, cells**2).reshape(cells, cells)
    weight = gaussian_filter(count, _BLUR_CELLS)
    known = weight > 0.05
    mean = np.where(
        known, gaussian_filter(total, _BLUR_CELLS) / np.where(known, weight, 1.0), np.nan
    )
    along, across = np.gradient(mean, _CELL_M)
    return np.nan_to_num(np.hypot(along, across))
