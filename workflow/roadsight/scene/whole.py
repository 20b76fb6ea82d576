"""The scene of a cloud that is in memory as a whole: what the stages do tile by tile.

For verbs, notebooks and checks on real data, which take one cloud and keep its order.
"""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Bools, Floats
from roadsight.scene.profile import count_cells, density
from roadsight.scene.spacing import plan_spacing_m
from roadsight.scene.terrain.ground import GroundSettings, ground_settings_for
from roadsight.scene.terrain.terrain import label_ground


def spacing_of(xyz_m: Floats) -> float:
    """Spacing of evenly spread points of the cloud's median density."""
    cells = count_cells(xyz_m, np.zeros(len(xyz_m), np.uint8))
    return plan_spacing_m(density(cells.column, cells.row, cells.count)["median"])


def ground_of(xyz_m: Floats, settings: GroundSettings | None = None) -> Bools:
    """Ground labels (n,) of a cloud, in its order.

    Parameters
    ----------
    xyz_m : (n, 3) local metres.
    """
    settings = ground_settings_for(spacing_of(xyz_m), settings or GroundSettings())
    west, south = xyz_m[:, :2].min(axis=0)
    east, north = xyz_m[:, :2].max(axis=0) + 1e-3
    bounds = (float(west), float(south), float(east), float(north))
    # One tile that holds everything, so that labels keep the cloud's order.
    _, mask = next(label_ground(lambda halo: iter([(bounds, xyz_m)]), bounds, settings))
    return mask
