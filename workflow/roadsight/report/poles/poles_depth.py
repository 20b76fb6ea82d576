"""How an image's relative depth becomes metres, and what it is worth (paper 2, Figure 9)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Ints
from roadsight.poles.sightings.metric_depth import HeightAt, balancing_weights, fit_metric_depth
from roadsight.poles.sightings.sighting_bearing import ViewCamera
from roadsight.poles.sightings.sighting_depth import road_points, sample_depth

_MOST_SAMPLES = 400
"""Points of the plot of a fit; more would only cover each other."""
_SOURCES = ("network", "ground", "lidar")


def depth_fit(
    image: str,
    camera: ViewCamera,
    mask: Bytes,
    depth: NDArray[np.uint16],
    height_at: HeightAt,
) -> dict[str, Any] | None:
    """Relative depth of the road against its LiDAR distance, with the fitted curve.

    Parameters
    ----------
    mask : project classes. depth : relative inverse depth, 0 = unknown. height_at : the terrain.

    Returns
    -------
    samples (distance along the optical axis and relative depth) and coefficients; None if the
    image allows no fit
    """
    uv, z = road_points(camera, mask, height_at)
    relative = sample_depth(depth, uv, mask.shape)
    known = np.isfinite(relative)
    z, relative = z[known], relative[known]
    fit = fit_metric_depth(relative, z, balancing_weights(z))
    if fit.reason:
        return None
    order = np.argsort(z, kind="stable")
    kept = order[np.unique(np.linspace(0, len(z) - 1, _MOST_SAMPLES).astype(int))]
    return {
        "image": image,
        "distance_m": z[kept].round(3).tolist(),
        "relative": relative[kept].round(5).tolist(),
        **{key: float(getattr(fit, key)) for key in ("c1", "c2", "sigma_d", "near_m", "far_m")},
        "points": int(fit.points),
    }


def depth_checks(sightings: pd.DataFrame, owner: Ints, poles: pd.DataFrame) -> dict[str, Any]:
    """Distance to the located pole and what each single source said, for sightings of poles.

    Parameters
    ----------
    owner : (n,) row of the pole of each sighting, -1 if none.
    """
    rows = np.flatnonzero(owner >= 0)
    apart = (
        poles[["x", "y"]].to_numpy(np.float64)[owner[rows]]
        - sightings[["x", "y"]].to_numpy(np.float64)[rows]
    )
    distance = np.hypot(apart[:, 0], apart[:, 1])
    checks = {}
    for source in _SOURCES:
        column = f"depth_{source}_m"
        if column not in sightings:
            continue
        said = sightings[column].to_numpy(np.float64)[rows]
        known = np.isfinite(said)
        if known.any():
            checks[source] = {
                "pole_m": distance[known].round(2).tolist(),
                "said_m": said[known].round(2).tolist(),
            }
    return checks
