"""Depth networks by camera: their distances held against those where feet meet the ground.

A network that sees another lens than it learned from errs alike on the whole drive, while its fit
to each image's road says that all is well. Feet that stand on the terrain tell by how much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from roadsight.poles.sightings.metric_depth import TO_SIGMA, fuse_depths

_FEWEST = 12
"""Objects with both distances from which a camera's scale is found."""
_SURE = 3.0
"""Standard errors by which a scale must differ from 1."""
_KINDS = ("network", "ground", "lidar")
"""Ways to a distance, in the order in which `COLUMNS` has them."""
COLUMNS = tuple(f"{part}depth_{kind}_m" for kind in _KINDS for part in ("", "sigma_"))
"""Distance and sigma of each way."""


@dataclass(frozen=True)
class NetworkScale:
    """How a network's distances in one camera compare with the ground's.

    Parameters
    ----------
    route, view : of the camera. ratio : network over ground, median. sigma : of one logarithm of
        the ratio. pairs : objects that have both.
    """

    route: str
    view: str
    ratio: float
    sigma: float
    pairs: int


def network_scales(sightings: pd.DataFrame) -> list[NetworkScale]:
    """Cameras whose network is surely off, in order of route and view.

    Parameters
    ----------
    sightings : a row for each object, kept or not: route, view and `COLUMNS`.
    """
    found = []
    for (route, view), part in sightings.groupby(["route", "view"], sort=True, observed=True):
        pairs = part[["depth_network_m", "depth_ground_m"]].to_numpy(np.float64)
        network_m, ground_m = pairs[(pairs > 0).all(axis=1)].T
        logs = np.log(network_m / ground_m)
        if len(logs) < _FEWEST:
            continue
        middle = float(np.median(logs))
        sigma = TO_SIGMA * float(np.median(np.abs(logs - middle)))
        # A median errs by a quarter more than a mean does.
        if abs(middle) > _SURE * 1.25 * sigma / np.sqrt(len(logs)):
            ratio = float(np.exp(middle))
            found.append(NetworkScale(str(route), str(view), ratio, sigma, len(logs)))
    return found


def with_scales(sightings: pd.DataFrame, scales: list[NetworkScale]) -> pd.DataFrame:
    """Sightings with the network's distances over their camera's scale, all distances fused anew.

    A scaled distance is not surer than the scatter of its camera's ratios.
    """
    if not scales:
        return sightings
    table = sightings.copy()
    network_m = table["depth_network_m"].to_numpy(np.float64).copy()
    sigma_m = table["sigma_depth_network_m"].to_numpy(np.float64).copy()
    touched = np.zeros(len(table), bool)
    for scale in scales:
        rows = ((table["route"] == scale.route) & (table["view"] == scale.view)).to_numpy()
        network_m[rows] /= scale.ratio
        sigma_m[rows] = np.fmax(sigma_m[rows] / scale.ratio, scale.sigma * network_m[rows])
        touched |= rows
    table["depth_network_m"], table["sigma_depth_network_m"] = network_m, sigma_m
    ways = table[list(COLUMNS)].to_numpy(np.float64)
    depth_m, depth_sigma_m = (
        table[name].to_numpy(np.float64).copy() for name in ("depth_m", "sigma_depth_m")
    )
    sources = table["depth_from"].to_numpy(object).copy()
    # Of a sighting that ends at a column nothing else tells the distance.
    free = ~np.isfinite(table["depth_lidar_m"].to_numpy(np.float64))
    for row in np.flatnonzero(touched & free & np.isfinite(network_m)):
        depth_m[row], depth_sigma_m[row], used = fuse_depths(ways[row, ::2], ways[row, 1::2])
        sources[row] = "+".join(kind for kind, one in zip(_KINDS, used, strict=True) if one)
    return table.assign(depth_m=depth_m, sigma_depth_m=depth_sigma_m, depth_from=sources)
