"""Reflectivity of surfaces from the cloud's intensities."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from roadsight.base.arrays import Floats

# Reflectance of weathered asphalt near 900 nm (ECOSTRESS library, Meerdink et al. 2019).
ASPHALT = 0.17
# Voxels whose intensities are averaged: single returns scatter, and surfaces are larger.
_VOXEL_M = 0.5


def voxel_means(xyz_m: NDArray[np.floating], intensity: NDArray[np.uint16]) -> pd.DataFrame:
    """Middle x, y, z and mean intensity of each occupied voxel of half a metre, float32.

    Parameters
    ----------
    xyz_m : (n, 3) local metres. intensity : (n,).
    """
    places = np.floor(xyz_m.astype(np.float64) / _VOXEL_M).astype(np.int64)
    names, of, count = np.unique(places, axis=0, return_inverse=True, return_counts=True)
    mean = np.bincount(of.reshape(-1), intensity, len(names)) / count
    table = pd.DataFrame((names + 0.5) * _VOXEL_M, columns=["x", "y", "z"])
    return table.assign(intensity=mean).astype(np.float32)


def reflectivity_of(intensity: NDArray[np.floating], on_pavement: NDArray[np.floating]) -> Floats:
    """Reflectivity (n,) of places from their intensities, 0 to 1.

    Intensities are taken as proportional to reflectivity, with the pavement's median as that of
    asphalt. Without intensities every surface is taken as asphalt.

    Parameters
    ----------
    intensity : (n,) of places. on_pavement : (m,) of those on the pavement.
    """
    level = float(np.median(on_pavement)) if len(on_pavement) else 0.0
    if level == 0:
        return np.full(len(intensity), ASPHALT)
    return np.clip(np.asarray(intensity, np.float64) / level * ASPHALT, 0.0, 1.0)
