"""The scene of a cloud that is in memory as a whole: what the stages do tile by tile.

For verbs, notebooks and checks on real data, which take one cloud and keep its order.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.scene.profile import count_cells, density
from roadsight.scene.spacing import plan_spacing_m
from roadsight.scene.terrain.ground_settings import GroundSettings, ground_settings_for
from roadsight.scene.terrain.terrain import Bounds, label_ground


def spacing_of(xyz_m: Floats) -> float:
    """Spacing of evenly spread points of the cloud's median density."""
    cells = count_cells(xyz_m, np.zeros(len(xyz_m), np.uint8))
    return plan_spacing_m(density(cells.column, cells.row, cells.count)["median"])


_LARGEST_TILE_M = 500.0
"""A cloud longer or wider than this is labelled in tiles of half of it: fine pillars of more fill
gigabytes."""


def ground_of(xyz_m: Floats, settings: GroundSettings | None = None) -> Bools:
    """Ground labels (n,) of a cloud, in its order.

    Parameters
    ----------
    xyz_m : (n, 3) local metres.
    """
    settings = ground_settings_for(spacing_of(xyz_m), settings or GroundSettings())
    west, south = xyz_m[:, :2].min(axis=0)
    # Half-open tiles hold their greatest coordinates only if they end beyond.
    east, north = xyz_m[:, :2].max(axis=0) + 1e-3
    bounds = (float(west), float(south), float(east), float(north))
    widest = max(east - west, north - south)
    side_m = widest if widest <= _LARGEST_TILE_M else _LARGEST_TILE_M / 2
    parts = _parts(xyz_m, side_m)
    mask = np.zeros(len(xyz_m), bool)

    def tiles(halo_m: float) -> Iterator[tuple[Bounds, Floats]]:
        for core, own in parts:
            yield core, xyz_m[own if len(parts) == 1 else _near(xyz_m, core, halo_m)]

    # Cores are yielded in the cloud's order, as `parts` holds them.
    for (_, own), (_, found) in zip(parts, label_ground(tiles, bounds, settings), strict=True):
        mask[own] = found
    return mask


def _parts(xyz_m: Floats, side_m: float) -> list[tuple[Bounds, Ints]]:
    """Half-open square tiles with points, and the indices of each one's points."""
    west, south = xyz_m[:, :2].min(axis=0)
    tile = np.floor((xyz_m[:, :2] - (west, south)) / (side_m + 1e-3)).astype(np.int64)
    found = []
    for column, row in np.unique(tile, axis=0).tolist():
        at_x, at_y = west + column * (side_m + 1e-3), south + row * (side_m + 1e-3)
        core = (float(at_x), float(at_y), float(at_x + side_m + 1e-3), float(at_y + side_m + 1e-3))
        found.append((core, _near(xyz_m, core, 0.0)))
    return [(core, own) for core, own in found if len(own)]


def _near(xyz_m: Floats, core: Bounds, halo_m: float) -> Ints:
    """Indices of the points of a tile and its halo, in their order."""
    x, y = xyz_m[:, 0], xyz_m[:, 1]
    near = (x >= core[0] - halo_m) & (x < core[2] + halo_m)
    near &= (y >= core[1] - halo_m) & (y < core[3] + halo_m)
    return np.flatnonzero(near)
