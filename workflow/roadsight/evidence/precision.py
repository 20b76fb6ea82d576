"""What single precision costs in accuracy at coordinates of the world and near a local origin."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats
from roadsight.scene.pavement.normals import nearest_neighbours, upward_normals


def stored(native: Floats, origin: ArrayLike, single: bool) -> Floats:
    """Native coordinates (n, 3) as they come back from storage, less the local origin.

    Parameters
    ----------
    origin : subtracted before storage; zeros store coordinates of the world. single : as float32.
    """
    kept = native - np.asarray(origin, np.float64)
    return kept.astype(np.float32).astype(np.float64) if single else kept


def largest_error_m(native: Floats, origin: ArrayLike, single: bool) -> float:
    """Largest distance between a point and what is stored of it, in the unit of the points."""
    back = stored(native, origin, single) + np.asarray(origin, np.float64)
    return float(np.sqrt(((back - native) ** 2).sum(axis=1)).max())


def normals_of(xyz_m: Floats, neighbours: int) -> Floats:
    """Upward normals (n, 3) of points; NaN where a neighbourhood is no plane."""
    _, index = nearest_neighbours(xyz_m, neighbours)
    return upward_normals(xyz_m, index)[0]


def normal_error_deg(found: Floats, exact: Floats) -> float:
    """95th percentile of the angle between normals (n, 3); a lost normal is 90 degrees off."""
    cosine = np.clip(np.abs((exact * found).sum(axis=1)), 0.0, 1.0)
    return float(np.percentile(np.degrees(np.arccos(np.nan_to_num(cosine))), 95))
